//! Teaching, sans-IO: decides when an arm's angles may be saved as a pose, and plays a single motion.

use host_arm::Director;
use host_robot::{Door as _, Joints, Motion, MotionName, Report, Robot, Twist};

/// Maximum time of waiting for a robot.
pub const SEARCH_MS: u64 = 8000;
/// Maximum speed of an arm that counts as at rest, in rad/s.
const REST_RAD_S: f64 = 0.02;
/// Time for which the angles must not change.
const RESTED_MS: u64 = 500;
const NOISE_RAD: f64 = 0.002;

/// Waits for an arm at rest. Some drivers report no speeds, so the angles must be constant for some time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rest {
    since: Option<(Joints, u64)>,
}

impl Rest {
    /// Adds a report about the arm's motion. Returns the arm's angles once it has been at rest long enough.
    pub fn see(&mut self, arm: &Motion, now_ms: u64) -> Option<Joints> {
        let here = arm.joints_rad;
        let moves = arm.velocity_rad_s.iter().any(|v| v.abs() > REST_RAD_S);
        match self.since {
            Some((there, since_ms)) if !moves && is_near(&here, &there) => {
                (now_ms.saturating_sub(since_ms) >= RESTED_MS).then_some(here)
            }
            _ => {
                self.since = Some((here, now_ms));
                None
            }
        }
    }

    /// Returns whether any angles have arrived.
    pub fn was_told(&self) -> bool {
        self.since.is_some()
    }
}

fn is_near(one: &Joints, two: &Joints) -> bool {
    one.iter().zip(two).all(|(a, b)| (a - b).abs() <= NOISE_RAD)
}

/// The result of playing a pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Played {
    /// The arm has reached the pose.
    Reached,
    /// The motion was not performed, for the reason in the text.
    Not(String),
    /// The program was asked to end.
    Interrupted,
}

/// Plays a single motion. It waits for the robot, and requests the motion once.
/// If there is a problem, it halts the robot.
#[derive(Clone, Debug)]
pub struct Play {
    motion: MotionName,
    farewell_ms: u64,
    began_ms: Option<u64>,
    started: bool,
    /// Time of the halt, and the result to report.
    halted: Option<(u64, Played)>,
}

impl Play {
    /// Creates a motion that has not begun. After a halt, the robot's messages are read for `farewell_ms`.
    pub fn new(motion: MotionName, farewell_ms: u64) -> Self {
        Play { motion, farewell_ms, began_ms: None, started: false, halted: None }
    }

    /// Performs one turn; `interrupted` halts the robot. Messages are passed to `note`.
    /// Returns the result at the end.
    pub fn turn<R: Robot>(
        &mut self,
        door: &mut Director<R>,
        now_ms: u64,
        interrupted: bool,
        mut note: impl FnMut(&str),
    ) -> Option<Played> {
        door.step(now_ms);
        // This message announces a commander; the base does not move.
        door.drive(Twist::ZERO);
        let mut reached = None;
        for report in door.take_reports() {
            match report {
                Report::MotionEnded { reached: there, .. } => reached = Some(there),
                Report::Note(text) => note(&text),
                _ => {}
            }
        }
        let outcome = match &self.halted {
            Some((since_ms, outcome)) => {
                (now_ms.saturating_sub(*since_ms) >= self.farewell_ms).then(|| outcome.clone())
            }
            None => match self.judge(door, now_ms, interrupted, reached) {
                Some(Played::Reached) => Some(Played::Reached),
                Some(outcome) => {
                    door.halt();
                    self.halted = Some((now_ms, outcome));
                    None
                }
                None => None,
            },
        };
        door.send();
        outcome
    }

    fn judge<R: Robot>(
        &mut self,
        door: &mut Director<R>,
        now_ms: u64,
        interrupted: bool,
        reached: Option<bool>,
    ) -> Option<Played> {
        let began_ms = *self.began_ms.get_or_insert(now_ms);
        if interrupted {
            return Some(Played::Interrupted);
        }
        let refusal = door.refusal();
        if self.started {
            return match (reached, refusal) {
                (_, Some(refusal)) => Some(Played::Not(format!("the robot refuses to move on: {refusal}"))),
                (Some(true), None) => Some(Played::Reached),
                (Some(false), None) => {
                    Some(Played::Not(format!("'{}' was given up on the way", self.motion)))
                }
                (None, None) => None,
            };
        }
        let waited = now_ms.saturating_sub(began_ms) >= SEARCH_MS;
        let is_ready = refusal.is_none() && door.robot().can_follow().is_ok() && door.has_seen(&self.motion);
        if !is_ready && !waited {
            return None;
        }
        if let Some(refusal) = refusal {
            return Some(Played::Not(format!("the robot refuses to move: {refusal}")));
        }
        self.started = true;
        match door.start_motion(&self.motion) {
            Ok(()) => None,
            Err(why) => Some(Played::Not(format!("'{}' does not start: {why}", self.motion))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::JOINTS;

    #[test]
    fn angles_are_taken_from_an_arm_that_rests_for_half_a_second_whether_or_not_it_reports_speeds() {
        let mut rest = Rest::default();
        assert!(!rest.was_told());
        // The arm moves at 0.1 rad/s for a second and reports no speed.
        let at = |ms: u64| Motion::at_rest([0.1 * ms.min(1000) as f64 / 1000.0; JOINTS]);
        let taken = (0..3000).step_by(10).find_map(|ms| Some((ms, rest.see(&at(ms), ms)?)));
        let (taken_ms, joints_rad) = taken.unwrap();
        assert!((1480..=1500).contains(&taken_ms), "{taken_ms}");
        assert!((joints_rad[0] - 0.1).abs() < NOISE_RAD && rest.was_told());
        // An arm that reports a speed is not at rest, even if its angles do not change.
        let mut rest = Rest::default();
        let mut drifting = Motion::at_rest([0.0; JOINTS]);
        drifting.velocity_rad_s[3] = -0.03;
        assert!((0..3000).step_by(10).all(|ms| rest.see(&drifting, ms).is_none()));
    }
}
