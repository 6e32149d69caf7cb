//! Restrictions that give a session fewer rights than others, and refusals of motions.

use host_robot::MotionName;

use super::{Bridge, EventKind, GestureOutcome};
use crate::intent::{Caps, SpeedRules};

/// The restriction of a session, and the reason for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Restriction {
    /// Maximum speed of the base, in m/s and rad/s.
    pub most: f64,
    /// The restriction and its reason, for users. The arm does not move.
    pub text: String,
}

impl Bridge {
    /// Limits the base to this speed, and keeps the arm at rest.
    #[must_use]
    pub fn restricted(mut self, restriction: Restriction) -> Self {
        let Restriction { most, text } = &restriction;
        let rules = self.caps.rules;
        let within = |value: f64| value.min(*most);
        self.caps = Caps::new(SpeedRules {
            start: within(rules.start),
            least: within(rules.least),
            most: within(rules.most),
            ..rules
        });
        self.note(0, EventKind::Restricted { text: text.clone() });
        self.restriction = Some(restriction);
        self
    }

    /// Returns the restriction of this session, as a text for users.
    pub fn restriction(&self) -> Option<&str> {
        self.restriction.as_ref().map(|restriction| restriction.text.as_str())
    }

    /// Reports why a requested motion does not start.
    pub(super) fn refuse(&mut self, motion: MotionName, reason: String, now_ms: u64) -> GestureOutcome {
        self.note(now_ms, EventKind::MotionRefused { motion: motion.clone(), reason });
        GestureOutcome::Refused(motion)
    }
}
