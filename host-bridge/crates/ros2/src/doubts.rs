//! Reasons against moving the arm:
//! two writers of its angles, impossible angles, foreign goals, or a scaled speed.
//! This module is sans-IO. Each reason is reported.
//! While a reason applies, no motion starts, and a running one is stopped.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use super::stream::off_rad;
use host_robot::{JOINTS, Joints};

/// Two writers of the arm's angles are reported if both have written within this time.
const TELLERS_MS: u64 = 1000;
/// Maximum number of writers that are distinguished.
const TELLERS_MAX: usize = 8;
/// Time for which impossible angles are remembered.
const MEMORY_MS: u64 = 2000;
/// Maximum speed of any joint in rad/s. It is twice the speed of the fastest arms of this kind.
const FASTEST_RAD_S: f64 = 4.0 * std::f64::consts::PI;
/// Tolerance for noise, rounding, and messages that arrive together.
const SLACK_RAD: f64 = 0.2;
/// Maximum number of turns that a driver counts.
const TURNS_MAX: f64 = 16.0;
/// Maximum age of a controller's state.
const STATE_MS: u64 = 500;
/// A motion may start at the controller's set point only if the arm is within this distance of the set point.
const HELD_MAX_RAD: f64 = 0.05;
/// Tolerance for a speed scaling of 1.
const SCALING_OFF: f64 = 1e-3;

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Doubts {
    tellers: BTreeMap<String, u64>,
    /// The impossible angle, and its time.
    impossible: Option<(String, u64)>,
    /// Number of goals on the controller's action server that other programs sent.
    foreign: usize,
    /// The reported scaling with its time, unless the scaling is 1.
    scaling: Option<(f64, u64)>,
    /// Whether a scaling other than zero was ever reported.
    /// Before such a report, a scaling of zero may just be a default value.
    is_scaled: bool,
    held: Option<(Joints, u64)>,
}

impl Doubts {
    /// Reports that a publisher has sent angles of the arm.
    pub fn told_by(&mut self, teller: &str, now_ms: u64) {
        self.tellers.retain(|_, at_ms| now_ms.saturating_sub(*at_ms) <= TELLERS_MS);
        if self.tellers.len() < TELLERS_MAX || self.tellers.contains_key(teller) {
            self.tellers.insert(teller.to_owned(), now_ms);
        }
    }

    /// Returns whether a joint can have moved to this angle within `passed_ms`. An impossible angle is stored.
    pub fn judge(&mut self, name: &str, rad: f64, before: Option<(f64, u64)>, now_ms: u64) {
        let what = if rad.abs() > TURNS_MAX * TAU {
            format!("{name} is told to be at {rad:.0} rad: no joint turns that often")
        } else if let Some((before_rad, passed_ms)) = before
            && let moved_rad = shortest(rad - before_rad)
            && moved_rad > SLACK_RAD + FASTEST_RAD_S * passed_ms as f64 / 1000.0
        {
            format!("{name} is told to have jumped by {moved_rad:.1} rad within {passed_ms} ms")
        } else {
            return;
        };
        self.impossible = Some((what, now_ms));
    }

    /// Sets the number of other programs' active goals on the controller's action server.
    pub fn set_foreign(&mut self, goals: usize) {
        self.foreign = goals;
    }

    /// Processes the controller's report: its set point with speeds, and its speed scaling.
    pub fn controller(&mut self, reference: Option<(Joints, Joints)>, scaling: Option<f64>, now_ms: u64) {
        if let Some(scaling) = scaling {
            self.is_scaled |= scaling != 0.0;
            // The comparison is also correct for NaN.
            let is_one = (scaling - 1.0).abs() <= SCALING_OFF;
            let off = self.is_scaled && !is_one;
            self.scaling = off.then_some((scaling, now_ms));
        }
        let rests = |speeds: &Joints| speeds.iter().all(|speed| *speed == 0.0);
        self.held = reference.filter(|(_, speeds)| rests(speeds)).map(|(held, _)| (held, now_ms));
    }

    /// Returns the position at which the controller holds an arm that rests at `here`.
    /// A motion from this position starts without a jump.
    pub fn held(&self, here: &Joints, now_ms: u64) -> Option<Joints> {
        let (held, at_ms) = self.held?;
        let near = off_rad(&held, here) <= HELD_MAX_RAD && now_ms.saturating_sub(at_ms) <= STATE_MS;
        // The controller's state is used only in the turn in which it is reported.
        near.then(|| std::array::from_fn(|i| here[i] + turned(held[i] - here[i])))
    }

    /// Returns the reason why the arm must not move, if there is one.
    /// `in_pieces` includes reasons that concern only motions sent as several short trajectories.
    pub fn problem(&self, in_pieces: bool, now_ms: u64) -> Option<String> {
        let lately = |at_ms: u64, long_ms: u64| now_ms.saturating_sub(at_ms) <= long_ms;
        let tellers: Vec<&str> = self
            .tellers
            .iter()
            .filter(|(_, at)| lately(**at, TELLERS_MS))
            .map(|(name, _)| name.as_str())
            .collect();
        if tellers.len() > 1 {
            return Some(format!(
                "{} writers tell the arm's angles ({}): end all but one (`ros2 topic info -v` names them)",
                tellers.len(),
                tellers.join(", ")
            ));
        }
        if let Some((what, _)) = self.impossible.as_ref().filter(|(_, at)| lately(*at, MEMORY_MS)) {
            return Some(format!("{what}; is somebody else writing the joint states?"));
        }
        if self.foreign > 0 {
            return Some(
                "another program's goal runs on the arm's controller: wait for its end, or cancel it"
                    .to_owned(),
            );
        }
        if let Some((scaling, _)) = self.scaling.filter(|(_, at)| in_pieces && lately(*at, STATE_MS)) {
            return Some(format!(
                "the arm's controller scales speeds by {scaling:.2}: pieces that are timed would jump ahead; set it to 1 \
                 (on a UR: the slider to 100 %)"
            ));
        }
        None
    }
}

/// Returns a difference of angles without complete turns.
fn turned(rad: f64) -> f64 {
    rad - TAU * (rad / TAU).round()
}

fn shortest(rad: f64) -> f64 {
    turned(rad).abs()
}

/// Returns the values by name in the arm's order, or `None` if one is missing or NaN.
pub fn in_order(names: &[String], told: &[String], values: &[f64]) -> Option<Joints> {
    let mut joints = [0.0; JOINTS];
    for (joint, name) in joints.iter_mut().zip(names) {
        let place = told.iter().position(|other| other == name)?;
        *joint = values.get(place).copied().filter(|value| value.is_finite())?;
    }
    Some(joints)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_who_tell_the_arms_angles_are_named_and_one_that_went_is_forgotten() {
        let mut doubts = Doubts::default();
        for n in 0..10 {
            doubts.told_by("robot", n * 100);
        }
        assert_eq!(doubts.problem(true, 900), None);
        doubts.told_by("liar", 950);
        let text = doubts.problem(false, 1000).unwrap();
        assert!(text.contains("liar, robot"), "{text}");
        doubts.told_by("robot", 1900);
        assert_eq!(doubts.problem(true, 1951), None);
    }

    #[test]
    fn no_joint_jumps_and_turns_without_end_are_no_jump() {
        let mut doubts = Doubts::default();
        // The angle wraps from just below half a turn to just above minus half a turn.
        doubts.judge("joint_1", -3.13, Some((3.13, 10)), 10);
        // A fast arm: 3 rad/s.
        doubts.judge("joint_2", 0.03, Some((0.0, 10)), 20);
        assert_eq!(doubts.problem(true, 20), None);
        doubts.judge("joint_2", 1.0, Some((0.0, 10)), 30);
        assert!(doubts.problem(true, 30).unwrap().contains("joint_2 is told to have jumped by 1.0 rad"));
        assert_eq!(doubts.problem(true, 2031), None);
        doubts.judge("joint_1", 1e6, None, 3000);
        assert!(doubts.problem(true, 3000).unwrap().contains("1000000 rad"));
    }

    #[test]
    fn a_foreign_goal_and_a_scaled_speed_are_named() {
        let mut doubts = Doubts::default();
        // Releases without this field leave it at zero.
        doubts.controller(None, Some(0.0), 0);
        doubts.controller(None, Some(1.0), 10);
        assert_eq!(doubts.problem(true, 10), None);
        for scaling in [0.6, 0.0, f64::NAN] {
            doubts.controller(None, Some(scaling), 20);
            assert!(doubts.problem(true, 20).unwrap().contains("scales speeds"), "{scaling}");
            assert_eq!(doubts.problem(false, 20), None, "a whole goal is only slower");
        }
        doubts.controller(None, Some(1.0), 30);
        doubts.set_foreign(1);
        assert!(doubts.problem(false, 30).unwrap().contains("another program's goal"));
        doubts.set_foreign(0);
        assert_eq!(doubts.problem(true, 30), None);
    }

    #[test]
    fn a_motion_begins_where_the_controller_holds_the_arm_in_the_turn_that_is_reported() {
        let mut doubts = Doubts::default();
        let (here, still) = ([0.1; JOINTS], [0.0; JOINTS]);
        let mut held = [0.12; JOINTS];
        held[0] += TAU;
        doubts.controller(Some((held, still)), None, 0);
        let from = doubts.held(&here, 100).unwrap();
        assert!(from.iter().all(|rad| (rad - 0.12).abs() < 1e-9), "{from:?}");
        assert_eq!(doubts.held(&here, 501), None, "too old");
        assert_eq!(doubts.held(&[0.2; JOINTS], 100), None, "too far away");
        doubts.controller(Some((held, [0.1; JOINTS])), None, 100);
        assert_eq!(doubts.held(&here, 100), None, "it moves");
    }
}
