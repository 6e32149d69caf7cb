//! Parameters of the Kinova Gen3 (7 degrees of freedom).
//!
//! The base frame has x forward, y left, z up. The flange is kortex's `end_effector_link`.
//! All parameters are from kortex_description, `gen3/7dof/urdf/gen3_macro.xacro`.
//! The result equals the reference table in `tests/data/kinova_gen3_fk.csv` (see `tests/arm_kinematics.rs`).

use host_robot::shape::Capsule;
use host_robot::{DMat3, DVec3, JointLimits, Joints, joints};

/// Number of joints of the Gen3.
pub const COUNT: usize = 7;

/// Maximum joint speeds in the URDF, in rad/s (80°/s and 70°/s).
pub const MAX_VELOCITY_RAD_S: [f64; COUNT] = [1.3963, 1.3963, 1.3963, 1.3963, 1.2218, 1.2218, 1.2218];

/// Maximum joint acceleration in rad/s², the same for all joints (from kortex's MoveIt configuration).
pub const MAX_ACCELERATION_RAD_S2: [f64; COUNT] = [8.6; COUNT];

/// Fraction of [`MAX_VELOCITY_RAD_S`] that motions use, as in the paper.
pub const VELOCITY_SCALING: f64 = 0.1;

/// Fraction of [`MAX_ACCELERATION_RAD_S2`] that motions use, as in the paper.
pub const ACCELERATION_SCALING: f64 = 0.05;

/// Jerk limit of all joints in rad/s³, used if jerk is limited. It is not scaled.
///
/// We chose this limit so that the paper's acceleration of 0.43 rad/s² is reached in 0.1 s.
/// Kinova specifies no limit.
/// MoveIt's smoothing uses at least 100 rad/s³ by default, which would reach that acceleration in 4 ms.
pub const MAX_JERK_RAD_S3: f64 = 4.3;

/// Returns the arm's own limits, scaled as in the paper. Jerk is not limited.
pub fn paper_limits() -> JointLimits {
    crate::model::SerialArm::gen3().limits(VELOCITY_SCALING, ACCELERATION_SCALING)
}

/// Joints 2, 4 and 6 turn by at most this angle in either direction; `None` means without a limit.
pub const POSITION_LIMIT_RAD: [Option<f64>; COUNT] =
    [None, Some(2.24), None, Some(2.57), None, Some(2.09), None];

/// Names of the joints in ros2_kortex.
pub const JOINT_NAMES: [&str; COUNT] =
    ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"];

/// Names of the links that these joints turn, as in ros2_kortex.
pub const LINK_NAMES: [&str; COUNT] = [
    "shoulder_link",
    "half_arm_1_link",
    "half_arm_2_link",
    "forearm_link",
    "spherical_wrist_1_link",
    "spherical_wrist_2_link",
    "bracelet_link",
];
/// The link that stands on the mobile base.
pub const ROOT_LINK: &str = "base_link";
/// The link at the flange.
pub const FLANGE_LINK: &str = "end_effector_link";

/// Kinova's own home pose (kortex SRDF, `Home`), in rad.
#[allow(clippy::approx_constant)] // 3.14 is what the file says
pub const HOME: Joints = joints([0.0, 0.26, 3.14, -2.27, 0.0, 0.96, 1.57]);

/// Origin of each joint (and, last, of the flange) in its parent's frame.
/// The values are metres, followed by quarter turns about x.
const ORIGINS: [([f64; 3], u8); COUNT + 1] = [
    ([0.0, 0.0, 0.15643], 2),
    ([0.0, 0.005375, -0.12838], 1),
    ([0.0, -0.21038, -0.006375], 3),
    ([0.0, 0.006375, -0.21038], 1),
    ([0.0, -0.20843, -0.006375], 3),
    ([0.0, 0.00017505, -0.10593], 1),
    ([0.0, -0.10593, -0.00017505], 3),
    ([0.0, 0.0, -0.061525], 2),
];

/// Returns the origin of a joint (or of the flange, last) in its parent's frame: metres and rotation.
pub(super) fn origin(joint: usize) -> (DVec3, DMat3) {
    let (origin_m, quarters) = ORIGINS[joint];
    // These values are exact, in contrast to the sine and cosine of pi.
    let turn = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);
    (origin_m.into(), (0..quarters).fold(DMat3::IDENTITY, |turned, _| turned * turn))
}

/// A capsule, given by two ends and a radius.
type Ends = ([f64; 3], [f64; 3], f64);

/// Capsules that enclose the arm's fixed base (first) and each joint's link.
/// Coordinates are in the link's own frame, in m.
///
/// Each capsule is the smallest one around all vertices of its mesh in kortex_description, plus 0.4 mm.
/// The bracelet has no vision module. Capsules are convex, so they enclose the faces.
/// The test `tests/arm_hulls.rs` checks the capsules.
const CAPSULES: [Ends; COUNT + 1] = [
    ([-0.0046, 0.0, 0.0149], [0.0001, 0.0, 0.1446], 0.0532),
    ([0.0, -0.0078, -0.1284], [0.0, 0.0, -0.0325], 0.0538),
    ([0.0, -0.2131, -0.0063], [0.0, 0.0038, -0.0192], 0.0479),
    ([0.0, -0.0043, -0.2155], [0.0, 0.0, -0.0298], 0.0523),
    ([0.0, -0.1885, -0.0064], [0.0, 0.0033, -0.0202], 0.0478),
    ([0.0, -0.0129, -0.1059], [0.0, 0.0, -0.0298], 0.0435),
    ([0.0, -0.1006, -0.0002], [0.0, -0.001, -0.0197], 0.0395),
    ([0.0, 0.0, -0.0536], [0.0, 0.0, -0.023], 0.0395),
];

/// Returns the capsule around the fixed base (0) or the link of a joint, counted from 1.
pub(super) fn capsule(link: usize) -> Capsule {
    let (a_m, b_m, radius_m) = CAPSULES[link];
    Capsule { a_m: a_m.into(), b_m: b_m.into(), radius_m }
}
