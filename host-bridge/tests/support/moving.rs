//! The simulated robot and a live engine for tests in virtual time.
#![allow(dead_code)] // each test file uses its own part

use host_bridge::arm::{Director, Motions};
use host_bridge::base::Odometry;
use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::keyboard::{KeyLeft, KeyRight};
use host_bridge::plan::Planner;
use host_bridge::robot::{ArmState, Door, Joints, MotionName, NotStarted};
use host_bridge::robots::Stage;
use host_bridge::sim::Simulator;
use host_bridge::source::Source;

/// The simulator as a robot of the engine.
pub type Robot = Director<Simulator>;

/// Creates the robot without surroundings.
pub fn bare() -> Robot {
    let config = Config::default();
    Stage::new(&config, None).unwrap().simulated(&config)
}

/// Creates the robot in a scene.
pub fn in_scene(planner: Planner) -> Robot {
    let config = Config::default();
    Stage::new(&config, Some(planner)).unwrap().simulated(&config)
}

/// Returns the paper's pose with this name.
pub fn pose(name: &str) -> Joints {
    Motions::paper().pose(name).unwrap()
}

/// The functions of a robot that the tests use.
pub trait Virtual {
    fn pass(&mut self, ms: u64);
    fn start(&mut self, motion: &str) -> Result<(), NotStarted>;
    fn arm(&self) -> ArmState;
    fn odometry(&self) -> Odometry;
    fn at_rest(&self) -> bool;
    fn wheels_rad_s(&self) -> [f64; 2];
}

impl Virtual for Robot {
    fn pass(&mut self, ms: u64) {
        self.step(self.now_ms() + ms);
    }
    fn start(&mut self, motion: &str) -> Result<(), NotStarted> {
        self.start_motion(&MotionName::from(motion))
    }
    fn arm(&self) -> ArmState {
        self.picture().arm
    }
    fn odometry(&self) -> Odometry {
        self.robot().odometry()
    }
    fn at_rest(&self) -> bool {
        self.robot().at_rest()
    }
    fn wheels_rad_s(&self) -> [f64; 2] {
        self.robot().wheels_rad_s()
    }
}

/// Creates an engine with the simulator and these hands, as `run` does.
pub fn live(config: &Config, left: HandInput, right: HandInput) -> Engine<'static, Robot> {
    live_before(bare(), config, left, right, 0)
}

/// Creates the same engine with another robot.
pub fn live_before<D: Door>(
    door: D,
    config: &Config,
    left: HandInput,
    right: HandInput,
    now_ms: u64,
) -> Engine<'static, D> {
    let source = |input, keys: Source<'static>| match input {
        HandInput::Nobody => Source::Nobody,
        HandInput::Board => Source::link(),
        HandInput::Keyboard => keys,
    };
    let sources = [
        source(left, Source::here(KeyLeft::new(config.keyboard))),
        source(right, Source::here(KeyRight::new())),
    ];
    Engine::new(config.bridge(config.motion_map()), door, sources, now_ms)
        .with_tilt(config.tilt)
        .with_vibration(config.vibration.wired)
}
