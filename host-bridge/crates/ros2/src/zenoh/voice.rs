//! The data other than commands that the program publishes on Zenoh.

use host_topics::cdr::encode;
use host_topics::message as ros;

use super::outbox::Outbox;
use super::waiting::{Order, Place};
use crate::transport::{Sent, Voice};

/// The description is published again after this many states of the simulator, for late subscribers.
const DESCRIBED_EVERY: u32 = 50;

/// See the module.
pub struct ZenohVoice {
    /// Where it goes.
    pub outbox: Outbox,
    /// Whether the simulator's state is published.
    pub has_simulator: bool,
    /// Whether the robot's description is published with the simulator's state; the configuration may have no topic
    /// for it.
    pub has_description: bool,
    /// States told.
    pub states: u32,
}

impl Voice for ZenohVoice {
    fn diagnose(&mut self, message: ros::DiagnosticArray) {
        self.outbox.put(Place::Diagnostics, encode(&message));
    }

    fn say_stopped(&mut self, stopped: bool) -> bool {
        self.outbox.put(Place::Stopped, encode(&ros::Bool { data: stopped })) != Sent::No
    }

    fn has_simulator(&self) -> bool {
        self.has_simulator
    }

    fn end_simulator(&mut self) {
        self.has_simulator = false;
        for place in [Place::JointStates, Place::Odometry, Place::Frames, Place::Description] {
            self.outbox.order(Order::Unwrite(place));
        }
    }

    fn describe(&mut self, urdf: &str) {
        if self.has_description && self.states.is_multiple_of(DESCRIBED_EVERY) {
            self.outbox.put(Place::Description, encode(&ros::Text { data: urdf.to_owned() }));
        }
    }

    fn simulate(&mut self, joints: ros::JointState, odometry: ros::Odometry, frames: ros::TfMessage) {
        self.states = self.states.wrapping_add(1);
        self.outbox.put(Place::JointStates, encode(&joints));
        self.outbox.put(Place::Odometry, encode(&odometry));
        self.outbox.put(Place::Frames, encode(&frames));
    }
}
