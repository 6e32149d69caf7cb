//! One-handed mode: the tilt of the right hand's board drives the base while no gesture is drawn.
//!
//! The board sends the mean acceleration of each hop (80 ms).
//! From these means, the laptop computes the tilt and the heading, with the code and the rules of a left hand's board.
//! For the safety machine, the result is a left hand like any other.
//! Silence, late states, neutral, stops and the clutch therefore work as with two hands.
//!
//! **Axes.** The heading does not depend on the kind of board, but on how the wearer mounts it.
//! [`crate::worn`] determines the axes from three poses.
//! By default, the board lies flat with its components up, +x points to the fingers, and +y points to the left.
//! The simulated wearers of `models` use the same axes.
//! An axis that points up reads +1 g.

use serde::{Deserialize, Serialize};
use shared_dsp::left::tilt::{Acceleration, Tilt as Angles, TiltDetector};
use shared_dsp::right::features::HOP;
use shared_proto::message::{Heading, RightTilt, TiltThresholds};

use crate::tilt::Tilt;

/// Minor version of the wire with which boards began to send their tilt.
pub const SINCE_MINOR: u8 = 6;

/// Mean accelerations outside this range (0.75 g to 1.3 g) say nothing about the tilt. Unit: mm/s².
pub(crate) const GRAVITY_MM_S2: std::ops::RangeInclusive<f64> = 7355.0..=12_749.0;

/// The mean acceleration of a hop, with the time of the state of the same hop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TiltReport {
    /// Upper bound of the newest sample's age.
    pub age_ms: u64,
    /// Time of the newest sample on the board's clock.
    pub board_time_ms: u32,
    /// As received.
    pub tilt: RightTilt,
}

/// A command must last for this many further hops (400 ms) before the base follows it.
/// The first stroke of a gesture looks like a tilt, and the scores follow the hand only after a while.
const CONFIRMING_HOPS: u8 = 5;

/// Maximum tilt of the wearer's neutral pose: 30°.
pub(crate) const NEUTRAL_MAX_MRAD: u16 = 524;

/// The mean acceleration of a driving hand changes by at most this much from one hop to the next, about 0.1 g.
/// A hand that turns at 70°/s changes it by as much.
const MOVING_MM_S2: f64 = 1000.0;

/// The acceleration of a wearer who walks changes more.
/// While this wearer drives, it may change by this multiple of its largest change before the base followed.
const RESTLESS: f64 = 2.0;

/// A direction of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// Along x.
    #[serde(rename = "+x")]
    PlusX,
    /// Against x.
    #[serde(rename = "-x")]
    MinusX,
    /// Along y.
    #[serde(rename = "+y")]
    PlusY,
    /// Against y.
    #[serde(rename = "-y")]
    MinusY,
    /// Along z.
    #[serde(rename = "+z")]
    PlusZ,
    /// Against z.
    #[serde(rename = "-z")]
    MinusZ,
}

impl Axis {
    /// Returns the number of the axis (x = 0), and whether the direction is against it.
    pub(crate) fn parts(self) -> (usize, bool) {
        match self {
            Axis::PlusX => (0, false),
            Axis::MinusX => (0, true),
            Axis::PlusY => (1, false),
            Axis::MinusY => (1, true),
            Axis::PlusZ => (2, false),
            Axis::MinusZ => (2, true),
        }
    }

    /// Returns the name as in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Axis::PlusX => "+x",
            Axis::MinusX => "-x",
            Axis::PlusY => "+y",
            Axis::MinusY => "-y",
            Axis::PlusZ => "+z",
            Axis::MinusZ => "-z",
        }
    }

    /// Returns the unit vector of this direction.
    pub(crate) fn direction(self) -> [f64; 3] {
        let (axis, is_against) = self.parts();
        let mut direction = [0.0; 3];
        direction[axis] = if is_against { -1.0 } else { 1.0 };
        direction
    }

    /// Returns the direction that is nearest to this vector.
    pub(crate) fn nearest(to: [f64; 3]) -> Self {
        let along = |axis: &Self| axis.direction().iter().zip(to).map(|(a, b)| a * b).sum::<f64>();
        let better = |best: Self, axis: Self| if along(&axis) > along(&best) { axis } else { best };
        [Axis::MinusX, Axis::PlusY, Axis::MinusY, Axis::PlusZ, Axis::MinusZ]
            .into_iter()
            .fold(Axis::PlusX, better)
    }

    fn of(self, values: [i16; 3]) -> i16 {
        let (axis, is_against) = self.parts();
        if is_against { values[axis].saturating_neg() } else { values[axis] }
    }
}

/// The choice of the mode, and how the board is mounted on the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OneHanded {
    /// Whether the right hand drives the base. A left hand is then not used.
    pub on: bool,
    /// The board's axis that points to the fingers.
    pub forward: Axis,
    /// The board's axis that points to the left of the hand.
    pub left: Axis,
    /// The board's axis that points out of the back of the hand.
    pub up: Axis,
    /// The forward tilt of the wearer's neutral pose, which counts as level.
    pub neutral_pitch_mrad: i16,
    /// The tilt to the left of the wearer's neutral pose, which counts as level.
    pub neutral_roll_mrad: i16,
}

impl OneHanded {
    /// The mode is off. The axes are those of the simulated wearers.
    pub const OFF: Self = OneHanded {
        on: false,
        forward: Axis::PlusX,
        left: Axis::PlusY,
        up: Axis::PlusZ,
        neutral_pitch_mrad: 0,
        neutral_roll_mrad: 0,
    };

    /// Returns whether the three axes differ, and the neutral pose is at most 30° off level.
    pub fn is_sound(&self) -> bool {
        let mut axes = [self.forward, self.left, self.up].map(|axis| axis.parts().0);
        axes.sort_unstable();
        let near = |mrad: i16| mrad.unsigned_abs() <= NEUTRAL_MAX_MRAD;
        axes == [0, 1, 2] && near(self.neutral_pitch_mrad) && near(self.neutral_roll_mrad)
    }
}

impl Default for OneHanded {
    fn default() -> Self {
        OneHanded::OFF
    }
}

/// The tilt of one hop.
#[derive(Clone, Copy, Debug)]
struct Hop {
    number: u16,
    angles: Angles,
    acceleration_mm_s2: [i16; 3],
}

impl Hop {
    /// Returns the size of the change of the acceleration since another hop, in mm/s².
    fn change_mm_s2(&self, since: &Self) -> f64 {
        let pairs = self.acceleration_mm_s2.iter().zip(since.acceleration_mm_s2);
        pairs.map(|(&now, then)| (f64::from(now) - f64::from(then)).powi(2)).sum::<f64>().sqrt()
    }
}

/// The detector's newest heading.
#[derive(Clone, Copy, Debug)]
struct Found {
    heading: Heading,
    /// For how many further hops it has not changed.
    hops: u8,
    /// The largest change of the acceleration while the command waited for its confirmation, in mm/s².
    restless_mm_s2: f64,
}

impl Found {
    const NOTHING: Self = Found { heading: Heading::Between, hops: 0, restless_mm_s2: 0.0 };

    /// Returns whether this is a command that has lasted long enough.
    fn drives(&self) -> bool {
        self.heading.is_command() && self.hops >= CONFIRMING_HOPS
    }

    /// Returns whether the driving hand moves more than it did when it began to drive.
    fn is_moved(&self, change_mm_s2: f64) -> bool {
        self.drives() && change_mm_s2 > MOVING_MM_S2.max(RESTLESS * self.restless_mm_s2)
    }

    /// Adds the heading of one hop.
    fn see(&mut self, heading: Heading, change_mm_s2: f64) {
        if heading != self.heading {
            *self = Found { heading, ..Found::NOTHING };
            return;
        }
        if !self.drives() {
            self.restless_mm_s2 = self.restless_mm_s2.max(change_mm_s2);
        }
        self.hops = self.hops.saturating_add(1);
    }
}

/// The right hand as a left hand.
#[derive(Clone, Debug)]
pub(crate) struct TiltHand {
    rules: OneHanded,
    detector: TiltDetector,
    /// The newest hop.
    newest: Option<Hop>,
    found: Found,
    /// Whether this board cannot drive. Nothing moves until another one starts.
    pub is_refused: bool,
}

impl TiltHand {
    pub fn new(rules: OneHanded, thresholds: TiltThresholds) -> Self {
        TiltHand {
            rules,
            detector: TiltDetector::new(thresholds),
            newest: None,
            found: Found::NOTHING,
            is_refused: false,
        }
    }

    /// The board has started. The hand must be neutral before it drives.
    pub fn restart(&mut self) {
        *self = TiltHand::new(self.rules, self.detector.thresholds());
    }

    /// Adds a hop. While the hand draws, it gives no command, and must be neutral before it drives again.
    ///
    /// A driving hand is still. The scores need up to a second to show that a hand draws.
    /// A sudden movement of a driving hand therefore counts as the beginning of a gesture.
    pub fn step(&mut self, number: u16, acceleration_mm_s2: [i16; 3], draws: bool) -> (Heading, Tilt) {
        let OneHanded { forward, left, up, neutral_pitch_mrad, neutral_roll_mrad, .. } = self.rules;
        // The code of the left hand has x to the wrist and y to the right.
        let a = Acceleration {
            x: forward.of(acceleration_mm_s2).saturating_neg(),
            y: left.of(acceleration_mm_s2).saturating_neg(),
            z: up.of(acceleration_mm_s2),
        };
        let level = Angles::of(a);
        let angles = Angles {
            pitch_mrad: level.pitch_mrad - neutral_pitch_mrad,
            roll_mrad: level.roll_mrad - neutral_roll_mrad,
        };
        let hop = Hop { number, angles, acceleration_mm_s2 };
        let before = self.newest.replace(hop).unwrap_or(hop);
        let change_mm_s2 = hop.change_mm_s2(&before);
        let draws = draws || self.found.is_moved(change_mm_s2);
        let size = acceleration_mm_s2.iter().map(|&a| f64::from(a).powi(2)).sum::<f64>().sqrt();
        let heading = if draws {
            self.detector.disarm();
            Heading::Between
        } else if a.z <= 0 || !GRAVITY_MM_S2.contains(&size) {
            // A single jolt starts no command, and a second one ends everything, as with a hand that is turned over.
            self.detector.turned_over()
        } else {
            self.hop(before, hop)
        };
        self.found.see(heading, change_mm_s2);
        let waits = heading.is_command() && !self.found.drives();
        let heading = if waits { Heading::Between } else { heading };
        (heading, Tilt { pitch_mrad: angles.pitch_mrad, roll_mrad: angles.roll_mrad })
    }

    /// The detector's times are counted in samples, so the tilts between two hops are interpolated.
    fn hop(&mut self, before: Hop, hop: Hop) -> Heading {
        if hop.number.wrapping_sub(before.number) != 1 {
            // Whatever happened meanwhile, no command starts because of it.
            self.detector.hold();
        }
        let between = |from: i16, to: i16, part: usize| {
            let way = i32::from(to) - i32::from(from);
            (i32::from(from) + way * part as i32 / HOP as i32) as i16
        };
        (1..=HOP).fold(Heading::Between, |_, part| {
            self.detector.step(Angles {
                pitch_mrad: between(before.angles.pitch_mrad, hop.angles.pitch_mrad, part),
                roll_mrad: between(before.angles.roll_mrad, hop.angles.roll_mrad, part),
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_proto::message::BoardMessage;

    /// The acceleration of a board with the default axes: forward lowers +x, left lowers +y.
    fn tilted(pitch_deg: f64, roll_deg: f64) -> [i16; 3] {
        let (pitch, roll) = (pitch_deg.to_radians(), roll_deg.to_radians());
        let a = [-pitch.sin(), -pitch.cos() * roll.sin(), pitch.cos() * roll.cos()];
        a.map(|a| (9807.0 * a).round() as i16)
    }

    struct Rig(TiltHand, u16);

    impl Rig {
        fn new(rules: OneHanded) -> Self {
            Rig(TiltHand::new(rules, TiltThresholds::DEFAULT), 0)
        }

        fn run(&mut self, acceleration: [i16; 3], hops: usize) -> Heading {
            (0..hops).fold(Heading::Between, |_, _| {
                self.1 = self.1.wrapping_add(1);
                self.0.step(self.1, acceleration, false).0
            })
        }
    }

    #[test]
    fn each_way_of_tilting_gives_its_heading_and_only_after_neutral() {
        for (pitch, roll, heading) in [
            (25.0, 0.0, Heading::Forward),
            (-25.0, 0.0, Heading::Backward),
            (0.0, 25.0, Heading::Left),
            (0.0, -25.0, Heading::Right),
        ] {
            let mut rig = Rig::new(OneHanded::OFF);
            assert_eq!(rig.run(tilted(pitch, roll), 20), Heading::Between, "before neutral");
            assert_eq!(rig.run(tilted(0.0, 0.0), 2), Heading::Neutral);
            assert_eq!(rig.run(tilted(pitch, roll), 10), heading);
            assert_eq!(rig.run(tilted(0.0, 0.0), 1), Heading::Between, "back by 25° in a hop is sudden");
            assert_eq!(rig.run(tilted(0.0, 0.0), 1), Heading::Neutral);
        }
    }

    #[test]
    fn a_board_that_is_mounted_otherwise_gives_the_same_headings() {
        // The board is turned by 90°: its y axis points to the fingers, and x to the right.
        let rules = OneHanded { forward: Axis::PlusY, left: Axis::MinusX, ..OneHanded::OFF };
        let mut rig = Rig::new(rules);
        let turned = |[forward, left, up]: [i16; 3]| [-left, forward, up];
        rig.run(turned(tilted(0.0, 0.0)), 2);
        assert_eq!(rig.run(turned(tilted(25.0, 0.0)), 10), Heading::Forward);
        rig.run(turned(tilted(0.0, 0.0)), 2);
        assert_eq!(rig.run(turned(tilted(0.0, 25.0)), 10), Heading::Left);
    }

    #[test]
    fn the_wearers_own_neutral_pose_counts_as_level() {
        let rules = OneHanded { neutral_pitch_mrad: 262, neutral_roll_mrad: -175, ..OneHanded::OFF };
        let mut rig = Rig::new(rules);
        assert_eq!(rig.run(tilted(0.0, 0.0), 5), Heading::Between);
        assert_eq!(rig.run(tilted(15.0, -10.0), 2), Heading::Neutral);
        assert_eq!(rig.run(tilted(40.0, -10.0), 10), Heading::Forward);
    }

    #[test]
    fn a_command_waits_until_it_has_lasted_so_that_the_stroke_of_a_gesture_is_none() {
        let mut rig = Rig::new(OneHanded::OFF);
        rig.run(tilted(0.0, 0.0), 2);
        // The board's own rules take at most two hops.
        assert_eq!(rig.run(tilted(25.0, 0.0), 5), Heading::Between);
        assert_eq!(rig.run(tilted(25.0, 0.0), 3), Heading::Forward);
        // The other way begins anew.
        assert_eq!(rig.run(tilted(0.0, 25.0), 3), Heading::Between);
    }

    #[test]
    fn a_drawing_hand_gives_no_command_and_needs_neutral_afterwards() {
        let mut rig = Rig::new(OneHanded::OFF);
        rig.run(tilted(0.0, 0.0), 2);
        assert_eq!(rig.run(tilted(25.0, 0.0), 10), Heading::Forward);
        rig.1 += 1;
        assert_eq!(rig.0.step(rig.1, tilted(25.0, 0.0), true).0, Heading::Between);
        assert_eq!(rig.run(tilted(25.0, 0.0), 50), Heading::Between);
        rig.run(tilted(0.0, 0.0), 2);
        assert_eq!(rig.run(tilted(25.0, 0.0), 10), Heading::Forward);
    }

    #[test]
    fn a_sudden_movement_of_a_driving_hand_brakes_at_its_first_hop_and_needs_neutral_afterwards() {
        let mut rig = Rig::new(OneHanded::OFF);
        rig.run(tilted(0.0, 0.0), 2);
        assert_eq!(rig.run(tilted(25.0, 0.0), 10), Heading::Forward);
        let [x, y, z] = tilted(25.0, 0.0);
        assert_eq!(rig.run([x, y + 990, z], 1), Heading::Forward);
        assert_eq!(rig.run([x, y, z], 1), Heading::Forward);
        assert_eq!(rig.run([x, y + 1010, z], 1), Heading::Between);
        assert_eq!(rig.run(tilted(25.0, 0.0), 50), Heading::Between);
        rig.run(tilted(0.0, 0.0), 2);
        assert_eq!(rig.run(tilted(25.0, 0.0), 10), Heading::Forward);
    }

    #[test]
    fn a_driving_hand_may_turn_slowly_and_a_restless_one_may_move_on_as_before() {
        let mut rig = Rig::new(OneHanded::OFF);
        rig.run(tilted(0.0, 0.0), 2);
        rig.run(tilted(20.0, 0.0), 10);
        // 50°/s.
        for pitch in [24.0, 28.0, 32.0, 36.0, 40.0] {
            assert_eq!(rig.run(tilted(pitch, 0.0), 1), Heading::Forward);
        }
        // The acceleration of a wearer who walks changes by 1.6 m/s² from hop to hop.
        rig.run(tilted(0.0, 0.0), 2);
        let [x, y, z] = tilted(25.0, 0.0);
        let walk = |rig: &mut Rig, hops: i16| {
            (0..hops).fold(Heading::Between, |_, hop| rig.run([x, y, z + 800 * (hop % 2 * 2 - 1)], 1))
        };
        assert_eq!(walk(&mut rig, 10), Heading::Forward);
        assert_eq!(walk(&mut rig, 40), Heading::Forward);
        assert_eq!(rig.run([x, y + 4000, z], 1), Heading::Between, "it draws");
    }

    #[test]
    fn accelerations_that_are_no_gravity_end_a_command_and_start_none() {
        for wrong in [[0, 0, 15_000], [0, 0, 4000], [-9000, 0, 13_000], [0, 0, -9807], [i16::MIN; 3], [0; 3]]
        {
            let mut rig = Rig::new(OneHanded::OFF);
            rig.run(tilted(0.0, 0.0), 2);
            assert!(!rig.run(wrong, 20).is_command(), "{wrong:?}");
            rig.run(tilted(0.0, 0.0), 2);
            assert_eq!(rig.run(tilted(25.0, 0.0), 10), Heading::Forward);
            assert_eq!(rig.run(wrong, 1), Heading::Between, "{wrong:?}");
            assert_eq!(rig.run(tilted(25.0, 0.0), 20), Heading::Between);
        }
    }

    #[test]
    fn rules_that_make_no_sense_are_not_sound() {
        assert!(OneHanded::OFF.is_sound());
        for wrong in [
            OneHanded { left: Axis::MinusX, ..OneHanded::OFF },
            OneHanded { up: Axis::PlusY, ..OneHanded::OFF },
            OneHanded { neutral_pitch_mrad: 525, ..OneHanded::OFF },
            OneHanded { neutral_roll_mrad: i16::MIN, ..OneHanded::OFF },
        ] {
            assert!(!wrong.is_sound(), "{wrong:?}");
        }
    }

    #[test]
    fn the_wire_says_since_when_boards_send_their_tilt() {
        let row = BoardMessage::ROWS.iter().find(|row| row.name == "Tilt").unwrap();
        assert_eq!(row.since, SINCE_MINOR);
    }
}
