//! What every robot has, simulated or real.

use std::sync::Arc;

use serde::Serialize;

use crate::base::{BaseConfig, Covariance, Odometry, Twist};
use crate::gripper::{Grip, GripEnd};
use crate::limits::{JointLimits, Motion};
use crate::pose::Joints;
use crate::trajectory::Trajectory;

/// Something that a robot reports of itself, and how old it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading<T> {
    /// What it reports.
    pub value: T,
    /// Time since it was measured, or, if the robot does not say, since it arrived.
    pub age_ms: u64,
}

/// The base as it reports itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseState {
    /// Where it is, and how fast.
    pub odometry: Odometry,
    /// How sure that is.
    pub covariance: Covariance,
    /// Its wheels, if it reports them.
    pub wheels: Option<Wheels>,
}

/// The left and the right wheel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wheels {
    /// Speeds in rad/s.
    pub speed_rad_s: [f64; 2],
    /// Angles turned since the start in rad.
    pub angle_rad: [f64; 2],
}

/// What the arm does with the trajectory that it was given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Following {
    /// It has none.
    Idle,
    /// It follows the trajectory, and is this far along.
    Moving {
        /// Time since the trajectory's start, in s.
        elapsed_s: f64,
    },
    /// It has abandoned the trajectory and brakes.
    Halting,
}

/// What a command is for.
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

/// How following a trajectory ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The arm rests at the trajectory's end.
    Reached,
    /// It rests, or is believed to, somewhere else.
    Halted,
}

/// A base and an arm. What it reports is its own state, never what it was asked for.
///
/// **Stops by itself**: an implementation brings the base to rest when [`drive`](Robot::drive) ceases to be
/// called. No method blocks.
pub trait Robot {
    /// Lets the time become `now_ms`.
    fn step(&mut self, now_ms: u64);

    /// Joint angles, speeds and (if known) accelerations; `None` = unknown, or older than the robot accepts.
    fn arm(&self) -> Option<Reading<Motion>>;

    /// Where the arm's controller holds it while it rests, within a few hundredths of where it is: a motion from there
    /// begins without a jump. `None` = the robot does not tell.
    fn held_rad(&self) -> Option<Joints> {
        None
    }

    /// Pose and speed of the base; `None` = unknown.
    fn base(&self) -> Option<Reading<BaseState>>;

    /// Limits of speed, acceleration and jerk for the arm's motions.
    fn joint_limits(&self) -> &JointLimits;

    /// Size and limits of the base.
    fn base_limits(&self) -> &BaseConfig;

    /// Sets the base's speed. Also says that the bridge is alive.
    fn drive(&mut self, twist: Twist);

    /// Whether the arm could follow a trajectory now.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn can_follow(&self) -> Result<(), String>;

    /// Lets the arm follow a trajectory that starts where it is. One that is already followed is replaced.
    ///
    /// # Errors
    /// Why it does not follow or grip; nothing moves then.
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String>;

    /// How far ahead of now a trajectory under way can be continued otherwise; see [`Robot::follow_on`].
    ///
    /// # Errors
    /// Why it cannot, and what to do.
    fn ahead_ms(&self) -> Result<u64, String> {
        Err("this robot cannot continue a motion otherwise while it runs".to_owned())
    }

    /// Continues the trajectory that is followed otherwise: up to `from_s` of its own time, which is at least
    /// [`Robot::ahead_ms`] from now, the new one is the same. It ends at rest, so that whoever falls silent after this leaves
    /// an arm that comes to rest.
    ///
    /// # Errors
    /// Why not; the arm goes on as before.
    fn follow_on(&mut self, _trajectory: Arc<Trajectory>, _from_s: f64) -> Result<(), String> {
        self.ahead_ms().map(|_| ())
    }

    /// What the arm does with its trajectory.
    fn following(&self) -> Following;

    /// How the last trajectory ended; once per trajectory.
    fn take_end(&mut self) -> Option<End>;

    /// Brings the arm to rest within its limits; its trajectory is abandoned.
    fn halt_arm(&mut self);

    /// Brings base, arm and gripper to rest within their limits.
    fn halt(&mut self);

    /// How far the fingers are apart, in m; `None` = there is no gripper, or it does not say.
    fn opening_m(&self) -> Option<Reading<f64>> {
        None
    }

    /// Whether the gripper could open or close now.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn can_grip(&self) -> Result<(), String> {
        Err("this robot has no gripper".to_owned())
    }

    /// Lets the gripper go to a width.
    ///
    /// # Errors
    /// Why it does not follow or grip; nothing moves then.
    fn grip(&mut self, _grip: Grip) -> Result<(), String> {
        self.can_grip()
    }

    /// How the last grip ended; once per grip.
    fn take_grip_end(&mut self) -> Option<GripEnd> {
        None
    }

    /// Lets the fingers rest where they are. It never opens them.
    fn halt_gripper(&mut self) {}

    /// The longest time between a command and its effect.
    fn reaction_ms(&self) -> u64 {
        0
    }

    /// How often the robot had to stop by itself, as far as known.
    fn timeouts(&self) -> u32 {
        0
    }

    /// Why nothing may be armed on this robot now; `None` = it may.
    fn refusal(&self) -> Option<String> {
        None
    }

    /// Parts that have shown, since the last call, that they act on their newest command. A robot that does not tell says
    /// nothing.
    fn take_accepted(&mut self) -> Vec<Part> {
        Vec::new()
    }

    /// Messages for a person, each returned once.
    fn take_notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Hands over what was decided in this turn; called at the end of each.
    fn send(&mut self) {}
}

impl<R: Robot + ?Sized> Robot for Box<R> {
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
