//! A sliding window over pieces that can be united but not subtracted.
//!
//! Subtracting what leaves a window from a running sum leaves rounding errors behind, for ever. Instead the
//! window is held in two parts. The *back* unites what arrived since the last turn. The *front* holds, for each
//! older piece, the union of it and all younger pieces of the front, so dropping the oldest is free. When the front is
//! used up the back becomes the front, one union per piece. So a step takes three unions on average, and nothing that
//! has left the window touches a result.

/// What can be united, in order of time.
pub trait Piece: Copy {
    /// Anything finite, for places not filled yet.
    const ZERO: Self;
    /// Union of `older_count` older pieces with `newer_count` newer ones.
    fn unite(older: &Self, older_count: usize, newer: &Self, newer_count: usize) -> Self;
}

/// The last `N` pieces.
#[derive(Clone, Copy, Debug)]
pub struct Sliding<T, const N: usize> {
    /// Back: pieces. Front: unions with all younger ones of the front.
    slots: [T; N],
    back: T,
}

impl<T: Piece, const N: usize> Sliding<T, N> {
    /// A window of zeros.
    pub const ZERO: Self = Self { slots: [T::ZERO; N], back: T::ZERO };

    /// Replaces the oldest piece, which stands in `slot`, and returns the union of all `N`.
    ///
    /// Slots come in turn, beginning with 0; the result has meaning once all have been filled. The back becomes
    /// the front when `slot` is `turn`, always the same number below `N`. Windows that are fed together should differ in
    /// it, so that this work does not come together.
    #[inline(always)]
    pub fn push(&mut self, slot: usize, turn: usize, piece: T) -> T {
        let in_back = if slot < turn { slot + N - turn } else { slot - turn };
        if in_back == 0 {
            self.turn(slot);
            self.back = piece;
        } else {
            self.back = T::unite(&self.back, in_back, &piece, 1);
        }
        let in_back = in_back + 1;
        if let Some(place) = self.slots.get_mut(slot) {
            *place = piece;
        }
        let oldest = if slot + 1 == N { 0 } else { slot + 1 };
        match self.slots.get(oldest) {
            Some(front) if in_back < N => T::unite(front, N - in_back, &self.back, in_back),
            _ => self.back,
        }
    }

    /// Makes the pieces of the back the front. `slot` holds the oldest, which is about to go.
    #[inline(never)]
    fn turn(&mut self, slot: usize) {
        let mut newer = slot.checked_sub(1).unwrap_or(N - 1);
        for count in 1..N - 1 {
            let older = newer.checked_sub(1).unwrap_or(N - 1);
            if let (Some(&old), Some(new)) = (self.slots.get(older), self.slots.get(newer)) {
                self.slots[older] = T::unite(&old, 1, new, count);
            }
            newer = older;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn the_union_is_always_of_the_last_pieces_whenever_the_turns_come() {
        for turn in 0..5 {
            let mut window = Sliding::<Sum, 5>::ZERO;
            let mut all: Vec<u64> = Vec::new();
            for step in 0..40u64 {
                let value = 1 << step;
                all.push(value);
                let got = window.push(step as usize % 5, turn, Sum(value));
                if step >= 4 {
                    let expected: u64 = all[all.len() - 5..].iter().sum();
                    assert_eq!(got.0, expected, "turn {turn}, step {step}");
                }
            }
        }
    }

    #[derive(Clone, Copy)]
    struct Sum(u64);

    impl Piece for Sum {
        const ZERO: Self = Self(0);
        fn unite(older: &Self, _: usize, newer: &Self, _: usize) -> Self {
            assert_eq!(older.0 & newer.0, 0, "no piece counts twice");
            Self(older.0 + newer.0)
        }
    }
}
