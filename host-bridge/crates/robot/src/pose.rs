//! Joint values and frames.

use glam::{DMat3, DQuat, DVec3};
use serde::{Serialize, Serializer};

/// Maximum number of joints that an arm may have. For an arm with fewer joints, the last values stay at zero.
pub const JOINTS: usize = 8;

/// One value per joint, counted from the foot, in rad, rad/s, rad/s² or rad/s³.
/// The units of sliding joints are m, m/s and so on.
pub type Joints = [f64; JOINTS];

/// Returns the values of an arm's joints, followed by zeros for the missing ones.
///
/// ```
/// assert_eq!(host_robot::joints([0.5, -1.0])[..3], [0.5, -1.0, 0.0]);
/// ```
pub const fn joints<const N: usize>(own: [f64; N]) -> Joints {
    let mut all = [0.0; JOINTS];
    let mut i = 0;
    while i < N {
        all[i] = own[i];
        i += 1;
    }
    all
}

/// Position and orientation of a frame in the arm's base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pose {
    /// Position: x forward, y left, z up, in metres.
    pub position_m: DVec3,
    /// Rotation matrix; serialised row by row.
    #[serde(serialize_with = "rows")]
    pub rotation: DMat3,
}

impl Pose {
    /// The frame itself.
    pub const IDENTITY: Pose = Pose { position_m: DVec3::ZERO, rotation: DMat3::IDENTITY };

    /// Translates along the frame's own axes, and then rotates about them.
    pub fn then(&self, step_m: DVec3, turn: DMat3) -> Pose {
        Pose { position_m: self.at(step_m), rotation: self.rotation * turn }
    }

    /// Converts a point in this frame to the parent frame, in m.
    pub fn at(&self, point_m: DVec3) -> DVec3 {
        self.position_m + self.rotation * point_m
    }

    /// Returns the orientation as a unit quaternion with w ≥ 0.
    pub fn quaternion(&self) -> DQuat {
        let quaternion = DQuat::from_mat3(&self.rotation);
        if quaternion.w < 0.0 { -quaternion } else { quaternion }
    }
}

/// Serialises a rotation matrix row by row, as pages and files require.
///
/// # Errors
/// Returns the errors of the serialiser.
pub fn rows<S: Serializer>(rotation: &DMat3, serializer: S) -> Result<S::Ok, S::Error> {
    rotation.transpose().to_cols_array_2d().serialize(serializer)
}
