//! Publishes hands, gestures and the bridge's state as `diagnostic_msgs`, for `rqt_robot_monitor` and similar tools.

use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Time};
use host_core::bridge::{Bridge, BridgeEvent, EventKind};
use host_core::safety::{Hand, PerHand, State};

/// Interval for repeating the diagnostics while no event occurs.
pub const INTERVAL_MS: u64 = 1000;

/// Collects events and determines when to publish them.
#[derive(Clone, Debug, Default)]
pub struct Diagnostics {
    gestures: u32,
    /// Label, confidence, age in ms, outcome.
    gesture: Option<(String, f32, u64, String)>,
    motion: Option<String>,
    labels: Vec<String>,
    hardware: PerHand<String>,
    due: bool,
    published_ms: Option<u64>,
}

impl Diagnostics {
    /// Processes an event of the session.
    pub fn note(&mut self, event: &BridgeEvent) {
        match &event.kind {
            EventKind::HandStarted { hand, identity } => {
                self.hardware[*hand] = format!("{} {:08x}", identity.board, identity.boot_id);
            }
            EventKind::Model { model, .. } => self.labels.clone_from(&model.labels),
            EventKind::Gesture { label, confidence, age_ms, outcome, .. } => {
                self.gestures = self.gestures.wrapping_add(1);
                let outcome = serde_json::to_value(outcome).ok().map(|value| match value {
                    serde_json::Value::String(text) => text,
                    serde_json::Value::Object(pair) => pair
                        .iter()
                        .map(|(what, motion)| format!("{what} {}", motion.as_str().unwrap_or_default()))
                        .collect(),
                    other => other.to_string(),
                });
                self.gesture = Some((label.clone(), *confidence, *age_ms, outcome.unwrap_or_default()));
            }
            EventKind::MotionEnded { motion, reached } => {
                self.motion = Some(format!("{motion} {}", if *reached { "reached" } else { "halted" }));
            }
            EventKind::MotionRefused { motion, reason } => {
                self.motion = Some(format!("{motion} refused: {reason}"));
            }
            EventKind::Ignored { .. } => return,
            _ => {}
        }
        self.due = true;
    }

    /// Returns the message if it is due: immediately after an event, otherwise once per second.
    pub fn take(&mut self, node: &str, bridge: &Bridge, now_ms: u64, stamp: Time) -> Option<DiagnosticArray> {
        let late = self.published_ms.is_none_or(|at| now_ms.saturating_sub(at) >= INTERVAL_MS);
        if !self.due && !late {
            return None;
        }
        self.due = false;
        self.published_ms = Some(now_ms);
        let mut status = vec![self.bridge(bridge)];
        // In one-handed mode, there is no left hand.
        status.extend((!bridge.is_one_handed()).then(|| self.left(bridge)));
        status.push(self.right(bridge));
        status.extend(self.gesture());
        for part in &mut status {
            part.name = format!("{node}: {}", part.name);
        }
        Some(DiagnosticArray { header: Header { stamp, frame_id: String::new() }, status })
    }

    fn bridge(&self, bridge: &Bridge) -> DiagnosticStatus {
        let state = bridge.safety().state();
        let (level, message) = match state {
            State::Armed => (DiagnosticStatus::OK, "armed"),
            State::Waiting => (DiagnosticStatus::WARN, "waiting for neutral hands"),
            State::Stopped => (DiagnosticStatus::WARN, "stopped by the operator"),
            State::Refused => (DiagnosticStatus::ERROR, "the robot refuses to move"),
            State::Stale => (DiagnosticStatus::ERROR, "a hand is silent or not fit to act on"),
        };
        let twist = bridge.twist();
        let caps = bridge.caps();
        let mut values = vec![
            value("linear_m_s", twist.linear_m_s),
            value("angular_rad_s", twist.angular_rad_s),
            value("cap_m_s", caps.linear_m_s),
            value("late_states", bridge.drops().late_states),
            value("late_gestures", bridge.drops().late_gestures),
        ];
        let accepted = bridge.accepted();
        for (part, seen) in [("base", accepted.base), ("arm", accepted.arm)] {
            let ages = seen.map(|seen| [("age", seen.age_ms), ("worst", seen.worst_ms)]);
            values.extend(ages.into_iter().flatten().map(|(what, ms)| {
                let key = format!("sample_to_{part}_{what}_ms");
                value(&key, ms)
            }));
        }
        values.push(value("jogging", bridge.is_jogging()));
        values.extend(bridge.refusal().map(|why| value("refusal", why)));
        values.extend(bridge.restriction().map(|text| value("restriction", text)));
        values.extend(self.motion.as_ref().map(|motion| value("motion", motion)));
        part("bridge", level, message, "", values)
    }

    fn left(&self, bridge: &Bridge) -> DiagnosticStatus {
        let (level, message) = health(bridge, Hand::Left);
        part("left hand", level, message, &self.hardware.left, tilt(bridge))
    }

    fn right(&self, bridge: &Bridge) -> DiagnosticStatus {
        let (level, message) = health(bridge, Hand::Right);
        let scores = self.labels.iter().zip(bridge.scores());
        let mut values: Vec<_> = scores.map(|(label, score)| value(label, format!("{score:.3}"))).collect();
        let battery_mv = bridge.link(Hand::Right).battery_mv();
        let battery = battery_mv.map(|mv| format!("{:.2}", f64::from(mv) / 1000.0));
        if bridge.is_one_handed() {
            values.extend(tilt(bridge));
        }
        values.push(value("battery_v", battery.unwrap_or_else(|| "unknown".to_owned())));
        part("right hand", level, message, &self.hardware.right, values)
    }

    fn gesture(&self) -> Option<DiagnosticStatus> {
        let (label, confidence, age_ms, outcome) = self.gesture.as_ref()?;
        let values = vec![
            value("count", self.gestures),
            value("confidence", format!("{confidence:.3}")),
            value("age_ms", age_ms),
            value("outcome", outcome),
        ];
        Some(part("gesture", DiagnosticStatus::OK, label, "", values))
    }
}

/// Returns the tilt of the hand that drives.
fn tilt(bridge: &Bridge) -> Vec<KeyValue> {
    let (pitch_mrad, roll_mrad, heading) = bridge.left_hand();
    vec![value("heading", heading.name()), value("pitch_mrad", pitch_mrad), value("roll_mrad", roll_mrad)]
}

fn health(bridge: &Bridge, hand: Hand) -> (u8, &'static str) {
    let safety = bridge.safety();
    match (safety.connected(hand), safety.live(hand)) {
        (true, true) => (DiagnosticStatus::OK, "live"),
        (true, false) => (DiagnosticStatus::ERROR, "silent or not fit to act on"),
        (false, _) => (DiagnosticStatus::STALE, "not connected"),
    }
}

fn value(key: &str, value: impl ToString) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

fn part(name: &str, level: u8, message: &str, hardware: &str, values: Vec<KeyValue>) -> DiagnosticStatus {
    DiagnosticStatus {
        level,
        name: name.to_owned(),
        message: message.to_owned(),
        hardware_id: hardware.to_owned(),
        values,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_core::bridge::GestureOutcome;
    use host_core::intent::MotionMap;
    use host_core::one_handed::OneHanded;
    use host_robot::MotionName;

    #[test]
    fn in_one_handed_mode_the_right_hand_has_the_tilt_and_there_is_no_left_one() {
        let rules = OneHanded { on: true, ..OneHanded::OFF };
        let bridge = Bridge::new(MotionMap::default()).one_handed(rules, Default::default());
        let message = Diagnostics::default().take("bimanual", &bridge, 0, Time::default()).unwrap();
        let names: Vec<&str> = message.status.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["bimanual: bridge", "bimanual: right hand"]);
        assert!(message.status[1].values.iter().any(|v| v.key == "heading" && v.value == "neutral"));
    }

    #[test]
    fn events_are_published_at_once_and_a_quiet_bridge_once_a_second() {
        let bridge = Bridge::new(MotionMap::default());
        let mut diagnostics = Diagnostics::default();
        let at = |diagnostics: &mut Diagnostics, now_ms| {
            diagnostics.take("bimanual", &bridge, now_ms, Time::default())
        };
        let first = at(&mut diagnostics, 0).unwrap();
        let names: Vec<&str> = first.status.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["bimanual: bridge", "bimanual: left hand", "bimanual: right hand"]);
        assert_eq!(first.status[1].level, DiagnosticStatus::STALE);
        assert_eq!(at(&mut diagnostics, 999), None);
        assert!(at(&mut diagnostics, 1000).is_some());
        let kind = EventKind::Gesture {
            label: "circle".to_owned(),
            confidence: 0.9,
            window_end_board_ms: 0,
            age_ms: 7,
            outcome: GestureOutcome::Started(MotionName::from("random-top")),
        };
        diagnostics.note(&BridgeEvent { time_ms: 1001, kind });
        let message = at(&mut diagnostics, 1001).unwrap();
        let gesture = message.status.last().unwrap();
        assert_eq!((gesture.name.as_str(), gesture.message.as_str()), ("bimanual: gesture", "circle"));
        let outcome = gesture.values.iter().find(|v| v.key == "outcome").unwrap();
        assert_eq!(outcome.value, "started random-top");
        assert_eq!(at(&mut diagnostics, 1002), None);
    }
}
