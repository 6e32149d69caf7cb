//! The robot on the graph as a [`Robot`]: what to send, and the node that sends it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use host_robot::{
    BaseConfig, BaseState, End, Following, JointLimits, Motion, Reading, Robot, Trajectory, Twist,
};
use host_topics::message::Time;

use crate::node::RosNode;
use crate::robot::{Counts, RosRobot};

/// See the module.
pub struct RosDriver {
    node: RosNode,
    robot: RosRobot,
    notes: Vec<String>,
    counts: Arc<Mutex<Counts>>,
}

impl RosDriver {
    /// Drives this robot through this node.
    pub fn new(node: RosNode, robot: RosRobot) -> Self {
        RosDriver { node, robot, notes: Vec::new(), counts: Arc::default() }
    }

    /// What was sent and heard, for whoever wants to look later.
    pub fn counts(&self) -> Arc<Mutex<Counts>> {
        Arc::clone(&self.counts)
    }
}

impl Robot for RosDriver {
    fn step(&mut self, now_ms: u64) {
        self.notes.extend(self.node.receive(&mut self.robot, now_ms));
        self.robot.step(now_ms);
    }

    fn arm(&self) -> Option<Reading<Motion>> {
        self.robot.arm()
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
        self.robot.drive(twist);
    }

    fn can_follow(&self) -> Result<(), String> {
        self.robot.can_follow()
    }

    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.robot.follow(trajectory)
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

    fn reaction_ms(&self) -> u64 {
        self.robot.reaction_ms()
    }

    fn take_notes(&mut self) -> Vec<String> {
        let mut notes = std::mem::take(&mut self.notes);
        notes.extend(self.robot.take_notes());
        notes
    }

    fn send(&mut self) {
        self.node.send(&mut self.robot, Time::at(SystemTime::now()));
        *self.counts.lock().unwrap_or_else(PoisonError::into_inner) = self.node.counts();
    }
}
