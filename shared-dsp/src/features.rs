//! Thirteen features per axis of a sliding window, renewed every hop.
//!
//! Per axis, in this order: mean, RMS, population variance, skewness m₃/m₂^1.5, excess kurtosis m₄/m₂² − 3, and the
//! powers P\[0\] to P\[7\] of 16-point FFTs, P\[k\] = |X\[k\]|²/16, averaged over the 24 half-overlapping full frames of the
//! window (no window function, mean kept). The paper leaves open how 200 samples meet 16 points: this is our answer.
//!
//! | | definition |
//! |---|---|
//! | samples that are no numbers | the axis holds its last good value (0 before the first); counted |
//! | magnitudes above [`SAMPLE_LIMIT`] | limited to it |
//! | constant signal | variance 0, skewness 0, kurtosis 0, powers 0 except P\[0\] |
//! | variance below [`VARIANCE_FLOOR`] | skewness 0, kurtosis 0 |
//!
//! Errors against float64 stay within 10⁻⁴ relative (10⁻⁴·max(|value|, 1) for skewness and kurtosis), for ever: sums
//! of floats are never updated by subtraction ([`crate::sliding`]), moments are central ([`crate::moments`]). The mean is
//! good to 10⁻⁹ of the unit, also beside a swing of hundreds.

use crate::fft::{HalfFrame, powers};
use crate::moments::{Moments, SlidingSum};
use crate::sliding::{Piece, Sliding};

pub use crate::mlp::FEATURES_PER_AXIS;
pub use crate::moments::SAMPLE_LIMIT;

/// Samples per window.
pub const WINDOW: usize = 200;
/// Samples per hop: half an FFT frame.
pub const HOP: usize = 8;
/// Hops per window.
pub const HOPS: usize = WINDOW / HOP;
/// Full frames of 16 samples per window.
const FRAMES: usize = HOPS - 1;
/// Variance below which a signal counts as constant in shape: a deviation of 10⁻⁸.
pub const VARIANCE_FLOOR: f32 = 1e-16;

/// A window over samples of `A` axes.
#[derive(Clone, Debug)]
pub struct FeatureWindow<const A: usize> {
    /// Samples of the hop under way.
    stage: [[f32; HOP]; A],
    staged: usize,
    axes: [Axis; A],
    features: [[f32; FEATURES_PER_AXIS]; A],
    /// Slot of the next block of 8 samples, 0 to 24.
    block: usize,
    /// Slot of the next frame, 0 to 23.
    frame: usize,
    /// Hops since the last reset, at most those of a window.
    hops: usize,
    replaced: u32,
    /// Hops until the last replaced value has left the window.
    tainted: usize,
}

/// What the window keeps of one axis.
#[derive(Clone, Copy, Debug)]
struct Axis {
    last: HalfFrame,
    sum: SlidingSum<HOPS>,
    moments: Sliding<Moments, HOPS>,
    powers: Sliding<Powers, FRAMES>,
}

/// Where a hop belongs in the queues of an axis.
#[derive(Clone, Copy)]
struct Slots {
    block: usize,
    frame: usize,
    /// When the queues turn: differs between the axes.
    turn: usize,
}

/// From one axis to the next. No divisor of 24, so that 24 axes have different turns.
const TURN_STEP: usize = 11;

#[derive(Clone, Copy, Debug)]
struct Powers([f32; 8]);

impl Piece for Powers {
    const ZERO: Self = Self([0.0; 8]);

    #[inline(always)]
    fn unite(older: &Self, _: usize, newer: &Self, _: usize) -> Self {
        Self(core::array::from_fn(|k| older.0[k] + newer.0[k]))
    }
}

impl Piece for Moments {
    const ZERO: Self = Self::ZERO;

    #[inline(always)]
    fn unite(older: &Self, older_count: usize, newer: &Self, newer_count: usize) -> Self {
        let reciprocal = RECIPROCALS[(older_count + newer_count) % RECIPROCALS.len()];
        Moments::unite(older, (older_count * HOP) as f32, newer, (newer_count * HOP) as f32, reciprocal)
    }
}

/// 1 / samples of so many hops.
const RECIPROCALS: [f32; HOPS + 1] = {
    let mut table = [0.0; HOPS + 1];
    let mut hops = 1;
    while hops <= HOPS {
        table[hops] = 1.0 / (hops * HOP) as f32;
        hops += 1;
    }
    table
};

impl<const A: usize> FeatureWindow<A> {
    /// An empty window.
    pub const fn new() -> Self {
        Self {
            stage: [[0.0; HOP]; A],
            staged: 0,
            axes: [Axis::ZERO; A],
            features: [[0.0; FEATURES_PER_AXIS]; A],
            block: 0,
            frame: 0,
            hops: 0,
            replaced: 0,
            tainted: 0,
        }
    }

    /// Takes a sample; true when a hop is complete and the window is full: then [`Self::features`] are new.
    pub fn push(&mut self, sample: &[f32; A]) -> bool {
        let at = self.staged % HOP;
        for (stage, &value) in self.stage.iter_mut().zip(sample) {
            let magnitude = value.to_bits() & 0x7FFF_FFFF;
            stage[at] = if magnitude <= SAMPLE_LIMIT.to_bits() {
                value
            } else if magnitude <= f32::INFINITY.to_bits() - 1 {
                SAMPLE_LIMIT.copysign(value)
            } else {
                self.replaced = self.replaced.saturating_add(1);
                self.tainted = HOPS + 1;
                stage[(at + HOP - 1) % HOP]
            };
        }
        self.staged = at + 1;
        self.staged == HOP && self.finish_hop()
    }

    fn finish_hop(&mut self) -> bool {
        let mut turn = 0;
        for ((axis, stage), features) in self.axes.iter_mut().zip(&self.stage).zip(&mut self.features) {
            axis.advance(stage, Slots { block: self.block, frame: self.frame, turn }, features);
            // The queues of the axes turn at different hops, to spread the work.
            turn = if turn + TURN_STEP >= FRAMES { turn + TURN_STEP - FRAMES } else { turn + TURN_STEP };
        }
        self.block = if self.block + 1 == HOPS { 0 } else { self.block + 1 };
        self.frame = if self.frame + 1 == FRAMES { 0 } else { self.frame + 1 };
        self.hops = (self.hops + 1).min(HOPS);
        self.tainted = self.tainted.saturating_sub(1);
        self.is_full()
    }

    /// Features of the window at the last complete hop, meaningless before the window was full.
    pub fn features(&self) -> &[[f32; FEATURES_PER_AXIS]; A] {
        &self.features
    }

    /// Whether the window has been filled since the last reset.
    pub fn is_full(&self) -> bool {
        self.hops == HOPS
    }

    /// Values that were no numbers, since the last reset.
    pub fn replaced(&self) -> u32 {
        self.replaced
    }

    /// Whether the window holds values that were no numbers and have been replaced.
    pub fn is_tainted(&self) -> bool {
        self.tainted > 0
    }

    /// Forgets all samples.
    pub fn reset(&mut self) {
        *self = Self::new();
    }
}

impl<const A: usize> Default for FeatureWindow<A> {
    fn default() -> Self {
        Self::new()
    }
}

impl Axis {
    const ZERO: Self =
        Self { last: HalfFrame::ZERO, sum: SlidingSum::ZERO, moments: Sliding::ZERO, powers: Sliding::ZERO };

    #[inline(never)]
    fn advance(
        &mut self,
        samples: &[f32; HOP],
        Slots { block, frame, turn }: Slots,
        features: &mut [f32; FEATURES_PER_AXIS],
    ) {
        self.sum.replace(block, samples);
        let half = HalfFrame::new(samples);
        let moments = self.moments.push(block, turn, Moments::of_eight(&half));
        // The first frame of all is half empty; it is the one that leaves when the window becomes full.
        let powers = self.powers.push(frame, turn, Powers(powers(&self.last, &half)));
        self.last = half;

        const N: f32 = WINDOW as f32;
        const ROOT_N: f32 = 14.142_136;
        let mean = self.sum.sum() * (1.0 / N);
        let variance = moments.m2 * (1.0 / N);
        features[0] = mean;
        features[1] = square_root(mean * mean + variance);
        features[2] = variance;
        if variance >= VARIANCE_FLOOR {
            features[3] = ROOT_N * moments.m3 / (moments.m2 * square_root(moments.m2));
            features[4] = N * moments.m4 / (moments.m2 * moments.m2) - 3.0;
        } else {
            features[3] = 0.0;
            features[4] = 0.0;
        }
        for (feature, power) in features[5..].iter_mut().zip(powers.0) {
            *feature = power * (1.0 / (16 * FRAMES) as f32);
        }
    }
}

/// Correctly rounded on every target, so the same bits.
#[inline(always)]
fn square_root(x: f32) -> f32 {
    #[cfg(cortex_m4f)]
    {
        let root: u32;
        // SAFETY: computes in a register that it restores, and needs an FPU, which this target has.
        unsafe {
            core::arch::asm!(
                "vmov s0, {0}",
                "vsqrt.f32 s0, s0",
                "vmov {0}, s0",
                inout(reg) x.to_bits() => root,
                out("s0") _,
                options(pure, nomem, nostack, preserves_flags)
            );
        }
        f32::from_bits(root)
    }
    #[cfg(not(cortex_m4f))]
    libm::sqrtf(x)
}
