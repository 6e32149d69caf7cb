//! The simulated robot: a differential-drive base with an arm, in fixed steps.

use std::sync::Arc;

use crate::arm::gen3::Joints;
use crate::arm::model::SerialArm;
use crate::arm::motions::READY;
use crate::arm::profile::JointLimits;
use crate::arm::sequencer::{ArmReport, ArmState, NotStarted};
use crate::arm::{ArmMotion, Sequencer};
use crate::base::{Base, BaseConfig, Covariance, Odometry, Twist};
use crate::plan::guard::{Guard, Moving, TICK_MS};
use crate::plan::{Placement, Planner};
use crate::robot::Robot;
use crate::scene::Scene;

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
    /// In a scene: plans the arm's motions, and holds back what would touch something.
    planner: Option<Arc<Planner>>,
    /// Where there is no scene: the Gen3 with nothing around.
    bare: Arc<(SerialArm, Scene)>,
    plans: u64,
    wanted: Twist,
    guard_due_ms: u64,
    guard_stops: u32,
}

impl Simulator {
    /// A robot at rest at time 0, in a scene: its arm takes planned ways, and neither base nor arm touches
    /// anything. The arm starts from the scene's pose `ready`, if it has one.
    pub fn in_scene(planner: Arc<Planner>) -> Self {
        let arm_start_rad = planner.goal("ready").unwrap_or(READY);
        let base = planner.world().scene().base.config();
        let config = SimConfig { base, arm_start_rad, arm_limits: *planner.limits() };
        Simulator { planner: Some(planner), ..Simulator::new(config) }
    }

    /// A robot at rest at time 0, with nothing around; its arm moves through home.
    pub fn new(config: SimConfig) -> Self {
        Simulator {
            base: Base::new(config.base),
            arm: Sequencer::new(config.arm_start_rad, config.arm_limits),
            now_ms: 0,
            last_command_ms: 0,
            timeouts: 0,
            timed_out: false,
            planner: None,
            bare: Arc::new((SerialArm::gen3(), Scene::default())),
            plans: 0,
            wanted: Twist::ZERO,
            guard_due_ms: 0,
            guard_stops: 0,
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
                self.halt_both();
            }
            self.guard();
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

    /// How far the left and the right wheel have turned since the start, in rad.
    pub fn wheels_rad(&self) -> [f64; 2] {
        self.base.wheels_rad()
    }

    /// How sure the odometry is.
    pub fn covariance(&self) -> Covariance {
        self.base.covariance()
    }

    /// Size and limits of the base.
    pub fn base_config(&self) -> &BaseConfig {
        self.base.config()
    }

    /// Which arm it has.
    pub fn arm_model(&self) -> &SerialArm {
        self.planner.as_ref().map_or(&self.bare.0, |planner| planner.world().arm())
    }

    /// Limits that the arm's motions keep.
    pub fn arm_limits(&self) -> &JointLimits {
        self.arm.limits()
    }

    /// What stands around it, and the shape of its base; of its base, only the body and the arm's foot count
    /// where no scene was given.
    pub fn scene(&self) -> &Scene {
        self.planner.as_ref().map_or(&self.bare.1, |planner| planner.world().scene())
    }

    /// How often the robot had to stop by itself.
    pub fn timeouts(&self) -> u32 {
        self.timeouts
    }

    /// How many ticks something had to brake for what was in its way.
    pub fn guard_stops(&self) -> u32 {
        self.guard_stops
    }

    fn halt_both(&mut self) {
        self.wanted = Twist::ZERO;
        self.base.drive(Twist::ZERO);
        self.arm.halt();
    }

    /// Lets base and arm go on for a tick if they can stop after it; else what must brake does so now.
    fn guard(&mut self) {
        let Some(planner) = &self.planner else { return };
        let still = self.wanted == Twist::ZERO && self.at_rest() && self.arm.state().running.is_none();
        if self.now_ms < self.guard_due_ms || still {
            return;
        }
        self.guard_due_ms = self.now_ms + TICK_MS;
        let guard = Guard { world: planner.world(), limits: planner.limits() };
        let now = moving(&self.base, &self.arm);
        let try_tick = |twist: Twist, halt_arm: bool| {
            let (mut base, mut arm) = (self.base.clone(), self.arm.clone());
            base.drive(twist);
            if halt_arm {
                arm.halt();
            }
            let dt_s = STEP_MS as f64 / 1000.0;
            let instants: Vec<Moving> = (0..TICK_MS / STEP_MS)
                .map(|_| {
                    base.step(dt_s);
                    arm.step(dt_s);
                    moving(&base, &arm)
                })
                .collect();
            guard.allows(&now, &instants)
        };
        let choices = [(self.wanted, false), (Twist::ZERO, false), (self.wanted, true)];
        let chosen = choices.into_iter().find(|&(twist, halt_arm)| try_tick(twist, halt_arm));
        self.guard_stops += u32::from(chosen != Some(choices[0]));
        let (twist, halt_arm) = chosen.unwrap_or((Twist::ZERO, true));
        self.base.drive(twist);
        if halt_arm {
            self.arm.halt();
        }
    }

    fn heard(&mut self) {
        self.last_command_ms = self.now_ms;
        self.timed_out = false;
    }
}

impl Robot for Simulator {
    fn drive(&mut self, twist: Twist) {
        self.heard();
        if self.planner.is_none() {
            self.base.drive(twist);
        } else if twist != self.wanted {
            self.wanted = twist;
            self.guard_due_ms = 0;
        }
    }

    fn start_motion(&mut self, motion: ArmMotion) -> Result<(), NotStarted> {
        self.heard();
        let state = self.arm.state();
        let (Some(planner), None) = (&self.planner, state.running) else {
            return Ok(self.arm.start(motion)?);
        };
        let placement = Placement::from(self.base.odometry());
        self.plans += 1;
        let goal_rad = planner.goal(motion.name()).unwrap_or_else(|| self.arm.goal(motion));
        let plan = planner.plan(&state.joints_rad, &goal_rad, placement, self.plans)?;
        self.guard_due_ms = 0;
        Ok(self.arm.start_planned(motion, plan)?)
    }

    fn halt(&mut self) {
        self.heard();
        self.halt_both();
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

fn moving(base: &Base, arm: &Sequencer) -> Moving {
    Moving::now(base, arm.motion())
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
