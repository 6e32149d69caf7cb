//! The simulated robot: a differential-drive base with an arm, in fixed steps.

use crate::arm::gen3::Joints;
use crate::arm::motions::READY;
use crate::arm::profile::JointLimits;
use crate::arm::sequencer::{ArmReport, ArmState, Busy};
use crate::arm::{ArmMotion, Sequencer};
use crate::base::{Base, BaseConfig, Odometry, Twist};
use crate::robot::Robot;

/// Length of one step.
pub const STEP_MS: u64 = 1;

/// Without a command for this long the robot stops by itself.
pub const COMMAND_TIMEOUT_MS: u64 = 500;

/// Figures of the simulated robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimConfig {
    /// Size and limits of the base.
    pub base: BaseConfig,
    /// Where the arm starts, in rad.
    pub arm_start_rad: Joints,
    /// Scaled limits of the arm.
    pub arm_limits: JointLimits,
}

impl Default for SimConfig {
    fn default() -> Self {
        SimConfig { base: BaseConfig::default(), arm_start_rad: READY, arm_limits: JointLimits::paper() }
    }
}

/// A robot in virtual time.
#[derive(Clone, Debug)]
pub struct Simulator {
    base: Base,
    arm: Sequencer,
    now_ms: u64,
    last_command_ms: u64,
    timeouts: u32,
    timed_out: bool,
}

impl Simulator {
    /// A robot at rest at time 0.
    pub fn new(config: SimConfig) -> Self {
        Simulator {
            base: Base::new(config.base),
            arm: Sequencer::new(config.arm_start_rad, config.arm_limits),
            now_ms: 0,
            last_command_ms: 0,
            timeouts: 0,
            timed_out: false,
        }
    }

    /// Lets time pass, in steps of [`STEP_MS`].
    pub fn step(&mut self, duration_ms: u64) {
        let dt_s = STEP_MS as f64 / 1000.0;
        for _ in 0..duration_ms / STEP_MS {
            self.now_ms += STEP_MS;
            if self.now_ms - self.last_command_ms > COMMAND_TIMEOUT_MS && !self.timed_out {
                self.timed_out = true;
                self.timeouts += u32::from(!self.at_rest());
                self.base.drive(Twist::ZERO);
                self.arm.halt();
            }
            self.base.step(dt_s);
            self.arm.step(dt_s);
        }
    }

    /// Neither a wheel nor a joint moves.
    pub fn at_rest(&self) -> bool {
        self.base.wheels_rad_s() == [0.0; 2] && self.arm.state().at_rest()
    }

    /// Speeds of the left and the right wheel in rad/s.
    pub fn wheels_rad_s(&self) -> [f64; 2] {
        self.base.wheels_rad_s()
    }

    /// How often the robot had to stop by itself.
    pub fn timeouts(&self) -> u32 {
        self.timeouts
    }

    fn heard(&mut self) {
        self.last_command_ms = self.now_ms;
        self.timed_out = false;
    }
}

impl Robot for Simulator {
    fn drive(&mut self, twist: Twist) {
        self.heard();
        self.base.drive(twist);
    }

    fn start_motion(&mut self, motion: ArmMotion) -> Result<(), Busy> {
        self.heard();
        self.arm.start(motion)
    }

    fn halt(&mut self) {
        self.heard();
        self.base.drive(Twist::ZERO);
        self.arm.halt();
    }

    fn arm(&self) -> ArmState {
        self.arm.state()
    }

    fn odometry(&self) -> Odometry {
        self.base.odometry()
    }

    fn take_arm_report(&mut self) -> Option<ArmReport> {
        self.arm.take_report()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_commands_base_and_arm_come_to_rest_by_themselves() {
        let mut robot = Simulator::new(SimConfig::default());
        robot.start_motion(ArmMotion::PickUp).unwrap();
        for _ in 0..100 {
            robot.drive(Twist { linear_m_s: 1.0, angular_rad_s: 0.0 });
            robot.step(20);
        }
        assert!(!robot.at_rest());
        // 0.5 s of silence, then 1 s to brake from 1 m/s at 1 m/s².
        robot.step(480);
        assert!((robot.odometry().twist.linear_m_s - 1.0).abs() < 1e-9);
        robot.step(1030);
        assert!(robot.at_rest());
        assert_eq!(robot.timeouts(), 1);
        assert!(!robot.take_arm_report().unwrap().reached);
        robot.step(10_000);
        assert!(robot.at_rest());
    }

    #[test]
    fn a_halted_motion_is_not_taken_up_again() {
        let mut robot = Simulator::new(SimConfig::default());
        robot.start_motion(ArmMotion::PickUp).unwrap();
        robot.drive(Twist::ZERO);
        robot.step(400);
        robot.halt();
        for _ in 0..100 {
            robot.drive(Twist::ZERO);
            robot.step(20);
        }
        let joints = robot.arm().joints_rad;
        robot.drive(Twist::ZERO);
        robot.step(400);
        assert_eq!(robot.arm().joints_rad, joints);
    }
}
