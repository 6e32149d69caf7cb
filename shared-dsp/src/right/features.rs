//! Computes thirteen features per axis of a sliding window, once per hop.
//!
//! The first five features of an axis are mean, RMS, population variance, skewness m₃/m₂^1.5 and excess kurtosis m₄/m₂² − 3.
//! The next eight features are the powers P\[0\] to P\[7\] of 16-point FFTs, P\[k\] = |X\[k\]|²/16.
//! The powers are averaged over the 24 full half-overlapping frames of the window.
//! There is no window function, and the mean is included.
//! The paper does not define how 200 samples are split into frames of 16 points, so this split is our choice.
//!
//! | case | definition |
//! |---|---|
//! | NaN samples | replaced with the axis' last valid value (0 before the first one) and counted |
//! | magnitudes above [`SAMPLE_LIMIT`] | reduced to this limit |
//! | constant signal | variance 0, skewness 0, kurtosis 0, powers 0 except P\[0\] |
//! | variance below [`VARIANCE_FLOOR`] | skewness 0, kurtosis 0 |
//!
//! Errors relative to float64 never exceed 10⁻⁴ (10⁻⁴·max(|value|, 1) for skewness and kurtosis).
//! Float sums are never updated by subtraction ([`crate::right::sliding`]).
//! All moments are central ([`crate::right::moments`]).
//! If 200 samples cancel, so that the mean is near 0, its error is 10⁻⁹ of the unit.
//! The same error applies to amplitudes in the hundreds.

use crate::right::fft::{HalfFrame, powers};
use crate::right::moments::{Block, SlidingMoments, SlidingSum};
use crate::right::powers::SlidingPowers;
use crate::right::sliding::RingPlace;

pub use crate::right::moments::SAMPLE_LIMIT;
pub use crate::right::network::FEATURES_PER_AXIS;

/// Samples per window.
pub const WINDOW: usize = 200;
/// Number of samples per hop: half an FFT frame.
pub const HOP: usize = 8;
/// Hops per window.
pub const HOPS: usize = WINDOW / HOP;
/// Number of full frames of 16 samples in a window.
const FRAMES: usize = HOPS - 1;
/// A signal with a variance below this value has no shape. The standard deviation is then below 10⁻⁸.
pub const VARIANCE_FLOOR: f32 = 1e-16;

/// A window over samples of `A` axes.
#[derive(Clone, Debug)]
pub struct FeatureWindow<const A: usize> {
    /// Samples of the hop that is not yet complete.
    stage: [[f32; A]; HOP],
    staged: usize,
    axes: [Axis; A],
    features: [[f32; FEATURES_PER_AXIS]; A],
    /// Number of the hop, modulo the number of blocks in a window.
    block: usize,
    /// Number of the hop, modulo the number of frames in a window.
    frame: usize,
    /// Number of hops since the last reset. It stops at the number of hops in a window.
    hops: usize,
    replaced: u32,
    /// Number of hops until the last value that replaced NaN has left the window.
    tainted: usize,
}

/// The data that the window stores for one axis.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// The last valid sample.
    held: f32,
    last: HalfFrame,
    sum: SlidingSum<HOPS>,
    moments: SlidingMoments<HOPS>,
    powers: SlidingPowers<FRAMES>,
}

/// The positions in the ring buffers where the samples of one hop are stored.
struct HopBlocks {
    axis: usize,
    block: RingPlace<HOPS>,
    frame: RingPlace<FRAMES>,
    /// Whether all samples are known to be numbers within the limit.
    repaired: bool,
}

impl<const A: usize> FeatureWindow<A> {
    /// An empty window. All its bytes are zero, so that a static window takes no flash.
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

    /// Adds a sample. Returns true if a hop is complete and the window is full.
    /// [`Self::features`] then returns new features.
    #[inline]
    pub fn push(&mut self, sample: &[f32; A]) -> bool {
        if let Some(place) = self.stage.get_mut(self.staged) {
            // The samples are copied one by one.
            // The compiler would turn a copy of the whole array into a call.
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
        // The moments' window of axis i turns at hop −i, and the powers' window turns half a round later.
        // With up to 12 axes, at most one turn therefore happens per hop.
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

    /// Returns the features at the last complete hop. The features are meaningless until the window is full.
    pub fn features(&self) -> &[[f32; FEATURES_PER_AXIS]; A] {
        &self.features
    }

    /// Whether the window has been filled since the last reset.
    pub fn is_full(&self) -> bool {
        self.hops == HOPS
    }

    /// Number of NaN values since the last reset, up to the last complete hop.
    pub fn replaced(&self) -> u32 {
        self.replaced
    }

    /// Whether the window contains values that replaced NaN.
    pub fn is_tainted(&self) -> bool {
        self.tainted > 0
    }

    /// Forgets all samples.
    pub fn reset(&mut self) {
        // A whole new window would be built on the stack first, where a board has no room for it.
        let Self { stage, staged, axes, features, block, frame, hops, replaced, tainted } = self;
        axes.iter_mut().for_each(|axis| *axis = Axis::ZERO);
        (*stage, *features) = ([[0.0; A]; HOP], [[0.0; FEATURES_PER_AXIS]; A]);
        (*staged, *block, *frame, *hops, *replaced, *tainted) = (0, 0, 0, 0, 0, 0);
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

    /// Processes the samples of a hop, writes the features, and returns the number of samples that were replaced.
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
        // Each x satisfies x² ≤ 2·(mean² + Σ(x − mean)²). If any value is NaN, the result is also false.
        let tame = block.m2 + block_mean * block_mean <= SAMPLE_LIMIT * SAMPLE_LIMIT / 2.0;
        if !tame && !hop.repaired {
            return self.repair_and_advance(hop, stage, features);
        }
        self.held = samples[HOP - 1];

        self.sum.push(hop.block, &samples);
        // The very first frame is half empty and leaves the sums when the window becomes full.
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

/// Returns the samples of one axis, whose index is below `A`.
#[inline(always)]
fn column<const A: usize>(stage: &[[f32; A]; HOP], axis: usize) -> [f32; HOP] {
    stage.each_ref().map(|sample| sample[axis])
}

/// Limits magnitudes, and replaces each NaN with the previous value. Returns the number of NaN values.
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

/// Returns the square root. It is correctly rounded on every target, so all targets give the same bits.
#[inline(always)]
pub(crate) fn square_root(x: f32) -> f32 {
    #[cfg(cortex_m4f)]
    {
        let root: u32;
        // SAFETY: the code uses and restores one register, and this target has an FPU.
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
