//! The two hands.

use core::fmt;
use core::ops::{Index, IndexMut};

/// The left or the right hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Hand {
    /// The hand whose tilts and bends drive the base.
    Left,
    /// The hand whose gestures move the arm.
    Right,
}

impl Hand {
    /// Both hands, in the order left, right.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

impl fmt::Display for Hand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Hand::Left => "left",
            Hand::Right => "right",
        })
    }
}

/// A pair of values, one for each hand: `values[Hand::Left]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PerHand<T> {
    /// The value that belongs to the left hand.
    pub left: T,
    /// The value that belongs to the right hand.
    pub right: T,
}

impl<T> PerHand<T> {
    /// Calls `make` for each hand.
    pub fn of(mut make: impl FnMut(Hand) -> T) -> Self {
        Self { left: make(Hand::Left), right: make(Hand::Right) }
    }

    /// Iterates over both hands and their values.
    pub fn iter(&self) -> impl Iterator<Item = (Hand, &T)> {
        [(Hand::Left, &self.left), (Hand::Right, &self.right)].into_iter()
    }

    /// Returns mutable references to both values.
    pub fn values_mut(&mut self) -> [&mut T; 2] {
        [&mut self.left, &mut self.right]
    }

    /// Applies `make` to each value.
    pub fn map<U>(self, mut make: impl FnMut(T) -> U) -> PerHand<U> {
        PerHand { left: make(self.left), right: make(self.right) }
    }
}

/// Converts an array with the values in the order left, right.
impl<T> From<[T; 2]> for PerHand<T> {
    fn from([left, right]: [T; 2]) -> Self {
        Self { left, right }
    }
}

impl<T> Index<Hand> for PerHand<T> {
    type Output = T;

    fn index(&self, hand: Hand) -> &T {
        match hand {
            Hand::Left => &self.left,
            Hand::Right => &self.right,
        }
    }
}

impl<T> IndexMut<Hand> for PerHand<T> {
    fn index_mut(&mut self, hand: Hand) -> &mut T {
        match hand {
            Hand::Left => &mut self.left,
            Hand::Right => &mut self.right,
        }
    }
}
