//! Implements [`Robot`] for the robot on the graph.
//! It combines the decisions about messages with the node that sends the messages.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use host_robot::{
    BaseConfig, BaseState, End, Following, Grip, GripEnd, JointLimits, Joints, Motion, Part, Reading, Robot,
    Sighting, Trajectory, Twist,
};

use crate::node::RosNode;
use crate::robot::{Counts, RosRobot};

/// See the module.
pub struct RosDriver {
    node: RosNode,
    robot: RosRobot,
    now_ms: u64,
    notes: Vec<String>,
    /// The reason why nothing may be armed.
    refusal: Option<String>,
    counts: Arc<Mutex<Counts>>,
}

impl RosDriver {
    /// Drives this robot through this node.
    pub fn new(node: RosNode, robot: RosRobot) -> Self {
        RosDriver { node, robot, now_ms: 0, notes: Vec::new(), refusal: None, counts: Arc::default() }
    }

    /// Returns counters of sent and received messages, for later use.
    pub fn counts(&self) -> Arc<Mutex<Counts>> {
        Arc::clone(&self.counts)
    }

    /// A refusal of the entire robot applies to each of its parts.
    fn may_move(&self) -> Result<(), String> {
        self.refusal.clone().map_or(Ok(()), Err)
    }
}

/// Seconds since 1970.
fn wall_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

impl Robot for RosDriver {
    fn hear(&mut self, now_ms: u64) {
        self.now_ms = now_ms;
        self.notes.extend(self.node.receive(&mut self.robot, wall_s(), now_ms));
        self.refusal = self.node.refusal(now_ms);
    }

    fn step(&mut self, now_ms: u64) {
        self.robot.step(now_ms);
    }

    fn arm(&self) -> Option<Reading<Motion>> {
        self.robot.arm()
    }

    fn held_rad(&self) -> Option<Joints> {
        self.robot.held_rad()
    }

    fn base(&self) -> Option<Reading<BaseState>> {
        self.robot.base()
    }

    fn joint_limits(&self) -> &JointLimits {
        self.robot.joint_limits()
    }

    fn base_limits(&self) -> &BaseConfig {
        self.robot.base_limits()
    }

    fn drive(&mut self, twist: Twist) {
        // `refusal` also reports this, to prevent arming.
        self.robot.drive(if self.refusal.is_none() { twist } else { Twist::ZERO });
    }

    fn can_follow(&self) -> Result<(), String> {
        self.may_move()?;
        self.robot.can_follow()
    }

    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.may_move()?;
        self.robot.follow(trajectory)
    }

    fn ahead_ms(&self) -> Result<u64, String> {
        self.robot.ahead_ms()
    }

    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        self.may_move()?;
        self.robot.follow_on(trajectory, from_s)
    }

    fn following(&self) -> Following {
        self.robot.following()
    }

    fn take_end(&mut self) -> Option<End> {
        self.robot.take_end()
    }

    fn halt_arm(&mut self) {
        self.robot.halt_arm();
    }

    fn halt(&mut self) {
        self.robot.halt();
    }

    fn opening_m(&self) -> Option<Reading<f64>> {
        self.robot.opening_m()
    }

    fn can_grip(&self) -> Result<(), String> {
        self.may_move()?;
        self.robot.can_grip()
    }

    fn grip(&mut self, grip: Grip) -> Result<(), String> {
        self.may_move()?;
        self.robot.grip(grip)
    }

    fn take_grip_end(&mut self) -> Option<GripEnd> {
        self.robot.take_grip_end()
    }

    fn halt_gripper(&mut self) {
        self.robot.halt_gripper();
    }

    fn sighting(&self, topic: &str) -> Result<Reading<Sighting>, String> {
        self.robot.sighting(topic)
    }

    fn reaction_ms(&self) -> u64 {
        self.robot.reaction_ms()
    }

    fn refusal(&self) -> Option<String> {
        self.refusal.clone()
    }

    fn take_accepted(&mut self) -> Vec<Part> {
        self.robot.take_accepted()
    }

    fn take_notes(&mut self) -> Vec<String> {
        let mut notes = std::mem::take(&mut self.notes);
        notes.extend(self.robot.take_notes());
        notes
    }

    fn send(&mut self) {
        self.node.send(&mut self.robot, wall_s(), self.now_ms);
        *self.counts.lock().unwrap_or_else(PoisonError::into_inner) = self.node.counts();
    }
}
