//! What does not change in a session: the robot, its limits, its surroundings.

use glam::DMat3;
use serde::Serialize;

use crate::base::BaseConfig;
use crate::pose::{Pose, rows};
use crate::shape::{Capsule, Point, UprightBox};

/// Frames: the world is where the base started, x forward, y left, z up from the floor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotSetting {
    /// The scene's title; empty without a scene.
    pub scene: String,
    /// What stands around.
    pub boxes: Vec<SceneBox>,
    /// Wheels and limits of the base.
    pub base: BaseConfig,
    /// The base's body, as seen from the point on the floor between its wheels.
    pub body: UprightBox,
    /// The arm's foot, as seen from the same point.
    pub mount_m: Point,
    /// Of the arm.
    pub arm_name: String,
    /// The link that the arm's base frame belongs to, as in the arm's own description.
    pub arm_root: String,
    /// From the foot on.
    pub joints: Vec<JointSetting>,
    /// The flange in the last joint's frame.
    pub flange_m: Point,
    /// How the flange is turned against the last joint.
    #[serde(serialize_with = "rows")]
    pub flange_rotation: DMat3,
    /// The flange's link in the arm's own description.
    pub flange_link: String,
    /// Shapes of the arm's foot, in the arm's base frame.
    pub foot: Vec<Capsule>,
}

/// A box of the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneBox {
    /// From the scene file.
    pub name: String,
    /// Where.
    #[serde(flatten)]
    pub shape: UprightBox,
}

/// An object of the scene, where it is now.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneObject {
    /// From the scene file.
    pub name: String,
    /// Height, from its underside up.
    pub height_m: f64,
    /// Radius, if it is round.
    pub radius_m: Option<f64>,
    /// Half its length and width.
    pub half_m: [f64; 2],
    /// The middle of its underside, in the world.
    #[serde(flatten)]
    pub pose: Pose,
}

/// One joint and the link that it moves. Where it slides, angles, speeds and limits are in m instead of rad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointSetting {
    /// As in the robot's own description.
    pub name: String,
    /// The link that it turns, as in the same.
    pub link: String,
    /// Where the joint sits in its parent's frame.
    pub origin_m: Point,
    /// How its frame is turned against its parent's.
    #[serde(serialize_with = "rows")]
    pub origin_rotation: DMat3,
    /// Axis in its own frame.
    pub axis: Point,
    /// It slides along its axis instead of turning about it.
    pub slides: bool,
    /// Minimum and maximum angle; `None` = turns without end.
    pub limit_rad: Option<(f64, f64)>,
    /// Maximum speed that motions use.
    pub velocity_max_rad_s: f64,
    /// Maximum acceleration that motions use.
    pub acceleration_max_rad_s2: f64,
    /// The link, in the joint's frame.
    pub shapes: Vec<Capsule>,
}
