//! The clutch: a gesture or a key switches the left hand from the base to the arm, and back.
//!
//! While the left hand is lent, the base stands still, and tilts move the tool horizontally.
//! Bends of the fingers move the tool up and down.
//! The right hand's rest is the dead-man: as soon as that hand does not rest, the arm brakes.
//! After every halt of the arm, both hands must be neutral before the arm moves again.
//! Only three things return the left hand to the base.
//! They are the clutch, the operator's stop, and the end of the arm's motion.
//! Silence, doubt, a restarted hand or a temporary refusal by the robot never do.
//! Otherwise, the same hand would suddenly drive the base.

use host_robot::DVec3;
use serde::{Deserialize, Serialize};

use crate::tilt::{Pointing, TiltDrive};

/// The controls of the clutch, and the speed of the tool.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JogRules {
    /// A gesture with this label switches the left hand from the base to the arm, and back.
    /// An empty label disables this function.
    pub label: String,
    /// This key has the same effect as the label; an empty key disables it.
    pub key: String,
    /// The tool's speed at full tilt, in m/s. Tilts have a proportional effect, as in `[drive]`.
    pub speed_m_s: f64,
    /// The tool's speed in m/s: up for a bend of the index finger, down for a bend of the middle finger.
    pub lift_m_s: f64,
    /// Duration of the motion for one bend. Bends add up; a bend of the other finger ends the motion.
    pub bend_ms: u64,
}

impl JogRules {
    /// Without a clutch, which is the default.
    pub fn off() -> Self {
        JogRules { label: String::new(), key: String::new(), speed_m_s: 0.05, lift_m_s: 0.03, bend_ms: 500 }
    }

    /// There is a clutch.
    pub fn is_on(&self) -> bool {
        !self.label.is_empty() || !self.key.is_empty()
    }

    /// All values make sense.
    pub fn is_sound(&self) -> bool {
        (0.005..=0.5).contains(&self.speed_m_s)
            && (0.005..=0.5).contains(&self.lift_m_s)
            && (100..=2000).contains(&self.bend_ms)
    }
}

impl Default for JogRules {
    fn default() -> Self {
        JogRules::off()
    }
}

/// Maximum number of bends that are remembered.
const BENDS_WAITING_MAX: u64 = 4;

/// Up or down, for some time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lift {
    up: bool,
    until_ms: u64,
}

impl Lift {
    /// Bends of the index finger move the tool up, and bends of the middle finger move it down.
    /// If one state contains both, their order is unknown, and nothing moves.
    pub(crate) fn bend(&mut self, index: u8, middle: u8, bend_ms: u64, now_ms: u64) {
        let (count, up) = match (index, middle) {
            (0, 0) => return,
            (index, 0) => (index, true),
            (0, middle) => (middle, false),
            _ => {
                *self = Lift::default();
                return;
            }
        };
        let runs = now_ms < self.until_ms;
        if runs && up != self.up {
            *self = Lift::default();
            return;
        }
        let from_ms = if runs { self.until_ms } else { now_ms };
        let until_ms = from_ms.saturating_add(u64::from(count) * bend_ms);
        *self = Lift { up, until_ms: until_ms.min(now_ms.saturating_add(BENDS_WAITING_MAX * bend_ms)) };
    }

    fn speed_m_s(&self, rules: &JogRules, now_ms: u64) -> f64 {
        match (now_ms < self.until_ms, self.up) {
            (false, _) => 0.0,
            (true, true) => rules.lift_m_s,
            (true, false) => -rules.lift_m_s,
        }
    }
}

/// Returns the requested speed of the tool in the arm's base frame (x forward, y left, z up).
pub(crate) fn tool_m_s(
    rules: &JogRules,
    drive: &TiltDrive,
    pointing: Pointing,
    lift: &Lift,
    now_ms: u64,
) -> DVec3 {
    let (forward, left) = drive.shares(pointing);
    let plane = DVec3::new(forward, left, 0.0).clamp_length_max(1.0) * rules.speed_m_s;
    plane + DVec3::Z * lift.speed_m_s(rules, now_ms)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tilt::Tilt;
    use shared_proto::message::Heading;

    #[test]
    fn tilts_move_in_the_plane_and_bends_up_and_down_for_a_while() {
        let rules = JogRules { speed_m_s: 0.1, lift_m_s: 0.02, bend_ms: 400, ..JogRules::off() };
        let speed = |heading, pitch_mrad, roll_mrad, lift: &Lift, now_ms| {
            let pointing = Pointing { heading, tilt: Tilt { pitch_mrad, roll_mrad } };
            tool_m_s(&rules, &TiltDrive::DEFAULT, pointing, lift, now_ms).to_array()
        };
        let mut lift = Lift::default();
        assert_eq!(speed(Heading::Forward, 419, 0, &lift, 0), [0.05, 0.0, 0.0]);
        assert_eq!(speed(Heading::Left, 0, 698, &lift, 0), [0.0, 0.1, 0.0]);
        assert_eq!(speed(Heading::Between, 698, 698, &lift, 0), [0.0; 3]);
        let [x, y, _] = speed(Heading::Forward, 1000, 1000, &lift, 0);
        assert!((x.hypot(y) - 0.1).abs() < 1e-12, "no faster to a corner");
        lift.bend(1, 0, 400, 1000);
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 1399), [0.0, 0.0, 0.02]);
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 1400), [0.0; 3]);
        lift.bend(0, 1, 400, 2000);
        lift.bend(0, 1, 400, 2100);
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 2799), [0.0, 0.0, -0.02]);
        lift.bend(1, 0, 400, 2200);
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 2201), [0.0; 3], "the other finger ends it");
        for _ in 0..100 {
            lift.bend(3, 0, 400, 3000);
        }
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 3000 + 1600), [0.0; 3], "four at most");
        lift.bend(1, 1, 400, 5000);
        assert_eq!(speed(Heading::Neutral, 0, 0, &lift, 5000), [0.0; 3]);
    }

    #[test]
    fn rules_that_make_no_sense_are_not_sound() {
        assert!(JogRules::off().is_sound() && !JogRules::off().is_on());
        for wrong in [
            JogRules { speed_m_s: f64::NAN, ..JogRules::off() },
            JogRules { speed_m_s: 2.0, ..JogRules::off() },
            JogRules { lift_m_s: 0.0, ..JogRules::off() },
            JogRules { bend_ms: 10, ..JogRules::off() },
        ] {
            assert!(!wrong.is_sound(), "{wrong:?}");
        }
    }
}
