//! Simulates the same movement at another tempo. Only tests of models use this, and never training.
//!
//! Gravity is the part of the acceleration below 0.3 Hz, and does not change.
//! The remaining acceleration scales with the square of the tempo, and rotation scales with the tempo.
//! Time is shortened, and the sensor clips at its `range`. The magnetometer's values are only replayed faster.

use crate::RATE_HZ;
use crate::recording::Recording;

/// The frequency that separates gravity (below) from movement (above).
const GRAVITY_HZ: f64 = 0.3;
/// Range of frequencies in Hz in which the period of a movement is searched.
const SEARCH_HZ: std::ops::Range<f64> = 0.2..8.0;
const STEP_HZ: f64 = 0.05;

/// Converts a recording (at the models' rate) to one in which the hand moves `factor` times as fast.
pub fn at_tempo(recording: &Recording, factor: f64, range: f64) -> Recording {
    let ready = recording.resampled();
    let axes = ready.axes();
    let rows: Vec<&[f32]> = ready.samples().collect();
    let column = |axis: usize| -> Vec<f64> { rows.iter().map(|row| f64::from(row[axis])).collect() };
    let columns: Vec<Vec<f64>> = (0..axes)
        .map(|axis| {
            let values = column(axis);
            match axis {
                0..3 => {
                    let gravity = low_pass(&values);
                    let moved = values.iter().zip(gravity);
                    moved.map(|(v, g)| (g + (v - g) * factor * factor).clamp(-range, range)).collect()
                }
                3..6 => values.iter().map(|value| (value * factor).clamp(-2000.0, 2000.0)).collect(),
                _ => values,
            }
        })
        .collect();
    let count = ((rows.len().saturating_sub(1)) as f64 / factor) as usize + 1;
    let mut values = Vec::with_capacity(count * axes);
    for n in 0..count {
        let at = n as f64 * factor;
        let left = (at as usize).min(rows.len().saturating_sub(2));
        let part = (at - left as f64).min(1.0);
        for column in &columns {
            let right = column.get(left + 1).or(column.last()).copied().unwrap_or_default();
            values.push((column[left] + (right - column[left]) * part) as f32);
        }
    }
    let time_ms = (0..count).map(|n| n as f64 * 1000.0 / RATE_HZ).collect();
    Recording::new(axes, time_ms, values)
}

/// Returns the range of the accelerometer in m/s², which is the smallest of 2, 4, 8 and 16 g that contains all values.
pub fn range_of<'a>(recordings: impl Iterator<Item = &'a Recording>) -> f64 {
    let samples = recordings.flat_map(Recording::samples).flat_map(|row| &row[..3]);
    let most = samples.fold(0.0f64, |most, value| most.max(f64::from(value.abs())));
    let ranges = [2.0, 4.0, 8.0].map(|range| range * 9.806_65);
    ranges.into_iter().find(|range| most <= range + 0.05).unwrap_or(16.0 * 9.806_65)
}

/// Applies a second-order filter forward and backward, so that the result has no delay.
fn low_pass(values: &[f64]) -> Vec<f64> {
    let once = |values: &mut dyn Iterator<Item = f64>, first: f64| -> Vec<f64> {
        let keep = (-std::f64::consts::TAU * GRAVITY_HZ / RATE_HZ).exp();
        let mut state = first;
        values
            .map(|value| {
                state = keep * state + (1.0 - keep) * value;
                state
            })
            .collect()
    };
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let forth = once(&mut values.iter().copied(), mean);
    let last = forth.last().copied().unwrap_or_default();
    let mut back = once(&mut forth.into_iter().rev(), last);
    back.reverse();
    back
}

/// Returns the number of strokes per second: the frequency with the most power in the acceleration without gravity.
/// The tempo is `None` if nothing moves.
pub fn strokes_per_second(recording: &Recording) -> Option<f64> {
    let ready = recording.resampled();
    let rows: Vec<&[f32]> = ready.samples().collect();
    let mut best = (0.0, None);
    let moved: Vec<Vec<f64>> = (0..3)
        .map(|axis| {
            let values: Vec<f64> = rows.iter().map(|row| f64::from(row[axis])).collect();
            let gravity = low_pass(&values);
            let count = values.len() as f64;
            // With a Hann window.
            let weighted = values.iter().zip(gravity).enumerate().map(|(n, (value, gravity))| {
                (value - gravity) * (std::f64::consts::PI * (n as f64 + 0.5) / count).sin().powi(2)
            });
            weighted.collect()
        })
        .collect();
    let steps = ((SEARCH_HZ.end - SEARCH_HZ.start) / STEP_HZ) as usize;
    for step in 0..=steps {
        let hz = SEARCH_HZ.start + STEP_HZ * step as f64;
        let power: f64 = moved
            .iter()
            .map(|series| {
                let (re, im) = series.iter().enumerate().fold((0.0, 0.0), |(re, im), (n, value)| {
                    let (sin, cos) = (std::f64::consts::TAU * hz * n as f64 / RATE_HZ).sin_cos();
                    (re + value * cos, im + value * sin)
                });
                re * re + im * im
            })
            .sum();
        if power > best.0 {
            best = (power, Some(hz));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Generates a sway along x with this frequency in Hz and amplitude in m/s².
    /// Gravity is along z, and the rotation is about z.
    fn sway(hz: f64, size: f64) -> Recording {
        let angle = |n: usize| std::f64::consts::TAU * hz * n as f64 / RATE_HZ;
        let row =
            |n: usize| [size * angle(n).sin(), 0.0, 9.8, 0.0, 0.0, 50.0 * angle(n).cos()].map(|v| v as f32);
        Recording::new(6, (0..400).map(|n| n as f64 * 10.0).collect(), (0..400).flat_map(row).collect())
    }

    fn most(recording: &Recording, axis: usize) -> f32 {
        // Excludes both ends, where the filter has little data.
        let rows: Vec<f32> = recording.samples().map(|row| row[axis].abs()).collect();
        rows[rows.len() / 4..3 * rows.len() / 4].iter().fold(0.0, |most, value| most.max(*value))
    }

    #[test]
    fn twice_the_tempo_is_four_times_the_force_and_twice_the_rotation_in_half_the_time() {
        let (before, after) = (sway(1.5, 2.0), at_tempo(&sway(1.5, 2.0), 2.0, 40.0));
        assert_eq!(after.len(), 200);
        assert!((most(&after, 0) / most(&before, 0) - 4.0).abs() < 0.2, "{}", most(&after, 0));
        assert!((most(&after, 5) / most(&before, 5) - 2.0).abs() < 0.02);
        assert!((most(&after, 2) - 9.8).abs() < 0.1, "gravity stays");
        let hz = strokes_per_second(&after).unwrap();
        assert!((hz - 3.0).abs() < 0.11, "{hz} Hz");
        assert!((strokes_per_second(&before).unwrap() - 1.5).abs() < 0.11);
    }

    #[test]
    fn what_the_sensor_could_not_measure_is_clipped() {
        let after = at_tempo(&sway(2.0, 15.0), 2.0, 4.0 * 9.806_65);
        assert!((most(&after, 0) - 4.0 * 9.806_65).abs() < 0.01, "{}", most(&after, 0));
    }

    #[test]
    fn a_hand_at_rest_has_no_tempo_worth_the_name_and_nothing_panics() {
        let still = Recording::new(3, vec![0.0, 10.0], vec![0.0, 0.0, 9.8, 0.0, 0.0, 9.8]);
        assert_eq!(strokes_per_second(&still), None);
        for factor in [0.5, 1.0, 2.0] {
            assert!(at_tempo(&still, factor, 19.6).samples().flatten().all(|value| value.is_finite()));
        }
    }
}
