//! Thirteen features per axis of a sliding window, renewed every hop.
//!
//! Per axis, in this order: mean, RMS, population variance, skewness m₃/m₂^1.5, excess kurtosis m₄/m₂² − 3, and the
//! powers P\[0\] to P\[7\] of 16-point FFTs, P\[k\] = |X\[k\]|²/16, averaged over the 24 half-overlapping full frames of the
//! window (no window function, mean kept). The paper leaves open how 200 samples meet 16 points: this is our answer.
//!
//! | | definition |
//! |---|---|
//! | samples that are NaN | the axis holds its last good value (0 before the first); counted |
//! | magnitudes above [`SAMPLE_LIMIT`] | limited to it |
//! | constant signal | variance 0, skewness 0, kurtosis 0, powers 0 except P\[0\] |
//! | variance below [`VARIANCE_FLOOR`] | skewness 0, kurtosis 0 |
//!
//! Errors against float64 stay within 10⁻⁴ relative (10⁻⁴·max(|value|, 1) for skewness and kurtosis), for ever: sums
//! of floats are never updated by subtraction ([`crate::right::sliding`]), moments are central ([`crate::right::moments`]). A mean
//! near 0, where 200 samples cancel, is good to 10⁻⁹ of the unit instead, also beside a swing of hundreds.

use crate::right::fft::{HalfFrame, powers};
use crate::right::moments::{Block, SlidingMoments, SlidingSum};
use crate::right::powers::SlidingPowers;
use crate::right::sliding::RingPlace;

pub use crate::right::moments::SAMPLE_LIMIT;
pub use crate::right::network::FEATURES_PER_AXIS;

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
    stage: [[f32; A]; HOP],
    staged: usize,
    axes: [Axis; A],
    features: [[f32; FEATURES_PER_AXIS]; A],
    /// Number of the hop, modulo blocks per window.
    block: usize,
    /// Number of the hop, modulo frames per window.
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
    /// The last good sample.
    held: f32,
    last: HalfFrame,
    sum: SlidingSum<HOPS>,
    moments: SlidingMoments<HOPS>,
    powers: SlidingPowers<FRAMES>,
}

/// Where the samples of a hop belong.
struct HopBlocks {
    axis: usize,
    block: RingPlace<HOPS>,
    frame: RingPlace<FRAMES>,
    /// Whether its samples are known to be numbers within the limit.
    repaired: bool,
}

impl<const A: usize> FeatureWindow<A> {
    /// An empty window: all bytes are zero, so that a static one takes no flash.
    pub const fn new() -> Self {
        Self {
            stage: [[0.0; A]; HOP],
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
    #[inline]
    pub fn push(&mut self, sample: &[f32; A]) -> bool {
        if let Some(place) = self.stage.get_mut(self.staged) {
            // Element by element: a copy of the whole would become a call.
            for (place, value) in place.iter_mut().zip(*sample) {
                *place = value;
            }
        }
        self.staged += 1;
        self.staged >= HOP && self.finish_hop()
    }

    #[inline(never)]
    fn finish_hop(&mut self) -> bool {
        self.staged = 0;
        let mut replaced = 0;
        // The moments of axis i turn at hop −i, its powers half a round later: one turn per hop up to 12 axes.
        let mut round = self.frame;
        let (block, frame) = (RingPlace::new(self.block, 0), RingPlace::new(self.frame, 0));
        let mut hop = HopBlocks { axis: 0, block, frame, repaired: false };
        for (axis, features) in self.axes.iter_mut().zip(&mut self.features) {
            let opposite = if round < FRAMES / 2 { round + FRAMES / 2 } else { round - FRAMES / 2 };
            (hop.block, hop.frame) = (block.with_in_back(round), frame.with_in_back(opposite));
            replaced += axis.advance(&hop, &mut self.stage, features);
            hop.axis += 1;
            round = if round + 1 < FRAMES { round + 1 } else { 0 };
        }
        (self.block, self.frame) = (block.oldest(), frame.oldest());
        self.hops = (self.hops + 1).min(HOPS);
        self.tainted = if replaced > 0 { HOPS } else { self.tainted.saturating_sub(1) };
        self.replaced = self.replaced.saturating_add(replaced);
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

    /// Values that were NaN, up to the last complete hop since the last reset.
    pub fn replaced(&self) -> u32 {
        self.replaced
    }

    /// Whether the window holds values that were NaN and have been replaced.
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
    const ZERO: Self = Self {
        held: 0.0,
        last: HalfFrame::ZERO,
        sum: SlidingSum::ZERO,
        moments: SlidingMoments::ZERO,
        powers: SlidingPowers::ZERO,
    };

    /// Takes a hop's samples, writes the features, and returns how many samples had to be replaced.
    #[inline(never)]
    fn advance<const A: usize>(
        &mut self,
        hop: &HopBlocks,
        stage: &mut [[f32; A]; HOP],
        features: &mut [f32; FEATURES_PER_AXIS],
    ) -> u32 {
        const N: f32 = WINDOW as f32;
        const ROOT_N: f32 = 14.142_136;
        let [mean, rms, variance, skewness, kurtosis, bins @ ..] = features;
        if hop.axis >= A {
            return 0;
        }

        let samples = column(stage, hop.axis);
        let half = HalfFrame::new(&samples);
        let block = Block::new(&half);
        let block_mean = block.first + block.offset;
        // x² ≤ 2·(mean² + Σ(x − mean)²) for each x. False also if anything is NaN.
        let tame = block.m2 + block_mean * block_mean <= SAMPLE_LIMIT * SAMPLE_LIMIT / 2.0;
        if !tame && !hop.repaired {
            return self.repair_and_advance(hop, stage, features);
        }
        self.held = samples[HOP - 1];

        self.sum.push(hop.block, &samples);
        // The first frame of all is half empty; it is the one that leaves when the window becomes full.
        let powers = powers(&self.last, &half).map(|power| power * const { 1.0 / (16 * FRAMES) as f32 });
        self.last = half;
        self.powers.push(hop.frame, powers, bins);
        let (m2, m3, m4) = self.moments.push(hop.block, block);

        *mean = self.sum.mean();
        *variance = m2 * const { 1.0 / N };
        *rms = square_root(*mean * *mean + *variance);
        let shaped = *variance >= VARIANCE_FLOOR;
        *skewness = if shaped { ROOT_N * m3 / (m2 * square_root(m2)) } else { 0.0 };
        *kurtosis = if shaped { N * m4 / (m2 * m2) - 3.0 } else { 0.0 };
        0
    }

    #[cold]
    #[inline(never)]
    fn repair_and_advance<const A: usize>(
        &mut self,
        hop: &HopBlocks,
        stage: &mut [[f32; A]; HOP],
        features: &mut [f32; FEATURES_PER_AXIS],
    ) -> u32 {
        let replaced = repair(stage, hop.axis, self.held);
        self.advance(&HopBlocks { repaired: true, ..*hop }, stage, features);
        replaced
    }
}

/// The samples of one axis, below `A`.
#[inline(always)]
fn column<const A: usize>(stage: &[[f32; A]; HOP], axis: usize) -> [f32; HOP] {
    stage.each_ref().map(|sample| sample[axis])
}

/// Limits magnitudes and lets values that are NaN repeat the one before; returns how many these were.
#[cold]
#[inline(never)]
fn repair<const A: usize>(stage: &mut [[f32; A]; HOP], axis: usize, mut held: f32) -> u32 {
    let mut replaced = 0;
    for sample in stage.iter_mut().filter_map(|sample| sample.get_mut(axis)) {
        if sample.is_finite() {
            held = sample.clamp(-SAMPLE_LIMIT, SAMPLE_LIMIT);
        } else {
            replaced += 1;
        }
        *sample = held;
    }
    replaced
}

/// Correctly rounded on every target, so the same bits.
#[inline(always)]
pub(crate) fn square_root(x: f32) -> f32 {
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
