//! Braking on a trajectory's own path.
//!
//! A trajectory q(σ) is planned with σ̇ = 1. To brake on its path, σ̇ must decrease to zero.
//! Then q̇ = q′σ̇ and q̈ = q″σ̇² − q′β with β = −σ̈ ≥ 0.
//! At each instant, β is the largest value that respects every joint's acceleration limit.
//! With a jerk limit, β also rises and falls no faster than the limit allows.
//! On a straight segment at full speed, braking takes v/a seconds, or v/a + a/j with a jerk limit.

use crate::{JOINTS, JointLimits, Motion, Trajectory};

/// Step of the integration, in s.
const STEP_S: f64 = 0.001;
/// Speeds below this fraction of the planned speed count as standstill.
const REST: f64 = 1e-6;
/// An upper limit for the duration of any braking.
const BRAKING_MAX_S: f64 = 10.0;

/// The motion at one instant of braking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// Time since braking began, in s.
    pub time_s: f64,
    /// Position on the trajectory as a time of the trajectory, in s.
    pub along_s: f64,
    /// Angles, speeds and accelerations.
    pub motion: Motion,
}

/// Brakes on a trajectory, starting at `from_s`.
/// Returns one instant per millisecond, the first at the start and the last at rest.
pub fn along(trajectory: &Trajectory, from_s: f64, limits: &JointLimits) -> Vec<Instant> {
    let (mut time_s, mut along_s, mut rate, mut brake) = (0.0, from_s.max(0.0), 1.0_f64, 0.0_f64);
    let mut instants = Vec::new();
    let end_s = trajectory.duration_s();
    loop {
        let planned = trajectory.motion(along_s);
        if rate <= REST || along_s >= end_s || time_s > BRAKING_MAX_S {
            instants.push(Instant { time_s, along_s, motion: Motion::at_rest(planned.joints_rad) });
            return instants;
        }
        let (allowed, ramp) = allowed(&planned, rate, limits);
        brake = match ramp {
            None => allowed,
            // The acceleration is reduced early enough to come to rest without a jump.
            Some(ramp) if rate <= 0.5 * brake * brake / ramp => (brake - ramp * STEP_S).max(ramp * STEP_S),
            Some(ramp) => (brake + ramp * STEP_S).min(allowed),
        };
        let motion = Motion {
            joints_rad: planned.joints_rad,
            velocity_rad_s: planned.velocity_rad_s.map(|v| v * rate),
            acceleration_rad_s2: std::array::from_fn(|i| {
                planned.acceleration_rad_s2[i] * rate * rate - planned.velocity_rad_s[i] * brake
            }),
        };
        instants.push(Instant { time_s, along_s, motion });
        let slower = (rate - brake * STEP_S).max(0.0);
        along_s += 0.5 * (rate + slower) * STEP_S;
        rate = slower;
        time_s += STEP_S;
    }
}

/// Returns the strongest braking that all joints allow.
/// Also returns the maximum rate at which the braking may rise (`None` = unlimited).
fn allowed(planned: &Motion, rate: f64, limits: &JointLimits) -> (f64, Option<f64>) {
    let (mut brake, mut ramp) = (f64::INFINITY, f64::INFINITY);
    for i in 0..JOINTS {
        let speed = planned.velocity_rad_s[i];
        if speed.abs() < 1e-9 {
            continue;
        }
        // The part of the limit that the path's curvature uses, in the direction of braking.
        let bend = planned.acceleration_rad_s2[i] * rate * rate * speed.signum();
        brake = brake.min((limits.acceleration_rad_s2[i] + bend).max(0.0) / speed.abs());
        ramp = ramp.min(limits.jerk_rad_s3[i] / speed.abs());
    }
    // Nothing moves here, for example at a corner where the arm rests. The arm therefore stops immediately.
    let brake = if brake.is_finite() { brake } else { 1.0 / STEP_S };
    (brake, ramp.is_finite().then_some(ramp))
}

/// Returns the longest braking time on a straight segment at full speed, in s.
pub fn longest_s(limits: &JointLimits) -> f64 {
    let of = |i: usize| {
        let (v, a, j) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i], limits.jerk_rad_s3[i]);
        v / a + if j.is_finite() { a / j } else { 0.0 }
    };
    (0..JOINTS).map(of).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3::{HOME, paper_limits};

    fn paths() -> Vec<Trajectory> {
        let mut corner = HOME;
        corner[0] += 0.8;
        corner[3] += 0.3;
        let mut end = corner;
        end[0] -= 0.5;
        end[5] -= 0.6;
        [paper_limits(), paper_limits().with_jerk(4.3)]
            .iter()
            .flat_map(|limits| {
                [
                    Trajectory::through(&[HOME, corner], &[], limits),
                    Trajectory::through(&[HOME, corner, end], &[], limits),
                ]
            })
            .collect()
    }

    #[test]
    fn braking_at_full_speed_takes_v_over_a() {
        let limits = paper_limits();
        let trajectory = &paths()[0];
        let instants = along(trajectory, 2.0, &limits);
        assert!((instants.last().unwrap().time_s - 0.3247).abs() < 0.002, "{:?}", instants.last());
        assert!((longest_s(&limits) - 0.3247).abs() < 1e-3);
        assert!((longest_s(&limits.with_jerk(4.3)) - 0.4247).abs() < 1e-3);
    }

    #[test]
    fn braking_keeps_to_the_path_and_the_acceleration_limits_from_everywhere() {
        for trajectory in paths() {
            let limits = paper_limits();
            for k in 0..100 {
                let from_s = trajectory.duration_s() * f64::from(k) / 100.0;
                let instants = along(&trajectory, from_s, &limits);
                assert_eq!(instants.last().unwrap().motion.velocity_rad_s, [0.0; JOINTS]);
                assert!(instants.last().unwrap().time_s < 1.2, "{:?}", instants.last());
                for instant in &instants {
                    assert_eq!(instant.motion.joints_rad, trajectory.motion(instant.along_s).joints_rad);
                    for i in 0..JOINTS {
                        let acceleration = instant.motion.acceleration_rad_s2[i].abs();
                        assert!(
                            acceleration <= limits.acceleration_rad_s2[i] * (1.0 + 1e-6),
                            "{acceleration}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn speeds_are_the_slopes_of_the_angles() {
        for trajectory in paths() {
            let instants = along(&trajectory, 1.5, &paper_limits().with_jerk(4.3));
            for two in instants.windows(2) {
                let dt_s = two[1].time_s - two[0].time_s;
                for i in 0..JOINTS {
                    let slope = (two[1].motion.joints_rad[i] - two[0].motion.joints_rad[i]) / dt_s;
                    let mean = 0.5 * (two[0].motion.velocity_rad_s[i] + two[1].motion.velocity_rad_s[i]);
                    assert!((slope - mean).abs() < 1e-3, "{slope} {mean}");
                }
            }
        }
    }
}
