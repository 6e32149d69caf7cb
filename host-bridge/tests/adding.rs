//! Tests the instructions of `docs/ADDING.md`: a new robot, a new output, and new poses, motions and arms as data.

use std::sync::{Arc, Mutex};

use host_bridge::arm::Motions;
use host_bridge::arm::gen3::paper_limits;
use host_bridge::base::{BaseConfig, Twist};
use host_bridge::config::{Config, HandInput};
use host_bridge::keyboard::HandKey;
use host_bridge::observe::{Now, Observer};
use host_bridge::robot::{
    BaseState, End, Following, JointLimits, Motion, MotionName, Reading, Robot, Trajectory,
};
use host_bridge::robots::Stage;
use shared_proto::message::Heading;

#[path = "support/moving.rs"]
mod moving;

use moving::{Virtual as _, live_before, pose};

/// A robot in thirty lines. It reaches every commanded position immediately, and stops when commands end.
struct Puppet {
    limits: JointLimits,
    base: BaseConfig,
    here: Motion,
    speeds: Arc<Mutex<Vec<Twist>>>,
    end: Option<End>,
}

impl Robot for Puppet {
    fn step(&mut self, _now_ms: u64) {}
    fn arm(&self) -> Option<Reading<Motion>> {
        Some(Reading { value: self.here, age_ms: 0 })
    }
    fn base(&self) -> Option<Reading<BaseState>> {
        None
    }
    fn joint_limits(&self) -> &JointLimits {
        &self.limits
    }
    fn base_limits(&self) -> &BaseConfig {
        &self.base
    }
    fn drive(&mut self, twist: Twist) {
        self.speeds.lock().unwrap().push(twist);
    }
    fn can_follow(&self) -> Result<(), String> {
        Ok(())
    }
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.here = Motion::at_rest(trajectory.goal_rad());
        self.end = Some(End::Reached);
        Ok(())
    }
    fn following(&self) -> Following {
        Following::Idle
    }
    fn take_end(&mut self) -> Option<End> {
        self.end.take()
    }
    fn halt_arm(&mut self) {}
    fn halt(&mut self) {
        self.drive(Twist::ZERO);
    }
}

/// An output in eight lines: it records the fastest commanded speed.
struct Fastest(Arc<Mutex<f64>>);

impl Observer for Fastest {
    fn state(&mut self, now: &Now<'_>) {
        let mut fastest = self.0.lock().unwrap();
        *fastest = fastest.max(now.bridge.twist().linear_m_s);
    }
}

#[test]
fn a_robot_of_ones_own_is_driven_moved_and_shown_and_an_output_sees_it() {
    let speeds = Arc::new(Mutex::new(Vec::new()));
    let puppet = Puppet {
        limits: paper_limits(),
        base: BaseConfig::default(),
        here: Motion::at_rest(pose("ready")),
        speeds: Arc::clone(&speeds),
        end: None,
    };
    let config = Config::default();
    let door = Stage::bare().before(puppet);
    let mut live = live_before(door, &config, HandInput::Keyboard, HandInput::Keyboard, 0);
    let fastest = Arc::new(Mutex::new(0.0));
    live.tap_mut().add(Box::new(Fastest(Arc::clone(&fastest))));
    for now_ms in 1..=2000 {
        match now_ms {
            1000 => live.press(HandKey::Arrow(Heading::Forward), now_ms),
            1700 => live.press(HandKey::Gesture(2), now_ms),
            _ => {}
        }
        live.advance(now_ms, [true; 2]);
    }
    assert_eq!(*fastest.lock().unwrap(), 0.5);
    assert!(speeds.lock().unwrap().contains(&Twist { linear_m_s: 0.5, angular_rad_s: 0.0 }));
    assert_eq!(live.door().robot().here.joints_rad, pose("pick-up"));
}

#[test]
fn a_motion_and_a_pose_in_the_configuration_are_carried_out_without_a_change_of_source() {
    let config = Config::parse(
        r#"
        [motions]
        wave = "fetch"
        [[pose]]
        name = "above the cup"
        joints_rad = [0.0, 0.9, 3.14, -1.7, 0.0, 0.4, 1.57]
        [[motion]]
        name = "fetch"
        steps = [{ to = "above the cup" }, { to = "pick-up" }]
        "#,
    )
    .unwrap();
    let mut robot = Stage::new(&config, None).unwrap().simulated(&config);
    let name = config.motion_map().motion("wave").cloned().unwrap();
    assert_eq!(name, MotionName::from("fetch"));
    robot.start(name.as_str()).unwrap();
    let mut passed_cup = false;
    while robot.arm().running.is_some() {
        use host_bridge::robot::Door as _;
        robot.drive(Twist::ZERO);
        robot.pass(10);
        let arm = robot.arm();
        passed_cup |= arm.joints_rad.iter().zip([0.0, 0.9]).all(|(a, b)| (a - b).abs() < 1e-3);
    }
    assert!(passed_cup);
    assert_eq!(robot.arm().joints_rad, Motions::paper().pose("pick-up").unwrap());
}

/// Context lines and removed lines of each diff must exist in the sources.
/// Otherwise, the document is out of date.
#[test]
fn the_diffs_of_the_document_fit_the_sources() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let page = std::fs::read_to_string(root.join("docs/ADDING.md")).unwrap();
    let mut diffs = 0;
    for diff in page.split("```diff\n+++ ").skip(1) {
        let (file, rest) = diff.split_once('\n').unwrap();
        let lines = rest.lines().take_while(|line| *line != "```");
        let standing: Vec<&str> = lines.filter_map(|line| line.strip_prefix([' ', '-'])).collect();
        let source =
            std::fs::read_to_string(root.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(!standing.is_empty(), "{file}: nothing to compare");
        assert!(source.contains(&standing.join("\n")), "{file} has no longer:\n{}", standing.join("\n"));
        diffs += 1;
    }
    assert_eq!(diffs, 6);
}
