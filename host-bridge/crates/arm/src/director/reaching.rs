//! Slows the base down so that no point of the robot is faster than the cap, however far the arm reaches.
//!
//! ```text
//! speed of a point (x, y) of the robot      |(v − ωy, ωx)|, see [`crate::plan::reach`]
//! speed of the outermost point, u           the maximum over body, arm, tool and held object,
//!                                           now and for as long as the base would need to stop
//! twist that is driven                      (v, ω) · min(1, cap / u)
//! ```
//!
//! Speed and turn rate are reduced by the same factor, so the base stays on its arc.
//! The wheels are part of the body, so they are no faster than the cap either.
//! After a stop, each point therefore travels at most cap · reaction + cap² / (2 · wheels' acceleration),
//! which is the braking distance of the base on a straight line.
//! The arm's own motion is not included; its limits apply to it, and the guard considers both together.

use host_robot::{DRIVE_INTERVAL_MS, Joints, Report, Robot, Trajectory, Twist};

use super::Director;

/// Interval at which the arm's future motion is considered.
const LOOK_S: f64 = 0.05;

/// The cap, and what is known about the arm.
#[derive(Clone, Debug)]
pub(super) struct Reaching {
    /// Maximum speed of any point in m/s.
    pub(super) cap_m_s: f64,
    /// The last reported angles. They remain valid for the cap if no more reports arrive.
    seen_rad: Option<Joints>,
    /// The user knows that the base is slowed down.
    is_told: bool,
}

impl Default for Reaching {
    fn default() -> Self {
        Reaching { cap_m_s: f64::INFINITY, seen_rad: None, is_told: false }
    }
}

impl<R: Robot> Director<R> {
    /// Returns the twist, slowed down so that no point exceeds the cap.
    pub(super) fn within_reach(&mut self, twist: Twist) -> Twist {
        self.reaching.seen_rad = self.robot.arm().map(|arm| arm.value.joints_rad).or(self.reaching.seen_rad);
        let cap_m_s = self.reaching.cap_m_s;
        let moves = twist.linear_m_s != 0.0 || twist.angular_rad_s != 0.0;
        // The robot itself treats a twist that is not a number as a halt.
        let is_number = twist.linear_m_s.is_finite() && twist.angular_rad_s.is_finite();
        if !moves || !is_number || cap_m_s == f64::INFINITY {
            return twist;
        }
        let world = self.site.world();
        let mut fastest = world.reach_of_body().outermost(twist, 0.0);
        // Straight ahead, all points have the same speed.
        if twist.angular_rad_s != 0.0 {
            for (joints_rad, off_m) in self.arm_soon(twist) {
                let outermost = world.reach(&joints_rad, &self.things).outermost(twist, off_m);
                fastest =
                    fastest.into_iter().chain(outermost).max_by(|a, b| a.speed_m_s.total_cmp(&b.speed_m_s));
            }
        }
        let Some(outermost) = fastest else { return twist };
        // `max` also turns a cap that is not a number into a standstill.
        let share = (cap_m_s / outermost.speed_m_s).max(0.0);
        if share >= 1.0 - 1e-9 {
            self.reaching.is_told = false;
            return twist;
        }
        if !self.reaching.is_told {
            self.reaching.is_told = true;
            let text = format!(
                "the base is slowed to {:.0} % because of {}, {:.2} m from its middle",
                100.0 * share,
                world.name(outermost.part),
                outermost.from_middle_m
            );
            self.reports.push(Report::Note(text));
        }
        Twist { linear_m_s: share * twist.linear_m_s, angular_rad_s: share * twist.angular_rad_s }
    }

    /// Returns angles of the arm, now and until the base could be at rest.
    /// Each is returned with the maximum distance of the arm from there until the next angles.
    fn arm_soon(&self, twist: Twist) -> Vec<(Joints, f64)> {
        let Some(seen_rad) = self.reaching.seen_rad else { return Vec::new() };
        let mut poses = vec![(seen_rad, 0.0)];
        let Some(reported) = self.robot.arm() else { return poses };
        let braking;
        let (trajectory, elapsed_s): (&Trajectory, f64) = match self.along() {
            Some((trajectory, elapsed_s)) => (trajectory, elapsed_s),
            None if reported.value.velocity_rad_s.iter().all(|speed| *speed == 0.0) => return poses,
            None => {
                braking = Trajectory::braking(reported.value, self.joint_limits());
                (&braking, 0.0)
            }
        };
        let base = self.robot.base_limits();
        let rim_m_s = twist.linear_m_s.abs() + 0.5 * base.track_m * twist.angular_rad_s.abs();
        let braking_s = rim_m_s / (base.wheel_radius_m * base.wheel_acceleration_max_rad_s2);
        let base_age_ms = self.robot.base().map_or(0, |reading| reading.age_ms);
        let late_s = (DRIVE_INTERVAL_MS + self.robot.reaction_ms() + base_age_ms) as f64 / 1000.0;
        let end_s = (elapsed_s + late_s + braking_s).min(trajectory.duration_s());
        let count = ((end_s - elapsed_s).max(0.0) / LOOK_S).ceil() as usize;
        poses.extend((0..count).map(|k| {
            let from_s = elapsed_s + LOOK_S * k as f64;
            let fastest_rad_s = trajectory.fastest_rad_s(from_s, from_s + LOOK_S);
            // No point is further away than this from its place in the middle.
            let off_m = self.site.world().displacement_m(&fastest_rad_s.map(|speed| 0.5 * LOOK_S * speed));
            (trajectory.motion(from_s + 0.5 * LOOK_S).joints_rad, off_m)
        }));
        poses
    }
}
