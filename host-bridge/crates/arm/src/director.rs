//! The arm director: the one place between the bridge and any robot.
//!
//! It turns names into goals, plans from where the robot says that it is, watches base and arm while they move, and says
//! how motions ended. The simulator and a robot on ROS 2 get the same plans, the same guard and the same refusals.
//!
//! Without a scene the arm moves through home, straight in joint space, as in the paper. With one, its motions are
//! planned around the scene's boxes, and the [guard](crate::plan::guard) vetoes what could not be stopped in time.

use std::collections::HashMap;
use std::sync::Arc;

use host_robot::{
    ArmState, Base, BaseState, Busy, Door, End, Following, JOINTS, JointLimits, JointSetting, Joints, Leg,
    Motion, MotionName, NotStarted, Picture, Pose, Reading, Report, Robot, RobotSetting, SceneBox,
    Trajectory, Twist, Wheels,
};

use host_robot::shape::Point;

use crate::model::SerialArm;
use crate::motions::{MotionError, Motions, Step};
use crate::plan::guard::{Guard, Moving, TICK_MS};
use crate::plan::{Placement, Planner};
use crate::scene::Scene;

/// How much of a long pause is looked at tick by tick, in ms.
const CATCH_UP_MS: u64 = 10_000;

/// A joint faster than this is not at rest: encoders are noisy.
const REST_RAD_S: f64 = 0.02;
/// With a scene the base does not drive on a pose older than this.
const BASE_AGE_MAX_MS: u64 = 250;

#[derive(Clone, Debug)]
struct Running {
    motion: MotionName,
    trajectory: Arc<Trajectory>,
    /// When it rests at home before it moves on; 0 = it does not.
    home_s: f64,
}

/// The arm and what stands around it, when nothing is planned for.
#[derive(Debug)]
struct Bare {
    arm: SerialArm,
    scene: Scene,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Director<R> {
    robot: R,
    motions: Motions,
    bare: Arc<Bare>,
    planner: Option<Arc<Planner>>,
    now_ms: u64,
    running: Option<Running>,
    /// How often each motion that draws has run.
    draws: HashMap<MotionName, usize>,
    plans: u64,
    wanted: Twist,
    allowed: Twist,
    guard_due_ms: u64,
    held: Option<String>,
    guard_stops: u32,
    reports: Vec<Report>,
}

impl<R: Robot> Director<R> {
    /// A robot with nothing around it: its arm moves through home.
    pub fn new(robot: R, motions: Motions) -> Self {
        Director::with(robot, motions, SerialArm::gen3(), None)
    }

    /// A robot in a scene: neither base nor arm touches anything.
    pub fn in_scene(robot: R, motions: Motions, planner: Arc<Planner>) -> Self {
        let arm = planner.world().arm().clone();
        Director::with(robot, motions, arm, Some(planner))
    }

    fn with(robot: R, motions: Motions, arm: SerialArm, planner: Option<Arc<Planner>>) -> Self {
        Director {
            robot,
            motions,
            bare: Arc::new(Bare { arm, scene: Scene::default() }),
            planner,
            now_ms: 0,
            running: None,
            draws: HashMap::new(),
            plans: 0,
            wanted: Twist::ZERO,
            allowed: Twist::ZERO,
            guard_due_ms: 0,
            held: None,
            guard_stops: 0,
            reports: Vec::new(),
        }
    }

    /// The robot.
    pub fn robot(&self) -> &R {
        &self.robot
    }

    /// The robot, to hand it what came from elsewhere.
    pub fn robot_mut(&mut self) -> &mut R {
        &mut self.robot
    }

    /// The time that it was last stepped to.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// What the arm can be asked to do.
    pub fn motions(&self) -> &Motions {
        &self.motions
    }

    /// Limits that the arm's motions keep.
    pub fn joint_limits(&self) -> &JointLimits {
        self.planner.as_ref().map_or(self.robot.joint_limits(), |planner| planner.limits())
    }

    fn scene(&self) -> &Scene {
        self.planner.as_ref().map_or(&self.bare.scene, |planner| planner.world().scene())
    }

    fn running_state(&self) -> Option<(MotionName, Leg)> {
        let running = self.running.as_ref()?;
        let leg = match self.robot.following() {
            Following::Halting => Leg::Halting,
            Following::Moving { elapsed_s } if elapsed_s < running.home_s => Leg::ToHome,
            Following::Moving { .. } | Following::Idle => Leg::ToGoal,
        };
        Some((running.motion.clone(), leg))
    }

    fn plan(&mut self, motion: &MotionName) -> Result<Running, String> {
        let steps = self.motions.get(motion.as_str()).map_err(|error: MotionError| error.to_string())?.steps;
        self.robot.can_follow()?;
        let here = self.robot.arm().ok_or("the arm's angles are not known")?.value;
        let arm = &self.bare.arm;
        if let Some(i) = here.velocity_rad_s.iter().position(|v| v.abs() > REST_RAD_S) {
            return Err(format!("the arm moves already ({})", arm.joints[i].name));
        }
        let draw = self.draws.get(motion).copied().unwrap_or_default();
        let mut from_rad = self.robot.held_rad().unwrap_or(here.joints_rad);
        let mut planned: Option<(Trajectory, f64)> = None;
        for step in &steps {
            let goal_rad = match step {
                Step::To(goal_rad) => *goal_rad,
                Step::ToNextOf(goals_rad) => goals_rad[draw % goals_rad.len()],
            };
            let goal_rad = arm.unwound(&goal_rad, &from_rad);
            let (leg, home_s) = match &self.planner {
                None => {
                    arm.check(&from_rad).map_err(|error| {
                        format!("the arm cannot start: {error}; bring it back within its limits")
                    })?;
                    let home_rad = arm.unwound(&arm.home_rad, &from_rad);
                    let goal_rad = arm.unwound(&goal_rad, &home_rad);
                    let limits = self.robot.joint_limits();
                    let home = Trajectory::through(&[from_rad, home_rad], &[], limits);
                    let onward = Trajectory::through(&[home_rad, goal_rad], &[], limits);
                    let home_s = home.duration_s();
                    (home.then(&onward), home_s)
                }
                Some(planner) => {
                    let base =
                        self.known_base().map_err(|why| format!("the arm cannot be planned for: {why}"))?;
                    self.plans += 1;
                    let placement = Placement::from(base.odometry);
                    let plan = planner
                        .plan(&from_rad, &goal_rad, placement, self.plans)
                        .map_err(|refusal| refusal.to_string())?;
                    (plan.trajectory, plan.home_s.unwrap_or(0.0))
                }
            };
            from_rad = leg.goal_rad();
            planned = Some(match planned {
                None => (leg, home_s),
                Some((before, home_s)) => (before.then(&leg), home_s),
            });
        }
        let (trajectory, home_s) = planned.ok_or("the motion has no step")?;
        Ok(Running { motion: motion.clone(), trajectory: Arc::new(trajectory), home_s })
    }

    /// The base, fresh enough to be guarded by.
    fn known_base(&self) -> Result<BaseState, String> {
        match self.robot.base() {
            Some(Reading { value, age_ms }) if age_ms <= BASE_AGE_MAX_MS => Ok(value),
            Some(Reading { age_ms, .. }) => Err(format!("the base's pose is {age_ms} ms old")),
            None => Err("the base's pose is not known; does the robot report its odometry?".to_owned()),
        }
    }

    /// How the arm will move from now on, a millisecond after the other.
    fn arm_ahead(&self, steps: u64, halt: bool) -> Option<(Motion, Vec<Motion>)> {
        let reported = self.robot.arm()?.value;
        let ahead = |trajectory: &Trajectory, from_s: f64| -> Vec<Motion> {
            (1..=steps).map(|k| trajectory.motion(from_s + k as f64 / 1000.0)).collect()
        };
        Some(match (self.robot.following(), &self.running) {
            (Following::Moving { elapsed_s }, Some(running)) => {
                let now = running.trajectory.motion(elapsed_s);
                if halt {
                    (now, ahead(&Trajectory::braking(now, self.joint_limits()), 0.0))
                } else {
                    (now, ahead(&running.trajectory, elapsed_s))
                }
            }
            _ => (reported, ahead(&Trajectory::braking(reported, self.joint_limits()), 0.0)),
        })
    }

    /// Lets base and arm go on for a tick if they can stop after it; else what must brake does so now.
    fn guard(&mut self) {
        let Some(planner) = self.planner.clone() else { return };
        if self.now_ms < self.guard_due_ms {
            return;
        }
        let still = self.wanted == Twist::ZERO && self.allowed == Twist::ZERO && self.running.is_none();
        let base = match self.known_base() {
            Ok(base) => base,
            Err(why) => {
                if !still {
                    self.hold(Twist::ZERO, self.running.is_some(), why);
                }
                return;
            }
        };
        if still && base.odometry.twist == Twist::ZERO {
            self.set_held(None);
            return;
        }
        self.guard_due_ms = self.now_ms + TICK_MS;
        let steps =
            TICK_MS + self.robot.reaction_ms() + self.robot.base().map_or(0, |reading| reading.age_ms);
        let guard = Guard { world: planner.world(), limits: planner.limits() };
        let try_tick = |twist: Twist, halt_arm: bool| {
            let Some((arm_now, arm_ahead)) = self.arm_ahead(steps, halt_arm) else { return false };
            let mut model = Base::at(*self.robot.base_limits(), &base);
            let now = Moving::now(&model, arm_now);
            model.drive(twist);
            let instants: Vec<Moving> = arm_ahead
                .into_iter()
                .map(|arm| {
                    model.step(0.001);
                    Moving::now(&model, arm)
                })
                .collect();
            guard.allows(&now, &instants)
        };
        let choices = [(self.wanted, false), (Twist::ZERO, false), (self.wanted, true)];
        let chosen = choices.into_iter().find(|&(twist, halt_arm)| try_tick(twist, halt_arm));
        if chosen == Some(choices[0]) {
            self.allowed = self.wanted;
            self.robot.drive(self.wanted);
            self.set_held(None);
            return;
        }
        let (twist, halt_arm) = chosen.unwrap_or((Twist::ZERO, true));
        let reason = match self.robot.arm() {
            None => "the arm's angles are not known".to_owned(),
            Some(arm) => guard.nearest(&base.odometry, &arm.value),
        };
        self.hold(twist, halt_arm, reason);
    }

    fn hold(&mut self, twist: Twist, halt_arm: bool, reason: String) {
        self.guard_stops += 1;
        self.allowed = twist;
        self.robot.drive(twist);
        if halt_arm {
            self.robot.halt_arm();
        }
        self.set_held((twist != self.wanted).then_some(reason));
    }

    fn set_held(&mut self, held: Option<String>) {
        match (&self.held, &held) {
            (None, Some(reason)) => self.reports.push(Report::BaseHeld { reason: reason.clone() }),
            (Some(_), None) => self.reports.push(Report::BaseFree),
            _ => {}
        }
        self.held = held;
    }
}

impl<R: Robot> Door for Director<R> {
    fn step(&mut self, now_ms: u64) {
        // In a scene the guard looks again after each tick, however long this program was away.
        // After a pause in which every robot has come to rest by itself, the rest of it is one step.
        let looks_until_ms = self.now_ms.saturating_add(CATCH_UP_MS);
        while self.now_ms < now_ms {
            let looks = self.planner.is_some() && self.now_ms < looks_until_ms;
            let tick_ms = if looks { TICK_MS } else { u64::MAX };
            self.guard();
            let due_ms = if self.guard_due_ms > self.now_ms { self.guard_due_ms } else { u64::MAX };
            self.now_ms = now_ms.min(self.now_ms.saturating_add(tick_ms)).min(due_ms);
            self.robot.step(self.now_ms);
        }
        if let Some(end) = self.robot.take_end()
            && let Some(running) = self.running.take()
        {
            self.reports.push(Report::MotionEnded { motion: running.motion, reached: end == End::Reached });
        }
        self.reports.extend(self.robot.take_accepted().into_iter().map(Report::Accepted));
        self.reports.extend(self.robot.take_notes().into_iter().map(Report::Note));
    }

    fn drive(&mut self, twist: Twist) {
        if self.planner.is_none() {
            self.allowed = twist;
        } else if twist != self.wanted {
            self.guard_due_ms = 0;
        }
        self.wanted = twist;
        // Also where nothing changed: it says that the bridge is alive.
        if self.guard_due_ms == 0 {
            self.guard();
        }
        self.robot.drive(self.allowed);
    }

    fn start_motion(&mut self, motion: &MotionName) -> Result<(), NotStarted> {
        if let Some(running) = &self.running {
            return Err(Busy(running.motion.clone()).into());
        }
        let running = self.plan(motion).map_err(NotStarted::Refused)?;
        self.robot.follow(Arc::clone(&running.trajectory)).map_err(NotStarted::Refused)?;
        *self.draws.entry(motion.clone()).or_default() += 1;
        self.running = Some(running);
        self.guard_due_ms = 0;
        Ok(())
    }

    fn halt(&mut self) {
        (self.wanted, self.allowed) = (Twist::ZERO, Twist::ZERO);
        self.robot.halt();
        self.set_held(None);
    }

    fn halt_arm(&mut self) {
        self.robot.halt_arm();
    }

    fn refusal(&self) -> Option<String> {
        self.robot.refusal()
    }

    fn take_reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    fn send(&mut self) {
        self.robot.send();
    }

    fn knows(&self, motion: &MotionName) -> bool {
        self.motions.get(motion.as_str()).is_ok()
    }

    fn picture(&self) -> Picture {
        let unknown = [f64::NAN; JOINTS];
        let (arm, base) = (self.robot.arm(), self.robot.base());
        let motion = arm.map(|reading| reading.value);
        let joints_rad = motion.map_or(unknown, |motion| motion.joints_rad);
        let state = base.map(|reading| reading.value).unwrap_or_default();
        let wheels = state.wheels.unwrap_or_else(|| Wheels {
            speed_rad_s: self.robot.base_limits().wheels_rad_s(state.odometry.twist),
            ..Wheels::default()
        });
        let reference_rad = match (self.robot.following(), &self.running) {
            (Following::Moving { elapsed_s }, Some(running)) => {
                Some(running.trajectory.motion(elapsed_s).joints_rad)
            }
            _ => None,
        };
        Picture {
            arm: ArmState {
                joints_rad,
                velocity_rad_s: motion.map_or(unknown, |motion| motion.velocity_rad_s),
                running: self.running_state(),
            },
            arm_age_ms: arm.map(|reading| reading.age_ms),
            odometry: state.odometry,
            base_age_ms: base.map(|reading| reading.age_ms),
            covariance: state.covariance,
            wheels_rad_s: wheels.speed_rad_s,
            wheels_rad: wheels.angle_rad,
            flange: self.bare.arm.flange_pose(&joints_rad),
            reference_rad,
            held: self.held.clone(),
            guard_stops: self.guard_stops,
            timeouts: self.robot.timeouts(),
        }
    }

    fn setting(&self) -> RobotSetting {
        let (arm, scene, limits) = (&self.bare.arm, self.scene(), self.joint_limits());
        let joints = arm.joints.iter().enumerate().map(|(i, joint)| JointSetting {
            name: joint.name.clone(),
            link: joint.link.clone(),
            origin_m: joint.origin_m,
            origin_rotation: joint.origin_rotation,
            axis: joint.axis,
            limit_rad: joint.limit_rad,
            velocity_max_rad_s: limits.velocity_rad_s[i],
            acceleration_max_rad_s2: limits.acceleration_rad_s2[i],
            shapes: joint.shapes.clone(),
        });
        RobotSetting {
            scene: scene.title.clone(),
            boxes: scene.boxes.iter().map(|b| SceneBox { name: b.name.clone(), shape: b.shape() }).collect(),
            base: *self.robot.base_limits(),
            body: scene.base.body(),
            mount_m: scene.base.mount_m,
            arm_name: arm.name.clone(),
            arm_root: arm.root_link.clone(),
            joints: joints.collect(),
            flange_m: arm.flange_m,
            flange_rotation: arm.flange_rotation,
            flange_link: arm.flange_link.clone(),
            foot: arm.foot.clone(),
        }
    }

    fn mount_m(&self) -> Point {
        self.scene().base.mount_m
    }

    fn link_poses(&self, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
        self.bare.arm.link_poses(joints_rad)
    }
}
