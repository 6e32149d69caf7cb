//! Simulates an LSM9DS1 on the hand: specific force, turn rate and magnetic field in the board's frame.
//! The model adds offsets, gains, noise, clipping at the ranges and quantisation to 16 bits.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::path::{OVERSAMPLING, STEP_S};
use super::pose::{BodyPose, rotation};
use super::wearer::{Wearer, normal};
use crate::RATE_HZ;
use crate::recording::Recording;

/// Standard gravity in m/s².
const GRAVITY: f64 = 9.806_65;

/// One of the three sensors on the chip.
struct Sensor {
    /// Value of one count according to the data sheet, for the range below.
    unit: f64,
    /// Maximum value of the range.
    range: f64,
    /// Standard deviation of the noise at 100 Hz.
    noise: f64,
    /// Number of decimals in the CSV file.
    decimals: i32,
}

/// Accelerometer ±4 g at 0.122 mg, gyroscope ±2000 deg/s at 70 mdeg/s, magnetometer ±4 gauss at 0.14 mgauss.
const SENSORS: [Sensor; 3] = [
    Sensor { unit: 0.122e-3 * GRAVITY, range: 4.0 * GRAVITY, noise: 0.02, decimals: 4 },
    Sensor { unit: 0.07, range: 2000.0, noise: 0.15, decimals: 2 },
    Sensor { unit: 0.014, range: 400.0, noise: 0.4, decimals: 2 },
];

/// Records a path at 100 Hz. The path has `OVERSAMPLING` points per sample, and one more at each end.
pub(super) fn record(wearer: &Wearer, rng: &mut ChaCha8Rng, track: &[BodyPose]) -> Recording {
    let count = (track.len() - 2) / OVERSAMPLING;
    let heading_rad = rng.random_range(0.0..std::f64::consts::TAU);
    let level = wearer.inclination_rad.cos();
    let field = [
        wearer.field_ut * level * heading_rad.cos(),
        wearer.field_ut * level * heading_rad.sin(),
        -wearer.field_ut * wearer.inclination_rad.sin(),
    ];
    let mag_phase = rng.random_range(0..wearer.mag_every);
    let mut values = Vec::with_capacity(count * 9);
    let mut held = [0.0f32; 3];
    for n in 0..count {
        let mut force = [0.0; 3];
        let mut rate = [0.0; 3];
        // The filter inside the sensor averages over the sample.
        for k in 0..OVERSAMPLING {
            let at = 1 + n * OVERSAMPLING + k;
            let [before, here, after] = [&track[at - 1], &track[at], &track[at + 1]];
            let pushed = std::array::from_fn(|a| {
                let second = after.position_m[a] - 2.0 * here.position_m[a] + before.position_m[a];
                second / (STEP_S * STEP_S) + if a == 2 { GRAVITY } else { 0.0 }
            });
            let turn = rotation(here.posture_rad);
            add(&mut force, into_board(&turn, pushed));
            add(&mut rate, turn_rate_deg_s(&turn, &rotation(after.posture_rad)));
        }
        let share = 1.0 / OVERSAMPLING as f64;
        values.extend(read(wearer, rng, 0, force.map(|v| v * share)));
        values.extend(read(wearer, rng, 1, rate.map(|v| v * share)));
        // The magnetometer is slower, so its last value is read several times.
        if n == 0 || n % wearer.mag_every == mag_phase {
            let turn = rotation(track[1 + n * OVERSAMPLING].posture_rad);
            held = read(wearer, rng, 2, into_board(&turn, field));
        }
        values.extend(held);
    }
    let time_ms = (0..count).map(|n| n as f64 * 1000.0 / RATE_HZ).collect();
    Recording::new(9, time_ms, values)
}

/// Computes a reading of one sensor, with gain, offset, noise, clipping, counts, and the decimals of the file.
fn read(wearer: &Wearer, rng: &mut ChaCha8Rng, which: usize, truth: [f64; 3]) -> [f32; 3] {
    let sensor = &SENSORS[which];
    std::array::from_fn(|axis| {
        let noise = normal(rng, sensor.noise, 5.0 * sensor.noise);
        let value = truth[axis] * wearer.gain[which][axis] + wearer.offset[which][axis] + noise;
        let counts = (value.clamp(-sensor.range, sensor.range) / sensor.unit).round();
        let scale = 10f64.powi(sensor.decimals);
        ((counts * sensor.unit * scale).round() / scale) as f32
    })
}

fn add(sum: &mut [f64; 3], value: [f64; 3]) {
    for axis in 0..3 {
        sum[axis] += value[axis];
    }
}

/// Converts a vector from the wearer's frame to the board's frame.
fn into_board(turn: &[[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|column| (0..3).map(|row| turn[row][column] * vector[row]).sum())
}

/// Computes the turn rate in the board's frame (in deg/s) from two postures one step apart.
fn turn_rate_deg_s(from: &[[f64; 3]; 3], to: &[[f64; 3]; 3]) -> [f64; 3] {
    // The relative rotation is fromᵀ·to. For a small angle, its antisymmetric part is the angle.
    let relative = |i: usize, j: usize| (0..3).map(|k| from[k][i] * to[k][j]).sum::<f64>();
    [
        (relative(2, 1) - relative(1, 2)) / 2.0,
        (relative(0, 2) - relative(2, 0)) / 2.0,
        (relative(1, 0) - relative(0, 1)) / 2.0,
    ]
    .map(|angle| (angle / STEP_S).to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_about_one_axis_is_read_as_its_rate() {
        let step = 100f64.to_radians() * STEP_S;
        for axis in 0..3 {
            let mut to = [0.0; 3];
            to[axis] = step;
            let rate = turn_rate_deg_s(&rotation([0.0; 3]), &rotation(to));
            for (n, value) in rate.iter().enumerate() {
                let want = if n == axis { 100.0 } else { 0.0 };
                assert!((value - want).abs() < 0.01, "axis {axis}: {rate:?}");
            }
        }
    }

    #[test]
    fn a_board_pitched_nose_down_by_a_quarter_turn_feels_gravity_along_minus_x() {
        let turn = rotation([0.0, std::f64::consts::FRAC_PI_2, 0.0]);
        let felt = into_board(&turn, [0.0, 0.0, GRAVITY]);
        assert!((felt[0] + GRAVITY).abs() < 1e-9 && felt[1].abs() < 1e-9 && felt[2].abs() < 1e-9);
    }
}
