//! The scene file: the robot's surroundings, the size of its base, and the motion of its arm.
//!
//! ```toml
//! [base]                      # every line is optional
//! wheel_radius_m = 0.1
//! track_m = 0.4
//! size_m = [0.6, 0.5, 0.35]   # length, width, height of the body, which floats 0.05 m above the floor
//! mount_m = [0.1, 0.0, 0.4]   # the arm's foot
//!
//! [arm]
//! route = "direct"            # or "via-home", as in the paper
//! velocity_scaling = 0.1
//! acceleration_scaling = 0.05
//! jerk_limited = false        # true: accelerations rise and fall no faster than jerk_rad_s3
//! jerk_rad_s3 = 4.3           # of all joints, not scaled
//! # urdf = "arm.urdf"         # another arm than the Gen3 (build with `--features urdf`); then also give poses
//! # packages = [".."]         # folders that hold the packages of its meshes
//!
//! [ros2]                      # the ROS 2 settings of the robot; a configuration overrides them; see robots/*.toml
//!
//! [[box]]                     # upright boxes; x forward, y left, z up from the robot's start on the floor
//! name = "table"
//! center_m = [0.8, 0.0, 0.35]
//! size_m = [0.6, 1.2, 0.7]
//! yaw_rad = 0.0
//!
//! [[object]]                  # what can be gripped, see `things.rs`
//! name = "cup"
//! at_m = [0.7, 0.0, 0.7]
//! height_m = 0.1
//! radius_m = 0.03
//!
//! [[tool]]                    # a tool on the flange, see `tool.rs`
//! name = "2f-85"
//!
//! [[pose]]                    # joint angles, or a pose of the tool's point; a motion's name (home, pick-up,
//! name = "pick-up"            # place, …) replaces that motion; the simulated arm starts at "ready".
//!                             # Any pose is also a motion: --map wave="bin 1"
//! position_m = [0.6, 0.1, 0.9]
//! quaternion_wxyz = [0, 1, 0, 0]
//! ```

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use host_robot::{DMat3, DQuat, Pose};

use crate::gen3::{ACCELERATION_SCALING, MAX_JERK_RAD_S3, VELOCITY_SCALING};
use crate::motions::MotionTable;
use crate::things::ObjectTable;
use crate::tool::{Tool, ToolTable};
use host_robot::BaseConfig;
use host_robot::JointLimits;
use host_robot::shape::{Point, UprightBox};

/// Everything in the file, checked.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// A line of text for users.
    #[serde(default)]
    pub title: String,
    /// Size of the base and its wheels.
    #[serde(default)]
    pub base: BaseTable,
    /// How the arm moves.
    #[serde(default)]
    pub arm: ArmTable,
    /// The robot's surroundings.
    #[serde(default, rename = "box")]
    pub boxes: Vec<NamedBox>,
    /// Named goals.
    #[serde(default, rename = "pose")]
    pub poses: Vec<NamedPose>,
    /// Motions of its own.
    #[serde(default, rename = "motion")]
    pub motions: Vec<MotionTable>,
    /// What can be gripped.
    #[serde(default, rename = "object")]
    pub objects: Vec<ObjectTable>,
    /// The tools on the flange.
    #[serde(default, rename = "tool")]
    pub tools: Vec<ToolTable>,
    /// The robot's profile for the driver of a real robot; this crate does not interpret it.
    #[serde(default)]
    pub ros2: toml::Table,
    /// The bundled hands that `demo` plays in this scene.
    /// An empty value selects the hands for the paper's six motions.
    #[serde(default)]
    pub demo: Option<String>,
}

/// The mobile base.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseTable {
    /// Radius of the driven wheels.
    pub wheel_radius_m: f64,
    /// Distance between the wheels' contact points.
    pub track_m: f64,
    /// Maximum speed of a wheel.
    pub wheel_speed_max_rad_s: f64,
    /// Maximum change of wheel speed per second.
    pub wheel_acceleration_max_rad_s2: f64,
    /// Variance of a wheel's travelled distance per metre, in m²/m.
    pub wheel_variance_m: f64,
    /// Length, width and height of the body, which begins 0.05 m above the floor.
    pub size_m: Point,
    /// Position of the arm's base, relative to the point on the floor between the wheels.
    pub mount_m: Point,
}

/// Minimum jerk limit. With it, a stop from full speed at the paper's scaling takes about a second.
pub const JERK_MIN_RAD_S3: f64 = 0.5;

/// Permitted radii of an arm's links.
const LINK_RADIUS_M: std::ops::RangeInclusive<f64> = 0.005..=0.3;

/// Height of the lowest part of the base's body above the floor.
const GROUND_CLEARANCE_M: f64 = 0.05;

impl Default for BaseTable {
    fn default() -> Self {
        let base = BaseConfig::default();
        BaseTable {
            wheel_radius_m: base.wheel_radius_m,
            track_m: base.track_m,
            wheel_speed_max_rad_s: base.wheel_speed_max_rad_s,
            wheel_acceleration_max_rad_s2: base.wheel_acceleration_max_rad_s2,
            wheel_variance_m: base.wheel_variance_m,
            size_m: Point::new(0.6, 0.5, 0.35),
            mount_m: Point::new(0.1, 0.0, 0.4),
        }
    }
}

impl BaseTable {
    /// Returns the body relative to the point on the floor between the wheels.
    pub fn body(&self) -> UprightBox {
        UprightBox {
            center_m: Point::new(0.0, 0.0, GROUND_CLEARANCE_M + 0.5 * self.size_m.z),
            half_m: 0.5 * self.size_m,
            yaw_rad: 0.0,
        }
    }

    /// Returns the parameters for the base's own motion.
    pub fn config(&self) -> BaseConfig {
        BaseConfig {
            wheel_radius_m: self.wheel_radius_m,
            track_m: self.track_m,
            wheel_speed_max_rad_s: self.wheel_speed_max_rad_s,
            wheel_acceleration_max_rad_s2: self.wheel_acceleration_max_rad_s2,
            wheel_variance_m: self.wheel_variance_m,
        }
    }
}

/// The path of the arm to a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Route {
    /// The arm moves to its home pose first, as in the paper.
    ViaHome,
    /// The planned path, or via home only if none is found.
    #[default]
    Direct,
}

/// The choice of the arm, and the parameters of its motion.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmTable {
    /// Which way.
    pub route: Route,
    /// Fraction of the arm's maximum speeds.
    pub velocity_scaling: f64,
    /// Fraction of the arm's maximum accelerations.
    pub acceleration_scaling: f64,
    /// Whether jerk is limited to `jerk_rad_s3`, also while stopping.
    pub jerk_limited: bool,
    /// The jerk limit of all joints, which is not scaled.
    pub jerk_rad_s3: f64,
    /// Minimum distance of plans from all obstacles at checked configurations.
    /// Between these configurations, half of this margin applies.
    pub margin_m: f64,
    /// Equal seeds give equal plans.
    pub seed: u64,
    /// File of an arm other than the Gen3, relative to the scene file (feature `urdf`).
    pub urdf: Option<PathBuf>,
    /// Folders that contain the packages of the arm's meshes, relative to the scene file.
    pub packages: Vec<PathBuf>,
    /// First link of that arm, which defines the arm's frame. `None` selects the robot's first link.
    pub root: Option<String>,
    /// Last link of that arm, required if the file has several tips.
    pub tip: Option<String>,
    /// Radius of the lines that replace links without simple shapes in the file.
    pub link_radius_m: f64,
    /// Acceleration of joints for which the file specifies none, before scaling.
    pub acceleration_rad_s2: f64,
    /// Speed of continuous joints for which the file specifies no limits, before scaling.
    pub velocity_rad_s: f64,
}

impl Default for ArmTable {
    fn default() -> Self {
        ArmTable {
            route: Route::default(),
            velocity_scaling: VELOCITY_SCALING,
            acceleration_scaling: ACCELERATION_SCALING,
            jerk_limited: false,
            jerk_rad_s3: MAX_JERK_RAD_S3,
            margin_m: 0.01,
            seed: 1,
            urdf: None,
            packages: Vec::new(),
            root: None,
            tip: None,
            link_radius_m: 0.06,
            acceleration_rad_s2: 1.0,
            velocity_rad_s: 0.5,
        }
    }
}

/// An upright box.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedBox {
    /// Name of the box, which must differ from the names of the other boxes.
    pub name: String,
    /// Its middle.
    pub center_m: Point,
    /// Length, width, height.
    pub size_m: Point,
    /// Turned to the left.
    #[serde(default)]
    pub yaw_rad: f64,
}

impl NamedBox {
    /// Shape of the box in collision checks.
    pub fn shape(&self) -> UprightBox {
        UprightBox { center_m: self.center_m, half_m: 0.5 * self.size_m, yaw_rad: self.yaw_rad }
    }
}

/// A goal of the arm: joint angles, or a pose of the flange.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedPose {
    /// Name of the pose, which must differ from the names of the other poses.
    pub name: String,
    /// One angle per joint.
    pub joints_rad: Option<Vec<f64>>,
    /// Position of the tool's point, or of the flange if there is no tool.
    /// The position is relative to the robot's start on the floor.
    pub position_m: Option<Point>,
    /// Orientation of the flange, whose z axis points out of the arm.
    pub quaternion_wxyz: Option<[f64; 4]>,
}

/// What a pose asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Goal {
    /// Joint angles, one per joint of the arm.
    Joints(Vec<f64>),
    /// A pose of the flange in the arm's base frame, with the base at the start.
    Flange(Pose),
}

/// The file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file is not valid TOML, or has invalid fields.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A value makes no sense.
    #[error("{0}")]
    Value(String),
}

impl Default for Scene {
    /// Returns an empty scene with the default base and the paper's scaling.
    fn default() -> Self {
        Scene {
            title: String::new(),
            base: BaseTable::default(),
            arm: ArmTable::default(),
            boxes: Vec::new(),
            poses: Vec::new(),
            motions: Vec::new(),
            objects: Vec::new(),
            tools: Vec::new(),
            ros2: toml::Table::new(),
            demo: None,
        }
    }
}

impl Scene {
    /// Parses a scene and checks every value.
    ///
    /// # Errors
    /// Returns the problem. For an error of format, it contains the line and the column.
    /// For an invalid value, it contains the name of the table.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        let scene: Scene = toml::from_str(text)?;
        scene.check().map_err(SceneError::Value)?;
        Ok(scene)
    }

    /// Returns the tool on the flange.
    pub fn tool(&self) -> Tool {
        // `check` has verified that the tools can be combined.
        Tool::new(&self.tools).unwrap_or_default()
    }

    fn check(&self) -> Result<(), String> {
        Tool::new(&self.tools)?;
        let positive = |name: &str, value: f64| {
            let fine = value.is_finite() && value > 0.0;
            if fine { Ok(()) } else { Err(format!("{name} = {value}: must be a number above 0")) }
        };
        let base = &self.base;
        positive("base: wheel_radius_m", base.wheel_radius_m)?;
        positive("base: track_m", base.track_m)?;
        positive("base: wheel_speed_max_rad_s", base.wheel_speed_max_rad_s)?;
        positive("base: wheel_acceleration_max_rad_s2", base.wheel_acceleration_max_rad_s2)?;
        positive("base: wheel_variance_m", base.wheel_variance_m)?;
        base.size_m.to_array().into_iter().try_for_each(|size| positive("base: size_m", size))?;
        if !base.mount_m.is_finite() {
            return Err("base: mount_m must be three numbers".to_owned());
        }
        for (name, value) in [
            ("arm: velocity_scaling", self.arm.velocity_scaling),
            ("arm: acceleration_scaling", self.arm.acceleration_scaling),
        ] {
            positive(name, value)?;
            if value > 1.0 {
                return Err(format!("{name} = {value}: must be at most 1"));
            }
        }
        let jerk_rad_s3 = self.arm.jerk_rad_s3;
        if !(jerk_rad_s3.is_finite() && jerk_rad_s3 >= JERK_MIN_RAD_S3) {
            return Err(format!(
                "arm: jerk_rad_s3 = {jerk_rad_s3}: must be a number of {JERK_MIN_RAD_S3} or more"
            ));
        }
        positive("arm: margin_m", self.arm.margin_m)?;
        let radius_m = self.arm.link_radius_m;
        if !LINK_RADIUS_M.contains(&radius_m) {
            return Err(format!(
                "arm: link_radius_m = {radius_m}: lies between {} and {} m; no arm's links are thinner or thicker",
                LINK_RADIUS_M.start(),
                LINK_RADIUS_M.end()
            ));
        }
        positive("arm: acceleration_rad_s2", self.arm.acceleration_rad_s2)?;
        positive("arm: velocity_rad_s", self.arm.velocity_rad_s)?;
        for (i, shape) in self.boxes.iter().enumerate() {
            let name = &shape.name;
            shape
                .size_m
                .to_array()
                .into_iter()
                .try_for_each(|size| positive(&format!("box '{name}': size_m"), size))?;
            if !(shape.center_m.is_finite() && shape.yaw_rad.is_finite()) {
                return Err(format!("box '{name}': center_m and yaw_rad must be numbers"));
            }
            if self.boxes[..i].iter().any(|other| other.name == *name) {
                return Err(format!("box '{name}' is there twice; give each its own name"));
            }
        }
        for (i, object) in self.objects.iter().enumerate() {
            object.check()?;
            let name = &object.name;
            let others = self.objects[..i].iter().map(|o| &o.name).chain(self.boxes.iter().map(|b| &b.name));
            if others.into_iter().any(|other| other == name) {
                return Err(format!("object '{name}' is there twice, or is a box; give each its own name"));
            }
        }
        for (i, pose) in self.poses.iter().enumerate() {
            let name = &pose.name;
            self.goal(pose)?;
            if self.poses[..i].iter().any(|other| other.name == *name) {
                return Err(format!("pose '{name}' is there twice; give each its own name"));
            }
        }
        Ok(())
    }

    /// Returns the scaled limits of an arm in this scene.
    pub fn limits(&self, arm: &crate::model::SerialArm) -> JointLimits {
        let limits = arm.limits(self.arm.velocity_scaling, self.arm.acceleration_scaling);
        if self.arm.jerk_limited { limits.with_jerk(self.arm.jerk_rad_s3) } else { limits }
    }

    /// The goals in the order of the file.
    pub fn goals(&self) -> Vec<(&str, Goal)> {
        // `check` has already parsed every pose.
        self.poses.iter().filter_map(|pose| Some((pose.name.as_str(), self.goal(pose).ok()?))).collect()
    }

    fn goal(&self, pose: &NamedPose) -> Result<Goal, String> {
        let name = &pose.name;
        match (&pose.joints_rad, pose.position_m, pose.quaternion_wxyz) {
            (Some(angles), None, None) => {
                if !angles.iter().all(|a| a.is_finite()) {
                    return Err(format!("pose '{name}': joints_rad must be finite angles"));
                }
                Ok(Goal::Joints(angles.clone()))
            }
            (None, Some(position_m), Some([w, x, y, z])) => {
                let turn = DQuat::from_xyzw(x, y, z, w);
                if !(turn.length().is_finite() && turn.length() > 0.5 && position_m.is_finite()) {
                    return Err(format!("pose '{name}': position_m or quaternion_wxyz is no place"));
                }
                let rotation = DMat3::from_quat(turn.normalize());
                let point_m = rotation * self.tool().point_m();
                Ok(Goal::Flange(Pose { position_m: position_m - self.base.mount_m - point_m, rotation }))
            }
            _ => Err(format!(
                "pose '{name}' needs either joints_rad, or position_m together with quaternion_wxyz"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_file_is_the_papers_robot_with_nothing_around() {
        let scene = Scene::parse("").unwrap();
        assert_eq!(scene, Scene::default());
        assert_eq!(scene.base.config(), BaseConfig::default());
        assert_eq!(scene.limits(&crate::model::SerialArm::gen3()), crate::gen3::paper_limits());
    }

    #[test]
    fn wheels_and_track_come_from_the_file() {
        let scene = Scene::parse("[base]\nwheel_radius_m = 0.05\ntrack_m = 0.3").unwrap();
        assert_eq!((scene.base.config().wheel_radius_m, scene.base.config().track_m), (0.05, 0.3));
    }

    #[test]
    fn wrong_values_are_named() {
        for (text, told) in [
            ("[[box]]\nname = \"a\"\ncenter_m = [0, 0, 0]\nsize_m = [1, 0, 1]", "box 'a': size_m = 0"),
            ("[base]\ntrack_m = -1.0", "base: track_m = -1"),
            ("[arm]\nvelocity_scaling = 2.0", "must be at most 1"),
            ("[arm]\njerk_rad_s3 = 0.1", "arm: jerk_rad_s3 = 0.1"),
            ("[arm]\nlink_radius_m = 60", "arm: link_radius_m = 60: lies between 0.005 and 0.3 m"),
            ("[arm]\nlink_radius_m = nan", "arm: link_radius_m = NaN: lies between"),
            ("[[pose]]\nname = \"p\"\nposition_m = [0, 0, 0]", "pose 'p' needs either"),
            ("[[pose]]\nname = \"p\"\njoints_rad = [nan]", "pose 'p': joints_rad"),
            ("[base]\nwheels = 3", "line 2"),
        ] {
            let error = Scene::parse(text).unwrap_err().to_string();
            assert!(error.contains(told), "{error}");
        }
    }
}
