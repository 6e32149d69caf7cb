//! Where things stand in a sliding window over pieces that can be united but not subtracted.
//!
//! Subtracting what leaves a window from a running sum leaves rounding errors behind, for ever. Instead the
//! window is held in two parts. The *back* is the sum of what arrived since the last turn. The *front* holds, for each
//! older piece, the sum of it and of all younger pieces of the front, so dropping the oldest is free. When the front
//! is used up the back becomes the front, one addition per piece. So a step takes three additions on average, and
//! nothing that has left the window touches a result.

/// What happens to a window of `N` pieces in one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place<const N: usize> {
    /// Holds the oldest piece, which the new one replaces.
    pub slot: usize,
    /// Pieces in the back before the step. At 0 the window turns: all but the oldest are the front now.
    pub in_back: usize,
    /// The slot that holds the oldest piece after the step.
    pub oldest: usize,
    /// Pieces in the front after the step.
    pub in_front: usize,
}

impl<const N: usize> Place<N> {
    /// Place of a step that fills `slot`. Slots come in turn, modulo `N`. `in_back` counts up, modulo `N` or `N` − 1; windows
    /// that are fed together should differ in it, so that their turns do not come together.
    ///
    /// Results have meaning once all slots have been filled.
    #[inline(always)]
    pub fn new(slot: usize, in_back: usize) -> Self {
        Self {
            slot,
            in_back,
            oldest: if slot + 1 >= N { 0 } else { slot + 1 },
            in_front: (N - 1).saturating_sub(in_back),
        }
    }
}
