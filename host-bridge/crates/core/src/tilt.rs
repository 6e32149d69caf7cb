//! Driving in proportion to the tilt: an option beside the paper's four headings.
//!
//! Whether the base drives at all is the board's word, as it is for the four headings: a command starts when a tilt is meant
//! and ends below the same threshold. While one lasts, both tilts count: the one forward or backward as speed, the one to a
//! side as a turn, together an arc. Silence, neutral, stops, caps and the guard are the same.

use serde::{Deserialize, Serialize};
use shared_proto::message::Heading;

/// How far the left hand is tilted, in milliradians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tilt {
    /// Positive = forward.
    pub pitch_mrad: i16,
    /// Positive = left.
    pub roll_mrad: i16,
}

/// Where the left hand points, and how far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pointing {
    /// As the board judges it.
    pub heading: Heading,
    /// How far it is tilted.
    pub tilt: Tilt,
}

/// States that a tilt must last for before it drives faster: a jolt is over by then.
const STATES: usize = 3;

/// The tilts of the newest states that count.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tilts([Tilt; STATES]);

impl Tilts {
    /// One more state; without a command there is no tilt.
    pub fn see(&mut self, heading: Heading, tilt: Tilt) {
        self.0.rotate_left(1);
        self.0[STATES - 1] = if heading.is_command() { tilt } else { Tilt::default() };
    }

    /// Per axis the smallest of them; none if they point to both sides. A hand that goes back slows the base at once.
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

/// How a tilt becomes a share of the caps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TiltDrive {
    /// Speed and turn follow the tilt; else the paper's four headings.
    pub proportional: bool,
    /// Tilts within this drive nothing (8° = 140).
    pub dead_mrad: u16,
    /// From this on a tilt is the whole cap (40° = 698).
    pub full_mrad: u16,
    /// Multiplies the share between the two, which ends at the cap all the same.
    pub gain: f64,
    /// No more than this share of the cap of forward and backward speed,
    pub linear_most: f64,
    /// and of the cap of turns.
    pub angular_most: f64,
}

impl TiltDrive {
    /// The paper's four headings; where proportional, 8° to 40°.
    pub const DEFAULT: Self = TiltDrive {
        proportional: false,
        dead_mrad: 140,
        full_mrad: 698,
        gain: 1.0,
        linear_most: 1.0,
        angular_most: 1.0,
    };

    /// All values make sense: the dead zone is one, the full tilt is one that a wrist reaches, and no share is above 1.
    pub fn is_sound(&self) -> bool {
        (35..=349).contains(&self.dead_mrad)
            && self.full_mrad <= 1309
            && self.full_mrad >= self.dead_mrad.saturating_add(87)
            && (0.1..=5.0).contains(&self.gain)
            && (0.05..=1.0).contains(&self.linear_most)
            && (0.05..=1.0).contains(&self.angular_most)
    }

    /// Shares of the caps of forward speed and of turns to the left, each from -1 to 1; zero unless the heading is a command.
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
