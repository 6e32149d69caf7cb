//! Where things stand in a sliding window over pieces that can be united but not subtracted.
//!
//! Subtracting what leaves a window from a running sum leaves rounding errors behind, for ever. Instead the
//! window is held in two parts. The *back* is the sum of what arrived since the last turn. The *front* holds, for each
//! older piece, the sum of it and of all younger pieces of the front, so dropping the oldest is free. When the front
//! is used up the back becomes the front, one addition per piece. So a step takes three additions on average, and
//! nothing that has left the window touches a result. Results have meaning once all places have been filled.

/// What happens to a window of `N` pieces in one step, but for how many pieces are in the back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place<const N: usize> {
    /// Holds the oldest piece, which the new one replaces.
    pub slot: usize,
    /// The slot that holds the oldest piece after the step.
    pub oldest: usize,
}

impl<const N: usize> Place<N> {
    /// Place of the step that fills `slot`, below `N`.
    #[inline(always)]
    pub fn new(slot: usize) -> Self {
        Self { slot, oldest: if slot + 1 >= N { 0 } else { slot + 1 } }
    }
}

/// Pieces in the front after a step before which `in_back` were in the back. There, 0 means that the window turns: all
/// pieces but the oldest are the front now. `in_back` counts up, modulo `N` or `N` − 1. Windows that are fed together
/// should differ in it, so that their turns do not come together.
#[inline(always)]
pub fn in_front<const N: usize>(in_back: usize) -> usize {
    (N - 1).saturating_sub(in_back)
}
