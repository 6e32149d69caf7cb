//! The arm director, which connects the bridge with any robot.
//!
//! The director resolves names to goals, plans from the reported pose, monitors base and arm,
//! and reports results.
//! A motion of several steps is planned as a unit. If one step fails, the entire motion ends.
//! The simulator and a robot on ROS 2 get the same plans, the same guard and the same refusals.
//!
//! Without a scene, the arm moves via its home pose in straight lines in joint space, as in the paper.
//! On request ([`Director::routed`]), it moves straight to its pose if it then stays clear of the robot itself and the floor.
//! In a scene, motions are planned around its boxes.
//! The [guard](crate::plan::guard) rejects motion that could not stop in time.

mod carry;
mod guarding;
mod jogging;
mod pacing;
mod planning;
mod reaching;
mod seen;
mod sequence;

use std::collections::HashMap;
use std::sync::Arc;

use host_robot::shape::Point;
use host_robot::{
    ArmState, Busy, DVec3, Door, Following, JOINTS, JointLimits, JointSetting, Joints, Leg, MotionName,
    NotStarted, Picture, Pose, Report, Robot, RobotSetting, SceneBox, Twist, Wheels,
};

use crate::model::SerialArm;
use crate::motions::Motions;
use crate::plan::guard::TICK_MS;
use crate::plan::{Placement, Planner, World};
use crate::scene::{Route, Scene};
use crate::things::{Shop, Things, in_scene};

use carry::Running;
use jogging::Jog;
use pacing::Pace;
use planning::{How, Planning};
use reaching::Reaching;

/// Part of a long pause that is checked tick by tick, in ms.
const CATCH_UP_MS: u64 = 10_000;

/// A joint slower than this counts as at rest, because encoders are noisy.
const REST_RAD_S: f64 = 0.02;

/// If the base is faster than this, it still moves. The value is in m/s and in rad/s.
const BASE_REST: f64 = 0.01;

/// Returns whether the base has not come to rest yet.
fn still_moves(twist: Twist) -> bool {
    twist.linear_m_s.abs() > BASE_REST || twist.angular_rad_s.abs() > BASE_REST
}

/// The arm with its surroundings.
#[derive(Clone, Debug)]
enum Site {
    /// A scene, in which motions are planned.
    Scene(Arc<Planner>),
    /// A robot without a scene, whose arm must still not collide with the robot itself.
    Bare(Arc<World>),
}

impl Site {
    /// Returns the planner, if there is a scene.
    fn planner(&self) -> Option<&Arc<Planner>> {
        match self {
            Site::Scene(planner) => Some(planner),
            Site::Bare(_) => None,
        }
    }

    fn world(&self) -> &World {
        match self {
            Site::Scene(planner) => planner.world(),
            Site::Bare(world) => world,
        }
    }

    fn arm(&self) -> &SerialArm {
        self.world().arm()
    }

    fn mount_m(&self) -> Point {
        self.world().scene().base.mount_m
    }

    fn shop(&self) -> Shop<'_> {
        self.world().shop()
    }

    /// Returns the flange's pose in the scene, with the base at this placement.
    fn flange(&self, placement: Placement, joints_rad: &Joints) -> Pose {
        in_scene(placement, self.mount_m(), &self.arm().flange_pose(joints_rad))
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Director<R> {
    robot: R,
    motions: Motions,
    site: Site,
    now_ms: u64,
    running: Option<Running>,
    /// The way in which motions are planned, and the motion that is being planned.
    how: How,
    planning: Option<Planning>,
    /// Tool and objects, if they are known.
    things: Things,
    /// Distance between the fingers at the last gripper command, if known.
    grip_before_m: Option<f64>,
    /// When somebody last commanded.
    commanded_ms: u64,
    /// Number of runs of each motion with random poses.
    draws: HashMap<MotionName, usize>,
    plans: u64,
    wanted: Twist,
    allowed: Twist,
    /// The cap on the speed of the robot's outermost point.
    reaching: Reaching,
    pace: Pace,
    /// Time at which the base last received a drive command or last reported a movement.
    base_moved_ms: Option<u64>,
    guard_due_ms: u64,
    held: Option<String>,
    guard_stops: u32,
    jog: Jog,
    reports: Vec<Report>,
}

impl<R: Robot> Director<R> {
    /// Creates a director without a scene, in which the arm moves via its home pose.
    pub fn new(robot: R, motions: Motions) -> Self {
        Director::routed(robot, motions, Route::ViaHome)
    }

    /// Creates a director without a scene, in which the arm takes this route.
    pub fn routed(robot: R, motions: Motions, route: Route) -> Self {
        let mut scene = Scene::default();
        scene.arm.route = route;
        let world = World::new(SerialArm::gen3(), scene);
        Director::with(robot, motions, Site::Bare(Arc::new(world)))
    }

    /// Creates a director for a scene, in which neither base nor arm touches anything.
    pub fn in_scene(robot: R, motions: Motions, planner: Arc<Planner>) -> Self {
        Director::with(robot, motions, Site::Scene(planner))
    }

    fn with(robot: R, motions: Motions, site: Site) -> Self {
        let mut things = site.world().start().clone();
        // The robot has not yet reported the finger distance.
        things.opening_m = None;
        Director {
            robot,
            motions,
            things,
            grip_before_m: None,
            commanded_ms: 0,
            site,
            now_ms: 0,
            running: None,
            how: How::AtOnce,
            planning: None,
            draws: HashMap::new(),
            plans: 0,
            wanted: Twist::ZERO,
            allowed: Twist::ZERO,
            reaching: Reaching::default(),
            pace: Pace::default(),
            base_moved_ms: None,
            guard_due_ms: 0,
            held: None,
            guard_stops: 0,
            jog: Jog::default(),
            reports: Vec::new(),
        }
    }

    /// The robot.
    pub fn robot(&self) -> &R {
        &self.robot
    }

    /// Returns the robot, so that the caller can pass external data to it.
    pub fn robot_mut(&mut self) -> &mut R {
        &mut self.robot
    }

    /// Time of the last step in ms.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// Returns the motions of the arm.
    pub fn motions(&self) -> &Motions {
        &self.motions
    }

    /// Returns the limits of the arm's motions.
    pub fn joint_limits(&self) -> &JointLimits {
        self.site.planner().map_or(self.robot.joint_limits(), |planner| planner.limits())
    }

    fn running_state(&self) -> Option<(MotionName, Leg)> {
        if let Some(planning) = &self.planning {
            return Some((planning.motion.clone(), Leg::Planning));
        }
        let running = self.running.as_ref()?;
        let leg = match self.robot.following() {
            Following::Halting => Leg::Halting,
            _ if running.jogs => Leg::Jogging,
            Following::Moving { elapsed_s } if elapsed_s < running.home_s() => Leg::ToHome,
            Following::Moving { .. } | Following::Idle => Leg::ToGoal,
        };
        Some((running.motion.clone(), leg))
    }
}

impl<R: Robot> Door for Director<R> {
    fn step(&mut self, now_ms: u64) {
        self.robot.hear(now_ms);
        // In a scene, the guard checks after each tick, however long this program was suspended.
        // After a pause of this length, every robot has come to rest by itself.
        // The rest of a longer pause is therefore a single step.
        let looks_until_ms = self.now_ms.saturating_add(CATCH_UP_MS);
        while self.now_ms < now_ms {
            let looks = self.site.planner().is_some() && self.now_ms < looks_until_ms;
            let tick_ms = if looks { TICK_MS } else { u64::MAX };
            self.guard();
            let due_ms = if self.guard_due_ms > self.now_ms { self.guard_due_ms } else { u64::MAX };
            self.now_ms = now_ms.min(self.now_ms.saturating_add(tick_ms)).min(due_ms);
            self.robot.step(self.now_ms);
            self.watch_base();
            self.carry_on();
            self.pace_on();
            self.jog_on();
            self.doubt_plan();
        }
        self.reports.extend(self.robot.take_accepted().into_iter().map(Report::Accepted));
        self.reports.extend(self.robot.take_notes().into_iter().map(Report::Note));
    }

    fn cap(&mut self, most_m_s: f64) {
        self.reaching.cap_m_s = most_m_s;
    }

    fn drive(&mut self, twist: Twist) {
        self.commanded_ms = self.now_ms;
        let twist = self.within_reach(twist);
        if self.site.planner().is_none() {
            self.allowed = twist;
        } else if twist != self.wanted {
            self.guard_due_ms = 0;
        }
        self.wanted = twist;
        // The command is repeated even without a change, to show that the bridge is alive.
        if self.guard_due_ms == 0 {
            self.guard();
        }
        self.robot.drive(self.allowed);
    }

    fn start_motion(&mut self, motion: &MotionName) -> Result<(), NotStarted> {
        if let Some((busy, _)) = self.running_state() {
            return Err(Busy(busy).into());
        }
        let task = self.task(motion).map_err(NotStarted::Refused)?;
        self.plan(motion, task).map_err(NotStarted::Refused)
    }

    fn plan_is_ready(&self) -> bool {
        self.has_planned()
    }

    fn begin_planned(&mut self) {
        self.begin_what_is_planned();
    }

    fn pace(&mut self, share: f64) {
        self.want_pace(share);
    }

    fn can_jog(&self) -> Result<(), NotStarted> {
        if let Some((busy, _)) = self.running_state() {
            return Err(Busy(busy).into());
        }
        self.robot.can_follow().and_then(|()| self.robot.ahead_ms()).map_err(NotStarted::Refused)?;
        Ok(())
    }

    fn jog(&mut self, tool_m_s: DVec3) {
        self.commanded_ms = self.now_ms;
        self.want_jog(tool_m_s);
    }

    fn halt(&mut self) {
        self.want_jog(DVec3::ZERO);
        (self.wanted, self.allowed) = (Twist::ZERO, Twist::ZERO);
        self.halt_motion();
        self.robot.halt();
        self.set_held(None);
    }

    fn halt_arm(&mut self) {
        self.want_jog(DVec3::ZERO);
        self.halt_motion();
        self.robot.halt_arm();
        self.robot.halt_gripper();
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
        let reference_rad =
            self.along().map(|(trajectory, elapsed_s)| trajectory.motion(elapsed_s).joints_rad);
        let shop = self.site.shop();
        let flange = self.site.arm().flange_pose(&joints_rad);
        let in_scene = in_scene(Placement::from(state.odometry), self.site.mount_m(), &flange);
        let objects = shop.objects.iter().zip(&self.things.poses);
        let objects = objects.map(|(object, at)| object.picture(at.pose(&in_scene)));
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
            flange,
            opening_m: self.robot.opening_m().map(|reading| reading.value),
            // A picture needs some position of the fingers.
            tool: shop
                .tool
                .shapes(self.things.opening_m.or_else(|| shop.tool.hand().map(|hand| hand.widest_m))),
            objects: objects.collect(),
            reference_rad,
            held: self.held.clone(),
            jog_held: self.jog.held.clone(),
            guard_stops: self.guard_stops,
            timeouts: self.robot.timeouts(),
        }
    }

    fn setting(&self) -> RobotSetting {
        let (arm, scene, limits) = (self.site.arm(), self.site.world().scene(), self.joint_limits());
        let joints = arm.joints.iter().enumerate().map(|(i, joint)| JointSetting {
            name: joint.name.clone(),
            link: joint.link.clone(),
            origin_m: joint.origin_m,
            origin_rotation: joint.origin_rotation,
            axis: joint.axis,
            slides: joint.slides,
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
        self.site.mount_m()
    }

    fn link_poses(&self, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
        self.site.arm().link_poses(joints_rad)
    }
}
