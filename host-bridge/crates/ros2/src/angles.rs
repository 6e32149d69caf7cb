//! The arm's angles, as reported in joint states.

use super::config::Ros2Config;
use super::doubts::Doubts;
use host_robot::{JOINTS, Motion, Reading};
use host_topics::message::JointState;

/// Maximum number of joints that are read in one message.
const NAMES_MAX: usize = 256;

/// See the module.
#[derive(Clone, Debug)]
pub struct Angles {
    /// One to eight joints; values of joints that the arm does not have stay at zero.
    names: Vec<String>,
    max_age_ms: u64,
    /// Of each of them.
    seen: Vec<Option<Seen>>,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    position_rad: f64,
    velocity_rad_s: f64,
    at_ms: u64,
}

impl Angles {
    /// Creates a record without angles.
    pub fn new(config: &Ros2Config) -> Self {
        Angles {
            names: config.joint_names.clone(),
            max_age_ms: config.joint_states_max_age_ms,
            seen: vec![None; config.joint_names.len()],
        }
    }

    /// The arm's joints, with the names that the robot uses.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Reads angles, except NaN and those of other joints. Returns whether the message contained joints of the arm.
    pub fn see(&mut self, state: &JointState, now_ms: u64, doubts: &mut Doubts) -> bool {
        let mut about_arm = false;
        // No arm has this many joints. The rest of a longer message is ignored.
        for (place, (name, &position_rad)) in
            state.name.iter().zip(&state.position).enumerate().take(NAMES_MAX)
        {
            let Some(joint) = self.names.iter().position(|own| own == name) else { continue };
            about_arm = true;
            let velocity = state.velocity.get(place).copied();
            let velocity_rad_s = velocity.filter(|v| v.is_finite()).unwrap_or(0.0);
            if position_rad.is_finite() {
                let before =
                    self.seen[joint].map(|seen| (seen.position_rad, now_ms.saturating_sub(seen.at_ms)));
                doubts.judge(name, position_rad, before, now_ms);
                self.seen[joint] = Some(Seen { position_rad, velocity_rad_s, at_ms: now_ms });
            }
        }
        about_arm
    }

    /// Returns all joints with the age of the oldest value, if all values are recent.
    /// Accelerations are not reported.
    pub fn reading(&self, now_ms: u64) -> Option<Reading<Motion>> {
        let mut value = Motion::at_rest([0.0; JOINTS]);
        let mut age_ms = 0;
        for (joint, seen) in self.seen.iter().enumerate() {
            let seen = seen.filter(|seen| self.is_fresh(seen, now_ms))?;
            value.joints_rad[joint] = seen.position_rad;
            value.velocity_rad_s[joint] = seen.velocity_rad_s;
            age_ms = age_ms.max(now_ms.saturating_sub(seen.at_ms));
        }
        Some(Reading { value, age_ms })
    }

    /// Describes the joints without recent angles, with a remedy.
    pub fn what_is_missing(&self, now_ms: u64) -> String {
        let fresh = |seen: &Option<Seen>| seen.is_some_and(|seen| self.is_fresh(&seen, now_ms));
        let joints = self.seen.iter().zip(&self.names);
        let missing: Vec<&str> =
            joints.filter(|(seen, _)| !fresh(seen)).map(|(_, name)| name.as_str()).collect();
        format!(
            "no angles of {} within {} ms: is the joint_state_broadcaster active, and are joint_names and \
             joint_states in [ros2] the robot's?",
            missing.join(", "),
            self.max_age_ms
        )
    }

    fn is_fresh(&self, seen: &Seen, now_ms: u64) -> bool {
        now_ms.saturating_sub(seen.at_ms) <= self.max_age_ms
    }
}
