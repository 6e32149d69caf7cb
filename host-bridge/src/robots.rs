//! The robots that the bridge can command through a common interface (door).

use std::sync::Arc;

use host_arm::plan::Planner;
use host_arm::scene::Route;
use host_arm::{Director, Motions};
use host_robot::{
    BaseConfig, BaseState, End, Following, Grip, GripEnd, JointLimits, Motion, Reading, Robot, Trajectory,
    Twist,
};
use host_sim::{SimConfig, Simulator};

use crate::config::Config;
use crate::ros2::Ros2Config;
use crate::ros2::sightings::Watched;

/// The robot's surroundings and the motions of its arm.
#[derive(Clone, Debug)]
pub struct Stage {
    /// The motions of the arm.
    pub motions: Motions,
    /// The planner, if there is a scene.
    pub planner: Option<Arc<Planner>>,
    /// Limits of the arm's motions.
    pub limits: JointLimits,
    /// The route of the arm without a scene.
    pub route: Route,
}

impl Stage {
    /// Creates a stage as configured, with or without a scene.
    ///
    /// # Errors
    /// Fails if a motion or pose does not fit the arm. The error contains the name of this motion or pose.
    pub fn new(config: &Config, planner: Option<Planner>) -> Result<Self, host_arm::motions::MotionError> {
        let Some(planner) = planner else {
            let arm = host_arm::model::SerialArm::gen3();
            let motions = Motions::new(&arm, &[], &config.pose, &config.motion)?;
            motions.check_objects(&[])?;
            let (limits, route) = (config.arm_limits(), config.arm.route);
            return Ok(Stage { motions, planner: None, limits, route });
        };
        let world = planner.world();
        let tables = [&world.scene().motions[..], &config.motion].concat();
        let motions = Motions::new(world.arm(), planner.goals(), &config.pose, &tables)?;
        let objects: Vec<&str> = world.scene().objects.iter().map(|object| object.name.as_str()).collect();
        motions.check_objects(&objects)?;
        let (limits, route) = (*planner.limits(), world.scene().arm.route);
        Ok(Stage { motions, planner: Some(Arc::new(planner)), limits, route })
    }

    /// Returns the Gen3 without surroundings, in the default configuration.
    ///
    /// # Panics
    /// This never fails, because the bundled motions fit the bundled arm and are tested.
    pub fn bare() -> Self {
        Stage::new(&Config::default(), None).expect("the bundled motions fit the bundled arm")
    }

    /// Tells the node which topics the motions need, and the name of the arm's base frame.
    pub fn tell(&self, ros2: &mut Ros2Config) {
        ros2.watched = Watched {
            topics: self.motions.topics(),
            arm_root: match &self.planner {
                None => host_arm::model::SerialArm::gen3().root_link,
                Some(planner) => planner.world().arm().root_link.clone(),
            },
        };
    }

    /// Returns the name of the arm and its number of joints.
    pub fn arm(&self) -> (&str, usize) {
        match &self.planner {
            None => ("the Gen3", host_arm::gen3::COUNT),
            Some(planner) => (&planner.world().arm().name, planner.world().arm().joints.len()),
        }
    }

    /// Creates the simulator as configured here, with the arm at the pose `ready` (or at home).
    pub fn simulator(&self, config: &Config) -> Simulator {
        let base = self.planner.as_ref().map_or(config.base, |planner| planner.world().scene().base.config());
        let home = || self.motions.pose("home").unwrap_or_default();
        let arm_start_rad = self.motions.pose("ready").unwrap_or_else(home);
        let simulator = Simulator::new(SimConfig { base, arm_start_rad, arm_limits: self.limits });
        let hand = self.planner.as_ref().and_then(|planner| planner.world().tool().hand());
        match hand {
            Some(hand) => simulator.with_gripper(hand.widest_m),
            None => simulator,
        }
    }

    /// Combines a robot with the arm director that commands it.
    pub fn before<R: Robot>(&self, robot: R) -> Director<R> {
        match &self.planner {
            None => Director::routed(robot, self.motions.clone(), self.route),
            Some(planner) => Director::in_scene(robot, self.motions.clone(), Arc::clone(planner)),
        }
    }

    /// Returns the simulator behind its door, for tests and played sessions.
    pub fn simulated(&self, config: &Config) -> Director<Simulator> {
        self.before(self.simulator(config))
    }
}

/// The simulator as a robot, combined with a graph on which its speed commands are also published.
pub struct Echoed<R> {
    /// The robot.
    pub simulator: Simulator,
    /// The publisher.
    pub graph: R,
}

impl<R: Robot> Robot for Echoed<R> {
    fn hear(&mut self, now_ms: u64) {
        self.graph.hear(now_ms);
    }
    fn step(&mut self, now_ms: u64) {
        self.simulator.step(now_ms);
        self.graph.step(now_ms);
    }
    fn arm(&self) -> Option<Reading<Motion>> {
        self.simulator.arm()
    }
    fn base(&self) -> Option<Reading<BaseState>> {
        self.simulator.base()
    }
    fn joint_limits(&self) -> &JointLimits {
        self.simulator.joint_limits()
    }
    fn base_limits(&self) -> &BaseConfig {
        self.simulator.base_limits()
    }
    fn drive(&mut self, twist: Twist) {
        self.simulator.drive(twist);
        self.graph.drive(twist);
    }
    fn can_follow(&self) -> Result<(), String> {
        self.simulator.can_follow()
    }
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.simulator.follow(trajectory)
    }
    fn ahead_ms(&self) -> Result<u64, String> {
        self.simulator.ahead_ms()
    }
    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        self.simulator.follow_on(trajectory, from_s)
    }
    fn following(&self) -> Following {
        self.simulator.following()
    }
    fn take_end(&mut self) -> Option<End> {
        self.simulator.take_end()
    }
    fn halt_arm(&mut self) {
        self.simulator.halt_arm();
    }
    fn halt(&mut self) {
        self.simulator.halt();
        self.graph.halt();
    }
    fn opening_m(&self) -> Option<Reading<f64>> {
        self.simulator.opening_m()
    }
    fn can_grip(&self) -> Result<(), String> {
        self.simulator.can_grip()
    }
    fn grip(&mut self, grip: Grip) -> Result<(), String> {
        self.simulator.grip(grip)
    }
    fn take_grip_end(&mut self) -> Option<GripEnd> {
        self.simulator.take_grip_end()
    }
    fn halt_gripper(&mut self) {
        self.simulator.halt_gripper();
    }
    fn timeouts(&self) -> u32 {
        self.simulator.timeouts()
    }
    fn refusal(&self) -> Option<String> {
        self.graph.refusal()
    }
    fn take_notes(&mut self) -> Vec<String> {
        self.graph.take_notes()
    }
    fn send(&mut self) {
        self.graph.send();
    }
}
