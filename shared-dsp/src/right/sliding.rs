//! The places in a sliding window over pieces that can be joined but not subtracted.
//!
//! Subtracting what leaves a window from a running sum leaves rounding errors behind, for ever. Instead the
//! window is held in two parts. The *back* is the sum of what arrived since the last turn. The *front* holds, for each
//! older piece, the sum of it and of all younger pieces of the front, so dropping the oldest is free. When the front
//! is used up the back becomes the front, one addition per piece. So a step takes three additions on average, and
//! nothing that has left the window touches a result. Results have meaning once all places have been filled.

/// What happens to a window of `N` pieces in one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingPlace<const N: usize> {
    // All below N: the compiler relies on it.
    slot: usize,
    oldest: usize,
    in_back: usize,
}

impl<const N: usize> RingPlace<N> {
    /// Place of a step that fills `slot`, which counts up modulo `N`.
    ///
    /// Before the step `in_back` pieces are in the back. At 0 the window turns: all pieces but the oldest are the
    /// front now. It counts up modulo `N` or `N` − 1; windows that are fed together should differ in it, so that their
    /// turns do not come together. Numbers out of range count as 0.
    #[inline(always)]
    pub fn new(slot: usize, in_back: usize) -> Self {
        const { assert!(N > 0) };
        Self {
            slot: if slot < N { slot } else { 0 },
            oldest: if slot + 1 < N { slot + 1 } else { 0 },
            in_back: if in_back < N { in_back } else { 0 },
        }
    }

    /// The same step of another window, with its own count of pieces in the back.
    #[inline(always)]
    pub fn with_in_back(self, in_back: usize) -> Self {
        Self { in_back: if in_back < N { in_back } else { 0 }, ..self }
    }

    /// Holds the oldest piece, which the new one replaces; below `N`.
    #[inline(always)]
    pub fn slot(&self) -> usize {
        // SAFETY: `new` sees to it, and nothing else writes the field.
        unsafe { core::hint::assert_unchecked(self.slot < N) };
        self.slot
    }

    /// Holds the oldest piece after the step; below `N`.
    #[inline(always)]
    pub fn oldest(&self) -> usize {
        // SAFETY: as above.
        unsafe { core::hint::assert_unchecked(self.oldest < N) };
        self.oldest
    }

    /// Pieces in the back before the step; below `N`.
    #[inline(always)]
    pub fn in_back(&self) -> usize {
        // SAFETY: as above.
        unsafe { core::hint::assert_unchecked(self.in_back < N) };
        self.in_back
    }

    /// Pieces in the front after the step; below `N`.
    #[inline(always)]
    pub fn in_front(&self) -> usize {
        N - 1 - self.in_back()
    }
}
