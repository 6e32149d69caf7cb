//! Infers the units of samples from gravity and from how hands move.
//!
//! At rest, an accelerometer measures gravity: 9.8 in m/s², 1 in g, or thousands in counts.
//! An accelerometer measures nothing at rest if a phone has subtracted gravity.
//! A moving hand also rotates.
//! The standard deviation of the gyroscope (deg/s) is 6 to 90 times that of the accelerometer (m/s²).
//! If the gyroscope is in rad/s, this ratio is 0.1 to 1.6. These figures come from 1,100 recordings of five boards.

use super::names::G;

/// Fewer samples are not enough for an inference.
const ENOUGH: usize = 20;
/// A window of half a second is at rest if its deviation is less than this fraction of its mean.
const REST: f32 = 0.03;
/// Range of gravity at rest in g; sensors have errors of several per cent.
const ONE_G: std::ops::RangeInclusive<f32> = 0.85..=1.17;
/// If a smaller fraction of the windows is at rest and does not show gravity, this may not be real rest.
const FEW: f32 = 0.25;
/// Maximum variation of gravity between windows at rest. Real sensors vary by up to 0.07.
/// If gravity was subtracted, the remaining acceleration varies with the tilt of the hand.
const APART: f32 = 0.2;
/// Maximum deviation of all samples relative to gravity; real recordings reach at most 1.8.
const WILDEST: f32 = 2.5;
/// Minimum mean acceleration of a hand that never rests, relative to the median magnitude.
/// Below this value, gravity is missing.
/// Gravity keeps its direction, while the hand's own acceleration averages to zero.
/// Real recordings have values of 0.36 to 1.
const LEAST_MEAN: f32 = 0.25;
/// Minimum mean if the unit seems to be g. The same minimum applies relative to the deviation.
/// The minimum is stricter for g, because movement without gravity has a similar magnitude in m/s².
/// Of 426 real recordings in g, one is below this value.
/// Two thirds of the recordings of linear acceleration are below it.
const LEAST_MEAN_IN_G: f32 = 0.4;
const LEAST_MEAN_OF_DEVIATION: f32 = 0.45;
/// Range of the median magnitude of a moving hand's acceleration, in g.
pub(super) const LIGHTEST: f32 = 0.6;
pub(super) const HEAVIEST: f32 = 3.2;
/// Range of the ratio between the deviations of turn rate and acceleration (in m/s²) if the turn rate is in rad/s.
/// Below this range, the hand does not rotate, or the gyroscope is defective.
const TURNS: std::ops::Range<f32> = 0.02..1.6;
/// If the hand moves less than this (in m/s²), rotation proves nothing.
/// For example, a hand may rest in a car.
const MOVES: f32 = 2.0;

/// What acceleration looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// In m/s², with gravity.
    MetresPerS2,
    /// In g, with gravity.
    G,
    /// The unit is a thousandth of g, and gravity is present.
    MilliG,
    /// Gravity was subtracted. The value is the median magnitude in the file's unit.
    NoGravity(f32),
    /// The samples are raw counts, or the sensor is not calibrated. The value is gravity in the file's unit.
    Odd(f32),
    /// Too short.
    Unknown,
}

impl Verdict {
    /// Returns the number of m/s² per unit, if it is known.
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

/// Returns the mean of vectors and their total deviation.
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

/// Returns values for the windows at rest: median of their mean magnitudes, relative variation, and fraction of all windows.
/// `rate_hz` determines the length of a window.
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
    // An up-down stroke has almost constant acceleration at each reversal, so one or two quiet windows are not rest.
    let rest = rest.filter(|(gravity, _, share)| unit_of(*gravity).is_some() || *share >= FEW);
    if let Some((gravity, apart, _)) = rest {
        let found = unit_of(gravity);
        return match found {
            // If the magnitude at rest is very small, gravity is missing.
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

/// Returns whether turn rates are in rad/s (true) or deg/s (false), given acceleration in m/s².
/// The result is `None` if the hand hardly moves.
pub(crate) fn turns_in_radians(acceleration: &[[f32; 3]], turns: &[[f32; 3]]) -> Option<bool> {
    let (_, moves) = moments(acceleration);
    let (_, turning) = moments(turns);
    let ratio = turning / moves;
    (acceleration.len() >= ENOUGH && moves > MOVES && ratio >= TURNS.start).then(|| TURNS.contains(&ratio))
}

/// Returns whether magnetic flux is in gauss (true) or µT (false).
/// The earth's field has 25 to 65 µT, and iron mostly adds to it.
/// The result is `None` if the sensor measures nothing.
pub(crate) fn field_in_gauss(field: &[[f32; 3]]) -> Option<bool> {
    let typical = median(field.iter().map(|sample| length(*sample)).collect());
    (field.len() >= ENOUGH && typical > 0.05).then_some(typical < 2.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tilted hand that moves to and fro, with its acceleration multiplied by `unit`; `gravity` is in m/s².
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
        // Gravity was subtracted from only one axis, and the hand was tilted.
        let tilted = vec![[4.0, 0.5, -1.2]; 100];
        assert!(matches!(acceleration(&tilted, 100.0), Verdict::Odd(_)));
        assert_eq!(acceleration(&tilted[..10], 100.0), Verdict::Unknown);
        // The remaining acceleration accidentally looks like one g until the hand turns or moves.
        let turned = [vec![[0.9, 0.3, -0.1]; 100], vec![[0.2, 1.6, -0.4]; 80]].concat();
        assert!(matches!(acceleration(&turned, 100.0), Verdict::NoGravity(_)));
        let moved = [vec![[0.9, 0.3, -0.1]; 100], waved(1.0, 0.0, 6.0)].concat();
        assert!(matches!(acceleration(&moved, 100.0), Verdict::NoGravity(_)));
        // A trembling hand with this tilt and occasional pushes of some m/s², which never rests.
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
        // A long rest at the value 12 means that the samples are counts.
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
