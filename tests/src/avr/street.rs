//! The complete chain in steps of 1 ms: voltages → emulated board → serial bytes → bridge → simulated base.

use host_bridge::arm::Director;
use host_bridge::bridge::Bridge;
use host_bridge::config::Config;
use host_bridge::intent::MotionMap;
use host_bridge::robot::Door as _;
use host_bridge::robots::Stage;
use host_bridge::safety::Hand;
use host_bridge::sim::Simulator;
use shared_proto::frame::{HOST_FRAME_MAX, encode_host};
use shared_proto::message::HostMessage;

use super::nano::{CYCLES_PER_MS, Nano};

/// The board, connected to bridge and robot.
pub struct Street {
    /// The emulated board.
    pub nano: Nano,
    /// The laptop's bridge.
    pub bridge: Bridge,
    /// The simulated robot.
    pub robot: Director<Simulator>,
    now_ms: u64,
}

impl Street {
    /// Creates a running board with a bridge that has not received anything yet.
    pub fn new(nano: Nano) -> Self {
        let now_ms = nano.cycle().div_ceil(CYCLES_PER_MS);
        Self {
            nano,
            bridge: Bridge::new(MotionMap::default()),
            robot: Stage::bare().simulated(&Config::default()),
            now_ms,
        }
    }

    /// Virtual time since the board's power-on, in ms.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// Advances by one millisecond: the board runs, the bridge reads new bytes, and the robot moves.
    pub fn step(&mut self) {
        self.now_ms += 1;
        let end = self.now_ms * CYCLES_PER_MS;
        self.nano.run_until(end);
        let bytes = self.nano.sent_until(end);
        self.bridge.receive(Hand::Left, &bytes, self.now_ms, &mut self.robot);
        self.bridge.step(self.now_ms, &mut self.robot);
        while let Some(message) = self.bridge.poll(Hand::Left, self.now_ms) {
            self.send(&message);
        }
        if let Some(ping) = self.bridge.ping(Hand::Left, self.now_ms) {
            self.send(&ping);
        }
        self.robot.step(self.robot.now_ms() + 1);
    }

    fn send(&mut self, message: &HostMessage<'_>) {
        let mut buffer = [0; HOST_FRAME_MAX];
        let frame = encode_host(message, &mut buffer).expect("the bridge's messages fit");
        self.nano.send(frame);
    }

    /// Runs for some time.
    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Returns whether any wheel turns.
    pub fn moves(&self) -> bool {
        self.robot.robot().wheels_rad_s() != [0.0; 2]
    }
}
