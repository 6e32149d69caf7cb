//! What the joints may do, and how they move at one instant. Motion in time is
//! [`Trajectory`](crate::Trajectory).

use crate::{JOINTS, Joints};

/// What a move must not exceed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
    /// In rad/s³; infinite = accelerations may jump.
    pub jerk_rad_s3: Joints,
}

impl JointLimits {
    /// The same limits, with a limit on the jerk of all joints.
    #[must_use]
    pub fn with_jerk(self, jerk_rad_s3: f64) -> Self {
        JointLimits { jerk_rad_s3: [jerk_rad_s3; JOINTS], ..self }
    }
}

/// Positions, speeds and accelerations of all joints at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// In rad.
    pub joints_rad: Joints,
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
}

impl Motion {
    /// Nothing moves.
    pub fn at_rest(joints_rad: Joints) -> Self {
        Motion { joints_rad, velocity_rad_s: [0.0; JOINTS], acceleration_rad_s2: [0.0; JOINTS] }
    }
}
