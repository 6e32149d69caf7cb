//! Central moments of pieces of a signal, and their union without loss of precision.
//!
//! Sums of powers (Σx², Σx³, Σx⁴) fail in `f32` as soon as a signal rests on a constant such as gravity.
//! Here a piece knows its mean as a kept sample plus a small offset, and sums of powers of deviations *from that
//! mean*. Two pieces unite by the formulas of Chan and Pébay, which only ever add what belongs together.

use crate::fft::HalfFrame;

/// Count-free summary of a piece; the number of samples goes beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// One of the samples (or a value near them).
    pub reference: f32,
    /// Mean less `reference`.
    pub offset: f32,
    /// Σ(x − mean)².
    pub m2: f32,
    /// Σ(x − mean)³.
    pub m3: f32,
    /// Σ(x − mean)⁴.
    pub m4: f32,
}

impl Moments {
    /// Of a signal that is 0.
    pub const ZERO: Self = Self { reference: 0.0, offset: 0.0, m2: 0.0, m3: 0.0, m4: 0.0 };

    /// Of eight samples.
    #[inline(always)]
    pub fn of_eight(samples: &HalfFrame) -> Self {
        let [d1, d2, d3, d4, d5, d6, d7] = samples.deviations;
        let offset = (((d1 + d2) + (d3 + d4)) + ((d5 + d6) + d7)) * 0.125;
        let (mut m2, mut m3, mut m4) = (0.0, 0.0, 0.0);
        for d in [0.0, d1, d2, d3, d4, d5, d6, d7] {
            let e = d - offset;
            let square = e * e;
            m2 += square;
            m3 += square * e;
            m4 += square * square;
        }
        Self { reference: samples.first, offset, m2, m3, m4 }
    }

    /// Union of a piece of `n_a` samples with one of `n_b`; `reciprocal` = 1 / (n_a + n_b).
    #[inline(always)]
    pub fn unite(a: &Self, n_a: f32, b: &Self, n_b: f32, reciprocal: f32) -> Self {
        // Difference of the means, small parts and large parts apart.
        let delta = (b.reference - a.reference) + (b.offset - a.offset);
        let (shift_a, shift_b) = (delta * (n_b * reciprocal), delta * (n_a * reciprocal));
        let (a2, a3, a4) = a.about(-shift_a, n_a);
        let (b2, b3, b4) = b.about(shift_b, n_b);
        Self { reference: a.reference, offset: a.offset + shift_a, m2: a2 + b2, m3: a3 + b3, m4: a4 + b4 }
    }

    /// Sums of powers about a point that lies `d` below the mean.
    #[inline(always)]
    fn about(&self, d: f32, count: f32) -> (f32, f32, f32) {
        let own = count * (d * d);
        let triple = 3.0 * self.m2;
        let third = triple + own;
        let fourth = 4.0 * self.m3 + d * (triple + third);
        (self.m2 + own, self.m3 + d * third, self.m4 + d * fourth)
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
