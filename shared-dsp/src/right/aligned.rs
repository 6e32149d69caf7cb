//! Features of recipe 3.
//! The features describe the motion in the hand's own frame, so they do not depend on the wearer or the sensor's orientation.
//!
//! Acceleration and rotation rate are averaged over hops of 8 samples (12.5 Hz, because gestures have 0.5 to 5 Hz).
//! The averages are then rotated into a frame whose first axis is the direction of gravity.
//! The second axis is the horizontal direction with the most rotation.
//! Without a gyroscope, the second axis is the horizontal direction with the most acceleration.
//! The third axis is perpendicular to the first and the second axis.
//! A change of sign of either horizontal axis does not change any feature.
//! Left and right hands, and rotated sensors, therefore give the same numbers.
//! The magnetometer is not used, so magnetic disturbances have no effect.
//!
//! A *triad* is the acceleration along three axes in g or, with a gyroscope, the rotation about them in 100 deg/s.
//! For each triad, e are the mean squares along each axis about its mean, and E is their sum.
//! The *floor* f ([`ACC_FLOOR`], [`GYRO_FLOOR`]) is the amount of movement below which differences are insignificant.
//! X stands for lines 1 to 10 (0.39 to 3.9 Hz) of a 32-point Fourier transform.
//! The transform covers 25 hops, which are weighted with a Hann window.
//! S is the power of these lines, Σ|X|².
//!
//! | features | count |
//! |---|---|
//! | 2√E / (√E + 2f) − 1 | 1 |
//! | 3e / (E + f²) − 1, per direction | 3 |
//! | 2·\|X\| / √(S + 60f²) − ½, line after line, for three axes each | 30 |
//! | for the pairs (second, first), (third, first), (third, second): 2·\|Re c\| − ½, 2·\|Im c\| − ½ where c = ΣX·X̄′ / √((S + 60f²)(S′ + 60f²)) | 6 |
//!
//! Each triad also has the feature ½·ln(tremor + floor) + 1.5.
//! Here, tremor is the square root of the mean variance within a hop, and the floors are 0.01 g and 2 deg/s.
//! The next features are ln(√e + f) + 1 for each triad and axis, and finally 2·(|gravity| − 1 g).
//! An accelerometer therefore has 45 features. With a gyroscope, there are 89 features.
//! `tests/reference/aligned_ref.py` implements the same algorithm in numpy.
//!
//! The rotation is linear, so the code applies it last.
//! Products and lines are computed from the unrotated channels.
//! Only ten lines are therefore rotated, instead of 25 hops.
//!
//! The mean acceleration of the window is gravity. If it is below 10⁻³ m/s², its direction is undefined.
//! In this case, all features remain finite, and the floors keep them small.
//! A window without movement gives the same constants in any posture.

mod tables;

use crate::right::features::{HOP, HOPS, SAMPLE_LIMIT, square_root};
use crate::right::kind::ln;
use tables::{COSINES, HANN};

/// Acceleration below this value is insignificant: 0.1 g.
pub const ACC_FLOOR: f32 = 0.1;
/// Rotation below this value is insignificant, in 100 deg/s.
pub const GYRO_FLOOR: f32 = 0.2;
/// Maximum number of features.
pub const MAX_FEATURES: usize = 89;

/// Number of m/s² per g.
const G: f32 = 9.806_65;
/// Channels of acceleration and rotation.
const CHANNELS: usize = 6;
const LINES: usize = 10;
const TRIAD_FEATURES: usize = 4 + 3 * LINES + 6;
/// Number of features for 3, 6 or 9 axes; 0 for other numbers of axes.
pub const fn feature_count(axes: usize) -> usize {
    match axes {
        3 => TRIAD_FEATURES + 1 + 3 + 1,
        6 | 9 => 2 * (TRIAD_FEATURES + 1 + 3) + 1,
        _ => 0,
    }
}

/// The means of each hop along one axis.
type Series = [f32; HOPS];

/// Three channels of a window, first in the frame of the sensor.
struct Triad {
    mean: [f32; 3],
    /// Mean products of the channels' deviations from their means.
    products: [[f32; 3]; 3],
    /// See [`spectrum`]. [`describe`] turns them into the hand's frame.
    lines: [[(f32, f32); LINES]; 3],
}

impl Triad {
    /// The place for a triad.
    const EMPTY: Self = Self { mean: [0.0; 3], products: [[0.0; 3]; 3], lines: [[(0.0, 0.0); LINES]; 3] };

    /// Computes a triad from the rings of its channels. The hop with index `oldest` is the oldest.
    ///
    /// This function and [`describe`] exist once for both triads and are built for size, because they are most of the code.
    /// A triad is filled in place, because its copies would cost more than some of its sums.
    #[inline(never)]
    fn fill(&mut self, rings: &[Series; 3], oldest: usize) {
        let mut centred = [[0.0; HOPS]; 3];
        let channels = centred.iter_mut().zip(&mut self.mean).zip(&mut self.lines);
        for (((series, mean), lines), ring) in channels.zip(rings) {
            *mean = centre(ring, oldest, series);
            spectrum(series, lines);
        }
        let [first, second, third] = &centred;
        let (mut xx, mut yy, mut zz, mut xy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for ((&x, &y), &z) in first.iter().zip(second).zip(third) {
            xx += x * x;
            yy += y * y;
            zz += z * z;
            xy += x * y;
            xz += x * z;
            yz += y * z;
        }
        let [xx, yy, zz, xy, xz, yz] = [xx, yy, zz, xy, xz, yz].map(|sum: f32| sum * (1.0 / HOPS as f32));
        self.products = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    }

    /// Multiplies the matrix of mean products by a vector.
    fn times(&self, vector: [f32; 3]) -> [f32; 3] {
        self.products.map(|row| dot(row, vector))
    }
}

/// Eight samples of a channel.
struct HopTerms {
    mean: f32,
    /// Mean square about the mean.
    variance: f32,
}

impl HopTerms {
    #[inline(always)]
    fn new(samples: &[f32; HOP]) -> Self {
        // Deviations are relative to the first sample, so a resting hand has an exact mean and a variance of 0.
        let first = samples[0];
        let offset = samples.iter().fold(0.0, |sum, sample| sum + (sample - first)) * (1.0 / HOP as f32);
        let squares = samples.iter().fold(0.0, |sum, sample| {
            let deviation = (sample - first) - offset;
            sum + deviation * deviation
        });
        Self { mean: first + offset, variance: squares * (1.0 / HOP as f32) }
    }

    /// Returns whether all samples are certainly numbers within the limit.
    /// Each sample x satisfies x² ≤ 2·(mean² + Σ(x − mean)²).
    #[inline(always)]
    fn is_tame(&self) -> bool {
        self.mean * self.mean + HOP as f32 * self.variance <= SAMPLE_LIMIT * SAMPLE_LIMIT / 2.0
    }
}

/// Limits magnitudes, and replaces each NaN with the previous value. Returns the number of NaN values.
#[cold]
#[inline(never)]
fn repair(samples: &mut [f32; HOP], mut held: f32) -> u32 {
    let mut replaced = 0;
    for sample in samples {
        if sample.is_finite() {
            held = sample.clamp(-SAMPLE_LIMIT, SAMPLE_LIMIT);
        } else {
            replaced += 1;
        }
        *sample = held;
    }
    replaced
}

/// The present movement of the hand, which [`crate::right::movement`] uses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Movement {
    /// Square root of the acceleration's summed variances over the last four hops, in m/s².
    pub acceleration: f32,
    /// Magnitude of the rotation rate in the last hop, in deg/s; 0 if there is no gyroscope.
    pub rotation: f32,
}

/// A window of 25 hops over samples of `A` axes: 3, 6 or 9.
#[derive(Clone, Debug)]
pub struct AlignedWindow<const A: usize> {
    /// Samples of the hop that is not yet complete.
    stage: [[f32; HOP]; CHANNELS],
    staged: usize,
    /// The last valid sample.
    held: [f32; CHANNELS],
    /// Ring buffer with each channel's means of the hops.
    bins: [[Series; 3]; 2],
    /// Variance within each hop, summed over the axes of a triad.
    tremor: [Series; 2],
    /// Index of the oldest hop in the ring.
    oldest: usize,
    hops: usize,
    features: [f32; MAX_FEATURES],
    replaced: u32,
    /// Number of hops until the last replaced value has left the window.
    tainted: usize,
}

impl<const A: usize> AlignedWindow<A> {
    const USED: usize = if A >= 6 { 6 } else { 3 };
    const TRIADS: usize = Self::USED / 3;

    /// An empty window.
    pub const fn new() -> Self {
        Self {
            stage: [[0.0; HOP]; CHANNELS],
            staged: 0,
            held: [0.0; CHANNELS],
            bins: [[[0.0; HOPS]; 3]; 2],
            tremor: [[0.0; HOPS]; 2],
            oldest: 0,
            hops: 0,
            features: [0.0; MAX_FEATURES],
            replaced: 0,
            tainted: 0,
        }
    }

    /// Adds a sample (m/s², deg/s).
    /// Returns true if a hop is complete and the window is full.
    /// [`Self::features`] then returns new features.
    /// NaN values are replaced with the last valid values, and magnitudes are limited to [`SAMPLE_LIMIT`].
    #[inline]
    pub fn push(&mut self, sample: &[f32; A]) -> bool {
        for (channel, value) in self.stage.iter_mut().zip(&sample[..A.min(Self::USED)]) {
            if let Some(place) = channel.get_mut(self.staged) {
                *place = *value;
            }
        }
        self.staged += 1;
        self.staged >= HOP && self.finish_hop()
    }

    #[inline(never)]
    fn finish_hop(&mut self) -> bool {
        self.staged = 0;
        let mut replaced = 0;
        let slot = self.oldest.min(HOPS - 1);
        for (index, tremor) in self.tremor.iter_mut().enumerate().take(Self::TRIADS) {
            tremor[slot] = 0.0;
            for channel in 3 * index..3 * index + 3 {
                let mut hop = HopTerms::new(&self.stage[channel]);
                if !hop.is_tame() {
                    replaced += repair(&mut self.stage[channel], self.held[channel]);
                    hop = HopTerms::new(&self.stage[channel]);
                }
                self.held[channel] = self.stage[channel][HOP - 1];
                self.bins[index][channel - 3 * index][slot] = hop.mean;
                tremor[slot] += hop.variance;
            }
        }
        self.oldest = if slot + 1 < HOPS { slot + 1 } else { 0 };
        self.hops = (self.hops + 1).min(HOPS);
        self.tainted = if replaced > 0 { HOPS } else { self.tainted.saturating_sub(1) };
        self.replaced = self.replaced.saturating_add(replaced);
        if self.is_full() {
            extract(&self.bins, &self.tremor, self.oldest, Self::TRIADS == 2, &mut self.features);
        }
        self.is_full()
    }

    /// Returns the [`feature_count`] features at the last complete hop. They are 0 until the window is full.
    pub fn features(&self) -> &[f32] {
        &self.features[..feature_count(A)]
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
        *self = Self::new();
    }

    /// Returns the movement of the hand in the last hops.
    pub fn movement(&self) -> Movement {
        let count = self.hops.clamp(1, 4);
        let place = |back: usize| (self.oldest + HOPS - 1 - back) % HOPS;
        let mut variance = 0.0;
        for channel in &self.bins[0] {
            let reference = channel[place(0)];
            let (mut sum, mut squares) = (0.0, 0.0);
            for back in 0..count {
                let deviation = channel[place(back)] - reference;
                sum += deviation;
                squares += deviation * deviation;
            }
            let mean = sum / count as f32;
            variance += (squares / count as f32 - mean * mean).max(0.0);
        }
        let [x, y, z] = self.bins[1].each_ref().map(|channel| channel[place(0)]);
        Movement { acceleration: square_root(variance), rotation: square_root(x * x + y * y + z * z) }
    }
}

impl<const A: usize> Default for AlignedWindow<A> {
    fn default() -> Self {
        Self::new()
    }
}

/// Computes all features of a full window whose oldest hop has the index `oldest`.
/// Without a gyroscope, only the first triad of channels counts.
#[inline(never)]
fn extract(
    bins: &[[Series; 3]; 2],
    tremor: &[Series; 2],
    oldest: usize,
    has_gyro: bool,
    features: &mut [f32; MAX_FEATURES],
) {
    let (mut acceleration, mut rotation) = (Triad::EMPTY, Triad::EMPTY);
    acceleration.fill(&bins[0], oldest);
    let length = square_root(dot(acceleration.mean, acceleration.mean));
    let [up, across, along] = frame(acceleration.mean.map(|value| value / length.max(1e-3)));
    // The second axis is the horizontal direction with the most rotation.
    // The mean rotation counts too, because a hand may turn in only one direction.
    let (most, mean) = if has_gyro {
        rotation.fill(&bins[1], oldest);
        (&rotation, rotation.mean)
    } else {
        (&acceleration, [0.0; 3])
    };
    let (cosine, sine) = principal(most, mean, across, along);
    let second = core::array::from_fn(|i| cosine * across[i] + sine * along[i]);
    let third = core::array::from_fn(|i| cosine * along[i] - sine * across[i]);
    let frame = [up, second, third];

    let mut squares = [[0.0; 3]; 2];
    let Some((first, rest)) = features.split_first_chunk_mut() else { return };
    squares[0] = describe(&mut acceleration, &frame, 1.0 / G, ACC_FLOOR, first);
    let rest = match rest.split_first_chunk_mut() {
        Some((second, rest)) if has_gyro => {
            squares[1] = describe(&mut rotation, &frame, 1.0 / 100.0, GYRO_FLOOR, second);
            rest
        }
        _ => rest,
    };
    let triads = 1 + usize::from(has_gyro);
    let (tremors, rest) = rest.split_at_mut(triads);
    let tremor_floors = [(1.0 / G, 0.01), (1.0 / 100.0, 0.02)];
    for ((place, tremor), (unit, floor)) in tremors.iter_mut().zip(tremor).zip(tremor_floors) {
        let mean = tremor.iter().fold(0.0, |sum, tremor| sum + tremor) * (1.0 / HOPS as f32);
        *place = ln(square_root(mean) * unit + floor) * 0.5 + 1.5;
    }
    let (sizes, rest) = rest.split_at_mut(3 * triads);
    for ((places, squares), floor) in sizes.chunks_exact_mut(3).zip(squares).zip([ACC_FLOOR, GYRO_FLOOR]) {
        for (place, square) in places.iter_mut().zip(squares) {
            *place = ln(square_root(square) + floor) + 1.0;
        }
    }
    rest[0] = 2.0 * (length * (1.0 / G) - 1.0);
}

/// Copies a ring from its oldest hop on, about its mean. Returns the mean.
/// The values are computed relative to the oldest hop, so that a constant has no effect.
fn centre(ring: &Series, oldest: usize, series: &mut Series) -> f32 {
    let (new, old) = ring.split_at(oldest.min(HOPS - 1));
    let start = old[0];
    let mut sum = 0.0;
    let (first, last) = series.split_at_mut(old.len());
    for (places, values) in [(first, old), (last, new)] {
        for (place, value) in places.iter_mut().zip(values) {
            *place = value - start;
            sum += *place;
        }
    }
    let offset = sum * (1.0 / HOPS as f32);
    series.iter_mut().for_each(|value| *value -= offset);
    start + offset
}

/// Computes lines 1 to 10 of the 32-point transform of a series with a Hann window. The middle hop is at time 0.
///
/// The origin of time does not matter, because only magnitudes and products with conjugates are used.
/// With the origin in the middle, sums of mirrored hops need only cosines, and differences need only sines.
/// Hops m and 16 − m have the same factors up to sign, so they are combined, separately for odd and even lines.
/// For even lines, m and 8 − m are also combined, and lines 7 and 9 share terms.
#[inline(never)]
fn spectrum(series: &Series, lines: &mut [(f32, f32); LINES]) {
    const MIDDLE: usize = HOPS / 2;
    let (mut s, mut d) = ([0.0; 13], [0.0; 13]);
    for (m, weight) in HANN.iter().enumerate() {
        let (after, before) = (series[MIDDLE + 1 + m], series[MIDDLE - 1 - m]);
        s[m + 1] = weight * (after + before);
        d[m + 1] = weight * (after - before);
    }
    let x = series[MIDDLE];
    let (c1, r, c3) = (COSINES[2], COSINES[4], COSINES[6]);

    // These are the even lines of the transform. No hop is 13 to 15 hops from the middle.
    let (e4, e5, e6, e7) = (s[4] + s[12], s[5] + s[11], s[6] + s[10], s[7] + s[9]);
    let (p1, p2, p3) = (s[1] - e7, s[2] - e6, s[3] - e5);
    let (q1, q2, q3) = (s[1] + e7, s[2] + e6, s[3] + e5);
    let (f4, f5, f6, f7) = (d[4] - d[12], d[5] - d[11], d[6] - d[10], d[7] - d[9]);
    let (g1, g2, g3) = (d[1] + f7, d[2] + f6, d[3] + f5);
    let (h1, h2, h3) = (d[1] - f7, d[2] - f6, d[3] - f5);
    let (minus, plus) = (x - s[8], x + s[8]);
    let (rp, rg) = (r * p2, r * g2);
    let (t, u) = (c3 * p1 - c1 * p3, c1 * g1 - c3 * g3);
    lines[1] = (minus + rp + (c1 * p1 + c3 * p3), c3 * g1 + c1 * g3 + rg + f4);
    lines[3] = (plus - e4 + r * (q1 - q3), r * (h1 + h3) + h2);
    lines[5] = (minus - rp + t, u + (rg - f4));
    lines[7] = (plus + e4 - q2, h1 - h3);
    lines[9] = (minus - rp - t, u - (rg - f4));

    // These are the odd lines of the transform, from hops at odd and at even distances.
    let [_, a1, _, a3, _, a5, _, a7] = COSINES;
    let (o4, o5, o6, o7) = (s[4] - s[12], s[5] - s[11], s[6] - s[10], s[7] - s[9]);
    let (i4, i5, i6, i7) = (d[4] + d[12], d[5] + d[11], d[6] + d[10], d[7] + d[9]);
    let (u, v, w) = (c1 * s[2] + c3 * o6, c3 * s[2] - c1 * o6, r * o4);
    let (re1, re3, re5, re7) = ((x + w) + u, (x - w) + v, (x - w) - v, (x + w) - u);
    let (u, v, w) = (c3 * d[2] + c1 * i6, c1 * d[2] - c3 * i6, r * i4);
    let (im1, im3, im5, im7) = (u + w + d[8], v + w - d[8], v - w + d[8], u - w - d[8]);
    let ((s1, s3), (d1, d3)) = ((s[1], s[3]), (d[1], d[3]));
    lines[0] = (
        re1 + ((a1 * s1 + a3 * s3) + (a5 * o5 + a7 * o7)),
        im1 + ((a7 * d1 + a5 * d3) + (a3 * i5 + a1 * i7)),
    );
    lines[2] = (
        re3 + ((a3 * s1 - a7 * s3) - (a1 * o5 + a5 * o7)),
        im3 + ((a5 * d1 + a1 * d3) + (a7 * i5 - a3 * i7)),
    );
    lines[4] = (
        re5 + ((a5 * s1 - a1 * s3) + (a7 * o5 + a3 * o7)),
        im5 + ((a3 * d1 + a7 * d3) - (a1 * i5 - a5 * i7)),
    );
    let re = (a7 * s1 - a5 * s3) + (a3 * o5 - a1 * o7);
    let im = (a1 * d1 - a3 * d3) + (a5 * i5 - a7 * i7);
    lines[6] = (re7 + re, im + im7);
    lines[8] = (re7 - re, im - im7);
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the up direction and two arbitrary horizontal directions. The features do not depend on their choice.
fn frame(up: [f32; 3]) -> [[f32; 3]; 3] {
    let across = if up[0].abs() > 0.9 { up[1] } else { up[0] };
    let start = if up[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let e: [f32; 3] = core::array::from_fn(|i| start[i] - up[i] * across);
    // The remaining vector is at least 0.19 long, because `start` is far from `up` and a short `up` subtracts little.
    let length = square_root(dot(e, e));
    let e = e.map(|value| value / length);
    let f = [up[1] * e[2] - up[2] * e[1], up[2] * e[0] - up[0] * e[2], up[0] * e[1] - up[1] * e[0]];
    [up, e, f]
}

/// Returns cosine and sine of the angle from `across` to the direction with the most power.
/// Only directions in the plane of `across` and `along` are considered.
/// The power is computed about the given mean, which may be zero.
fn principal(triad: &Triad, mean: [f32; 3], across: [f32; 3], along: [f32; 3]) -> (f32, f32) {
    let (turned, a, b) = (triad.times(along), dot(mean, across), dot(mean, along));
    let difference = (dot(across, triad.times(across)) + a * a) - (dot(along, turned) + b * b);
    // The angle follows from tan 2θ = 2·product / difference. This half-angle formula avoids cancellation.
    let twice = 2.0 * (dot(across, turned) + a * b);
    let length = square_root(difference * difference + twice * twice);
    if length < 1e-12 {
        return (1.0, 0.0);
    }
    let large = square_root(0.5 * (1.0 + difference.abs() / length));
    let small = twice.abs() / (2.0 * length * large);
    let sign = if twice < 0.0 { -1.0 } else { 1.0 };
    if difference >= 0.0 { (large, sign * small) } else { (small, sign * large) }
}

/// Turns the lines of a triad into the given frame, and computes its first features. Returns the mean squares.
#[inline(never)]
fn describe(
    triad: &mut Triad,
    frame: &[[f32; 3]; 3],
    unit: f32,
    floor: f32,
    out: &mut [f32; TRIAD_FEATURES],
) -> [f32; 3] {
    let [up, second, third] = frame.map(|direction| direction.map(|value| value * unit));
    // Rounding may give slightly negative values.
    let squares = [up, second, third].map(|direction| dot(direction, triad.times(direction)).max(0.0));
    let energy = squares[0] + squares[1] + squares[2];
    let root = square_root(energy);
    let (shares, out) = out.split_at_mut(4);
    shares[0] = 2.0 * root / (root + 2.0 * floor) - 1.0;
    let share = 3.0 / (energy + floor * floor);
    for (place, square) in shares[1..].iter_mut().zip(squares) {
        *place = square * share - 1.0;
    }
    let start = 60.0 * floor * floor;
    let (mut sum_x, mut sum_y, mut sum_z) = (start, start, start);
    let [xs, ys, zs] = &mut triad.lines;
    for ((x, y), z) in xs.iter_mut().zip(ys).zip(zs) {
        let (re, im) = ([x.0, y.0, z.0], [x.1, y.1, z.1]);
        // Three times the same: a loop over the directions would cost as much as what it does.
        *x = (dot(up, re), dot(up, im));
        sum_x += x.0 * x.0 + x.1 * x.1;
        *y = (dot(second, re), dot(second, im));
        sum_y += y.0 * y.0 + y.1 * y.1;
        *z = (dot(third, re), dot(third, im));
        sum_z += z.0 * z.0 + z.1 * z.1;
    }
    let scales = [sum_x, sum_y, sum_z].map(|sum| 1.0 / square_root(sum));
    let (magnitudes, relations) = out.split_at_mut(3 * LINES);
    for (axis, (lines, scale)) in triad.lines.iter().zip(scales).enumerate() {
        for (place, (re, im)) in magnitudes[axis..].iter_mut().step_by(3).zip(lines) {
            *place = 2.0 * (square_root(re * re + im * im) * scale) - 0.5;
        }
    }
    let [xs, ys, zs] = &triad.lines;
    let pairs =
        [(ys, xs, scales[1] * scales[0]), (zs, xs, scales[2] * scales[0]), (zs, ys, scales[2] * scales[1])];
    for (place, (first, second, scale)) in relations.chunks_exact_mut(2).zip(pairs) {
        let (mut real, mut imaginary) = (0.0, 0.0);
        for ((a, b), (c, d)) in first.iter().zip(second) {
            real += a * c + b * d;
            imaginary += b * c - a * d;
        }
        let scale = 2.0 * scale;
        place[0] = f32::abs(real) * scale - 0.5;
        place[1] = f32::abs(imaginary) * scale - 0.5;
    }
    squares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_equal_the_definition() {
        let mut state = 1u32;
        for round in 0..300 {
            let series: Series = core::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 1e7 - 0.8
            });
            let mut lines = [(0.0, 0.0); LINES];
            spectrum(&series, &mut lines);
            for (index, (re, im)) in lines.into_iter().enumerate() {
                let (mut cosines, mut sines) = (0f64, 0f64);
                for (n, &x) in series.iter().enumerate() {
                    let m = n as f64 - 12.0;
                    let weighted = f64::from(x) * (0.5 + 0.5 * (core::f64::consts::TAU * m / 26.0).cos());
                    let angle = core::f64::consts::TAU * (index + 1) as f64 * m / 32.0;
                    cosines += weighted * angle.cos();
                    sines += weighted * angle.sin();
                }
                let close = |got: f32, expected: f64| (f64::from(got) - expected).abs() < 3e-6;
                assert!(close(re, cosines) && close(im, sines), "round {round}, line {}", index + 1);
            }
        }
    }
}
