//! The interface of every robot, simulated or real.

use std::sync::Arc;

use serde::Serialize;

use crate::base::{BaseConfig, Covariance, Odometry, Twist};
use crate::gripper::{Grip, GripEnd};
use crate::limits::{JointLimits, Motion};
use crate::pose::{Joints, Pose};
use crate::trajectory::Trajectory;

/// A value that a robot reports, with its age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading<T> {
    /// What it reports.
    pub value: T,
    /// Time since the measurement, or since arrival if the robot sends no stamp.
    pub age_ms: u64,
}

/// The state of the base, as reported by the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseState {
    /// Position and speed of the base.
    pub odometry: Odometry,
    /// The covariance of the position.
    pub covariance: Covariance,
    /// State of the wheels, if reported.
    pub wheels: Option<Wheels>,
}

/// The left and the right wheel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wheels {
    /// Speeds in rad/s.
    pub speed_rad_s: [f64; 2],
    /// Angles turned since the start, in rad.
    pub angle_rad: [f64; 2],
}

/// The frame of an object's pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Root {
    /// The frame at the point on the floor between the wheels.
    Base,
    /// The frame of the arm's base.
    Arm,
}

/// The pose of an object to which the arm may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Position and orientation, with finite values.
    pub pose: Pose,
    /// The frame of the pose.
    pub root: Root,
}

/// The arm's progress on its trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Following {
    /// It has none.
    Idle,
    /// The arm follows the trajectory and has come this far.
    Moving {
        /// Time since the trajectory's start, in s.
        elapsed_s: f64,
    },
    /// The arm has abandoned the trajectory and is braking.
    Halting,
}

/// The part of the robot that a command is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    /// The wheels.
    Base,
    /// The arm.
    Arm,
}

impl Part {
    /// For people and files.
    pub fn name(self) -> &'static str {
        match self {
            Part::Base => "base",
            Part::Arm => "arm",
        }
    }
}

/// The result of following a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The arm rests at the trajectory's end.
    Reached,
    /// The arm rests, or is assumed to rest, at another position.
    Halted,
}

/// A robot with a base and an arm, which always reports its measured state and never its commands.
///
/// **Stops by itself**: an implementation must bring the base to rest when [`drive`](Robot::drive) is no longer called.
/// No method may block.
pub trait Robot {
    /// Reads what the robot has sent until `now_ms`, the time of this turn.
    /// Afterwards, [`Robot::step`] may advance to this time in several steps.
    /// The messages of a remote robot must not be dated earlier than their arrival.
    fn hear(&mut self, _now_ms: u64) {}

    /// Advances the time to `now_ms`.
    fn step(&mut self, now_ms: u64);

    /// Returns joint angles, speeds and (if known) accelerations.
    /// The result is `None` if the values are unknown, or older than the robot accepts.
    fn arm(&self) -> Option<Reading<Motion>>;

    /// Returns the position at which the controller holds the resting arm.
    /// The position may differ from the reported one by a few hundredths of a radian.
    /// A motion from this position starts without a jump.
    /// `None` means that the robot does not report the position.
    fn held_rad(&self) -> Option<Joints> {
        None
    }

    /// Returns pose and speed of the base, or `None` if unknown.
    fn base(&self) -> Option<Reading<BaseState>>;

    /// Returns the limits of speed, acceleration and jerk for the arm's motions.
    fn joint_limits(&self) -> &JointLimits;

    /// Returns the size and limits of the base.
    fn base_limits(&self) -> &BaseConfig;

    /// Sets the base's speed, and shows that the bridge is alive.
    fn drive(&mut self, twist: Twist);

    /// Checks whether the arm can follow a trajectory now.
    ///
    /// # Errors
    /// Returns the reason why the arm cannot follow a motion, with a remedy.
    fn can_follow(&self) -> Result<(), String>;

    /// Makes the arm follow a trajectory that starts at its position. The new trajectory replaces the current one.
    ///
    /// # Errors
    /// Returns the reason why the robot does not follow the trajectory. Nothing moves in this case.
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String>;

    /// Returns how long before its effect a change of a running trajectory must be sent;
    /// see [`Robot::follow_on`].
    ///
    /// # Errors
    /// Returns the reason why the trajectory cannot be changed, with a remedy.
    fn ahead_ms(&self) -> Result<u64, String> {
        Err("this robot cannot continue a motion otherwise while it runs".to_owned())
    }

    /// Changes the remainder of the running trajectory, from `from_s` of its own time on.
    /// `from_s` is at least [`Robot::ahead_ms`] from now. Until then, the new trajectory must equal the old one.
    /// The new trajectory ends at rest, so the arm also comes to rest if no further call follows.
    ///
    /// # Errors
    /// Returns the reason why the trajectory cannot be changed. The arm then continues as before.
    fn follow_on(&mut self, _trajectory: Arc<Trajectory>, _from_s: f64) -> Result<(), String> {
        self.ahead_ms().map(|_| ())
    }

    /// Returns the arm's progress on its trajectory.
    fn following(&self) -> Following;

    /// Returns the result of the last trajectory, once per trajectory.
    fn take_end(&mut self) -> Option<End>;

    /// Brings the arm to rest within its limits, and abandons its trajectory.
    fn halt_arm(&mut self);

    /// Brings base, arm and gripper to rest within their limits.
    fn halt(&mut self);

    /// Returns the distance between the fingers in m, or `None` if there is no gripper or no report.
    fn opening_m(&self) -> Option<Reading<f64>> {
        None
    }

    /// Checks whether the gripper can open or close now.
    ///
    /// # Errors
    /// Returns the reason why the gripper cannot be used, with a remedy.
    fn can_grip(&self) -> Result<(), String> {
        Err("this robot has no gripper".to_owned())
    }

    /// Moves the gripper to a width.
    ///
    /// # Errors
    /// Returns the reason why the gripper does not move. Nothing moves in this case.
    fn grip(&mut self, _grip: Grip) -> Result<(), String> {
        self.can_grip()
    }

    /// Returns the result of the last grip, once per grip.
    fn take_grip_end(&mut self) -> Option<GripEnd> {
        None
    }

    /// Stops the fingers at their current position. This function never opens the fingers.
    fn halt_gripper(&mut self) {}

    /// Returns the newest pose of the object on this topic. The age counts from the time of measurement.
    ///
    /// # Errors
    /// Returns the reason why the pose is unknown, with a remedy.
    fn sighting(&self, topic: &str) -> Result<Reading<Sighting>, String> {
        Err(format!("nobody reads {topic} here: only `--ros2` with a robot reads topics"))
    }

    /// Returns the longest time between a command and its effect.
    fn reaction_ms(&self) -> u64 {
        0
    }

    /// Returns the number of times the robot had to stop by itself, if this is known.
    fn timeouts(&self) -> u32 {
        0
    }

    /// Returns the reason why this robot must not be armed now, or `None`.
    fn refusal(&self) -> Option<String> {
        None
    }

    /// Returns the parts that have acted on their newest command since the last call, if the robot reports this.
    fn take_accepted(&mut self) -> Vec<Part> {
        Vec::new()
    }

    /// Returns messages for the user. Each message is returned once.
    fn take_notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Sends the decisions of this turn. Called at the end of each turn.
    fn send(&mut self) {}
}

impl<R: Robot + ?Sized> Robot for Box<R> {
    fn hear(&mut self, now_ms: u64) {
        (**self).hear(now_ms);
    }
    fn step(&mut self, now_ms: u64) {
        (**self).step(now_ms);
    }
    fn arm(&self) -> Option<Reading<Motion>> {
        (**self).arm()
    }
    fn held_rad(&self) -> Option<Joints> {
        (**self).held_rad()
    }
    fn base(&self) -> Option<Reading<BaseState>> {
        (**self).base()
    }
    fn joint_limits(&self) -> &JointLimits {
        (**self).joint_limits()
    }
    fn base_limits(&self) -> &BaseConfig {
        (**self).base_limits()
    }
    fn drive(&mut self, twist: Twist) {
        (**self).drive(twist);
    }
    fn can_follow(&self) -> Result<(), String> {
        (**self).can_follow()
    }
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        (**self).follow(trajectory)
    }
    fn ahead_ms(&self) -> Result<u64, String> {
        (**self).ahead_ms()
    }
    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        (**self).follow_on(trajectory, from_s)
    }
    fn following(&self) -> Following {
        (**self).following()
    }
    fn take_end(&mut self) -> Option<End> {
        (**self).take_end()
    }
    fn halt_arm(&mut self) {
        (**self).halt_arm();
    }
    fn halt(&mut self) {
        (**self).halt();
    }
    fn opening_m(&self) -> Option<Reading<f64>> {
        (**self).opening_m()
    }
    fn can_grip(&self) -> Result<(), String> {
        (**self).can_grip()
    }
    fn grip(&mut self, grip: Grip) -> Result<(), String> {
        (**self).grip(grip)
    }
    fn take_grip_end(&mut self) -> Option<GripEnd> {
        (**self).take_grip_end()
    }
    fn halt_gripper(&mut self) {
        (**self).halt_gripper();
    }
    fn sighting(&self, topic: &str) -> Result<Reading<Sighting>, String> {
        (**self).sighting(topic)
    }
    fn reaction_ms(&self) -> u64 {
        (**self).reaction_ms()
    }
    fn timeouts(&self) -> u32 {
        (**self).timeouts()
    }
    fn refusal(&self) -> Option<String> {
        (**self).refusal()
    }
    fn take_accepted(&mut self) -> Vec<Part> {
        (**self).take_accepted()
    }
    fn take_notes(&mut self) -> Vec<String> {
        (**self).take_notes()
    }
    fn send(&mut self) {
        (**self).send();
    }
}
