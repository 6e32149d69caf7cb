//! The one door to a robot: the bridge commands through it, observers look through it.

use std::fmt;
use std::sync::Arc;

use glam::DVec3;
use serde::{Serialize, Serializer};

use crate::base::{Covariance, Odometry, Twist};
use crate::pose::{JOINTS, Joints, Pose};
use crate::robot::Part;
use crate::setting::{RobotSetting, SceneObject};
use crate::shape::{Capsule, Point};

/// Name of an arm motion or pose, such as `pick-up`. Cheap to copy about.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MotionName(Arc<str>);

impl MotionName {
    /// The motion that also releases the operator's stop.
    pub const HOME: &'static str = "home";
    /// Not a motion: it only ends the motion under way.
    pub const END_ARM: &'static str = "end-arm";
    /// Not a motion of the configuration: the left hand moves the tool.
    pub const JOG: &'static str = "jog";

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<&str> for MotionName {
    fn from(name: &str) -> Self {
        MotionName(name.into())
    }
}

impl PartialEq<str> for MotionName {
    fn eq(&self, name: &str) -> bool {
        self.as_str() == name
    }
}

impl PartialEq<&str> for MotionName {
    fn eq(&self, name: &&str) -> bool {
        self.as_str() == *name
    }
}

impl fmt::Display for MotionName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl Serialize for MotionName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

/// Which part of a motion is under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leg {
    /// It is planned; the arm rests.
    Planning,
    /// Moving to the home pose.
    ToHome,
    /// Moving to the motion's own pose.
    ToGoal,
    /// The tool follows a hand.
    Jogging,
    /// Braking, since the motion was abandoned.
    Halting,
}

/// The arm as it is now.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArmState {
    /// In rad; NaN if unknown.
    pub joints_rad: Joints,
    /// In rad/s; NaN if unknown.
    pub velocity_rad_s: Joints,
    /// What runs, and how far it is; `None` = nothing.
    pub running: Option<(MotionName, Leg)>,
}

impl ArmState {
    /// No joint moves.
    pub fn at_rest(&self) -> bool {
        self.velocity_rad_s.iter().all(|v| *v == 0.0)
    }
}

/// A motion is under way; a new one is not accepted, and not queued.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the arm is busy with {0}")]
pub struct Busy(pub MotionName);

/// Why a motion does not start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotStarted {
    /// Another one runs.
    #[error(transparent)]
    Busy(#[from] Busy),
    /// It would not be safe, or the robot is not ready; the text says why and what to do.
    #[error("{0}")]
    Refused(String),
}

/// What the bridge should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// An arm motion ended.
    MotionEnded {
        /// Which.
        motion: MotionName,
        /// At its pose, not halted.
        reached: bool,
    },
    /// An arm motion that was accepted is not begun: there is no safe way, or something has changed while it was planned.
    MotionRefused {
        /// Which.
        motion: MotionName,
        /// Why, and what to do.
        reason: String,
    },
    /// The guard does not let the base drive as asked.
    BaseHeld {
        /// What is in the way, or what is not known.
        reason: String,
    },
    /// The base drives as asked again.
    BaseFree,
    /// The robot shows that it acts on the newest command for this part.
    Accepted(Part),
    /// The robot has something to say to a person.
    Note(String),
}

/// Everything about the robot that changes, as the robot itself reports it.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// The arm; NaN if its angles are unknown.
    pub arm: ArmState,
    /// Age of its angles; `None` = unknown.
    pub arm_age_ms: Option<u64>,
    /// The base; the origin if it is unknown.
    pub odometry: Odometry,
    /// Age of that; `None` = unknown.
    pub base_age_ms: Option<u64>,
    /// How sure the odometry is.
    pub covariance: Covariance,
    /// Speeds of the left and the right wheel in rad/s.
    pub wheels_rad_s: [f64; 2],
    /// How far each has turned since the start, in rad.
    pub wheels_rad: [f64; 2],
    /// The flange in the arm's base frame; NaN if the angles are unknown.
    pub flange: Pose,
    /// How far the gripper's fingers are apart; `None` = there is none, or it does not say.
    pub opening_m: Option<f64>,
    /// Shapes of what is on the flange, in its frame.
    pub tool: Vec<Capsule>,
    /// Objects of the scene, where they are now.
    pub objects: Vec<SceneObject>,
    /// Where the arm should be by now, in rad, while it follows a trajectory.
    pub reference_rad: Option<Joints>,
    /// What holds the base back, if anything does.
    pub held: Option<String>,
    /// What keeps the tool from following a hand, if anything does.
    pub jog_held: Option<String>,
    /// Ticks in which the guard braked for an obstacle.
    pub guard_stops: u32,
    /// How often the robot had to stop by itself.
    pub timeouts: u32,
}

/// See the module.
pub trait Door {
    /// Lets the time become `now_ms`: the robot moves, the guard watches, motions end.
    fn step(&mut self, now_ms: u64);

    /// Sets the base's speed, as far as the guard allows. Also says that the bridge is alive.
    fn drive(&mut self, twist: Twist);

    /// Starts an arm motion.
    ///
    /// # Errors
    /// [`NotStarted`] while another one runs, or if it would not be safe. Nothing moves then.
    fn start_motion(&mut self, motion: &MotionName) -> Result<(), NotStarted>;

    /// Whether a hand could move the tool now.
    ///
    /// # Errors
    /// [`NotStarted`] while a motion runs, or if this robot's arm cannot be moved that way.
    fn can_jog(&self) -> Result<(), NotStarted> {
        Err(NotStarted::Refused("this robot's arm cannot be moved by hand".to_owned()))
    }

    /// The tool shall move at this speed, in the arm's base frame, until told otherwise; as far as limits and guard allow.
    /// Repeated by a bridge that is alive: what is older than a quarter second counts as zero.
    fn jog(&mut self, _tool_m_s: DVec3) {}

    /// A motion was planned elsewhere, and waits to be begun.
    fn plan_is_ready(&self) -> bool {
        false
    }

    /// Begins it, if nothing speaks against it by now.
    fn begin_planned(&mut self) {}

    /// Brings base and arm to rest within their limits; targets are forgotten.
    fn halt(&mut self);

    /// Brings the arm to rest within its limits; the base goes on.
    fn halt_arm(&mut self);

    /// Why nothing may move on this robot now; `None` = it may.
    fn refusal(&self) -> Option<String> {
        None
    }

    /// What happened since the last call.
    fn take_reports(&mut self) -> Vec<Report>;

    /// Hands over what was decided in this turn; called at the end of each.
    fn send(&mut self);

    /// Whether a motion of that name exists.
    fn knows(&self, motion: &MotionName) -> bool;

    /// The robot as it reports itself.
    fn picture(&self) -> Picture;

    /// What does not change.
    fn setting(&self) -> RobotSetting;

    /// The arm's foot, from the point on the floor between the wheels.
    fn mount_m(&self) -> Point;

    /// Frames of the arm's joints and its flange (last), in the arm's base frame.
    fn link_poses(&self, joints_rad: &Joints) -> [Pose; JOINTS + 1];
}
