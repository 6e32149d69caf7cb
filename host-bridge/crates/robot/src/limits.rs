//! Limits of the joints, and their motion at one instant. [`Trajectory`](crate::Trajectory) describes motion over time.

use crate::{JOINTS, Joints};

/// Limits that a move must not exceed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
    /// Jerk limits in rad/s³, which are infinite if accelerations may jump.
    pub jerk_rad_s3: Joints,
}

impl JointLimits {
    /// Returns these limits with an additional jerk limit for all joints.
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
