//! The interface between bridge and robot: shared types and two traits.
//!
//! ```text
//! bridge ─► Door ─► (director: goals, planning, guard) ─► Robot ─► simulator, ROS 2, …
//!            │                                              │
//! observers ◄┴── Picture, RobotSetting ◄── its own state ◄──┘
//! ```
//!
//! * [`Robot`]: the interface of every robot, such as the simulator or a robot on a ROS 2 graph.
//! * [`Door`]: the interface for the bridge and for observers. The arm director implements it for all robots.
//! * [`brake`]: braking along a trajectory's own path,
//! * [`base`], [`pose`], [`limits`], [`trajectory`], [`shape`]: geometry and motion, without time or links.

pub mod base;
pub mod brake;
pub mod door;
pub mod gripper;
pub mod limits;
pub mod pose;
pub mod random;
pub mod robot;
pub mod setting;
pub mod shape;
pub mod trajectory;

pub use base::{Base, BaseConfig, Covariance, Odometry, Twist};
pub use door::{
    ArmState, Busy, DRIVE_INTERVAL_MS, Door, Leg, MotionName, NotStarted, PACE_LEAST, Picture, Report,
};
pub use glam::{DMat3, DQuat, DVec2, DVec3, EulerRot};
pub use gripper::{Grip, GripEnd};
pub use limits::{JointLimits, Motion};
pub use pose::{JOINTS, Joints, Pose, joints};
pub use random::Random;
pub use robot::{BaseState, End, Following, Part, Reading, Robot, Root, Sighting, Wheels};
pub use setting::{JointSetting, RobotSetting, SceneBox, SceneObject};
pub use trajectory::Trajectory;

/// Parameters of the Gen3, for tests of code that does not depend on a particular arm.
#[cfg(test)]
mod gen3 {
    use crate::{JOINTS, JointLimits, Joints, joints};

    #[allow(clippy::approx_constant)] // Kinova's file has 3.14, too.
    pub const HOME: Joints = joints([0.0, 0.26, 3.14, -2.27, 0.0, 0.96, 1.57]);

    /// Kinova's limits at the paper's scaling of 0.1 and 0.05.
    pub fn paper_limits() -> JointLimits {
        JointLimits {
            velocity_rad_s: [1.3963, 1.3963, 1.3963, 1.3963, 1.2218, 1.2218, 1.2218, 1.0].map(|v| v * 0.1),
            acceleration_rad_s2: [8.6 * 0.05; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        }
    }
}
