//! Which units samples are in, judged by what every hand on Earth feels.
//!
//! At rest an accelerometer shows gravity: 9.8 in m/s², 1 in g, thousands in counts, nothing if a phone has taken
//! gravity off. A hand that moves turns, too: in 1,100 recordings of five boards, a gyroscope's deviation in deg/s is 6
//! to 90 times the accelerometer's in m/s², so in rad/s it is 0.1 to 1.6 times that.

use super::names::G;

/// Samples that are too few to judge by.
const ENOUGH: usize = 20;
/// A window of half a second whose deviation is a smaller part of its mean than this is at rest.
const REST: f32 = 0.03;
/// Gravity at rest, in g: sensors are some per cent off.
const ONE_G: std::ops::RangeInclusive<f32> = 0.85..=1.17;
/// Share of the windows at rest below which they may be no rest, if what they show is no gravity.
const FEW: f32 = 0.25;
/// How far apart gravity may be from one rest to the next: real sensors have up to 0.07, and what is left of gravity
/// where it was taken off changes with the hand's tilt.
const APART: f32 = 0.2;
/// Deviation of all samples over gravity: real recordings have 1.8 at most.
const WILDEST: f32 = 2.5;
/// Where a hand never rests: its mean acceleration over the median length, below which there is no gravity in it.
/// Gravity keeps its direction; a hand's own acceleration adds up to nothing. Real recordings have 0.36 to 1.
const LEAST_MEAN: f32 = 0.25;
/// What would be g is doubted sooner, for what moves without gravity has the same size in m/s²: below this mean over the
/// median length, or over the deviation. Of 426 real recordings in g one has less; of as many of linear acceleration, two
/// thirds of those that would pass for g.
const LEAST_MEAN_IN_G: f32 = 0.4;
const LEAST_MEAN_OF_DEVIATION: f32 = 0.45;
/// The median length of a moving hand's acceleration lies between these, in g.
pub(super) const LIGHTEST: f32 = 0.6;
pub(super) const HEAVIEST: f32 = 3.2;
/// Deviation of turn rate over deviation of acceleration (m/s²): in this range it is rad/s. Below it nothing turns, or
/// the gyroscope is dead.
const TURNS: std::ops::Range<f32> = 0.02..1.6;
/// With less movement than this, in m/s², turning says nothing: a hand rests in a car.
const MOVES: f32 = 2.0;

/// What acceleration looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// In m/s², with gravity.
    MetresPerS2,
    /// In g, with gravity.
    G,
    /// In thousandths of g, with gravity.
    MilliG,
    /// Gravity has been taken off; the median length, in the file's unit.
    NoGravity(f32),
    /// None of these: raw counts, or a sensor that is not calibrated. Gravity, in the file's unit.
    Odd(f32),
    /// Too short.
    Unknown,
}

impl Verdict {
    /// How many m/s² the unit is, if it is known.
    pub(crate) fn factor(self) -> Option<f64> {
        match self {
            Verdict::MetresPerS2 => Some(1.0),
            Verdict::G => Some(G),
            Verdict::MilliG => Some(G / 1000.0),
            _ => None,
        }
    }
}

fn length(v: [f32; 3]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// Mean and total deviation of vectors.
fn moments(vectors: &[[f32; 3]]) -> ([f32; 3], f32) {
    let n = vectors.len().max(1) as f64;
    let mut mean = [0.0f64; 3];
    for vector in vectors {
        for (sum, x) in mean.iter_mut().zip(vector) {
            *sum += f64::from(*x);
        }
    }
    let mean = mean.map(|sum| sum / n);
    let squares: f64 = vectors
        .iter()
        .flat_map(|vector| vector.iter().zip(mean).map(|(x, m)| (f64::from(*x) - m).powi(2)))
        .sum();
    (mean.map(|m| m as f32), (squares / n).sqrt() as f32)
}

/// Median of the mean lengths of the windows at rest, if there are any, how far they are apart, as part of it, and which
/// share of all windows they are; `rate_hz` says how long a window is.
fn at_rest(acceleration: &[[f32; 3]], rate_hz: f64) -> Option<(f32, f32, f32)> {
    let window = ((rate_hz / 2.0) as usize).max(8);
    let mut resting: Vec<f32> = acceleration
        .windows(window)
        .step_by(window.div_ceil(2))
        .filter_map(|window| {
            let (mean, deviation) = moments(window);
            let mean = length(mean);
            (deviation < REST * mean).then_some(mean)
        })
        .collect();
    let all = acceleration.windows(window).step_by(window.div_ceil(2)).len();
    resting.sort_unstable_by(f32::total_cmp);
    let share = resting.len() as f32 / all.max(1) as f32;
    let at = |part: usize| resting.get((resting.len().checked_sub(1)?) * part / 10).copied();
    let (low, middle, high) = (at(1)?, at(5)?, at(9)?);
    Some((middle, (high - low) / middle, share))
}

/// Judges acceleration.
pub(crate) fn acceleration(samples: &[[f32; 3]], rate_hz: f64) -> Verdict {
    if samples.len() < ENOUGH {
        return Verdict::Unknown;
    }
    let typical = median(samples.iter().map(|sample| length(*sample)).collect());
    let g = G as f32;
    let scaled =
        |unit: f32, ranges: &std::ops::RangeInclusive<f32>, value: f32| ranges.contains(&(value / unit));
    let (mean, deviation) = moments(samples);
    let rest = at_rest(samples, rate_hz);
    let known = [(g, Verdict::MetresPerS2), (1.0, Verdict::G), (1000.0, Verdict::MilliG)];
    let unit_of = |gravity: f32| known.into_iter().find(|(unit, _)| scaled(*unit, &ONE_G, gravity));
    // A hand that strokes up and down is pushed evenly for a while at each turn: a window or two are no rest.
    let rest = rest.filter(|(gravity, _, share)| unit_of(*gravity).is_some() || *share >= FEW);
    if let Some((gravity, apart, _)) = rest {
        let found = unit_of(gravity);
        return match found {
            // What rests at nothing much has no gravity.
            None if gravity < 0.3 => Verdict::NoGravity(typical),
            None => Verdict::Odd(gravity),
            Some((_, Verdict::G)) if apart > APART || deviation > WILDEST * gravity => {
                Verdict::NoGravity(typical)
            }
            Some((_, verdict)) => verdict,
        };
    }
    let mean = length(mean);
    if mean < LEAST_MEAN * typical || typical < LIGHTEST {
        return Verdict::NoGravity(typical);
    }
    let doubtful = mean < LEAST_MEAN_IN_G * typical
        || mean < LEAST_MEAN_OF_DEVIATION * deviation
        || deviation > WILDEST * typical;
    match typical {
        ..HEAVIEST if doubtful => Verdict::NoGravity(typical),
        ..HEAVIEST => Verdict::G,
        5.0..40.0 => Verdict::MetresPerS2,
        700.0..3200.0 => Verdict::MilliG,
        _ => Verdict::Odd(typical),
    }
}

/// Whether turn rates are in rad/s (true) or deg/s (false), beside acceleration in m/s²; none if the hand is too still
/// to tell.
pub(crate) fn turns_in_radians(acceleration: &[[f32; 3]], turns: &[[f32; 3]]) -> Option<bool> {
    let (_, moves) = moments(acceleration);
    let (_, turning) = moments(turns);
    let ratio = turning / moves;
    (acceleration.len() >= ENOUGH && moves > MOVES && ratio >= TURNS.start).then(|| TURNS.contains(&ratio))
}

/// Whether magnetic flux is in gauss (true) or µT (false): the Earth's field has 25 to 65 µT, and what is built of iron
/// rather adds to it. None if the sensor shows nothing at all.
pub(crate) fn field_in_gauss(field: &[[f32; 3]]) -> Option<bool> {
    let typical = median(field.iter().map(|sample| length(*sample)).collect());
    (field.len() >= ENOUGH && typical > 0.05).then_some(typical < 2.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tilted hand that moves to and fro, with its acceleration multiplied by `unit`; `gravity` in m/s².
    fn waved(unit: f32, gravity: f32, size: f32) -> Vec<[f32; 3]> {
        let wave = |n: usize, hz: f32| (n as f32 / 100.0 * hz * std::f32::consts::TAU).sin() * size;
        let one = |n: usize| [wave(n, 2.0) + 0.3 * gravity, wave(n, 1.3), wave(n, 1.0) + 0.95 * gravity];
        (0..400).map(|n| one(n).map(|v| v * unit)).collect()
    }

    #[test]
    fn gravity_tells_the_unit_of_a_hand_that_rests_or_moves() {
        for size in [0.0, 0.05, 1.0, 6.0] {
            let judge = |unit: f32| acceleration(&waved(unit, 9.81, size), 100.0);
            assert_eq!(judge(1.0), Verdict::MetresPerS2, "{size}");
            assert_eq!(judge(1.0 / 9.81), Verdict::G, "{size}");
            assert_eq!(judge(1000.0 / 9.81), Verdict::MilliG, "{size}");
            assert!(matches!(judge(16_384.0 / 9.81), Verdict::Odd(_)), "{size}");
        }
    }

    #[test]
    fn a_hand_without_gravity_is_seen_moving_or_not() {
        for size in [0.01, 1.0, 6.0] {
            let verdict = acceleration(&waved(1.0, 0.0, size), 100.0);
            assert!(matches!(verdict, Verdict::NoGravity(_)), "{size}: {verdict:?}");
        }
        // Of one axis alone it was taken, and the hand was tilted.
        let tilted = vec![[4.0, 0.5, -1.2]; 100];
        assert!(matches!(acceleration(&tilted, 100.0), Verdict::Odd(_)));
        assert_eq!(acceleration(&tilted[..10], 100.0), Verdict::Unknown);
        // What is left by chance looks like one g, until the hand turns or moves.
        let turned = [vec![[0.9, 0.3, -0.1]; 100], vec![[0.2, 1.6, -0.4]; 80]].concat();
        assert!(matches!(acceleration(&turned, 100.0), Verdict::NoGravity(_)));
        let moved = [vec![[0.9, 0.3, -0.1]; 100], waved(1.0, 0.0, 6.0)].concat();
        assert!(matches!(acceleration(&moved, 100.0), Verdict::NoGravity(_)));
        // A hand that trembles, tilted by this much, with pushes of some m/s² now and then: it never rests.
        let pushed = |n: usize| if n % 100 < 12 { 6.0 * (n as f32 * 0.8).sin() } else { 0.0 };
        let tremble = |n: usize| 0.06 * (n as f32 * 1.9).sin();
        let residue: Vec<_> =
            (0..2000).map(|n| [0.6 + tremble(n), 0.3 + pushed(n), pushed(n + 30)]).collect();
        assert!(matches!(acceleration(&residue, 100.0), Verdict::NoGravity(_)));
    }

    #[test]
    fn a_hand_that_is_pushed_evenly_for_a_moment_does_not_rest() {
        let mut stroked = waved(1.0, 9.81, 6.0);
        stroked[300..360].fill([0.0, 0.3, 12.4]);
        assert_eq!(acceleration(&stroked, 100.0), Verdict::MetresPerS2);
        // What rests for long at 12 has counts of its own.
        stroked[200..400].fill([0.0, 0.3, 12.4]);
        assert!(matches!(acceleration(&stroked, 100.0), Verdict::Odd(_)));
    }

    #[test]
    fn turning_and_the_earths_field_tell_their_units() {
        let moving = waved(1.0, 9.81, 3.0);
        let turns = |unit: f32| waved(unit, 0.0, 60.0);
        assert_eq!(turns_in_radians(&moving, &turns(1.0)), Some(false));
        assert_eq!(turns_in_radians(&moving, &turns(std::f32::consts::PI / 180.0)), Some(true));
        assert_eq!(turns_in_radians(&waved(1.0, 9.81, 0.1), &turns(1.0)), None);
        assert_eq!(field_in_gauss(&vec![[0.2, -0.3, 0.3]; 50]), Some(true));
        assert_eq!(field_in_gauss(&vec![[20.0, -30.0, 30.0]; 50]), Some(false));
        assert_eq!(field_in_gauss(&vec![[0.0; 3]; 50]), None);
    }
}
