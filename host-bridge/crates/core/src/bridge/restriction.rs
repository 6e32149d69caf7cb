//! Sessions that may do less than others.

use super::{Bridge, EventKind};
use crate::intent::{Caps, SpeedRules};

/// What a session is not allowed to do, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Restriction {
    /// Fastest speed of the base, in m/s and rad/s.
    pub most: f64,
    /// For people: what is less, and why. The arm does not move.
    pub text: String,
}

impl Bridge {
    /// The base drives no faster than that, and the arm does not move.
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

    /// What this session may not do, for people.
    pub fn restriction(&self) -> Option<&str> {
        self.restriction.as_ref().map(|restriction| restriction.text.as_str())
    }
}
