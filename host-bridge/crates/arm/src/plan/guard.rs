//! Keeps base and arm in states from which both can still stop before they touch anything.
//!
//! Plans hold for a base that stands still. When it moves, or is driven at a wall, this decides: a tick of
//! motion is allowed only if, after it, both can brake to rest with nothing touched. Since that is so after
//! every tick, braking is always safe, and is what happens if a tick is not allowed.

use crate::plan::collision::{Placement, World};
use crate::things::Things;
use host_robot::Trajectory;
use host_robot::{Base, Odometry, Twist};
use host_robot::{JOINTS, Joints};
use host_robot::{JointLimits, Motion};

/// How long a tick of motion lasts; it is looked at in steps of a millisecond.
pub const TICK_MS: u64 = 10;

/// Nothing comes nearer than half of this; less than what plans keep (half of their margin, 5 mm).
pub const MARGIN_M: f64 = 0.004;

/// Base and arm, moving together.
#[derive(Clone, Copy, Debug)]
pub struct Moving {
    /// Where the base is and how it moves.
    pub odometry: Odometry,
    /// How long the base takes to rest.
    pub base_braking_s: f64,
    /// The arm.
    pub arm: Motion,
}

impl Moving {
    /// Base and arm as they are now.
    pub fn now(base: &Base, arm: Motion) -> Self {
        Moving { odometry: base.odometry(), base_braking_s: base.braking_s(), arm }
    }
}

/// Shapes and limits to go by.
#[derive(Clone, Copy, Debug)]
pub struct Guard<'w> {
    /// Robot and scene.
    pub world: &'w World,
    /// The arm's limits.
    pub limits: &'w JointLimits,
    /// Tool and objects.
    pub things: &'w Things,
}

/// A part of the braking: when, and what moves in it.
struct Braking<'a> {
    from: &'a Moving,
    arm: Trajectory,
    margin_m: f64,
}

impl Guard<'_> {
    /// After the tick that starts `now` and leads through `instants`, a millisecond each, base and arm can
    /// brake to rest, and nothing is touched on the way.
    pub fn allows(&self, now: &Moving, instants: &[Moving]) -> bool {
        let Some(next) = instants.last() else { return true };
        let nearest_m = self.nearest_m(&now.odometry, &now.arm, None);
        // What is too near already may be left, but not approached.
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

    /// The two parts that are nearest to each other now, for people.
    pub fn nearest(&self, odometry: &Odometry, arm: &Motion) -> String {
        let around = self.world.around_with(Placement::from(*odometry), self.things);
        let (own, boxes) = around.arm_clearances(&arm.joints_rad);
        // The robot's own parts are always near each other; they count only if they hold it.
        let own = Some(own).filter(|own| own.distance_m < 2.0 * MARGIN_M);
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
        // The base only slows down; a joint may still gain speed until its acceleration is gone.
        let base_m = self.base_speed_m_s(&braking.at(start_s).0.twist) * half_s;
        let arm_m = self.lever_speed_m_s(&braking.arm.fastest_rad_s(start_s, end_s)) * half_s;
        let nearest_m = self.nearest_m(&odometry, &arm, None);
        if nearest_m < braking.margin_m {
            return false;
        }
        // The base's motion changes nothing between the robot's own parts.
        if self.nearest_m(&odometry, &arm, Some((base_m, arm_m))) >= 0.5 * braking.margin_m {
            return true;
        }
        self.stretch_is_clear(braking, start_s, middle_s) && self.stretch_is_clear(braking, middle_s, end_s)
    }

    /// Shortest distance; less what each can move, where that is given for base and arm.
    fn nearest_m(&self, odometry: &Odometry, arm: &Motion, moves_m: Option<(f64, f64)>) -> f64 {
        let (base_m, arm_m) = moves_m.unwrap_or((0.0, 0.0));
        let around = self.world.around_with(Placement::from(*odometry), self.things);
        let (own, boxes) = around.arm_clearances(&arm.joints_rad);
        let body = around.base_clearance();
        (own.distance_m - arm_m).min(boxes.distance_m - arm_m - base_m).min(body.distance_m - base_m)
    }

    /// A point moves this far from one instant to the next at most. The speed changes evenly in between, but
    /// for the bend that a limited jerk allows it.
    fn way_m(&self, from: &Moving, to: &Moving, step_s: f64) -> f64 {
        let bend =
            self.limits.jerk_rad_s3.map(|j| if j.is_finite() { j * step_s * step_s / 8.0 } else { 0.0 });
        (self.speed_m_s(from).max(self.speed_m_s(to)) + self.lever_speed_m_s(&bend)) * step_s
    }

    fn speed_m_s(&self, moving: &Moving) -> f64 {
        self.base_speed_m_s(&moving.odometry.twist) + self.lever_speed_m_s(&moving.arm.velocity_rad_s)
    }

    /// No point of the robot is moved faster by the base.
    fn base_speed_m_s(&self, twist: &Twist) -> f64 {
        let base = &self.world.scene().base;
        let body_m = 0.5 * base.size_m[0].hypot(base.size_m[1]);
        let arm_m = base.mount_m[0].hypot(base.mount_m[1]) + self.world.lever_m()[0];
        twist.linear_m_s.abs() + twist.angular_rad_s.abs() * body_m.max(arm_m)
    }

    /// No point of the arm is moved faster by its joints.
    fn lever_speed_m_s(&self, velocity_rad_s: &Joints) -> f64 {
        (0..JOINTS).map(|i| velocity_rad_s[i].abs() * self.world.lever_m()[i]).sum()
    }
}

impl Braking<'_> {
    /// Base and arm, this long after they began to brake.
    fn at(&self, time_s: f64) -> (Odometry, Motion) {
        let mut odometry = self.from.odometry;
        let braking_s = self.from.base_braking_s;
        let t = time_s.min(braking_s);
        if braking_s > 0.0 {
            let twist = odometry.twist;
            // Both wheels slow down evenly and together: the base keeps to its arc.
            odometry.advance(twist, t - 0.5 * t * t / braking_s);
            let left = 1.0 - t / braking_s;
            odometry.twist =
                Twist { linear_m_s: twist.linear_m_s * left, angular_rad_s: twist.angular_rad_s * left };
        }
        (odometry, self.arm.motion(time_s))
    }
}
