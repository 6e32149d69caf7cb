//! Features of recipe 3: how a hand moves in a frame of its own movement, whoever wears the sensor and however.
//!
//! Acceleration and rotation rate are averaged over hops of 8 samples (12.5 Hz: gestures live between 0.5 and 5 Hz) and
//! turned so that the first direction is gravity, the second the horizontal direction with the most rotation (the most
//! acceleration where there is no gyroscope), the third across. Every feature is even in the two horizontal
//! directions, so left and right hands, and sensors turned on the hand, give the same numbers. The magnetometer is not
//! used: it cannot disturb.
//!
//! Per *triad* (three directions of acceleration in g; with a gyroscope also of rotation in 100 deg/s), e being
//! the mean squares about the mean of each direction, E their sum, f a *floor* of movement ([`ACC_FLOOR`],
//! [`GYRO_FLOOR`]) below which differences stop to matter, and X the lines 1 to 10 (0.39 to 3.9 Hz) of a 32-point Fourier
//! transform of the 25 hops under a Hann window, S = Σ|X|²:
//!
//! | features | count |
//! |---|---|
//! | 2√E / (√E + 2f) − 1 | 1 |
//! | 3e / (E + f²) − 1, per direction | 3 |
//! | 2·\|X\| / √(S + 60f²) − ½, line after line, three directions each | 30 |
//! | for the pairs (second, first), (third, first), (third, second): 2·\|Re c\| − ½, 2·\|Im c\| − ½ where c = ΣX·X̄′ / √((S + 60f²)(S′ + 60f²)) | 6 |
//!
//! then ½·ln(tremor + floor) + 1.5, once per triad, where tremor is the root of the mean variance inside a hop (floors 0.01 g
//! and 2 deg/s); then ln(√e + f) + 1 per triad and direction; last 2·(|gravity| − 1 g). That is 45 for an accelerometer
//! and 89 with a gyroscope. `tests/reference/aligned_ref.py` is the same in numpy.
//!
//! Gravity is the mean acceleration of the window. Below 10⁻³ m/s² it has no direction: what remains is finite and the
//! floors keep it small. A window in which nothing moves gives the same constants in any posture.

use crate::features::{HOP, HOPS, SAMPLE_LIMIT, square_root};
use crate::recipe::ln;

/// Movement below this counts as none: 0.1 g.
pub const ACC_FLOOR: f32 = 0.1;
/// Rotation below this counts as none, in 100 deg/s.
pub const GYRO_FLOOR: f32 = 0.2;
/// Most features.
pub const MAX_FEATURES: usize = 89;

/// m/s² per g.
const G: f32 = 9.806_65;
/// Acceleration and rotation.
const CHANNELS: usize = 6;
const LINES: usize = 10;
const TRIAD_FEATURES: usize = 4 + 3 * LINES + 6;
/// Features with this many axes: 3, 6 or 9; 0 for other numbers.
pub const fn feature_count(axes: usize) -> usize {
    match axes {
        3 => TRIAD_FEATURES + 1 + 3 + 1,
        6 | 9 => 2 * (TRIAD_FEATURES + 1 + 3) + 1,
        _ => 0,
    }
}

/// A series of hops in one direction.
type Series = [f32; HOPS];

/// How much the hand moves now, for [`crate::movement`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Movement {
    /// Root of the summed variances of the acceleration's hops, in m/s²: the last four hops with a gyroscope, eight
    /// without.
    pub acceleration: f32,
    /// Magnitude of the rotation rate in the last hop, in deg/s; 0 without a gyroscope.
    pub rotation: f32,
}

/// A window of 25 hops over samples of `A` axes: 3, 6 or 9.
#[derive(Clone, Debug)]
pub struct AlignedWindow<const A: usize> {
    /// Samples of the hop under way.
    stage: [[f32; HOP]; CHANNELS],
    staged: usize,
    /// The last good sample.
    held: [f32; CHANNELS],
    /// Means of the hops, a ring.
    bins: [[f32; CHANNELS]; HOPS],
    /// Variance inside the hops, summed over the directions of a triad.
    tremor: [[f32; 2]; HOPS],
    /// Where the oldest hop stands.
    oldest: usize,
    hops: usize,
    features: [f32; MAX_FEATURES],
    replaced: u32,
    /// Hops until the last replaced value has left the window.
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
            bins: [[0.0; CHANNELS]; HOPS],
            tremor: [[0.0; 2]; HOPS],
            oldest: 0,
            hops: 0,
            features: [0.0; MAX_FEATURES],
            replaced: 0,
            tainted: 0,
        }
    }

    /// Takes a sample (m/s², deg/s); true when a hop is complete and the window is full: then [`Self::features`] are
    /// new. Values that are no numbers repeat the last good one; magnitudes are limited to [`SAMPLE_LIMIT`].
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
        let (bin, tremor) = (&mut self.bins[slot], &mut self.tremor[slot]);
        *tremor = [0.0; 2];
        for (index, samples) in self.stage.iter_mut().enumerate().take(Self::USED) {
            for sample in samples.iter_mut() {
                if sample.is_finite() {
                    self.held[index] = sample.clamp(-SAMPLE_LIMIT, SAMPLE_LIMIT);
                } else {
                    replaced += 1;
                }
                *sample = self.held[index];
            }
            // About the first sample: the mean of a resting hand is exact, its variance 0.
            let first = samples[0];
            let offset = samples.iter().fold(0.0, |sum, sample| sum + (sample - first)) * (1.0 / HOP as f32);
            let squares = samples.iter().fold(0.0, |sum, sample| {
                let deviation = (sample - first) - offset;
                sum + deviation * deviation
            });
            bin[index] = first + offset;
            tremor[index / 3] += squares * (1.0 / HOP as f32);
        }
        self.oldest = if slot + 1 < HOPS { slot + 1 } else { 0 };
        self.hops = (self.hops + 1).min(HOPS);
        self.tainted = if replaced > 0 { HOPS } else { self.tainted.saturating_sub(1) };
        self.replaced = self.replaced.saturating_add(replaced);
        if self.is_full() {
            self.extract();
        }
        self.is_full()
    }

    /// Features of the window at the last complete hop, [`feature_count`] of them; zeros before the window was full.
    pub fn features(&self) -> &[f32] {
        &self.features[..feature_count(A)]
    }

    /// Whether the window has been filled since the last reset.
    pub fn is_full(&self) -> bool {
        self.hops == HOPS
    }

    /// Values that were no numbers, up to the last complete hop since the last reset.
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

    /// How much the hand moved in the last hops.
    pub fn movement(&self) -> Movement {
        let count = if Self::TRIADS == 2 { 4 } else { 8 };
        let last = |back: usize| &self.bins[(self.oldest + HOPS - 1 - back) % HOPS];
        let newest = last(0);
        let count = count.min(self.hops.max(1));
        let mut variance = 0.0;
        for (axis, reference) in newest.iter().enumerate().take(3) {
            let (mut sum, mut squares) = (0.0, 0.0);
            for back in 0..count {
                let deviation = last(back)[axis] - reference;
                sum += deviation;
                squares += deviation * deviation;
            }
            let mean = sum / count as f32;
            variance += (squares / count as f32 - mean * mean).max(0.0);
        }
        let [_, _, _, x, y, z] = *newest;
        Movement { acceleration: square_root(variance), rotation: square_root(x * x + y * y + z * z) }
    }

    /// The hops of three channels from `first`, oldest first.
    fn series(&self, first: usize) -> [Series; 3] {
        let (new, old) = self.bins.split_at(self.oldest.min(HOPS));
        let mut all = [[0.0; HOPS]; 3];
        for (index, bin) in old.iter().chain(new).enumerate() {
            for (series, value) in all.iter_mut().zip(&bin[first..first + 3]) {
                series[index] = *value;
            }
        }
        all
    }

    #[inline(never)]
    fn extract(&mut self) {
        let mut triads = [self.series(0), [[0.0; HOPS]; 3]];
        if Self::TRIADS == 2 {
            triads[1] = self.series(3);
        }
        let gravity = triads[0].each_mut().map(centre);
        let length = square_root(dot(gravity, gravity));
        let frame = frame(gravity.map(|value| value / length.max(1e-3)));
        turn(&mut triads[0], &frame, 1.0 / G);
        if Self::TRIADS == 2 {
            turn(&mut triads[1], &frame, 1.0 / 100.0);
        }
        // The rotation's mean counts: a hand that turned one way has turned about that direction.
        let (cosine, sine) = principal(&triads[Self::TRIADS - 1]);
        let floors = [ACC_FLOOR, GYRO_FLOOR];
        let mut writer = Writer { place: self.features.iter_mut() };
        let mut squares = [[0.0; 3]; 2];
        for ((triad, floor), squares) in triads.iter_mut().zip(floors).zip(&mut squares).take(Self::TRIADS) {
            let [_, second, third] = &mut *triad;
            for (b, c) in second.iter_mut().zip(third) {
                (*b, *c) = (cosine * *b + sine * *c, cosine * *c - sine * *b);
            }
            for series in triad.iter_mut() {
                centre(series);
            }
            *squares = describe(triad, floor, &mut writer);
        }
        let tremor_floors = [(1.0 / G, 0.01), (1.0 / 100.0, 0.02)];
        for (index, (unit, floor)) in tremor_floors.into_iter().enumerate().take(Self::TRIADS) {
            let mean = self.tremor.iter().fold(0.0, |sum, tremor| sum + tremor[index]) * (1.0 / HOPS as f32);
            writer.push(ln(square_root(mean) * unit + floor) * 0.5 + 1.5);
        }
        for (squares, floor) in squares.iter().zip(floors).take(Self::TRIADS) {
            for &square in squares {
                writer.push(ln(square_root(square) + floor) + 1.0);
            }
        }
        writer.push(2.0 * (length * (1.0 / G) - 1.0));
    }
}

impl<const A: usize> Default for AlignedWindow<A> {
    fn default() -> Self {
        Self::new()
    }
}

/// Fills features one after the other.
struct Writer<'a> {
    place: core::slice::IterMut<'a, f32>,
}

impl Writer<'_> {
    fn push(&mut self, value: f32) {
        if let Some(place) = self.place.next() {
            *place = value;
        }
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Takes the mean away and gives it.
fn centre(series: &mut Series) -> f32 {
    // About the first hop, so that a constant leaves nothing behind.
    let first = series[0];
    let offset = series.iter().fold(0.0, |sum, value| sum + (value - first)) * (1.0 / HOPS as f32);
    for value in series.iter_mut() {
        *value = (*value - first) - offset;
    }
    first + offset
}

/// Up, and two horizontal directions. Features do not depend on which.
fn frame(up: [f32; 3]) -> [[f32; 3]; 3] {
    let across = if up[0].abs() > 0.9 { up[1] } else { up[0] };
    let start = if up[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let e: [f32; 3] = core::array::from_fn(|i| start[i] - up[i] * across);
    // At least 0.19: `start` is far from `up`, and a short `up` takes little away.
    let length = square_root(dot(e, e));
    let e = e.map(|value| value / length);
    let f = [up[1] * e[2] - up[2] * e[1], up[2] * e[0] - up[0] * e[2], up[0] * e[1] - up[1] * e[0]];
    [up, e, f]
}

/// Expresses three series in another frame and unit.
fn turn(triad: &mut [Series; 3], frame: &[[f32; 3]; 3], unit: f32) {
    let [x, y, z] = triad;
    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
        let vector = [*x * unit, *y * unit, *z * unit];
        [*x, *y, *z] = [dot(frame[0], vector), dot(frame[1], vector), dot(frame[2], vector)];
    }
}

/// Cosine and sine of the angle from the second to the direction with the most power among second and third.
fn principal(triad: &[Series; 3]) -> (f32, f32) {
    let (mut difference, mut product) = (0.0, 0.0);
    for (a, b) in triad[1].iter().zip(&triad[2]) {
        difference += a * a - b * b;
        product += a * b;
    }
    // tan 2θ = 2·product / difference; half-angle formulas on the side where nothing cancels.
    let twice = 2.0 * product;
    let length = square_root(difference * difference + twice * twice);
    if length < 1e-12 {
        return (1.0, 0.0);
    }
    let large = square_root(0.5 * (1.0 + difference.abs() / length));
    let small = twice.abs() / (2.0 * length * large);
    let sign = if twice < 0.0 { -1.0 } else { 1.0 };
    if difference >= 0.0 { (large, sign * small) } else { (small, sign * large) }
}

/// Writes the first [`TRIAD_FEATURES`] of a centred triad; gives the mean squares.
fn describe(triad: &[Series; 3], floor: f32, out: &mut Writer<'_>) -> [f32; 3] {
    let squares = triad
        .each_ref()
        .map(|series| series.iter().fold(0.0, |sum, value| sum + value * value) * (1.0 / HOPS as f32));
    let energy = squares[0] + squares[1] + squares[2];
    let root = square_root(energy);
    out.push(2.0 * root / (root + 2.0 * floor) - 1.0);
    let share = 3.0 / (energy + floor * floor);
    for square in squares {
        out.push(square * share - 1.0);
    }
    let lines = triad.each_ref().map(spectrum);
    let scales = lines.each_ref().map(|lines| {
        let sum = lines.iter().fold(0.0, |sum, (re, im)| sum + (re * re + im * im));
        1.0 / square_root(sum + 60.0 * floor * floor)
    });
    for line in 0..LINES {
        for (lines, scale) in lines.iter().zip(&scales) {
            let (re, im) = lines[line];
            out.push(2.0 * (square_root(re * re + im * im) * scale) - 0.5);
        }
    }
    for (i, j) in [(1, 0), (2, 0), (2, 1)] {
        let (mut real, mut imaginary) = (0.0, 0.0);
        for ((a, b), (c, d)) in lines[i].iter().zip(&lines[j]) {
            real += a * c + b * d;
            imaginary += b * c - a * d;
        }
        let scale = 2.0 * (scales[i] * scales[j]);
        out.push(real.abs() * scale - 0.5);
        out.push(imaginary.abs() * scale - 0.5);
    }
    squares
}

/// Half of the Hann window of 25 points beside its centre: ½ + ½·cos(2πm/26), m = 1 to 12.
const HANN: [f32; 12] = [
    0.985_470_9,
    0.942_728,
    0.874_255_36,
    0.784_032_4,
    0.677_302_4,
    0.560_268_34,
    0.439_731_66,
    0.322_697_55,
    0.215_967_63,
    0.125_744_63,
    0.057_271_987,
    0.014_529_091,
];

/// cos(2πm/32), m = 0 to 8.
const QUARTER: [f32; 9] = [
    1.0,
    0.980_785_25,
    0.923_879_5,
    0.831_469_6,
    core::f32::consts::FRAC_1_SQRT_2,
    0.555_570_24,
    0.382_683_43,
    0.195_090_32,
    0.0,
];

const fn cosine(m: usize) -> f32 {
    match m % 32 {
        m @ 0..=8 => QUARTER[m],
        m @ 9..=16 => -QUARTER[16 - m],
        m @ 17..=24 => -QUARTER[m - 16],
        m => QUARTER[32 - m],
    }
}

/// cos and sin of 2πkm/32 for lines k = 1 to 10 and m = 1 to 8.
const TURNS: [[(f32, f32); 8]; LINES] = {
    let mut table = [[(0.0, 0.0); 8]; LINES];
    let mut k = 0;
    while k < LINES {
        let mut m = 0;
        while m < 8 {
            let turn = (k + 1) * (m + 1);
            table[k][m] = (cosine(turn), cosine(turn + 24));
            m += 1;
        }
        k += 1;
    }
    table
};

/// Lines 1 to 10 of the 32-point transform of a series under the Hann window, with the middle hop as time 0.
///
/// Where time starts does not matter: all series turn alike, and only magnitudes and products with conjugates are used.
/// About the middle, sums of mirrored hops meet cosines and differences sines; m and 16 − m share one of these up to sign.
fn spectrum(series: &Series) -> [(f32, f32); LINES] {
    const MIDDLE: usize = HOPS / 2;
    let mut sums = [0.0; 16];
    let mut differences = [0.0; 16];
    for (m, weight) in HANN.iter().enumerate() {
        let (after, before) = (series[MIDDLE + 1 + m], series[MIDDLE - 1 - m]);
        sums[m + 1] = weight * (after + before);
        differences[m + 1] = weight * (after - before);
    }
    // Of even and of odd lines.
    let mut folded = [[(0.0, 0.0); 8]; 2];
    for m in 1..8 {
        let (s, t) = (sums[m], sums[16 - m]);
        let (d, e) = (differences[m], differences[16 - m]);
        folded[0][m - 1] = (s + t, d - e);
        folded[1][m - 1] = (s - t, d + e);
    }
    folded[0][7] = (sums[8], differences[8]);
    folded[1][7] = folded[0][7];
    let mut lines = [(0.0, 0.0); LINES];
    for (index, (line, turns)) in lines.iter_mut().zip(&TURNS).enumerate() {
        let terms = &folded[(index + 1) % 2];
        let (mut re, mut im) = (series[MIDDLE], 0.0);
        for ((s, d), (cosine, sine)) in terms.iter().zip(turns) {
            re += s * cosine;
            im += d * sine;
        }
        *line = (re, im);
    }
    lines
}
