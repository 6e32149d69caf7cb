//! Joint motion in time: all joints start and arrive together, along a straight line in joint space.
//!
//! The share of the way `s` runs from 0 to 1 with a trapezoidal (or triangular) speed. The joint with
//! the least speed in hand sets the pace: v = min(vᵢ/|Δqᵢ|), a = min(aᵢ/|Δqᵢ|), and the duration is
//! 1/v + v/a, or 2/√a where v² > a. MoveIt's time-optimal profile gives the same on such moves
//! (`shared/reference/robotics.md`).

use super::gen3::{
    ACCELERATION_SCALING, JOINTS, Joints, MAX_ACCELERATION_RAD_S2, MAX_VELOCITY_RAD_S, VELOCITY_SCALING,
};

/// What a move must not exceed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
}

impl JointLimits {
    /// The arm's own limits, scaled as in the paper (0.1 and 0.05).
    pub fn paper() -> Self {
        JointLimits {
            velocity_rad_s: MAX_VELOCITY_RAD_S.map(|v| v * VELOCITY_SCALING),
            acceleration_rad_s2: MAX_ACCELERATION_RAD_S2.map(|a| a * ACCELERATION_SCALING),
        }
    }
}

/// Positions and speeds of all joints at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// In rad.
    pub joints_rad: Joints,
    /// In rad/s.
    pub velocity_rad_s: Joints,
}

/// How the share of the way changes with time.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Law {
    /// Speeds up, holds `peak_per_s`, slows down.
    Trapezoid { peak_per_s: f64, ramp_s: f64, cruise_s: f64 },
    /// Slows down to rest from here.
    Braking { share: f64, speed_per_s: f64 },
}

/// A straight joint move, from rest to rest, or braking to rest on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMove {
    from_rad: Joints,
    to_rad: Joints,
    acceleration_per_s2: f64,
    law: Law,
}

impl JointMove {
    /// Plans the fastest straight move within the limits. Equal ends give a move of no duration.
    pub fn new(from_rad: Joints, to_rad: Joints, limits: &JointLimits) -> Self {
        let (mut velocity, mut acceleration) = (f64::INFINITY, f64::INFINITY);
        for i in 0..JOINTS {
            let travel = (to_rad[i] - from_rad[i]).abs();
            if travel > 0.0 {
                velocity = velocity.min(limits.velocity_rad_s[i] / travel);
                acceleration = acceleration.min(limits.acceleration_rad_s2[i] / travel);
            }
        }
        if !velocity.is_finite() {
            let law = Law::Trapezoid { peak_per_s: 0.0, ramp_s: 0.0, cruise_s: 0.0 };
            return JointMove { from_rad, to_rad, acceleration_per_s2: 0.0, law };
        }
        let law = if velocity * velocity > acceleration {
            let peak_per_s = acceleration.sqrt();
            Law::Trapezoid { peak_per_s, ramp_s: peak_per_s / acceleration, cruise_s: 0.0 }
        } else {
            let ramp_s = velocity / acceleration;
            Law::Trapezoid { peak_per_s: velocity, ramp_s, cruise_s: 1.0 / velocity - ramp_s }
        };
        JointMove { from_rad, to_rad, acceleration_per_s2: acceleration, law }
    }

    /// Seconds until rest.
    pub fn duration_s(&self) -> f64 {
        match self.law {
            Law::Trapezoid { ramp_s, cruise_s, .. } => 2.0 * ramp_s + cruise_s,
            Law::Braking { speed_per_s, .. } if speed_per_s > 0.0 => speed_per_s / self.acceleration_per_s2,
            Law::Braking { .. } => 0.0,
        }
    }

    /// Where the joints are, `time_s` after the start of the move.
    pub fn sample(&self, time_s: f64) -> Sample {
        if time_s >= self.duration_s()
            && let Law::Trapezoid { .. } = self.law
        {
            // Exactly the goal.
            return Sample { joints_rad: self.to_rad, velocity_rad_s: [0.0; JOINTS] };
        }
        let (share, mut speed) = self.share_and_speed(time_s);
        if time_s >= self.duration_s() {
            speed = 0.0; // Exactly, with no rounding left over.
        }
        let mut sample = Sample { joints_rad: self.from_rad, velocity_rad_s: [0.0; JOINTS] };
        for i in 0..JOINTS {
            let travel = self.to_rad[i] - self.from_rad[i];
            sample.joints_rad[i] += share * travel;
            sample.velocity_rad_s[i] = speed * travel;
        }
        sample
    }

    /// The same move, braking to rest from `time_s` on, along the same line and within the same limits.
    #[must_use]
    pub fn halted_at(&self, time_s: f64) -> JointMove {
        let (share, speed_per_s) = self.share_and_speed(time_s);
        JointMove { law: Law::Braking { share, speed_per_s }, ..*self }
    }

    fn share_and_speed(&self, time_s: f64) -> (f64, f64) {
        let t = time_s.clamp(0.0, self.duration_s());
        let a = self.acceleration_per_s2;
        match self.law {
            Law::Trapezoid { peak_per_s, ramp_s, cruise_s } => {
                if peak_per_s == 0.0 {
                    (1.0, 0.0)
                } else if t < ramp_s {
                    (0.5 * a * t * t, a * t)
                } else if t < ramp_s + cruise_s {
                    (0.5 * peak_per_s * ramp_s + peak_per_s * (t - ramp_s), peak_per_s)
                } else {
                    let left_s = 2.0 * ramp_s + cruise_s - t;
                    (1.0 - 0.5 * a * left_s * left_s, a * left_s)
                }
            }
            Law::Braking { share, speed_per_s } => {
                (share + speed_per_s * t - 0.5 * a * t * t, (speed_per_s - a * t).max(0.0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::gen3::HOME;
    use proptest::prelude::*;

    #[test]
    fn kinovas_own_poses_take_the_times_of_moveit() {
        // Figures of shared/reference/robotics.md, from MoveIt at scaling 0.1 and 0.05.
        let limits = JointLimits::paper();
        let retract = [0.0, -0.35, 3.14, -2.54, 0.0, -0.87, 1.57];
        let up = JointMove::new([0.0; JOINTS], HOME, &limits).duration_s();
        let back = JointMove::new(HOME, retract, &limits).duration_s();
        assert!((up - 22.81).abs() < 0.01, "{up}");
        assert!((back - 15.26).abs() < 0.01, "{back}");
    }

    #[test]
    fn a_short_move_never_reaches_full_speed() {
        let mut to = HOME;
        to[0] += 0.01;
        let limits = JointLimits::paper();
        let duration = JointMove::new(HOME, to, &limits).duration_s();
        assert!((duration - 2.0 * (0.01_f64 / 0.43).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn equal_ends_take_no_time() {
        let still = JointMove::new(HOME, HOME, &JointLimits::paper());
        assert_eq!(still.duration_s(), 0.0);
        assert_eq!(still.sample(1.0).joints_rad, HOME);
        assert_eq!(still.halted_at(0.0).sample(0.0).velocity_rad_s, [0.0; JOINTS]);
    }

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(-2.0..2.0_f64)
    }

    proptest! {
        #[test]
        fn limits_hold_on_the_way_and_while_halting(from in joints(), to in joints(), when in 0.0..1.0_f64) {
            let limits = JointLimits::paper();
            let plan = JointMove::new(from, to, &limits);
            let halt_s = when * plan.duration_s();
            let halting = plan.halted_at(halt_s);
            prop_assert!(halting.duration_s() <= 0.1222 / 0.43 + 0.05);
            let dt = 0.005;
            let mut previous = plan.sample(0.0);
            let mut time_s = 0.0;
            while time_s < halt_s + halting.duration_s() + 2.0 * dt {
                time_s += dt;
                let now = if time_s < halt_s { plan.sample(time_s) } else { halting.sample(time_s - halt_s) };
                for i in 0..JOINTS {
                    prop_assert!(now.velocity_rad_s[i].abs() <= limits.velocity_rad_s[i] * (1.0 + 1e-9));
                    let change = (now.velocity_rad_s[i] - previous.velocity_rad_s[i]).abs();
                    prop_assert!(change <= limits.acceleration_rad_s2[i] * dt * (1.0 + 1e-6) + 1e-9);
                    let step = now.joints_rad[i] - previous.joints_rad[i];
                    prop_assert!(step.abs() <= limits.velocity_rad_s[i] * dt + 1e-9);
                    prop_assert!(step * (to[i] - from[i]) >= -1e-12, "never turns back");
                }
                previous = now;
            }
            prop_assert_eq!(previous.velocity_rad_s, [0.0; JOINTS]);
        }
    }
}
