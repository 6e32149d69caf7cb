//! Sums of the powers of the last frames, without drift.
//!
//! Eight sums at a time fill half of the Cortex-M4F's floating-point registers.
//! The assembly moves them as blocks, which takes a third of the instructions that a compiler generates.
//! The two loops therefore also exist in assembly, which adds in the same order.

use crate::right::sliding::RingPlace;

/// The powers of bins 0 to 7, or a sum of such powers.
pub type Bins = [f32; 8];

/// The last `N` frames, in the structure of [`crate::right::sliding`].
#[derive(Clone, Copy, Debug)]
pub struct SlidingPowers<const N: usize> {
    slots: [Bins; N],
    back: Bins,
}

impl<const N: usize> SlidingPowers<N> {
    /// The window of a signal that is zero.
    pub const ZERO: Self = Self { slots: [[0.0; 8]; N], back: [0.0; 8] };

    /// Adds a frame and writes the sums over the last `N` frames.
    #[inline(always)]
    pub fn push(&mut self, place: RingPlace<N>, frame: Bins, sums: &mut Bins) {
        if place.in_back() == 0 {
            let (newer, older) = self.slots.split_at_mut(place.slot());
            let mut sum = [0.0; 8];
            accumulate_down(&mut sum, newer);
            if let Some((_, older)) = older.split_first_mut() {
                accumulate_down(&mut sum, older);
            }
            self.back = [0.0; 8];
        }
        self.slots[place.slot()] = frame;
        add_to(&mut self.back, &self.slots[place.slot()]);
        if place.in_front() > 0 {
            add(sums, &self.slots[place.oldest()], &self.back);
        } else {
            *sums = self.back;
        }
    }
}

/// `out` = a + b.
#[cfg(not(cortex_m4f))]
#[inline(always)]
fn add(out: &mut Bins, a: &Bins, b: &Bins) {
    *out = core::array::from_fn(|k| a[k] + b[k]);
}

/// `sum` += frame.
#[cfg(not(cortex_m4f))]
#[inline(always)]
fn add_to(sum: &mut Bins, frame: &Bins) {
    for (sum, value) in sum.iter_mut().zip(frame) {
        *sum += value;
    }
}

/// Replaces each piece, from last to first, with the sum of this piece, all later pieces and `sum`.
#[cfg(not(cortex_m4f))]
fn accumulate_down(sum: &mut Bins, pieces: &mut [Bins]) {
    for piece in pieces.iter_mut().rev() {
        for (sum, value) in sum.iter_mut().zip(piece.iter_mut()) {
            *sum += *value;
            *value = *sum;
        }
    }
}

#[cfg(cortex_m4f)]
use cortex_m4f::{accumulate_down, add, add_to};

#[cfg(cortex_m4f)]
mod cortex_m4f {
    use super::Bins;

    core::arch::global_asm!(
        ".fpu fpv4-sp-d16",
        ".section .text.bimanual_add8,\"ax\",%progbits",
        ".global bimanual_add8",
        ".type bimanual_add8,%function",
        ".thumb_func",
        // Registers: r0 = out, r1 = a, r2 = b. The caller saves s0 to s15.
        "bimanual_add8:",
        "vldmia r1, {{s0-s7}}",
        "vldmia r2, {{s8-s15}}",
        "vadd.f32 s0, s0, s8",
        "vadd.f32 s1, s1, s9",
        "vadd.f32 s2, s2, s10",
        "vadd.f32 s3, s3, s11",
        "vadd.f32 s4, s4, s12",
        "vadd.f32 s5, s5, s13",
        "vadd.f32 s6, s6, s14",
        "vadd.f32 s7, s7, s15",
        "vstmia r0, {{s0-s7}}",
        "bx lr",
        ".size bimanual_add8, . - bimanual_add8",
        ".section .text.bimanual_accumulate8,\"ax\",%progbits",
        ".global bimanual_accumulate8",
        ".type bimanual_accumulate8,%function",
        ".thumb_func",
        // Registers: r0 = sum, r1 = behind the last piece, r2 = number of pieces (at least 1).
        "bimanual_accumulate8:",
        "vldmia r0, {{s0-s7}}",
        "1:",
        "vldmdb r1!, {{s8-s15}}",
        "vadd.f32 s0, s0, s8",
        "vadd.f32 s1, s1, s9",
        "vadd.f32 s2, s2, s10",
        "vadd.f32 s3, s3, s11",
        "vadd.f32 s4, s4, s12",
        "vadd.f32 s5, s5, s13",
        "vadd.f32 s6, s6, s14",
        "vadd.f32 s7, s7, s15",
        "vstmia r1, {{s0-s7}}",
        "subs r2, #1",
        "bne 1b",
        "vstmia r0, {{s0-s7}}",
        "bx lr",
        ".size bimanual_accumulate8, . - bimanual_accumulate8",
        ".text",
    );

    unsafe extern "C" {
        fn bimanual_add8(out: *mut Bins, a: *const Bins, b: *const Bins);
        fn bimanual_accumulate8(sum: *mut Bins, end: *mut Bins, pieces: usize);
    }

    #[inline(always)]
    pub(super) fn add(out: &mut Bins, a: &Bins, b: &Bins) {
        // SAFETY: the routine reads eight floats at `a` and `b`, writes eight at `out`, and follows the call standard.
        unsafe { bimanual_add8(out, a, b) }
    }

    #[inline(always)]
    pub(super) fn add_to(sum: &mut Bins, frame: &Bins) {
        // SAFETY: as in the function above; the routine reads everything before it writes.
        unsafe { bimanual_add8(sum, sum, frame) }
    }

    pub(super) fn accumulate_down(sum: &mut Bins, pieces: &mut [Bins]) {
        if !pieces.is_empty() {
            // SAFETY: the routine reads and writes `pieces.len()` blocks of eight floats before the end of `pieces`.
            unsafe { bimanual_accumulate8(sum, pieces.as_mut_ptr_range().end, pieces.len()) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn sums_are_of_the_last_frames_whenever_the_window_turns() {
        for turn in 0..5 {
            let mut window = SlidingPowers::<5>::ZERO;
            let mut all: Vec<f32> = Vec::new();
            for step in 0..24 {
                // Each frame has its own bit, so a sum shows which frames are in it.
                let value = (1u32 << step) as f32;
                all.push(value);
                let mut sums = [0.0; 8];
                window.push(RingPlace::new(step % 5, (step + turn) % 5), [value; 8], &mut sums);
                if step >= 4 {
                    let expected: f32 = all[all.len() - 5..].iter().sum();
                    assert_eq!(sums, [expected; 8], "turn {turn}, step {step}");
                }
            }
        }
    }
}
