//! What the joints may do, and where they are at one instant. Motion in time is
//! [`Trajectory`](crate::plan::Trajectory).

use super::gen3::{
    ACCELERATION_SCALING, Joints, MAX_ACCELERATION_RAD_S2, MAX_VELOCITY_RAD_S, VELOCITY_SCALING,
};

/// What a move must not exceed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
}

impl JointLimits {
    /// The arm's own limits, scaled as in the paper (0.1 and 0.05).
    pub fn paper() -> Self {
        JointLimits {
            velocity_rad_s: MAX_VELOCITY_RAD_S.map(|v| v * VELOCITY_SCALING),
            acceleration_rad_s2: MAX_ACCELERATION_RAD_S2.map(|a| a * ACCELERATION_SCALING),
        }
    }
}

/// Positions and speeds of all joints at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// In rad.
    pub joints_rad: Joints,
    /// In rad/s.
    pub velocity_rad_s: Joints,
}
