//! Central moments of the last samples, without loss of precision and without drift.
//!
//! Sums of powers (Σx², Σx³, Σx⁴) fail in `f32` as soon as a signal rests on a constant such as gravity. Here each block of
//! eight samples knows its mean, as a kept sample plus a small offset, and sums of powers of deviations from that mean.
//! Longer pieces are sums of powers about the mean of *some of their own blocks*, which moves what lies between by the
//! binomial formula. The reference belongs to the piece, so it lies few deviations from its mean, and what cancels in
//! the end is bounded, whatever the signal did before.

use crate::fft::HalfFrame;
use crate::sliding::{Place, in_front};

/// Samples per block.
const BLOCK: f32 = 8.0;
/// More than a third of a window, and less than a half, in blocks.
const CENTRED: usize = 9;

/// Summary of eight samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// The first sample.
    pub first: f32,
    /// Mean less `first`.
    pub offset: f32,
    /// Σ(x − mean)².
    pub m2: f32,
    /// Σ(x − mean)³.
    pub m3: f32,
    /// Σ(x − mean)⁴.
    pub m4: f32,
}

impl Block {
    /// Of eight zeros.
    pub const ZERO: Self = Self { first: 0.0, offset: 0.0, m2: 0.0, m3: 0.0, m4: 0.0 };

    /// Of eight samples.
    #[inline(always)]
    pub fn new(samples: &HalfFrame) -> Self {
        let [d1, d2, d3, d4, d5, d6, d7] = samples.deviations;
        let offset = (((d1 + d2) + (d3 + d4)) + ((d5 + d6) + d7)) * (1.0 / BLOCK);
        // The first sample's deviation from itself is 0.
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

/// Sums over a piece, about a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sums {
    reference: f32,
    /// Σ(mean of block − reference), over blocks.
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

    /// Of nothing.
    const fn about(reference: f32) -> Self {
        Self { reference, s1: 0.0, s2: 0.0, s3: 0.0, s4: 0.0 }
    }

    /// With one more block.
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

    /// The same piece, of `blocks` blocks, about another reference.
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

    /// When a piece has grown to [`CENTRED`] blocks, its mean becomes its reference: little cancels later.
    #[inline(always)]
    fn centred(self, blocks: usize) -> Self {
        if blocks == CENTRED {
            self.moved(CENTRED as f32, self.reference + self.s1 * const { 1.0 / CENTRED as f32 })
        } else {
            self
        }
    }
}

/// The last `N` blocks, as [`crate::sliding`] explains.
#[derive(Clone, Copy, Debug)]
pub struct SlidingMoments<const N: usize> {
    blocks: [Block; N],
    /// Each block of the front and all younger ones of the front.
    front: [Sums; N],
    back: Sums,
}

impl<const N: usize> SlidingMoments<N> {
    /// Of no signal.
    pub const ZERO: Self = Self { blocks: [Block::ZERO; N], front: [Sums::ZERO; N], back: Sums::ZERO };

    /// Takes a block; gives Σ(x − mean)², ³ and ⁴ over all samples of the last `N`. `in_back` is as in
    /// [`in_front`].
    #[inline(always)]
    pub fn push(&mut self, place: Place<N>, in_back: usize, block: Block) -> (f32, f32, f32) {
        if in_back == 0 {
            self.turn(place.slot);
            self.back = Sums::about(block.first + block.offset);
        }
        self.back = self.back.with(&block).centred(in_back + 1);
        if let Some(slot) = self.blocks.get_mut(place.slot) {
            *slot = block;
        }
        let in_front = in_front::<N>(in_back);
        let all = match self.front.get(place.oldest) {
            Some(front) if in_front > 0 => {
                // About the reference of the larger part, which lies nearer to the mean.
                let (small, count, large) =
                    if in_front > N / 2 { (&self.back, N - in_front, front) } else { (front, in_front, &self.back) };
                let small = small.moved(count as f32, large.reference);
                Sums {
                    reference: large.reference,
                    s1: small.s1 + large.s1,
                    s2: small.s2 + large.s2,
                    s3: small.s3 + large.s3,
                    s4: small.s4 + large.s4,
                }
            }
            _ => self.back,
        };
        let mean = all.s1 * const { 1.0 / N as f32 };
        let sum = BLOCK * all.s1;
        let square = mean * sum;
        (
            all.s2 - square,
            all.s3 - mean * (3.0 * all.s2 - 2.0 * square),
            all.s4 - mean * (4.0 * all.s3 - mean * (6.0 * all.s2 - 3.0 * square)),
        )
    }

    /// Makes the blocks of the back the front. `slot` holds the oldest, which is about to go.
    #[inline(never)]
    fn turn(&mut self, slot: usize) {
        let newest = slot.checked_sub(1).unwrap_or(N - 1);
        let Some(newest) = self.blocks.get(newest) else { return };
        // The newest is in the front to the end.
        let mut sums = Sums::about(newest.first + newest.offset);
        let mut count = 0;
        for range in [0..slot, (slot + 1).min(N)..N] {
            let (Some(blocks), Some(front)) = (self.blocks.get(range.clone()), self.front.get_mut(range)) else { return };
            for (block, front) in blocks.iter().zip(front).rev() {
                count += 1;
                sums = sums.with(block).centred(count);
                *front = sums;
            }
        }
    }
}

/// Sum of the last samples, to about 10⁻⁹ of the unit, without drift.
///
/// A mean can be small beside the signal (a gyroscope swings about 0), so `f32` sums are too coarse for it. Each
/// sample is split without error into a multiple of 1/32 and a rest; the former add exactly, the latter are small.
/// Both enter and leave integers.
#[derive(Clone, Copy, Debug)]
pub struct SlidingSum<const BLOCKS: usize> {
    coarse: [i32; BLOCKS],
    fine: [i32; BLOCKS],
    coarse_sum: i32,
    fine_sum: i32,
}

/// Largest magnitude of a sample.
pub const SAMPLE_LIMIT: f32 = 65_536.0;

impl<const BLOCKS: usize> SlidingSum<BLOCKS> {
    /// Of zeros.
    pub const ZERO: Self = Self { coarse: [0; BLOCKS], fine: [0; BLOCKS], coarse_sum: 0, fine_sum: 0 };

    /// Replaces the block in `slot` (below `BLOCKS`) by eight samples, each at most [`SAMPLE_LIMIT`] in magnitude.
    #[inline(always)]
    pub fn replace(&mut self, slot: usize, samples: &[f32; 8]) {
        // Between 2¹⁸ and 2¹⁹ floats are multiples of 1/32.
        const SPLITTER: f32 = 393_216.0;
        let (mut coarse, mut fine) = (0.0, 0.0);
        for &sample in samples {
            let multiple = (sample + SPLITTER) - SPLITTER;
            coarse += multiple;
            fine += sample - multiple;
        }
        let (coarse, fine) = ((coarse * 32.0) as i32, (fine * FINE_STEPS) as i32);
        if let (Some(old_coarse), Some(old_fine)) = (self.coarse.get_mut(slot), self.fine.get_mut(slot)) {
            self.coarse_sum += coarse - core::mem::replace(old_coarse, coarse);
            self.fine_sum += fine - core::mem::replace(old_fine, fine);
        }
    }

    /// Sum over all blocks.
    #[inline(always)]
    pub fn sum(&self) -> f32 {
        self.coarse_sum as f32 * (1.0 / 32.0) + self.fine_sum as f32 * (1.0 / FINE_STEPS)
    }
}

/// Rests are below 1/64, so that 200 of them stay below 2³¹ steps.
const FINE_STEPS: f32 = (1u32 << 29) as f32;
