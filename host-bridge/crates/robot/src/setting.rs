//! The constant data of a session: the robot, its limits and its surroundings.

use glam::DMat3;
use serde::Serialize;

use crate::base::BaseConfig;
use crate::pose::{Pose, rows};
use crate::shape::{Capsule, Point, UprightBox};

/// The constant data of a session, in the world frame.
/// The base starts at the origin; x is forward, y left, and z up from the floor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotSetting {
    /// Title of the scene; empty without a scene.
    pub scene: String,
    /// The robot's surroundings.
    pub boxes: Vec<SceneBox>,
    /// Wheels and limits of the base.
    pub base: BaseConfig,
    /// Body of the base, relative to the point on the floor between its wheels.
    pub body: UprightBox,
    /// Position of the arm's base, relative to the point on the floor between the wheels.
    pub mount_m: Point,
    /// The name of the arm.
    pub arm_name: String,
    /// Link of the arm's base frame, as named in the arm's description.
    pub arm_root: String,
    /// The joints of the arm, in order from the foot.
    pub joints: Vec<JointSetting>,
    /// Position of the flange in the last joint's frame.
    pub flange_m: Point,
    /// Rotation of the flange relative to the last joint.
    #[serde(serialize_with = "rows")]
    pub flange_rotation: DMat3,
    /// Link of the flange, as named in the arm's description.
    pub flange_link: String,
    /// Shapes of the arm's fixed base, in the arm's base frame.
    pub foot: Vec<Capsule>,
}

/// A box of the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneBox {
    /// The name in the scene file.
    pub name: String,
    /// Where.
    #[serde(flatten)]
    pub shape: UprightBox,
}

/// An object of the scene at its current position.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneObject {
    /// The name in the scene file.
    pub name: String,
    /// Height above its underside.
    pub height_m: f64,
    /// Radius, if the object is round.
    pub radius_m: Option<f64>,
    /// Half of the object's length and width.
    pub half_m: [f64; 2],
    /// Pose of the centre of the object's bottom face in the world.
    #[serde(flatten)]
    pub pose: Pose,
}

/// One joint and the link that it moves. For a sliding joint, positions, speeds and limits are in m instead of rad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointSetting {
    /// Name of the joint in the robot's own description.
    pub name: String,
    /// Name of the moved link in the robot's own description.
    pub link: String,
    /// Position of the joint in its parent's frame.
    pub origin_m: Point,
    /// Rotation of the joint's frame relative to the parent's frame.
    #[serde(serialize_with = "rows")]
    pub origin_rotation: DMat3,
    /// Axis of the joint in its own frame.
    pub axis: Point,
    /// Whether the joint slides along its axis instead of turning about it.
    pub slides: bool,
    /// Minimum and maximum angle; `None` means that the joint turns without end.
    pub limit_rad: Option<(f64, f64)>,
    /// Maximum speed in planned motions.
    pub velocity_max_rad_s: f64,
    /// Maximum acceleration in planned motions.
    pub acceleration_max_rad_s2: f64,
    /// Shapes of the link, in the joint's frame.
    pub shapes: Vec<Capsule>,
}
