//! Converts the state of the hands to commands for the robot, without time or links.

pub use shared_words::is_rest;

use serde::{Deserialize, Serialize};
use shared_proto::message::Heading;

use crate::tilt::{Pointing, TiltDrive};
use host_robot::{MotionName, PACE_LEAST, Twist};

/// The caps on forward and turning speed, the pace of the arm, and their changes by bends.
///
/// Both caps change together. If [`SpeedRules::arm`] is set, bends also change the arm's pace while it moves.
/// Each bend of the index finger multiplies the caps by 1.10, and each bend of the middle finger by 0.90.
/// Caps stay within [0.05, 1.0] (the paper's table II and figures).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Caps {
    /// Maximum forward or backward speed in m/s.
    pub linear_m_s: f64,
    /// Maximum speed of a turn, in rad/s.
    pub angular_rad_s: f64,
    /// The arm's speed as a fraction of its planned speed.
    #[serde(skip)]
    pub pace: f64,
    /// The initial value of the caps and the rules for changes.
    #[serde(skip)]
    pub rules: SpeedRules,
}

/// Initial value of the caps and their changes by bends, with the same numbers for m/s and rad/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpeedRules {
    /// Initial value of both caps, which a stop restores.
    pub start: f64,
    /// Never slower.
    pub least: f64,
    /// Never faster.
    pub most: f64,
    /// Factor for each bend of the index finger.
    pub faster: f64,
    /// Factor for each bend of the middle finger.
    pub slower: f64,
    /// Whether bends also change the arm's speed while the arm moves, up to its planned speed.
    /// In the paper, bends change the base's speed alone.
    pub arm: bool,
}

impl Default for SpeedRules {
    fn default() -> Self {
        let (start, least, most) = (Caps::START, Caps::LEAST, Caps::MOST);
        SpeedRules { start, least, most, faster: Caps::FASTER, slower: Caps::SLOWER, arm: false }
    }
}

impl SpeedRules {
    /// Returns the factors of these bends, in the order in which they apply.
    fn factors(&self, index: u8, middle: u8) -> impl Iterator<Item = f64> + use<> {
        std::iter::repeat_n(self.faster, index.into()).chain(std::iter::repeat_n(self.slower, middle.into()))
    }
}

impl Caps {
    /// Initial value of both caps, which a stop restores.
    pub const START: f64 = 0.5;
    /// Never slower.
    pub const LEAST: f64 = 0.05;
    /// Never faster.
    pub const MOST: f64 = 1.0;
    /// Factor for a bend of the index finger.
    pub const FASTER: f64 = 1.10;
    /// Factor for a bend of the middle finger.
    pub const SLOWER: f64 = 0.90;

    /// The caps at the start.
    pub fn new(rules: SpeedRules) -> Self {
        Caps { linear_m_s: rules.start, angular_rad_s: rules.start, pace: 1.0, rules }
    }

    /// Applies bends. If one state reports bends of both fingers, their order is unknown.
    /// The middle finger is applied last, so that clipping errs towards lower speeds.
    pub fn bend(&mut self, index: u8, middle: u8) {
        let SpeedRules { least, most, .. } = self.rules;
        for factor in self.rules.factors(index, middle) {
            for cap in [&mut self.linear_m_s, &mut self.angular_rad_s] {
                // `clamp` would panic if the minimum is above the maximum.
                *cap = (*cap * factor).min(most).max(least);
            }
        }
    }

    /// Applies bends to the arm's pace, in the same way.
    /// The planned speed is the fastest, because a plan uses the limits of the configuration completely.
    pub fn bend_pace(&mut self, index: u8, middle: u8) {
        for factor in self.rules.factors(index, middle) {
            self.pace = (self.pace * factor).clamp(PACE_LEAST, 1.0);
        }
    }

    /// Returns the twist of a heading (the paper's table II).
    pub fn twist(&self, heading: Heading) -> Twist {
        let (linear, angular) = match heading {
            Heading::Neutral | Heading::Between => (0.0, 0.0),
            Heading::Forward => (1.0, 0.0),
            Heading::Backward => (-1.0, 0.0),
            Heading::Left => (0.0, 1.0),
            Heading::Right => (0.0, -1.0),
        };
        Twist { linear_m_s: linear * self.linear_m_s, angular_rad_s: angular * self.angular_rad_s }
    }

    /// Returns the twist of a hand, by its heading or in proportion to its tilt.
    pub fn twist_of(&self, pointing: Pointing, drive: &TiltDrive) -> Twist {
        if !drive.proportional {
            return self.twist(pointing.heading);
        }
        let (linear, angular) = drive.shares(pointing);
        Twist { linear_m_s: linear * self.linear_m_s, angular_rad_s: angular * self.angular_rad_s }
    }
}

impl Default for Caps {
    fn default() -> Self {
        Caps::new(SpeedRules::default())
    }
}

/// Maps gestures to arm motions.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionMap {
    entries: Vec<(String, MotionName)>,
}

impl Default for MotionMap {
    /// The paper's six.
    fn default() -> Self {
        let entries = [
            ("up-down", MotionName::HOME),
            ("to-fro", "pick-up"),
            ("left-right", "place"),
            ("rectangle", "place-top-right"),
            ("rectangle-flat", "place-bottom-right"),
            ("circle", "random-top"),
        ];
        MotionMap { entries: entries.map(|(label, motion)| (label.to_owned(), motion.into())).into() }
    }
}

/// The text does not have the form `LABEL=MOTION`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// There is no `=`, or there is no label before it.
    #[error("'{0}' is no mapping; write LABEL=MOTION, for example wave=pick-up")]
    NoPair(String),
    /// A rest label cannot start a motion.
    #[error("'{0}' is the class of a resting hand and cannot start a motion; map another label")]
    Rest(String),
}

impl MotionMap {
    /// Adds or replaces one entry, in the form `LABEL=MOTION`.
    ///
    /// # Errors
    /// Returns [`MapError`] if the text does not have this form, or maps a rest label.
    pub fn assign(&mut self, mapping: &str) -> Result<(), MapError> {
        let (label, motion) = mapping
            .split_once('=')
            .map(|(label, motion)| (label.trim(), motion.trim()))
            .filter(|(label, motion)| !label.is_empty() && !motion.is_empty())
            .ok_or_else(|| MapError::NoPair(mapping.to_owned()))?;
        if is_rest(label) {
            return Err(MapError::Rest(label.to_owned()));
        }
        let motion = match motion.trim_matches('"') {
            "end arm" => MotionName::END_ARM,
            motion => motion,
        };
        let motion = MotionName::from(motion);
        self.entries.retain(|(known, _)| !same_label(known, label));
        self.entries.push((label.to_owned(), motion));
        Ok(())
    }

    /// Removes the motion of a label.
    pub fn release(&mut self, label: &str) {
        self.entries.retain(|(known, _)| !same_label(known, label));
    }

    /// Returns the motion of a label, if it has one.
    pub fn motion(&self, label: &str) -> Option<&MotionName> {
        if is_rest(label) {
            return None;
        }
        self.entries.iter().find(|(known, _)| same_label(known, label)).map(|(_, motion)| motion)
    }

    /// Removes entries whose motion this robot does not have.
    /// Another arm may have fewer motions than the paper's six.
    #[must_use]
    pub fn known_to(mut self, knows: impl Fn(&MotionName) -> bool) -> Self {
        self.entries.retain(|(_, motion)| knows(motion));
        self
    }

    /// Returns the labels without a motion, except rest labels, which never have one.
    pub fn without_motion<'a>(&self, labels: &'a [String]) -> Vec<&'a str> {
        let idle = |label: &&str| !is_rest(label) && self.motion(label).is_none();
        labels.iter().map(String::as_str).filter(idle).collect()
    }

    /// Returns entries whose label is not in this list. Most of them are typing errors.
    pub fn unknown_labels(&self, labels: &[String], mappings: &[String]) -> Vec<String> {
        let wanted = mappings.iter().filter_map(|m| m.split_once('=')).map(|(label, _)| label.trim());
        wanted.filter(|w| !labels.iter().any(|l| same_label(l, w))).map(str::to_owned).collect()
    }
}

/// Compares labels without case and punctuation: `leftright` = `left-right` = `Left_Right`.
pub fn same_label(a: &str, b: &str) -> bool {
    let letters = |s: &str| -> String {
        s.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
    };
    letters(a) == letters(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_index_bends_reach_the_top_and_seven_middle_bends_lead_to_0_478() {
        let mut caps = Caps::default();
        for _ in 0..8 {
            caps.bend(1, 0);
        }
        assert_eq!(caps, Caps { linear_m_s: 1.0, angular_rad_s: 1.0, ..Caps::default() });
        for _ in 0..7 {
            caps.bend(0, 1);
        }
        assert!((caps.linear_m_s - 0.478).abs() < 5e-4);
        assert_eq!(caps.linear_m_s, caps.angular_rad_s);
    }

    #[test]
    fn caps_stay_within_their_range_however_often_a_finger_bends() {
        let mut caps = Caps::default();
        caps.bend(255, 0);
        assert_eq!(caps.linear_m_s, 1.0);
        caps.bend(0, 255);
        assert_eq!(caps.linear_m_s, 0.05);
    }

    #[test]
    fn the_arms_pace_is_never_above_the_planned_speed_and_a_tenth_of_it_at_least() {
        let mut caps = Caps::default();
        caps.bend_pace(3, 0);
        assert_eq!(caps.pace, 1.0);
        caps.bend_pace(0, 2);
        assert!((caps.pace - 0.81).abs() < 1e-12);
        caps.bend_pace(1, 0);
        assert!((caps.pace - 0.891).abs() < 1e-12);
        caps.bend_pace(0, 255);
        assert_eq!((caps.pace, caps.linear_m_s), (0.1, Caps::START));
    }

    #[test]
    fn headings_give_the_twists_of_table_ii() {
        let caps = Caps::default();
        let twist = |linear_m_s, angular_rad_s| Twist { linear_m_s, angular_rad_s };
        assert_eq!(caps.twist(Heading::Forward), twist(0.5, 0.0));
        assert_eq!(caps.twist(Heading::Backward), twist(-0.5, 0.0));
        assert_eq!(caps.twist(Heading::Left), twist(0.0, 0.5));
        assert_eq!(caps.twist(Heading::Right), twist(0.0, -0.5));
        assert_eq!(caps.twist(Heading::Neutral), Twist::ZERO);
        assert_eq!(caps.twist(Heading::Between), Twist::ZERO);
    }

    #[test]
    fn a_mapping_replaces_the_papers_and_aliases_are_one_label() {
        let mut map = MotionMap::default();
        assert_eq!(map.motion("leftright"), Some(&MotionName::from("place")));
        map.assign("wave=pick-up").unwrap();
        map.assign("LeftRight=home").unwrap();
        assert_eq!(map.motion("wave"), Some(&MotionName::from("pick-up")));
        assert_eq!(map.motion("left-right"), Some(&MotionName::from("home")));
        let labels = ["idle", "peak", "wave", "other"].map(str::to_owned);
        assert_eq!(map.without_motion(&labels), ["peak"]);
    }

    #[test]
    fn bad_mappings_are_refused() {
        let mut map = MotionMap::default();
        assert!(matches!(map.assign("wave"), Err(MapError::NoPair(_))));
        assert!(matches!(map.assign("=home"), Err(MapError::NoPair(_))));
        assert!(matches!(map.assign("wave="), Err(MapError::NoPair(_))));
        assert!(matches!(map.assign("idle=home"), Err(MapError::Rest(_))));
        assert_eq!(map, MotionMap::default());
    }
}
