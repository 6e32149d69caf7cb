//! Varies single windows for recipe `aligned`, to simulate other hands and other orientations of the sensor.
//!
//! The order of the variations is: tempo, phase and evenness; size (fast movements need more force);
//! rotation; mirroring; tremor; offset and range of the accelerometer.
//! If a movement is accelerated, it is extended periodically.
//! Idle windows are enlarged only slightly, because a larger idle movement could resemble a small, slow gesture.
//! In half of the copies, the movement begins or ends inside the window, and the hand rests before or after it.

use std::f64::consts::{PI, TAU};

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Exp1, StandardNormal};

use super::augment::{apply, rotation};
use crate::WINDOW;
use crate::evaluate::events::{POSTURE, posture};
use crate::labels::OTHER;

/// The description of this variation on the card.
#[cfg(feature = "train")]
pub(super) const WORDS: &str = "tempo ×0.67 to 1.49 (gestures with a gyroscope 0.45 to 2.2) and uneven, shift ±0.2 s, or ±0.6 s with the \
     hand at rest before and after, size ×0.37 to 1.49 (other 0.5 to 2, idle 0.5 to 1.35), sensor turned at will about \
     gravity and up to 25° about any axis, mirrored, tremor of 3 to 10 Hz, accelerometer offset 0.3 m/s², clipped at 2 or 4 g";

/// The kind of movement that a label stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Gesture,
    Idle,
    Other,
}

impl Kind {
    pub fn of(label: &str) -> Self {
        match label {
            "idle" => Self::Idle,
            OTHER => Self::Other,
            _ => Self::Gesture,
        }
    }

    /// Range of the logarithm of the size.
    fn sizes(self) -> (f64, f64) {
        match self {
            Self::Gesture => (-1.0, 0.4),
            Self::Other => (-0.7, 0.7),
            Self::Idle => (-0.7, 0.3),
        }
    }
}

/// Returns a varied copy of a window, which has [`WINDOW`] samples of 3, 6 or 9 axes in sequence.
pub(super) fn vary(window: &[f32], axes: usize, kind: Kind, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let uniform = |rng: &mut ChaCha8Rng, low: f64, high: f64| rng.random_range(low..high);
    // Gestures get any tempo between half a stroke and five strokes per second.
    // Without a gyroscope, the range is half of that, because the slow window detects slow gestures.
    let tempos = if kind == Kind::Gesture && axes >= 6 { 0.8 } else { 0.4 };
    let stretch = uniform(rng, -tempos, tempos).exp();
    let rest = rng.random_bool(0.5).then(|| ends(window, axes));
    let rows: Vec<&[f32]> = window.chunks_exact(axes).collect();
    let period = if rest.is_some() { None } else { crate::windows::period(&rows) }.unwrap_or(WINDOW - 1);
    let most = if rest.is_some() { 60.0 } else { 20.0 };
    let shift = uniform(rng, -most, most);
    let (phase, bend) = (uniform(rng, 0.0, TAU), uniform(rng, 0.0, 0.1) * WINDOW as f64 / TAU);
    let (low, high) = kind.sizes();
    let size = uniform(rng, low, high).exp();
    // Idle movement has no tempo that would determine its force.
    let tempo = if kind == Kind::Idle { 1.0 } else { stretch };

    let mut samples: Vec<[f64; 9]> = (0..WINDOW)
        .map(|n| {
            let (n, half) = (n as f64, WINDOW as f64 / 2.0);
            let at = (n - half) * stretch + half + shift + bend * (TAU * n / WINDOW as f64 + phase).sin();
            sample_at(window, axes, at, rest.as_ref(), period)
        })
        .collect();

    let mut gravity = [0.0; 3];
    for sample in &samples {
        for (sum, value) in gravity.iter_mut().zip(sample) {
            *sum += value / WINDOW as f64;
        }
    }
    let axis = [0; 3].map(|_| StandardNormal.sample(rng));
    let tilt = rotation(axis, 25f64.to_radians() * uniform(rng, 0.0, 1.0).sqrt());
    let heading = rotation(gravity, uniform(rng, -PI, PI));
    let mirrored = rng.random_bool(0.5);
    for sample in &mut samples {
        for (value, centre) in sample.iter_mut().zip(gravity) {
            *value = centre + (*value - centre) * size * tempo * tempo;
        }
        for value in &mut sample[3..6] {
            *value *= size * tempo;
        }
        for (index, triad) in sample.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            if mirrored {
                // The motion is mirrored in y; rotation and magnetic field are axial vectors.
                triad[1] = -triad[1];
                if index > 0 {
                    *triad = triad.map(|value| -value);
                }
            }
            *triad = apply(&tilt, apply(&heading, *triad).map(f64::from)).map(f64::from);
        }
    }

    let pace = uniform(rng, 3.0, 10.0);
    let (start, length) = (uniform(rng, 0.0, 150.0), uniform(rng, 50.0, 200.0));
    let strength: f64 = 0.5 * <Exp1 as Distribution<f64>>::sample(&Exp1, rng);
    let strength = strength * (spread(&samples) / 2.0).min(1.0);
    let tremor: [(f64, f64); 6] =
        std::array::from_fn(|_| (strength * uniform(rng, 0.0, 1.0), uniform(rng, 0.0, TAU)));
    let offset = [0; 3].map(|_| 0.3 * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng));
    // The range is 2 g or 4 g, but not less than the maximum in this window.
    let range = if rng.random_bool(0.4) { 2.0 } else { 4.0 } * 9.806_65;
    let accelerations = window.chunks_exact(axes).flat_map(|row| &row[..3]);
    let range = accelerations.fold(range, |most: f64, value| most.max(f64::from(value.abs())));
    let mut values = Vec::with_capacity(WINDOW * axes);
    for (n, sample) in samples.iter().enumerate() {
        let envelope = (PI * ((n as f64 - start) / length).clamp(0.0, 1.0)).sin();
        for (axis, value) in sample.iter().take(axes).enumerate() {
            let unit = [3.0, 40.0, 0.0][axis / 3];
            let shake = tremor.get(axis).map_or(0.0, |(size, phase)| {
                unit * size * envelope * (TAU * pace * n as f64 / crate::RATE_HZ + phase).sin()
            });
            let value = value + shake + offset.get(axis).unwrap_or(&0.0);
            values.push(if axis < 3 { value.clamp(-range, range) } else { value } as f32);
        }
    }
    values
}

/// Returns the readings of a hand that rests in the posture at the start and at the end of a window.
fn ends(window: &[f32], axes: usize) -> [[f64; 9]; 2] {
    let rows: Vec<&[f32]> = window.chunks_exact(axes).collect();
    [&rows[..POSTURE], &rows[WINDOW - POSTURE..]].map(|part| {
        let held = posture(part);
        std::array::from_fn(|axis| match axis {
            3..6 => 0.0,
            _ => held.get(axis).copied().unwrap_or_default(),
        })
    })
}

/// Number of samples over which a jump fades when a movement is extended periodically.
const SEAM: f64 = 10.0;

/// Interpolates between samples. Beyond the ends, it uses the resting posture or extends the window periodically.
fn sample_at(window: &[f32], axes: usize, at: f64, rest: Option<&[[f64; 9]; 2]>, period: usize) -> [f64; 9] {
    let last = (WINDOW - 1) as f64;
    let inside = |at: f64| -> [f64; 9] {
        let left = (at.max(0.0) as usize).min(WINDOW - 2);
        let part = (at - left as f64).clamp(0.0, 1.0);
        std::array::from_fn(|axis| {
            if axis >= axes {
                return 0.0;
            }
            let (a, b) = (f64::from(window[left * axes + axis]), f64::from(window[(left + 1) * axes + axis]));
            a + (b - a) * part
        })
    };
    if (0.0..=last).contains(&at) {
        return inside(at);
    }
    if let Some([before, after]) = rest {
        return if at < 0.0 { *before } else { *after };
    }
    let period = period as f64;
    let (beyond, end, back) = if at < 0.0 { (-at, 0.0, period) } else { (at - last, last, -period) };
    let periods = (beyond / period).ceil();
    let (here, seam) = (inside(at + periods * back), 1.0 - (beyond / SEAM).min(1.0));
    let (edge, twin) = (inside(end), inside(end + back));
    std::array::from_fn(|axis| here[axis] + seam * (edge[axis] - twin[axis]))
}

/// Square root of the sum of the accelerometer's variances.
fn spread(samples: &[[f64; 9]]) -> f64 {
    let count = samples.len() as f64;
    let variance = |axis: usize| {
        let mean = samples.iter().map(|sample| sample[axis]).sum::<f64>() / count;
        samples.iter().map(|sample| (sample[axis] - mean).powi(2)).sum::<f64>() / count
    };
    (variance(0) + variance(1) + variance(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_still_hand_stays_still_but_for_an_offset() {
        let row = [0.0, 3.0, 9.0, 0.0, 0.0, 0.0, 20.0, 0.0, -40.0f32];
        let window: Vec<f32> = row.iter().copied().cycle().take(9 * WINDOW).collect();
        for seed in 0..20 {
            let varied = vary(&window, 9, Kind::Gesture, &mut ChaCha8Rng::seed_from_u64(seed));
            let (rows, _) = varied.as_chunks::<9>();
            let length = |v: &[f32]| v.iter().map(|x| x * x).sum::<f32>().sqrt();
            for sample in rows {
                assert!(sample.iter().zip(&rows[0]).all(|(a, b)| (a - b).abs() < 1e-3), "it does not move");
                assert!((length(&sample[..3]) - length(&row[..3])).abs() < 2.0);
                assert!((length(&sample[6..]) - length(&row[6..])).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn a_movement_begins_or_ends_inside_some_copies_and_the_hand_rests_there_as_it_was_held() {
        // In this test, the hand moves all the time except at the start and the end, where other features appear.
        let window: Vec<f32> = (0..WINDOW)
            .flat_map(|n| match n {
                0..15 => [6.0, 0.0, 8.0f32],
                185.. => [0.0, 6.0, 8.0],
                _ => [0.0, 4.0 * (n as f32 * 0.13).sin(), 9.8],
            })
            .collect();
        let mut resting = 0;
        for seed in 0..200 {
            let varied = vary(&window, 3, Kind::Gesture, &mut ChaCha8Rng::seed_from_u64(seed));
            let (rows, _) = varied.as_chunks::<3>();
            let is_still = |rows: &[[f32; 3]]| {
                rows.iter().all(|row| (0..3).all(|axis| (row[axis] - rows[0][axis]).abs() < 0.02))
            };
            resting += usize::from(is_still(&rows[..30]) || is_still(&rows[WINDOW - 30..]));
        }
        // Half of the copies contain rest. In some of them, the rest is shorter than 0.3 s or contains tremor.
        assert!((30..100).contains(&resting), "{resting} of 200");
    }

    #[test]
    fn idle_windows_grow_by_a_third_at_most() {
        let window: Vec<f32> =
            (0..WINDOW).flat_map(|n| [if n % 2 == 0 { 0.1 } else { -0.1 }, 0.0, 9.8f32]).collect();
        for seed in 0..50 {
            let varied = vary(&window, 3, Kind::Idle, &mut ChaCha8Rng::seed_from_u64(seed));
            let samples: Vec<[f64; 9]> = varied
                .as_chunks::<3>()
                .0
                .iter()
                .map(|v| std::array::from_fn(|a| if a < 3 { f64::from(v[a]) } else { 0.0 }))
                .collect();
            // Tremor is at most proportional to the movement.
            assert!(spread(&samples) < 0.1 * 1.35 + 0.3, "seed {seed}");
        }
    }
}
