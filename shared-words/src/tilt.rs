//! The meaning of a tilt of the left hand, and the thresholds for it.

/// The direction that the left hand commands. There is at most one command at a time, and the larger tilt wins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize, postcard::experimental::max_size::MaxSize),
    serde(rename_all = "lowercase")
)]
pub enum Heading {
    /// Both tilts are within the dead zone (5°). The robot can be armed again after a stop only in this state.
    Neutral,
    /// The hand is not neutral, but gives no command.
    #[default]
    Between,
    /// The base drives forward: the pitch is beyond the start threshold.
    Forward,
    /// The base drives backward: the pitch is beyond the negative start threshold.
    Backward,
    /// The base turns left (counter-clockwise seen from above): the roll is beyond the start threshold.
    Left,
    /// The base turns right: the roll is beyond the negative start threshold.
    Right,
}

impl Heading {
    /// Returns whether this heading moves the base.
    pub const fn is_command(self) -> bool {
        !matches!(self, Heading::Neutral | Heading::Between)
    }

    /// Returns a text for users.
    pub const fn name(self) -> &'static str {
        match self {
            Heading::Neutral => "neutral",
            Heading::Between => "between",
            Heading::Forward => "forward",
            Heading::Backward => "backward",
            Heading::Left => "left",
            Heading::Right => "right",
        }
    }
}

/// The thresholds in milliradians at which a command starts and ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize, postcard::experimental::max_size::MaxSize),
    serde(default, deny_unknown_fields)
)]
pub struct TiltThresholds {
    /// A hand within this angle is neutral. The default is 5°, which is 87 mrad.
    pub neutral_mrad: u16,
    /// A command ends below this angle (12° = 209).
    pub end_mrad: u16,
    /// A command starts beyond this angle (15° = 262).
    pub start_mrad: u16,
}

impl TiltThresholds {
    /// The default thresholds: 5°, 12° and 15°.
    pub const DEFAULT: Self = Self { neutral_mrad: 87, end_mrad: 209, start_mrad: 262 };

    /// Returns whether the thresholds are ordered with enough hysteresis, and the neutral zone is wide enough to be reached.
    /// Otherwise, a command might never end, or the robot could never be armed again.
    pub fn are_sound(self) -> bool {
        self.neutral_mrad >= 17
            && self.neutral_mrad < self.end_mrad
            && self.end_mrad < self.start_mrad
            && self.start_mrad <= 1047
    }
}

impl Default for TiltThresholds {
    fn default() -> Self {
        Self::DEFAULT
    }
}
