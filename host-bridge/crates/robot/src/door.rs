//! The interface to a robot: the bridge commands it, and observers read its state.

use std::fmt;
use std::sync::Arc;

use glam::DVec3;
use serde::{Serialize, Serializer};

use crate::base::{Covariance, Odometry, Twist};
use crate::pose::{JOINTS, Joints, Pose};
use crate::robot::Part;
use crate::setting::{RobotSetting, SceneObject};
use crate::shape::{Capsule, Point};

/// Name of an arm motion or pose, such as `pick-up`. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MotionName(Arc<str>);

impl MotionName {
    /// The motion that also releases the operator's stop.
    pub const HOME: &'static str = "home";
    /// A special name that ends the current motion instead of starting one.
    pub const END_ARM: &'static str = "end-arm";
    /// The name for the motion of the tool by the left hand. The configuration contains no such motion.
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

/// The current part of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leg {
    /// The motion is being planned, and the arm rests.
    Planning,
    /// Moving to the home pose.
    ToHome,
    /// Moving to the pose of the motion.
    ToGoal,
    /// The tool follows a hand.
    Jogging,
    /// The arm brakes because the motion was abandoned.
    Halting,
}

/// The current state of the arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArmState {
    /// Joint angles in rad; NaN if unknown.
    pub joints_rad: Joints,
    /// Joint speeds in rad/s; NaN if unknown.
    pub velocity_rad_s: Joints,
    /// The running motion and its current part, or `None`.
    pub running: Option<(MotionName, Leg)>,
}

impl ArmState {
    /// A planned motion moves the arm, and nothing has halted it.
    pub fn is_on_its_way(&self) -> bool {
        matches!(self.running, Some((_, Leg::ToHome | Leg::ToGoal)))
    }

    /// No joint moves.
    pub fn at_rest(&self) -> bool {
        self.velocity_rad_s.iter().all(|v| *v == 0.0)
    }
}

/// Another motion is running, so the new one is rejected and not queued.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the arm is busy with {0}")]
pub struct Busy(pub MotionName);

/// The reason why a motion does not start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotStarted {
    /// Another one runs.
    #[error(transparent)]
    Busy(#[from] Busy),
    /// The motion would not be safe, or the robot is not ready. The text contains the reason and a remedy.
    #[error("{0}")]
    Refused(String),
}

/// Reports to the bridge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// An arm motion ended.
    MotionEnded {
        /// Which.
        motion: MotionName,
        /// Whether the arm reached its pose without a halt.
        reached: bool,
    },
    /// An accepted arm motion does not begin, because no safe path exists or something changed during planning.
    MotionRefused {
        /// Which.
        motion: MotionName,
        /// The reason, and a remedy.
        reason: String,
    },
    /// The guard prevents the requested motion of the base.
    BaseHeld {
        /// The obstacle, or the missing information.
        reason: String,
    },
    /// The base follows its commands again.
    BaseFree,
    /// The robot reports that it acts on the newest command for this part.
    Accepted(Part),
    /// A message from the robot to the user.
    Note(String),
}

/// All data about the robot that changes, as the robot reports it.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// The arm. Its angles are NaN if unknown.
    pub arm: ArmState,
    /// Age of the joint angles; `None` if unknown.
    pub arm_age_ms: Option<u64>,
    /// The base, or the origin if it is unknown.
    pub odometry: Odometry,
    /// Age of the odometry; `None` if unknown.
    pub base_age_ms: Option<u64>,
    /// The covariance of the odometry.
    pub covariance: Covariance,
    /// Speeds of the left and the right wheel in rad/s.
    pub wheels_rad_s: [f64; 2],
    /// Total rotation of each wheel since the start, in rad.
    pub wheels_rad: [f64; 2],
    /// Pose of the flange in the arm's base frame; NaN if the angles are unknown.
    pub flange: Pose,
    /// Distance between the gripper's fingers; `None` without a gripper or a report.
    pub opening_m: Option<f64>,
    /// Shapes of the tool in the flange's frame.
    pub tool: Vec<Capsule>,
    /// Objects of the scene at their current positions.
    pub objects: Vec<SceneObject>,
    /// Current target of the arm in rad, while it follows a trajectory.
    pub reference_rad: Option<Joints>,
    /// The reason why the guard has stopped the base, or `None`.
    pub held: Option<String>,
    /// The reason why the tool does not follow a hand, or `None`.
    pub jog_held: Option<String>,
    /// Ticks in which the guard braked for an obstacle.
    pub guard_stops: u32,
    /// Number of times the robot had to stop by itself.
    pub timeouts: u32,
}

/// The bridge repeats the base's speed at this interval, so that the robot detects the end of the bridge.
pub const DRIVE_INTERVAL_MS: u64 = 20;
/// The slowest pace of the arm. At a slower one, nobody would see that the arm still moves.
pub const PACE_LEAST: f64 = 0.1;

/// See the module.
pub trait Door {
    /// Advances the time to `now_ms`: the robot moves, the guard checks, and motions end.
    fn step(&mut self, now_ms: u64);

    /// Sets the cap: while the base moves, no point of the robot moves faster because of it.
    /// The value applies to all later calls of [`Door::drive`]. Without a call, there is no cap.
    fn cap(&mut self, _most_m_s: f64) {}

    /// Sets the base's speed, if the guard allows it, and shows that the bridge is alive.
    fn drive(&mut self, twist: Twist);

    /// Starts an arm motion.
    ///
    /// # Errors
    /// Returns [`NotStarted`] if another motion is running or this one would not be safe. Nothing moves in this case.
    fn start_motion(&mut self, motion: &MotionName) -> Result<(), NotStarted>;

    /// Sets the arm's speed as a fraction of the planned speed ([`PACE_LEAST`] to 1), for the running motion and all later ones.
    fn pace(&mut self, _share: f64) {}

    /// Checks whether a hand could move the tool now.
    ///
    /// # Errors
    /// Returns [`NotStarted`] while a motion runs, or if this robot's arm cannot be moved that way.
    fn can_jog(&self) -> Result<(), NotStarted> {
        Err(NotStarted::Refused("this robot's arm cannot be moved by hand".to_owned()))
    }

    /// Moves the tool at this speed, in the arm's base frame, within the limits and if the guard allows it.
    /// A live bridge repeats the speed. A value older than a quarter of a second counts as zero.
    fn jog(&mut self, _tool_m_s: DVec3) {}

    /// Returns whether a motion was planned elsewhere and waits for its start.
    fn plan_is_ready(&self) -> bool {
        false
    }

    /// Begins the planned motion, if it is still permitted.
    fn begin_planned(&mut self) {}

    /// Brings base and arm to rest within their limits, and discards their targets.
    fn halt(&mut self);

    /// Brings only the arm to rest within its limits.
    fn halt_arm(&mut self);

    /// Returns the reason why this robot must not move now, or `None`.
    fn refusal(&self) -> Option<String> {
        None
    }

    /// Returns the reports since the last call.
    fn take_reports(&mut self) -> Vec<Report>;

    /// Sends the decisions of this turn. Called at the end of each turn.
    fn send(&mut self);

    /// Returns whether a motion of that name exists.
    fn knows(&self, motion: &MotionName) -> bool;

    /// Returns the state that the robot reports.
    fn picture(&self) -> Picture;

    /// Returns the data that does not change.
    fn setting(&self) -> RobotSetting;

    /// Position of the arm's base, relative to the point on the floor between the wheels.
    fn mount_m(&self) -> Point;

    /// Returns the frames of the arm's joints and its flange (last), in the arm's base frame.
    fn link_poses(&self, joints_rad: &Joints) -> [Pose; JOINTS + 1];
}
