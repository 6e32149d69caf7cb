//! Varies recordings, to simulate other hands and other days and places.

use std::fmt;

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::recording::Recording;

/// The variation of recordings. Values are standard deviations of normal distributions unless the text says otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Augmentation {
    /// Varied copies per recording.
    pub copies: usize,
    /// Rotation of the board on the hand about a random axis, in degrees.
    pub turn_deg: f64,
    /// Logarithm of the size of the movement.
    pub size: f64,
    /// Tempo, logarithm.
    pub tempo: f64,
    /// Effect of nearby iron: offset of the magnetometer in µT.
    pub iron_ut: f64,
    /// Maximum rotation of the wearer relative to north, in degrees. The rotations are distributed uniformly.
    pub heading_deg: f64,
}

impl Augmentation {
    /// No copies.
    pub const NONE: Self =
        Self { copies: 0, turn_deg: 0.0, size: 0.0, tempo: 0.0, iron_ut: 0.0, heading_deg: 0.0 };
    /// The variation that recipe `log-power` uses.
    pub const DEFAULT: Self =
        Self { copies: 6, turn_deg: 8.0, size: 0.1, tempo: 0.08, iron_ut: 3.0, heading_deg: 30.0 };

    /// Returns a varied copy of a recording at the models' rate.
    pub fn vary(&self, recording: &Recording, rng: &mut ChaCha8Rng) -> Recording {
        let mut normal = |deviation: f64, limit: f64| -> f64 {
            let value: f64 = StandardNormal.sample(rng);
            (value * deviation).clamp(-limit, limit)
        };
        let size = normal(self.size, 3.0 * self.size).exp();
        let tempo = normal(self.tempo, 0.25).exp();
        let axis = [0; 3].map(|_| normal(1.0, 3.0));
        let turn = rotation(axis, normal(self.turn_deg, 3.0 * self.turn_deg).to_radians());
        let iron = [0; 3].map(|_| normal(self.iron_ut, 3.0 * self.iron_ut));
        let heading = (self.heading_deg * rng.random_range(-1.0..=1.0)).to_radians();

        let rows: Vec<&[f32]> = recording.samples().collect();
        let axes = recording.axes();
        let mean: Vec<f64> = (0..axes)
            .map(|a| rows.iter().map(|row| f64::from(row[a])).sum::<f64>() / rows.len() as f64)
            .collect();
        // The mean of the accelerometer is gravity, which is also the axis of the heading.
        let about_up = rotation([mean[0], mean[1], mean[2]], heading);
        let count = ((rows.len() - 1) as f64 / tempo).floor() as usize + 1;
        let mut values = Vec::with_capacity(count * axes);
        for n in 0..count {
            let at = n as f64 * tempo;
            let left = (at as usize).min(rows.len() - 2);
            let part = (at - left as f64).clamp(0.0, 1.0);
            let sample = |a: usize| {
                let (l, r) = (f64::from(rows[left][a]), f64::from(rows[left + 1][a]));
                l + (r - l) * part
            };
            // A tempo multiplies turn rates by `tempo` and accelerations by its square.
            let force = std::array::from_fn(|a| mean[a] + (sample(a) - mean[a]) * size * tempo * tempo);
            values.extend(apply(&turn, force));
            if axes > 3 {
                values.extend(apply(&turn, std::array::from_fn(|a| sample(3 + a) * size * tempo)));
            }
            if axes > 6 {
                let field = apply(&about_up, std::array::from_fn(|a| sample(6 + a)));
                values.extend(apply(&turn, std::array::from_fn(|a| f64::from(field[a]) + iron[a])));
            }
        }
        let time_ms = (0..count).map(|n| n as f64 * 1000.0 / crate::RATE_HZ).collect();
        Recording::new(axes, time_ms, values)
    }
}

impl fmt::Display for Augmentation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.copies == 0 {
            return f.write_str("none");
        }
        write!(
            f,
            "{} copies: board turned ±{}°, size ±{} %, tempo ±{} %, iron ±{} µT, heading up to ±{}°",
            self.copies,
            self.turn_deg,
            self.size * 100.0,
            self.tempo * 100.0,
            self.iron_ut,
            self.heading_deg
        )
    }
}

/// Returns the rotation by `angle` about `axis` (of any length except 0).
pub(super) fn rotation(axis: [f64; 3], angle: f64) -> [[f64; 3]; 3] {
    let length = axis.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
    let [x, y, z] = axis.map(|v| v / length);
    let (s, c) = angle.sin_cos();
    let d = 1.0 - c;
    [
        [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
        [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
        [z * x * d - y * s, z * y * d + x * s, c + z * z * d],
    ]
}

pub(super) fn apply(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|row| (0..3).map(|k| matrix[row][k] * v[k]).sum::<f64>() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_still_hand_stays_still_with_the_same_gravity_and_field() {
        let row = [0.0, 3.0, 9.0, 0.0, 0.0, 0.0, 20.0, 0.0, -40.0f32];
        let values = row.iter().copied().cycle().take(9 * 300).collect();
        let still = Recording::new(9, (0..300).map(|n| f64::from(n) * 10.0).collect(), values);
        let plan = Augmentation { iron_ut: 0.0, ..Augmentation::DEFAULT };
        let varied = plan.vary(&still, &mut ChaCha8Rng::seed_from_u64(5));
        let norm = |v: &[f32]| v.iter().map(|x| x * x).sum::<f32>().sqrt();
        for sample in varied.samples() {
            assert!((norm(&sample[..3]) - norm(&row[..3])).abs() < 1e-4);
            assert!(norm(&sample[3..6]) < 1e-6);
            assert!((norm(&sample[6..]) - norm(&row[6..])).abs() < 1e-3);
        }
        assert_ne!(varied.samples().next().unwrap()[..3], row[..3], "it is turned");
    }
}
