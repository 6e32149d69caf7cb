//! Central moments of the last samples, computed without loss of precision and without drift.
//!
//! Sums of powers (Σx², Σx³, Σx⁴) lose their precision in `f32` if the signal has a constant part such as gravity.
//! Here, each block of eight samples stores its mean (as one sample plus a small offset).
//! The block also stores power sums of the deviations from that mean.
//! Longer pieces store power sums about a reference, which is the mean of *some of their own blocks*.
//! The binomial formula converts sums from one reference to another.
//! The reference is within a few deviations of the piece's mean, so the final cancellation is limited for any signal.

use crate::right::fft::HalfFrame;
use crate::right::sliding::RingPlace;

/// Samples per block.
const BLOCK: f32 = 8.0;
/// A number of blocks that is between a third and a half of a window.
const CENTRED: usize = 9;

/// Power sums of one block of eight samples.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Block {
    /// The first sample.
    pub first: f32,
    /// Mean minus `first`.
    pub offset: f32,
    /// Σ(x − mean)².
    pub m2: f32,
    /// Σ(x − mean)³.
    pub m3: f32,
    /// Σ(x − mean)⁴.
    pub m4: f32,
}

impl Block {
    /// The block that contains eight zeros.
    pub const ZERO: Self = Self { first: 0.0, offset: 0.0, m2: 0.0, m3: 0.0, m4: 0.0 };

    /// Computes the block of eight samples.
    #[inline(always)]
    pub fn new(samples: &HalfFrame) -> Self {
        let [d1, d2, d3, d4, d5, d6, d7] = samples.deviations;
        let offset = (((d1 + d2) + (d3 + d4)) + ((d5 + d6) + d7)) * (1.0 / BLOCK);
        // The deviation of the first sample from itself is 0.
        let square = offset * offset;
        let (mut m2, mut m3, mut m4) = (square, -(square * offset), square * square);
        for d in [d1, d2, d3, d4, d5, d6, d7] {
            let e = d - offset;
            let square = e * e;
            m2 += square;
            m3 += square * e;
            m4 += square * square;
        }
        Self { first: samples.first, offset, m2, m3, m4 }
    }
}

/// Power sums over a piece about a reference value.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
struct Sums {
    reference: f32,
    /// Σ(mean of block − reference), summed over the blocks.
    s1: f32,
    /// Σ(x − reference)², over samples.
    s2: f32,
    /// Σ(x − reference)³.
    s3: f32,
    /// Σ(x − reference)⁴.
    s4: f32,
}

impl Sums {
    const ZERO: Self = Self::about(0.0);

    /// The sums of an empty piece.
    const fn about(reference: f32) -> Self {
        Self { reference, s1: 0.0, s2: 0.0, s3: 0.0, s4: 0.0 }
    }

    /// Adds one block to the piece.
    #[inline(always)]
    fn with(&self, block: &Block) -> Self {
        let t = (block.first - self.reference) + block.offset;
        let own = BLOCK * (t * t);
        let triple = 3.0 * block.m2;
        let third = triple + own;
        let fourth = 4.0 * block.m3 + t * (triple + third);
        Self {
            reference: self.reference,
            s1: self.s1 + t,
            s2: self.s2 + (block.m2 + own),
            s3: self.s3 + (block.m3 + t * third),
            s4: self.s4 + (block.m4 + t * fourth),
        }
    }

    /// Converts a piece of `blocks` blocks to another reference.
    #[inline(always)]
    fn moved(&self, blocks: f32, reference: f32) -> Self {
        let t = self.reference - reference;
        let step = blocks * t;
        let (sum, own) = (BLOCK * self.s1, BLOCK * step);
        let third = 3.0 * self.s2 + t * (3.0 * sum + own);
        let fourth = 4.0 * self.s3 + t * (6.0 * self.s2 + t * (4.0 * sum + own));
        Self {
            reference,
            s1: self.s1 + step,
            s2: self.s2 + t * (2.0 * sum + own),
            s3: self.s3 + t * third,
            s4: self.s4 + t * fourth,
        }
    }

    /// When a piece has [`CENTRED`] blocks, the mean of the piece becomes the value that is subtracted from later samples.
    /// This keeps cancellation small.
    #[inline(always)]
    fn centred(self, blocks: usize) -> Self {
        if blocks == CENTRED {
            self.moved(CENTRED as f32, self.reference + self.s1 * const { 1.0 / CENTRED as f32 })
        } else {
            self
        }
    }
}

/// The last `N` blocks, in the structure of [`crate::right::sliding`].
#[derive(Clone, Copy, Debug)]
pub struct SlidingMoments<const N: usize> {
    blocks: [Block; N],
    /// For each block of the front, the sums over this block and all younger blocks of the front.
    front: [Sums; N],
    back: Sums,
}

impl<const N: usize> SlidingMoments<N> {
    /// The window of a signal that is zero.
    pub const ZERO: Self = Self { blocks: [Block::ZERO; N], front: [Sums::ZERO; N], back: Sums::ZERO };

    /// Adds a block. Returns Σ(x − mean)², ³ and ⁴ over all samples of the last `N` blocks.
    #[inline(always)]
    pub fn push(&mut self, place: RingPlace<N>, block: Block) -> (f32, f32, f32) {
        if place.in_back() == 0 {
            self.turn(place.slot());
            self.back = Sums::about(block.first + block.offset);
        }
        let in_back = place.in_back() + 1;
        self.back = self.back.with(&block).centred(in_back);
        self.blocks[place.slot()] = block;
        let mut all = self.back;
        if in_back < N {
            // Uses the reference of the larger part, because it is closer to the mean.
            let (front, back) = (&self.front[place.oldest()], &self.back);
            let (small, count, large) =
                if in_back < N / 2 { (back, in_back, front) } else { (front, N - in_back, back) };
            let small = small.moved(count as f32, large.reference);
            all = Sums {
                reference: large.reference,
                s1: small.s1 + large.s1,
                s2: small.s2 + large.s2,
                s3: small.s3 + large.s3,
                s4: small.s4 + large.s4,
            };
        }
        let mean = all.s1 * const { 1.0 / N as f32 };
        let sum = BLOCK * all.s1;
        let square = mean * sum;
        (
            all.s2 - square,
            all.s3 - mean * (3.0 * all.s2 - 2.0 * square),
            all.s4 - mean * (4.0 * all.s3 - mean * (6.0 * all.s2 - 3.0 * square)),
        )
    }

    /// Moves the blocks of the back to the front. `slot` is the oldest block, which is about to be dropped.
    #[inline(never)]
    fn turn(&mut self, slot: usize) {
        let newest = slot.checked_sub(1).unwrap_or(N - 1);
        let Some(newest) = self.blocks.get(newest) else { return };
        // The newest block stays in the front until the end.
        let mut sums = Sums::about(newest.first + newest.offset);
        let mut to_centre = CENTRED;
        for (start, mut end) in [(0, slot), (slot + 1, N)] {
            while start < end {
                let from = end - to_centre.min(end - start);
                let (Some(blocks), Some(front)) = (self.blocks.get(from..end), self.front.get_mut(from..end))
                else {
                    return;
                };
                accumulate_down(&mut sums, blocks, front);
                to_centre -= front.len();
                if to_centre == 0 {
                    sums = sums.centred(CENTRED);
                    front[0] = sums;
                    to_centre = N;
                }
                end = from;
            }
        }
    }
}

/// Adds blocks from the last to the first, and writes the sums after each block.
#[cfg(not(cortex_m4f))]
fn accumulate_down(sums: &mut Sums, blocks: &[Block], front: &mut [Sums]) {
    for (block, front) in blocks.iter().zip(front).rev() {
        *sums = sums.with(block);
        *front = *sums;
    }
}

#[cfg(cortex_m4f)]
use cortex_m4f::accumulate_down;

#[cfg(cortex_m4f)]
mod cortex_m4f {
    use super::{Block, Sums};

    core::arch::global_asm!(
        ".fpu fpv4-sp-d16",
        ".section .text.bimanual_moments,\"ax\",%progbits",
        ".global bimanual_moments",
        ".type bimanual_moments,%function",
        ".thumb_func",
        // Registers: r0 = sums, r1 and r2 = behind the last block and front, r3 = number of blocks (at least 1).
        "bimanual_moments:",
        "vldmia r0, {{s0-s4}}", // reference, s1 to s4
        "vmov.f32 s5, #3.0",
        "vmov.f32 s6, #4.0",
        "vmov.f32 s7, #8.0",
        "1:",
        "vldmdb r1!, {{s8-s12}}", // first, offset, m2, m3, m4
        "vsub.f32 s13, s8, s0",
        "vadd.f32 s13, s13, s9", // t
        "vmul.f32 s14, s13, s13",
        "vmul.f32 s14, s7, s14", // own
        "vmul.f32 s15, s5, s10", // triple
        "vadd.f32 s8, s15, s14", // third
        "vadd.f32 s9, s15, s8",
        "vmul.f32 s9, s13, s9",
        "vmul.f32 s15, s6, s11",
        "vadd.f32 s9, s15, s9", // fourth
        "vadd.f32 s1, s1, s13",
        "vadd.f32 s10, s10, s14",
        "vadd.f32 s2, s2, s10",
        "vmul.f32 s8, s13, s8",
        "vadd.f32 s8, s11, s8",
        "vadd.f32 s3, s3, s8",
        "vmul.f32 s9, s13, s9",
        "vadd.f32 s9, s12, s9",
        "vadd.f32 s4, s4, s9",
        "vstmdb r2!, {{s0-s4}}",
        "subs r3, #1",
        "bne 1b",
        "vstmia r0, {{s0-s4}}",
        "bx lr",
        ".size bimanual_moments, . - bimanual_moments",
        ".text",
    );

    unsafe extern "C" {
        fn bimanual_moments(sums: *mut Sums, blocks_end: *const Block, front_end: *mut Sums, count: usize);
    }

    /// Performs the same operations as the portable version in the same order.
    /// Unlike that version, it keeps all values in registers.
    pub(super) fn accumulate_down(sums: &mut Sums, blocks: &[Block], front: &mut [Sums]) {
        let count = blocks.len().min(front.len());
        if count > 0 {
            let (blocks, front) = (&blocks[..count], &mut front[..count]);
            // SAFETY: the routine reads `count` blocks of five floats. It writes `count` sums of five floats before the given ends.
            unsafe { bimanual_moments(sums, blocks.as_ptr_range().end, front.as_mut_ptr_range().end, count) }
        }
    }
}

/// Sum of the last samples, with an error of about 10⁻⁹ of the unit and without drift.
///
/// A mean can be much smaller than the signal (a gyroscope oscillates about 0), so `f32` sums are not precise enough.
/// Each sample is split exactly into a multiple of 1/32 and a remainder.
/// The sums of the multiples are exact, and the remainders are small.
/// The multiples and remainders are integers.
#[derive(Clone, Copy, Debug)]
pub struct SlidingSum<const BLOCKS: usize> {
    coarse: [i32; BLOCKS],
    fine: [i32; BLOCKS],
    coarse_sum: i32,
    fine_sum: i32,
}

/// Maximum magnitude of a sample.
pub const SAMPLE_LIMIT: f32 = 65_536.0;

impl<const BLOCKS: usize> SlidingSum<BLOCKS> {
    /// The window of zeros.
    pub const ZERO: Self = Self { coarse: [0; BLOCKS], fine: [0; BLOCKS], coarse_sum: 0, fine_sum: 0 };

    /// Replaces the oldest block with eight samples, whose magnitudes are at most [`SAMPLE_LIMIT`].
    #[inline(always)]
    pub fn push(&mut self, place: RingPlace<BLOCKS>, samples: &[f32; 8]) {
        // Between 2¹⁸ and 2¹⁹, floats are multiples of 1/32.
        const SPLITTER: f32 = 393_216.0;
        let split = |sample: f32| {
            let multiple = (sample + SPLITTER) - SPLITTER;
            (multiple, sample - multiple)
        };
        let [first, rest @ ..] = *samples;
        let (mut coarse, mut fine) = split(first);
        for sample in rest {
            let (multiple, rest) = split(sample);
            coarse += multiple;
            fine += rest;
        }
        let (coarse, fine) = ((coarse * 32.0) as i32, (fine * FINE_STEPS) as i32);
        self.coarse_sum += coarse - core::mem::replace(&mut self.coarse[place.slot()], coarse);
        self.fine_sum += fine - core::mem::replace(&mut self.fine[place.slot()], fine);
    }

    /// Mean over all blocks.
    #[inline(always)]
    pub fn mean(&self) -> f32 {
        self.coarse_sum as f32 * const { 1.0 / 32.0 / (8 * BLOCKS) as f32 }
            + self.fine_sum as f32 * const { 1.0 / FINE_STEPS / (8 * BLOCKS) as f32 }
    }
}

/// The remainders are below 1/64, so 200 of them stay below 2³¹ steps.
const FINE_STEPS: f32 = (1u32 << 29) as f32;
