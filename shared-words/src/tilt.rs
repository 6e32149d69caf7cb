//! What a tilt of the left hand means, and from where on.

/// Where the left hand points. At most one command at a time: the larger tilt wins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize, postcard::experimental::max_size::MaxSize),
    serde(rename_all = "lowercase")
)]
pub enum Heading {
    /// Both tilts lie within the dead zone (5°). Needed to re-arm after a stop.
    Neutral,
    /// Neither neutral nor a command.
    #[default]
    Between,
    /// Base forward: pitch beyond the start threshold.
    Forward,
    /// Base backward: pitch beyond the negative start threshold.
    Backward,
    /// Base turns left (counter-clockwise seen from above): roll beyond the start threshold.
    Left,
    /// Base turns right: roll beyond the negative start threshold.
    Right,
}

impl Heading {
    /// Does this heading move the base?
    pub const fn is_command(self) -> bool {
        !matches!(self, Heading::Neutral | Heading::Between)
    }

    /// As a text for people.
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

/// When a command starts and ends, in milliradians.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize, postcard::experimental::max_size::MaxSize),
    serde(default, deny_unknown_fields)
)]
pub struct TiltThresholds {
    /// Neutral lies within this (5° = 87).
    pub neutral_mrad: u16,
    /// A command ends below this (12° = 209).
    pub end_mrad: u16,
    /// A command starts beyond this (15° = 262).
    pub start_mrad: u16,
}

impl TiltThresholds {
    /// 5°, 12° and 15°.
    pub const DEFAULT: Self = Self { neutral_mrad: 87, end_mrad: 209, start_mrad: 262 };

    /// Ordered, with room for hysteresis, and neutral wide enough to be reached: else a hand could
    /// be commanded for ever, or never be re-armed.
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
