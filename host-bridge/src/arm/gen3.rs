//! Figures and forward kinematics of the Kinova Gen3 (7 degrees of freedom).
//!
//! Frames: the base frame has x forward, y left, z up; the flange is kortex's `end_effector_link`.
//! Source of all figures: kortex_description, `gen3/7dof/urdf/gen3_macro.xacro`
//! (`shared/reference/hardware.md`, part G). The result equals the reference table in
//! `tests/data/kinova_gen3_fk.csv` (see `tests/arm_kinematics.rs`).

use serde::Serialize;

/// Number of joints.
pub const JOINTS: usize = 7;

/// One value per joint, joint 1 first: radians, rad/s or rad/s² as the name says.
pub type Joints = [f64; JOINTS];

/// Fastest joint speeds of the URDF in rad/s (80°/s and 70°/s).
pub const MAX_VELOCITY_RAD_S: Joints = [1.3963, 1.3963, 1.3963, 1.3963, 1.2218, 1.2218, 1.2218];

/// Largest joint acceleration in rad/s², the same for all joints (MoveIt configuration of kortex).
pub const MAX_ACCELERATION_RAD_S2: Joints = [8.6; JOINTS];

/// Share of [`MAX_VELOCITY_RAD_S`] that motions use, as in the paper.
pub const VELOCITY_SCALING: f64 = 0.1;

/// Share of [`MAX_ACCELERATION_RAD_S2`] that motions use, as in the paper.
pub const ACCELERATION_SCALING: f64 = 0.05;

/// Jerk limit of all joints in rad/s³, where jerk is limited: not scaled.
///
/// Our choice: the paper's acceleration of 0.43 rad/s² is built up in 0.1 s. We know of none by Kinova; MoveIt's
/// smoothing takes 100 rad/s³ or more where a robot names none, which would be there in 4 ms.
pub const MAX_JERK_RAD_S3: f64 = 4.3;

/// Joints 2, 4 and 6 turn this far either way; `None` = without end.
pub const POSITION_LIMIT_RAD: [Option<f64>; JOINTS] =
    [None, Some(2.24), None, Some(2.57), None, Some(2.09), None];

/// Joint names of ros2_kortex.
pub const JOINT_NAMES: [&str; JOINTS] =
    ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"];

/// Kinova's own home pose (kortex SRDF, `Home`), in rad.
#[allow(clippy::approx_constant)] // 3.14 is what the file says
pub const HOME: Joints = [0.0, 0.26, 3.14, -2.27, 0.0, 0.96, 1.57];

/// Origin of each joint in its parent's frame: xyz in metres, then a rotation about x in quarter turns.
const ORIGINS: [([f64; 3], Quarter); JOINTS + 1] = [
    ([0.0, 0.0, 0.15643], Quarter::Two),
    ([0.0, 0.005375, -0.12838], Quarter::One),
    ([0.0, -0.21038, -0.006375], Quarter::Three),
    ([0.0, 0.006375, -0.21038], Quarter::One),
    ([0.0, -0.20843, -0.006375], Quarter::Three),
    ([0.0, 0.00017505, -0.10593], Quarter::One),
    ([0.0, -0.10593, -0.00017505], Quarter::Three),
    ([0.0, 0.0, -0.061525], Quarter::Two),
];

/// Quarter turns about x; exact, where sin and cos of π would not be.
#[derive(Clone, Copy)]
enum Quarter {
    One,
    Two,
    Three,
}

impl Quarter {
    /// (cos, sin)
    fn cos_sin(self) -> (f64, f64) {
        match self {
            Quarter::One => (0.0, 1.0),
            Quarter::Two => (-1.0, 0.0),
            Quarter::Three => (0.0, -1.0),
        }
    }
}

/// Origin of a joint (or, last, of the flange) in its parent's frame: metres, rotation matrix.
pub(super) fn origin(joint: usize) -> ([f64; 3], [[f64; 3]; 3]) {
    let (origin_m, roll) = ORIGINS[joint];
    let (c, s) = roll.cos_sin();
    (origin_m, [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
}

/// Position and orientation of a frame in the base frame of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pose {
    /// x forward, y left, z up, in metres.
    pub position_m: [f64; 3],
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
}

impl Pose {
    pub(crate) const IDENTITY: Pose =
        Pose { position_m: [0.0; 3], rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// Moves along, and turns about, the frame's own axes.
    pub(crate) fn then(&self, step_m: [f64; 3], turn: [[f64; 3]; 3]) -> Pose {
        let mut next = Pose { position_m: self.position_m, rotation: [[0.0; 3]; 3] };
        for row in 0..3 {
            for col in 0..3 {
                next.position_m[row] += self.rotation[row][col] * step_m[col];
                next.rotation[row][col] = (0..3).map(|k| self.rotation[row][k] * turn[k][col]).sum();
            }
        }
        next
    }

    /// The orientation as a unit quaternion w, x, y, z with w ≥ 0.
    pub fn quaternion_wxyz(&self) -> [f64; 4] {
        let r = &self.rotation;
        // Shepperd's method: start from the largest component, so that nothing divides by almost zero.
        let trace = r[0][0] + r[1][1] + r[2][2];
        let q = if trace > 0.0 {
            let s = 2.0 * (1.0 + trace).sqrt();
            [s / 4.0, (r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s]
        } else if r[0][0] >= r[1][1] && r[0][0] >= r[2][2] {
            let s = 2.0 * (1.0 + r[0][0] - r[1][1] - r[2][2]).sqrt();
            [(r[2][1] - r[1][2]) / s, s / 4.0, (r[0][1] + r[1][0]) / s, (r[0][2] + r[2][0]) / s]
        } else if r[1][1] >= r[2][2] {
            let s = 2.0 * (1.0 + r[1][1] - r[0][0] - r[2][2]).sqrt();
            [(r[0][2] - r[2][0]) / s, (r[0][1] + r[1][0]) / s, s / 4.0, (r[1][2] + r[2][1]) / s]
        } else {
            let s = 2.0 * (1.0 + r[2][2] - r[0][0] - r[1][1]).sqrt();
            [(r[1][0] - r[0][1]) / s, (r[0][2] + r[2][0]) / s, (r[1][2] + r[2][1]) / s, s / 4.0]
        };
        if q[0] < 0.0 { q.map(|c| -c) } else { q }
    }
}

/// Frames of the seven joints and of the flange (last), in the arm's base frame.
pub fn link_poses(joints_rad: &Joints) -> [Pose; JOINTS + 1] {
    let mut poses = [Pose::IDENTITY; JOINTS + 1];
    let mut pose = Pose::IDENTITY;
    for (i, (origin_m, roll)) in ORIGINS.iter().enumerate() {
        let (c, s) = roll.cos_sin();
        pose = pose.then(*origin_m, [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]);
        if let Some(angle) = joints_rad.get(i) {
            let (s, c) = angle.sin_cos();
            pose = pose.then([0.0; 3], [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]);
        }
        poses[i] = pose;
    }
    poses
}

/// Where the flange is.
pub fn flange_pose(joints_rad: &Joints) -> Pose {
    link_poses(joints_rad)[JOINTS]
}

/// The first joint beyond its limit (counted from 0), if any. Not-a-number is beyond every limit.
pub fn joint_beyond_limit(joints_rad: &Joints) -> Option<usize> {
    (0..JOINTS).find(|&i| {
        let within = match POSITION_LIMIT_RAD[i] {
            Some(limit) => joints_rad[i].abs() <= limit,
            None => joints_rad[i].is_finite(),
        };
        !within
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_pose_is_straight_up() {
        let pose = flange_pose(&[0.0; JOINTS]);
        assert!((pose.position_m[2] - 1.1873).abs() < 1e-3, "{pose:?}");
    }

    #[test]
    fn limits_hold_for_home_and_catch_excess_and_nan() {
        assert_eq!(joint_beyond_limit(&HOME), None);
        let mut joints = HOME;
        joints[3] = -2.6;
        assert_eq!(joint_beyond_limit(&joints), Some(3));
        joints[0] = f64::NAN;
        assert_eq!(joint_beyond_limit(&joints), Some(0));
    }
}
