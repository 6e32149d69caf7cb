//! DDS as the node's middleware.

use super::action::active;
use super::advice::{Graph, Probe};
use super::answer::Answer;
use super::config::Ros2Config;
use super::grip::{Gripper, NO_GRIPPER};
use super::gripper::GripAnswer;
use super::joined::{Arm, Joined, Published, SimTopics, Speed, name_of};
use super::transport::{ArmWay, Came, NodeError, Sent, Transport, Voice};
use host_topics::message as ros;

impl Transport for Joined {
    fn graph(&mut self) -> Graph {
        self.look_around()
    }

    fn is_alive(&self) -> bool {
        self.watch.is_alive()
    }

    fn take(&mut self, came: &mut dyn FnMut(Came)) {
        // Data that cannot be read is dropped.
        while let Ok(Some((clock, _))) = self.clock.take() {
            came(Came::Clock(clock));
        }
        let own = self.own_name();
        for (input, readers) in self.flags.iter().enumerate() {
            for reader in readers {
                while let Ok(Some((flag, info))) = reader.take() {
                    let writer = name_of(info.publisher_gid().as_bytes());
                    if writer != own {
                        came(Came::Flag { input, writer, stop: flag.data });
                    }
                }
            }
        }
        for (n, things) in self.things.iter().enumerate() {
            while let Ok(Some((pose, info))) = things.take() {
                came(Came::Thing(n, Box::new(pose), name_of(info.publisher_gid().as_bytes())));
            }
        }
        while let Some(Ok(Some((list, _)))) = self.goals.as_ref().map(|goals| goals.take()) {
            came(Came::ForeignGoals(active(&list).count()));
        }
        while let Some(Ok(Some((state, info)))) = self.joint_states.as_ref().map(|states| states.take()) {
            came(Came::Arm(state, name_of(info.publisher_gid().as_bytes())));
        }
        while let Some(Ok(Some((odom, _)))) = self.odom.as_ref().map(|odom| odom.take()) {
            came(Came::Base(Box::new(odom)));
        }
        while let Some(Ok(Some((state, _)))) = self.controller_state.as_ref().map(|states| states.take()) {
            came(Came::Controller(Box::new(state)));
        }
    }

    fn is_stamped(&self) -> bool {
        matches!(self.speed, Speed::Stamped(_))
    }

    fn set_stamped(&mut self, config: &Ros2Config, stamped: bool) -> Result<(), NodeError> {
        self.restamp(config, stamped)
    }

    fn send_speed(&mut self, speed: ros::TwistStamped) -> Sent {
        match &self.speed {
            Speed::Plain(publisher) => Sent::at_once(publisher.publish(speed.twist).is_ok()),
            Speed::Stamped(publisher) => Sent::at_once(publisher.publish(speed).is_ok()),
        }
    }

    fn arm_way(&self) -> ArmWay {
        match &self.arm {
            Arm::None => ArmWay::None,
            Arm::Topic(_) => ArmWay::Topic,
            Arm::Action(_) => ArmWay::Action,
        }
    }

    fn send_trajectory(&mut self, trajectory: ros::JointTrajectory) -> Sent {
        match &self.arm {
            Arm::Topic(publisher) => Sent::at_once(publisher.publish(trajectory).is_ok()),
            _ => Sent::No,
        }
    }

    fn look_for_server(&mut self, graph: &Graph) -> Result<bool, NodeError> {
        match &mut self.arm {
            Arm::Action(follow) => follow.look(&mut self.node, graph),
            _ => Ok(false),
        }
    }

    fn send_goal(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool {
        match &mut self.arm {
            Arm::Action(follow) => follow.send(ours, trajectory),
            _ => false,
        }
    }

    fn cancel(&mut self, ours: u32) -> Sent {
        Sent::at_once(matches!(&self.arm, Arm::Action(follow) if follow.cancel(ours)))
    }

    fn ask(&mut self) {
        if let Arm::Action(follow) = &mut self.arm {
            follow.ask();
        }
    }

    fn probe(&self) -> Probe {
        match &self.arm {
            Arm::Action(follow) => follow.probe(),
            _ => Probe::NotSent,
        }
    }

    fn foreign(&self) -> usize {
        match &self.arm {
            Arm::Action(follow) => follow.foreign(),
            _ => 0,
        }
    }

    fn answers(&mut self) -> Vec<(u32, Answer)> {
        match &mut self.arm {
            Arm::Action(follow) => follow.answers(),
            _ => Vec::new(),
        }
    }

    fn look_for_gripper(&mut self, graph: &Graph) -> Option<String> {
        match &mut self.gripper {
            None => Some(NO_GRIPPER.to_owned()),
            Some(gripper) => {
                gripper.look(&mut self.node, graph).unwrap_or_else(|error| Some(error.to_string()))
            }
        }
    }

    fn about_gripper(&self) -> Option<String> {
        self.gripper.as_ref().and_then(Gripper::about)
    }

    fn send_grip(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool {
        self.gripper.as_mut().is_some_and(|gripper| gripper.send(ours, position, effort))
    }

    fn cancel_grip(&mut self, ours: u32) -> Sent {
        Sent::at_once(self.gripper.as_ref().is_some_and(|gripper| gripper.cancel(ours)))
    }

    fn grip_answers(&mut self) -> Vec<(u32, GripAnswer)> {
        self.gripper.as_mut().map(Gripper::answers).unwrap_or_default()
    }
}

impl Voice for Published {
    fn diagnose(&mut self, message: ros::DiagnosticArray) {
        // A message that cannot be sent is replaced by the next one.
        let _ = self.diagnostics.publish(message);
    }

    fn say_stopped(&mut self, stopped: bool) -> bool {
        self.stopped.publish(ros::Bool { data: stopped }).is_ok()
    }

    fn has_simulator(&self) -> bool {
        self.sim.is_some()
    }

    fn end_simulator(&mut self) {
        self.sim = None;
    }

    fn describe(&mut self, urdf: &str) {
        let Some(SimTopics { description: Some(publisher), is_described, .. }) = &mut self.sim else {
            return;
        };
        if !*is_described {
            *is_described = publisher.publish(ros::Text { data: urdf.to_owned() }).is_ok();
        }
    }

    fn simulate(&mut self, joints: ros::JointState, odometry: ros::Odometry, frames: ros::TfMessage) {
        let Some(topics) = &self.sim else { return };
        let _ = topics.joint_states.publish(joints);
        let _ = topics.odom.publish(odometry);
        let _ = topics.tf.publish(frames);
    }
}
