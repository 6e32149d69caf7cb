//! Driving in proportion to the tilt, an alternative to the paper's four headings.
//!
//! As with the four headings, the board decides whether the base drives at all.
//! As with the headings, a command starts with an intended tilt, and ends below the board's threshold.
//! During a command, the forward or backward tilt sets the speed, and the sideways tilt sets the turn rate.
//! Together, the two tilts drive an arc.
//! Silence, neutral, stops, caps and the guard work as with the four headings.

use serde::{Deserialize, Serialize};
use shared_proto::message::Heading;

/// The tilt of the left hand in milliradians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tilt {
    /// Positive = forward.
    pub pitch_mrad: i16,
    /// Positive = left.
    pub roll_mrad: i16,
}

/// The heading and the tilt of the left hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pointing {
    /// The heading, as determined by the board.
    pub heading: Heading,
    /// The tilt of the hand.
    pub tilt: Tilt,
}

/// A tilt must last for this many states before the speed increases, which takes longer than a jolt.
const STATES: usize = 3;

/// The tilts of the newest valid states.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tilts([Tilt; STATES]);

impl Tilts {
    /// Adds one state. Without a command, the tilt is zero.
    pub fn see(&mut self, heading: Heading, tilt: Tilt) {
        self.0.rotate_left(1);
        self.0[STATES - 1] = if heading.is_command() { tilt } else { Tilt::default() };
    }

    /// Returns the smallest tilt per axis, or zero if their signs differ.
    /// The base therefore slows down as soon as the hand returns towards neutral.
    pub fn meant(&self) -> Tilt {
        let least = |of: fn(&Tilt) -> i16| {
            let [first, rest @ ..] = self.0.each_ref().map(of);
            rest.into_iter().fold(first, |least, next| match (least.signum(), next.signum()) {
                (1, 1) => least.min(next),
                (-1, -1) => least.max(next),
                _ => 0,
            })
        };
        Tilt { pitch_mrad: least(|tilt| tilt.pitch_mrad), roll_mrad: least(|tilt| tilt.roll_mrad) }
    }
}

/// Converts a tilt to a fraction of the caps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TiltDrive {
    /// Whether speed and turn rate follow the tilt; otherwise, the paper's four headings apply.
    pub proportional: bool,
    /// Smaller tilts cause no motion (8° are 140 mrad).
    pub dead_mrad: u16,
    /// Tilts above this value cause the full cap (40° are 698 mrad).
    pub full_mrad: u16,
    /// Factor for tilts between these two values. The result is limited to the cap.
    pub gain: f64,
    /// Maximum fraction of the cap for forward and backward speed.
    pub linear_most: f64,
    /// Maximum fraction of the cap for turns.
    pub angular_most: f64,
}

impl TiltDrive {
    /// The default is the paper's four headings; proportional mode uses 8° to 40°.
    pub const DEFAULT: Self = TiltDrive {
        proportional: false,
        dead_mrad: 140,
        full_mrad: 698,
        gain: 1.0,
        linear_most: 1.0,
        angular_most: 1.0,
    };

    /// Returns whether the dead zone is positive, and a wrist can reach the full tilt.
    /// In addition, no fraction may be above 1.
    pub fn is_sound(&self) -> bool {
        (35..=349).contains(&self.dead_mrad)
            && self.full_mrad <= 1309
            && self.full_mrad >= self.dead_mrad.saturating_add(87)
            && (0.1..=5.0).contains(&self.gain)
            && (0.05..=1.0).contains(&self.linear_most)
            && (0.05..=1.0).contains(&self.angular_most)
    }

    /// Returns fractions of the caps for forward speed and left turns.
    /// Each fraction is from -1 to 1. Without a command, both are zero.
    pub fn shares(&self, pointing: Pointing) -> (f64, f64) {
        if !pointing.heading.is_command() {
            return (0.0, 0.0);
        }
        let share = |mrad: i16, most: f64| {
            let beyond = f64::from(mrad.unsigned_abs().saturating_sub(self.dead_mrad));
            let way = f64::from(self.full_mrad.saturating_sub(self.dead_mrad).max(1));
            let share = (self.gain * beyond / way).min(most);
            if mrad < 0 { -share } else { share }
        };
        let Tilt { pitch_mrad, roll_mrad } = pointing.tilt;
        (share(pitch_mrad, self.linear_most), share(roll_mrad, self.angular_most))
    }
}

impl Default for TiltDrive {
    fn default() -> Self {
        TiltDrive::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ON: TiltDrive = TiltDrive { proportional: true, ..TiltDrive::DEFAULT };

    fn at(heading: Heading, pitch_mrad: i16, roll_mrad: i16) -> Pointing {
        Pointing { heading, tilt: Tilt { pitch_mrad, roll_mrad } }
    }

    #[test]
    fn a_share_grows_from_the_dead_zone_to_the_full_tilt_and_both_tilts_make_an_arc() {
        assert_eq!(ON.shares(at(Heading::Forward, 698, 0)), (1.0, 0.0));
        assert_eq!(ON.shares(at(Heading::Forward, 1500, 140)), (1.0, 0.0));
        assert_eq!(ON.shares(at(Heading::Backward, -419, 0)), (-0.5, 0.0));
        assert_eq!(ON.shares(at(Heading::Forward, 419, -419)), (0.5, -0.5));
        assert_eq!(ON.shares(at(Heading::Left, 0, 698)), (0.0, 1.0));
        let slow = TiltDrive { gain: 0.5, linear_most: 0.4, angular_most: 0.3, ..ON };
        assert_eq!(slow.shares(at(Heading::Forward, 698, 1500)), (0.4, 0.3));
        assert_eq!(slow.shares(at(Heading::Forward, 419, 0)), (0.25, 0.0));
        assert_eq!(ON.shares(at(Heading::Forward, i16::MIN, i16::MAX)), (-1.0, 1.0));
    }

    #[test]
    fn without_a_command_nothing_drives_however_far_the_hand_is_tilted() {
        for heading in [Heading::Neutral, Heading::Between] {
            assert_eq!(ON.shares(at(heading, 1500, -1500)), (0.0, 0.0));
        }
    }

    #[test]
    fn a_jolt_drives_no_faster_and_a_hand_that_goes_back_slows_at_once() {
        let mut tilts = Tilts::default();
        let mut see = |heading, pitch_mrad, roll_mrad| {
            tilts.see(heading, Tilt { pitch_mrad, roll_mrad });
            let Tilt { pitch_mrad, roll_mrad } = tilts.meant();
            (pitch_mrad, roll_mrad)
        };
        let forward = Heading::Forward;
        assert_eq!(see(forward, 400, 0), (0, 0));
        assert_eq!(see(forward, 400, 50), (0, 0));
        assert_eq!(see(forward, 390, 60), (390, 0), "after three of them");
        assert_eq!(see(forward, 1500, -900), (390, 0), "a jolt");
        assert_eq!(see(forward, 300, 60), (300, 0), "slower at once");
        assert_eq!(see(Heading::Between, 300, 60), (0, 0));
        assert_eq!(see(forward, 500, 500), (0, 0), "and begins anew");
    }

    #[test]
    fn rules_that_make_no_sense_are_not_sound() {
        assert!(ON.is_sound());
        for wrong in [
            TiltDrive { dead_mrad: 0, ..ON },
            TiltDrive { full_mrad: 200, ..ON },
            TiltDrive { full_mrad: 1500, ..ON },
            TiltDrive { gain: f64::NAN, ..ON },
            TiltDrive { gain: 50.0, ..ON },
            TiltDrive { linear_most: 1.5, ..ON },
            TiltDrive { angular_most: 0.0, ..ON },
        ] {
            assert!(!wrong.is_sound(), "{wrong:?}");
        }
    }
}
