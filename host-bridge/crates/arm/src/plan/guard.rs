//! Keeps base and arm in states from which both can still stop before a contact.
//!
//! Plans assume that the base does not move.
//! The guard handles a moving base, for example one that drives towards a wall.
//! The guard permits a tick of motion only if base and arm can brake to rest afterwards without contact.
//! This condition is true after every tick, so braking is always safe. A forbidden tick triggers braking.

use crate::plan::collision::{Placement, World};
use crate::things::Things;
use host_robot::Trajectory;
use host_robot::{Base, Odometry, Twist};
use host_robot::{JOINTS, Joints};
use host_robot::{JointLimits, Motion};

/// Duration of a tick of motion, which is checked in steps of a millisecond.
pub const TICK_MS: u64 = 10;

/// Twice the minimum distance. This value is smaller than that of the planner (half of its margin, 5 mm).
pub const MARGIN_M: f64 = 0.004;

/// Base and arm in simultaneous motion.
#[derive(Clone, Copy, Debug)]
pub struct Moving {
    /// Position and motion of the base.
    pub odometry: Odometry,
    /// Time that the base needs to come to rest.
    pub base_braking_s: f64,
    /// The arm.
    pub arm: Motion,
}

impl Moving {
    /// Returns the current state of base and arm.
    pub fn now(base: &Base, arm: Motion) -> Self {
        Moving { odometry: base.odometry(), base_braking_s: base.braking_s(), arm }
    }
}

/// The shapes and limits of the guard.
#[derive(Clone, Copy, Debug)]
pub struct Guard<'w> {
    /// Robot and scene.
    pub world: &'w World,
    /// The arm's limits.
    pub limits: &'w JointLimits,
    /// Tool and objects.
    pub things: &'w Things,
}

/// A part of the braking: its time and the moving parts.
struct Braking<'a> {
    from: &'a Moving,
    arm: Trajectory,
    margin_m: f64,
}

impl Guard<'_> {
    /// Returns whether base and arm can brake to rest without contact after the tick.
    /// The tick starts at `now` and consists of `instants`, one per millisecond.
    pub fn allows(&self, now: &Moving, instants: &[Moving]) -> bool {
        let Some(next) = instants.last() else { return true };
        let nearest_m = self.nearest_m(&now.odometry, &now.arm, None);
        // If the distance is already too small, it may increase but not decrease.
        let margin_m = MARGIN_M.min(0.99 * nearest_m);
        if nearest_m <= 0.0 {
            return false;
        }
        let step_s = 0.001;
        let clear = |pair: &[&Moving]| {
            let way_m = self.way_m(pair[0], pair[1], step_s);
            self.nearest_m(&pair[1].odometry, &pair[1].arm, None) - way_m >= 0.5 * margin_m
        };
        let tick_s = step_s * instants.len() as f64;
        let way_m = self.way_m(now, next, tick_s);
        let through: Vec<&Moving> = std::iter::once(now).chain(instants).collect();
        (nearest_m - way_m >= margin_m || through.windows(2).all(clear)) && self.can_brake(next, margin_m)
    }

    /// Returns the closest pair of parts now, for users.
    pub fn nearest(&self, odometry: &Odometry, arm: &Motion) -> String {
        let around = self.world.around_with(Placement::from(*odometry), self.things);
        let (own, boxes) = around.arm_clearances(&arm.joints_rad);
        // The robot's own parts are always close to each other.
        // Such a pair is returned only if it blocks the motion, or if nothing else is there.
        let own = Some(own).filter(|own| own.distance_m < 2.0 * MARGIN_M || !boxes.distance_m.is_finite());
        let all = [boxes, around.base_clearance()].into_iter().chain(own);
        let nearest = all.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        nearest.map_or_else(String::new, |clearance| {
            let (one, two) = clearance.parts;
            let (one, two) = (self.world.name(one), self.world.name(two));
            format!("{one} is {:.2} m from {two}", clearance.distance_m)
        })
    }

    fn can_brake(&self, from: &Moving, margin_m: f64) -> bool {
        let arm = Trajectory::braking(from.arm, self.limits);
        let end_s = arm.duration_s().max(from.base_braking_s);
        let braking = Braking { from, arm, margin_m };
        self.stretch_is_clear(&braking, 0.0, end_s)
    }

    fn stretch_is_clear(&self, braking: &Braking<'_>, start_s: f64, end_s: f64) -> bool {
        let middle_s = 0.5 * (start_s + end_s);
        let (odometry, arm) = braking.at(middle_s);
        let half_s = 0.5 * (end_s - start_s);
        // The base only slows down, but a joint may still accelerate until its acceleration is zero.
        let base_m = self.base_speed_m_s(&braking.at(start_s).0.twist) * half_s;
        let arm_m = self.lever_speed_m_s(&braking.arm.fastest_rad_s(start_s, end_s)) * half_s;
        let nearest_m = self.nearest_m(&odometry, &arm, None);
        if nearest_m < braking.margin_m {
            return false;
        }
        // The base's motion does not affect distances within the robot.
        if self.nearest_m(&odometry, &arm, Some((base_m, arm_m))) >= 0.5 * braking.margin_m {
            return true;
        }
        self.stretch_is_clear(braking, start_s, middle_s) && self.stretch_is_clear(braking, middle_s, end_s)
    }

    /// Returns the smallest distance. If a displacement of base and arm is given, it is subtracted.
    fn nearest_m(&self, odometry: &Odometry, arm: &Motion, moves_m: Option<(f64, f64)>) -> f64 {
        let (base_m, arm_m) = moves_m.unwrap_or((0.0, 0.0));
        let around = self.world.around_with(Placement::from(*odometry), self.things);
        let (own, boxes) = around.arm_clearances(&arm.joints_rad);
        let body = around.base_clearance();
        (own.distance_m - arm_m).min(boxes.distance_m - arm_m - base_m).min(body.distance_m - base_m)
    }

    /// Returns the maximum displacement of a point between two instants.
    /// The speed changes uniformly, except for the curvature that a limited jerk permits.
    fn way_m(&self, from: &Moving, to: &Moving, step_s: f64) -> f64 {
        let bend =
            self.limits.jerk_rad_s3.map(|j| if j.is_finite() { j * step_s * step_s / 8.0 } else { 0.0 });
        (self.speed_m_s(from).max(self.speed_m_s(to)) + self.lever_speed_m_s(&bend)) * step_s
    }

    fn speed_m_s(&self, moving: &Moving) -> f64 {
        self.base_speed_m_s(&moving.odometry.twist) + self.lever_speed_m_s(&moving.arm.velocity_rad_s)
    }

    /// Returns the maximum speed of any point due to the base.
    fn base_speed_m_s(&self, twist: &Twist) -> f64 {
        let base = &self.world.scene().base;
        let body_m = 0.5 * base.size_m[0].hypot(base.size_m[1]);
        let arm_m = base.mount_m[0].hypot(base.mount_m[1]) + self.world.lever_m()[0];
        twist.linear_m_s.abs() + twist.angular_rad_s.abs() * body_m.max(arm_m)
    }

    /// Returns the maximum speed of any point of the arm due to its joints.
    fn lever_speed_m_s(&self, velocity_rad_s: &Joints) -> f64 {
        (0..JOINTS).map(|i| velocity_rad_s[i].abs() * self.world.lever_m()[i]).sum()
    }
}

impl Braking<'_> {
    /// Returns base and arm at this time after they began to brake.
    fn at(&self, time_s: f64) -> (Odometry, Motion) {
        let mut odometry = self.from.odometry;
        let braking_s = self.from.base_braking_s;
        let t = time_s.min(braking_s);
        if braking_s > 0.0 {
            let twist = odometry.twist;
            // Both wheels slow down uniformly and together, so the base stays on its arc.
            odometry.advance(twist, t - 0.5 * t * t / braking_s);
            let left = 1.0 - t / braking_s;
            odometry.twist =
                Twist { linear_m_s: twist.linear_m_s * left, angular_rad_s: twist.angular_rad_s * left };
        }
        (odometry, self.arm.motion(time_s))
    }
}
