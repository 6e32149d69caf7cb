//! A door without a robot, and frames of a left board.

use host_robot::{Door, JOINTS, Joints, MotionName, NotStarted, Picture, Pose, Report, RobotSetting, Twist};
use shared_proto::frame::{BOARD_FRAME_MAX, encode_board};
use shared_proto::message::{Board, BoardMessage, Hello, PROTOCOL_MAJOR, PROTOCOL_MINOR, Text};

/// Accepts every command and stores the last speed, which is all that the bridge needs.
#[derive(Default)]
pub struct NoRobot {
    pub twist: Twist,
}

impl Door for NoRobot {
    fn step(&mut self, _now_ms: u64) {}
    fn drive(&mut self, twist: Twist) {
        self.twist = twist;
    }
    fn start_motion(&mut self, _motion: &MotionName) -> Result<(), NotStarted> {
        Ok(())
    }
    fn halt(&mut self) {
        self.twist = Twist::ZERO;
    }
    fn halt_arm(&mut self) {}
    fn take_reports(&mut self) -> Vec<Report> {
        Vec::new()
    }
    fn send(&mut self) {}
    fn knows(&self, _motion: &MotionName) -> bool {
        true
    }
    fn picture(&self) -> Picture {
        unreachable!("the bridge decides without looking")
    }
    fn setting(&self) -> RobotSetting {
        unreachable!("the bridge decides without looking")
    }
    fn mount_m(&self) -> host_robot::DVec3 {
        unreachable!("the bridge decides without looking")
    }
    fn link_poses(&self, _joints_rad: &Joints) -> [Pose; JOINTS + 1] {
        unreachable!("the bridge decides without looking")
    }
}

pub fn encode(message: &BoardMessage<'_>) -> Vec<u8> {
    encode_board(message, &mut [0; BOARD_FRAME_MAX]).unwrap().to_vec()
}

pub fn hello(boot_id: u32) -> Vec<u8> {
    encode(&BoardMessage::Hello(Hello {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        board: Board::LeftNano,
        firmware: Text("test"),
        boot_id,
        model_id: 0,
        sample_hz: 100,
    }))
}
