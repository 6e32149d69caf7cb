//! Index logic of a sliding window. Its pieces can be added but not subtracted.
//!
//! If a running sum subtracted the values that leave the window, rounding errors would accumulate for ever.
//! Instead, the window has two parts.
//! The *back* is the sum of all pieces since the last turn.
//! For each older piece, the *front* stores the sum of this piece and all younger pieces of the front.
//! Dropping the oldest piece therefore needs no arithmetic.
//! When the front is empty, the back becomes the front. This takes one addition per piece.
//! A step takes three additions on average, and pieces that have left the window do not affect any result.
//! Results are valid once all places have been filled with pieces.

/// The actions of one step in a window of `N` pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingPlace<const N: usize> {
    // All fields are below N. The compiler relies on this.
    slot: usize,
    oldest: usize,
    in_back: usize,
}

impl<const N: usize> RingPlace<N> {
    /// Returns the step that fills the place `slot`, which counts up modulo `N`.
    ///
    /// Before the step, `in_back` pieces are in the back.
    /// If `in_back` is 0, the window turns: all pieces except the oldest are then in the front.
    /// `in_back` counts up modulo `N` or `N` − 1. Windows that are fed together should start with different values.
    /// The turns of such windows then happen in different hops. Numbers out of range count as 0.
    #[inline(always)]
    pub fn new(slot: usize, in_back: usize) -> Self {
        const { assert!(N > 0) };
        Self {
            slot: if slot < N { slot } else { 0 },
            oldest: if slot + 1 < N { slot + 1 } else { 0 },
            in_back: if in_back < N { in_back } else { 0 },
        }
    }

    /// Returns the same step for another window with its own number of pieces in the back.
    #[inline(always)]
    pub fn with_in_back(self, in_back: usize) -> Self {
        Self { in_back: if in_back < N { in_back } else { 0 }, ..self }
    }

    /// Index of the oldest piece, which is below `N`. The new piece replaces it.
    #[inline(always)]
    pub fn slot(&self) -> usize {
        // SAFETY: `new` guarantees this, and no other code writes the field.
        unsafe { core::hint::assert_unchecked(self.slot < N) };
        self.slot
    }

    /// Index of the oldest piece after the step. The index is below `N`.
    #[inline(always)]
    pub fn oldest(&self) -> usize {
        // SAFETY: as above.
        unsafe { core::hint::assert_unchecked(self.oldest < N) };
        self.oldest
    }

    /// Number of pieces in the back before the step. The number is below `N`.
    #[inline(always)]
    pub fn in_back(&self) -> usize {
        // SAFETY: as above.
        unsafe { core::hint::assert_unchecked(self.in_back < N) };
        self.in_back
    }

    /// Number of pieces in the front after the step. The number is below `N`.
    #[inline(always)]
    pub fn in_front(&self) -> usize {
        N - 1 - self.in_back()
    }
}
