//! The six named motions and the poses they end in.
//!
//! The paper names motions and prints how long they take, but no poses. These are ours: near enough to
//! [`HOME`] that a move from home takes the paper's time, and where their names say. All lie
//! within the joint limits and above the table (z > 0.1 m). `tests/arm_kinematics.rs` prints the table.
//!
//! | gesture | motion | paper, s |
//! |---|---|---|
//! | up-down | home | 3.3 |
//! | to-fro | pick-up | 5.7 |
//! | left-right | place | 6.1 |
//! | rectangle | place-top-right | 6.4 |
//! | rectangle-flat | place-bottom-right | 7.1 |
//! | circle | random-top | 5.9 |

use std::str::FromStr;

use serde::Serialize;

use super::gen3::{HOME, Joints};

/// What the arm can be asked to do. Each motion but the first goes home first, as in the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ArmMotion {
    /// To the home pose.
    Home,
    /// Low in front of the robot, the tool looking down.
    PickUp,
    /// Low to the left.
    Place,
    /// High to the right.
    PlaceTopRight,
    /// Low to the right.
    PlaceBottomRight,
    /// High above, to the next of [`random_top_poses`].
    RandomTop,
}

/// Every motion, in the paper's order.
pub const ALL_MOTIONS: [ArmMotion; 6] = [
    ArmMotion::Home,
    ArmMotion::PickUp,
    ArmMotion::Place,
    ArmMotion::PlaceTopRight,
    ArmMotion::PlaceBottomRight,
    ArmMotion::RandomTop,
];

/// Where the demo starts: raised before the robot, 3.3 s from home.
pub const READY: Joints = offset([0.0, -0.30, 0.0, 0.415, 0.0, -0.12, 0.0]);

const PICK_UP: Joints = offset([0.0, 0.75, 0.0, 0.55, 0.0, -0.55, 0.0]);
const PLACE: Joints = offset([-0.806, 0.60, 0.0, 0.20, 0.0, -0.55, 0.0]);
const PLACE_TOP_RIGHT: Joints = offset([0.848, -0.10, 0.0, 0.45, 0.0, -0.30, 0.0]);
const PLACE_BOTTOM_RIGHT: Joints = offset([0.946, 0.62, 0.0, 0.20, 0.0, -0.50, 0.0]);

/// Seed of [`random_top_poses`].
pub const RANDOM_TOP_SEED: u64 = 2026;

/// How many random top poses there are.
pub const RANDOM_TOP_COUNT: usize = 8;

/// `HOME` plus a difference per joint, in rad.
const fn offset(difference: Joints) -> Joints {
    let mut joints = HOME;
    let mut i = 0;
    while i < joints.len() {
        joints[i] += difference[i];
        i += 1;
    }
    joints
}

/// The poses that a circle may lead to: drawn once, from a fixed seed, so that runs can be repeated.
pub fn random_top_poses() -> [Joints; RANDOM_TOP_COUNT] {
    let mut state = RANDOM_TOP_SEED;
    let mut between = |low: f64, high: f64| {
        // SplitMix64 (Steele, Lea, Flood 2014).
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        low + (high - low) * (z >> 11) as f64 / (1_u64 << 53) as f64
    };
    // Joint 4 opens the elbow most and so sets the pace; the others only spread the poses.
    std::array::from_fn(|_| {
        offset([
            between(-0.6, 0.6),
            between(-0.5, -0.1),
            0.0,
            between(0.68, 0.88),
            between(-0.3, 0.3),
            between(-0.3, 0.2),
            0.0,
        ])
    })
}

impl ArmMotion {
    /// The name used by `--map` and in summaries.
    pub fn name(self) -> &'static str {
        match self {
            ArmMotion::Home => "home",
            ArmMotion::PickUp => "pick-up",
            ArmMotion::Place => "place",
            ArmMotion::PlaceTopRight => "place-top-right",
            ArmMotion::PlaceBottomRight => "place-bottom-right",
            ArmMotion::RandomTop => "random-top",
        }
    }

    /// Where the motion ends. `draw` counts the random motions made so far; the others ignore it.
    pub fn goal(self, draw: usize) -> Joints {
        match self {
            ArmMotion::Home => HOME,
            ArmMotion::PickUp => PICK_UP,
            ArmMotion::Place => PLACE,
            ArmMotion::PlaceTopRight => PLACE_TOP_RIGHT,
            ArmMotion::PlaceBottomRight => PLACE_BOTTOM_RIGHT,
            ArmMotion::RandomTop => random_top_poses()[draw % RANDOM_TOP_COUNT],
        }
    }
}

impl std::fmt::Display for ArmMotion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The name is no motion.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is no motion; choose one of: home, pick-up, place, place-top-right, place-bottom-right, random-top"
)]
pub struct UnknownMotion(pub String);

impl FromStr for ArmMotion {
    type Err = UnknownMotion;

    fn from_str(name: &str) -> Result<Self, UnknownMotion> {
        ALL_MOTIONS
            .into_iter()
            .find(|motion| motion.name() == name)
            .ok_or_else(|| UnknownMotion(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for motion in ALL_MOTIONS {
            assert_eq!(motion.name().parse(), Ok(motion));
        }
        assert!("wave".parse::<ArmMotion>().is_err());
    }

    #[test]
    fn random_poses_are_the_same_each_time_and_differ_from_each_other() {
        let poses = random_top_poses();
        assert_eq!(poses, random_top_poses());
        for (i, a) in poses.iter().enumerate() {
            for b in &poses[i + 1..] {
                assert_ne!(a, b);
            }
        }
    }
}
