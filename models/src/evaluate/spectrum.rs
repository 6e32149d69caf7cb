//! How strong a movement is at which frequencies, to compare simulated people with real ones.

use std::f64::consts::TAU;

use crate::{RATE_HZ, WINDOW};

/// Limits of the bands in Hz. The first begins above the mean of the window, so gravity is in none.
pub const BANDS_HZ: [f64; 5] = [0.25, 1.0, 3.0, 8.0, 20.0];

/// The root mean square of a window in each band, over the three axes together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Strength {
    /// Acceleration, m/s².
    pub acceleration: [f64; BANDS_HZ.len() - 1],
    /// Turn rate, deg/s; 0 without a gyroscope.
    pub turning: [f64; BANDS_HZ.len() - 1],
}

/// Returns the strength of each whole window of 2 s of samples with this many axes.
pub fn strengths(values: &[f32], axes: usize) -> Vec<Strength> {
    let one = |window: &[f32]| {
        let of = |sensor: usize| {
            let mut bands = [0.0; BANDS_HZ.len() - 1];
            for axis in (3 * sensor..3 * sensor + 3).filter(|axis| *axis < axes) {
                let samples: Vec<f64> =
                    window.iter().skip(axis).step_by(axes).map(|value| f64::from(*value)).collect();
                let power = band_powers(&samples);
                bands.iter_mut().zip(power).for_each(|(sum, power)| *sum += power);
            }
            bands.map(f64::sqrt)
        };
        Strength { acceleration: of(0), turning: of(1) }
    };
    values.chunks_exact(WINDOW * axes.max(1)).map(one).collect()
}

/// The mean square of the sines of each band. A window of Hann keeps slow drift out of the other bands.
fn band_powers(samples: &[f64]) -> [f64; BANDS_HZ.len() - 1] {
    let count = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / count;
    let hann = |n: usize| 0.5 - 0.5 * (TAU * (n as f64 + 0.5) / count).cos();
    let windowed: Vec<f64> = samples.iter().enumerate().map(|(n, value)| (value - mean) * hann(n)).collect();
    let mut bands = [0.0; BANDS_HZ.len() - 1];
    for (band, limits) in bands.iter_mut().zip(BANDS_HZ.windows(2)) {
        let first = (limits[0] * count / RATE_HZ).ceil() as usize;
        let end = (limits[1] * count / RATE_HZ).ceil() as usize;
        for bin in first.max(1)..end {
            let (mut real, mut imaginary) = (0.0, 0.0);
            for (n, value) in windowed.iter().enumerate() {
                let (sine, cosine) = (TAU * bin as f64 * n as f64 / count).sin_cos();
                real += value * cosine;
                imaginary += value * sine;
            }
            // The mean of the squared window is 3/8.
            *band += 2.0 * (real * real + imaginary * imaginary) / (count * count) / 0.375;
        }
    }
    bands
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_is_as_strong_as_it_is_and_in_its_band_alone() {
        for (hz, band) in [(2.0, 1), (5.0, 2), (12.5, 3)] {
            let values: Vec<f32> = (0..WINDOW)
                .flat_map(|n| {
                    let value = 3.0 * (TAU * hz * n as f64 / RATE_HZ).sin();
                    [value as f32, 0.0, 9.81, 0.0, 10.0 * value as f32, 0.0]
                })
                .collect();
            let all = strengths(&values, 6);
            assert_eq!(all.len(), 1);
            for (n, (force, turning)) in all[0].acceleration.iter().zip(all[0].turning).enumerate() {
                let want = if n == band { 3.0 / 2.0f64.sqrt() } else { 0.0 };
                assert!((force - want).abs() < 0.05, "{hz} Hz, band {n}: {force}");
                assert!((turning - 10.0 * want).abs() < 0.5, "{hz} Hz, band {n}: {turning}");
            }
        }
    }

    #[test]
    fn a_part_of_a_window_and_a_missing_gyroscope_count_as_nothing() {
        assert!(strengths(&[1.0; 3 * (WINDOW - 1)], 3).is_empty());
        assert_eq!(strengths(&[1.0; 3 * WINDOW], 3)[0].turning, [0.0; 4]);
    }
}
