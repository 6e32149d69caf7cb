//! Tests that a scene also applies to a robot on the ROS 2 graph.
//! Planning, refusals and the guard must work as for the simulator.

use host_bridge::arm::Director;
use host_bridge::arm::gen3::{HOME, JOINT_NAMES};
use host_bridge::arm::model::SerialArm;
use host_bridge::base::{Odometry, Twist};
use host_bridge::bridge::EventKind;
use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::keyboard::HandKey;
use host_bridge::observe::{SessionEvent, Snapshot};
use host_bridge::plan::Planner;
use host_bridge::robot::{Joints, Robot as _, joints};
use host_bridge::robots::Stage;
use host_bridge::ros2::{ArmInterface, Output, Ros2Config, RosRobot};
use host_bridge::scene::Scene;
use host_bridge::topics::message::{self as ros, JointState};
use shared_proto::message::Heading;

#[path = "support/moving.rs"]
mod moving;

use moving::{live_before, pose};

/// The bridge with keys for both hands, and a simulated ROS 2 robot whose replies the test provides.
struct Site {
    live: Engine<'static, Director<RosRobot>>,
    now_ms: u64,
    joints_rad: Joints,
    base: Odometry,
    sent: Vec<Output>,
    events: Vec<EventKind>,
}

impl Site {
    fn new(scene: &str) -> Self {
        let config = Config::default();
        let planner = Planner::new(SerialArm::gen3(), Scene::parse(scene).unwrap()).unwrap();
        let stage = Stage::new(&config, Some(planner)).unwrap();
        // The action interface sends complete goals, so the test sees complete plans.
        let whole = Ros2Config { arm: ArmInterface::Action, ..Ros2Config::default() };
        let robot = RosRobot::new(&whole, stage.limits, config.base);
        let live = live_before(stage.before(robot), &config, HandInput::Keyboard, HandInput::Keyboard, 0);
        let mut site = Site {
            live,
            now_ms: 0,
            joints_rad: HOME,
            base: Odometry { x_m: 7.0, y_m: -3.0, ..Odometry::default() },
            sent: Vec::new(),
            events: Vec::new(),
        };
        site.run(1000);
        site
    }

    /// The robot reports every 10 ms, and its base executes commands immediately.
    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ms += 1;
            let robot = self.live.door_mut().robot_mut();
            self.base.advance(self.base.twist, 0.001);
            if self.now_ms.is_multiple_of(10) {
                robot.step(self.now_ms);
                robot.set_arm_listened_to(true);
                robot.see(&JointState {
                    name: JOINT_NAMES.map(str::to_owned).to_vec(),
                    position: self.joints_rad[..7].to_vec(),
                    velocity: vec![0.0; 7],
                    ..JointState::default()
                });
                let mut odometry = ros::Odometry::default();
                odometry.pose.pose.position.x = self.base.x_m;
                odometry.pose.pose.position.y = self.base.y_m;
                odometry.pose.pose.orientation = ros::Quaternion::yaw(self.base.heading_rad);
                odometry.twist.twist = self.base.twist.into();
                robot.see_base(&odometry);
            }
            for event in self.live.advance(self.now_ms, [true; 2]) {
                if let SessionEvent::Bridge(event) = event {
                    self.events.push(event.kind);
                }
            }
            for output in self.live.door_mut().robot_mut().take_outputs() {
                if let Output::Twist(twist) = output {
                    self.base.twist = twist;
                }
                self.sent.push(output);
            }
        }
    }

    fn goals(&self) -> Vec<&ros::JointTrajectory> {
        self.sent
            .iter()
            .filter_map(
                |output| if let Output::Goal { trajectory, .. } = output { Some(trajectory) } else { None },
            )
            .collect()
    }
}

#[test]
fn a_pose_inside_a_box_is_refused_to_the_operator_and_nothing_is_sent() {
    let [x, y, z] = SerialArm::gen3().flange_pose(&pose("pick-up")).position_m.to_array();
    // The arm's mount is 0.1 m ahead of the base's centre and 0.4 m above the floor.
    let (x, z) = (x + 0.1, z + 0.4);
    let mut site = Site::new(&format!(
        "[[box]]\nname = \"crate\"\ncenter_m = [{x}, {y}, {z}]\nsize_m = [0.2, 0.2, 0.2]\n"
    ));
    site.live.press(HandKey::Gesture(2), site.now_ms);
    site.run(2000);
    assert!(site.goals().is_empty());
    let told = site.events.iter().any(|event| {
        matches!(event, EventKind::MotionRefused { motion, reason } if *motion == "pick-up" && reason.contains("crate"))
    });
    assert!(told, "{:?}", site.events);
}

#[test]
fn the_plan_that_is_sent_is_the_scenes_around_its_boxes_to_its_pose_at_its_speed() {
    let text = include_str!("../scenes/posts.toml");
    let scene = Scene::parse(text).unwrap();
    let planner = Planner::new(SerialArm::gen3(), scene).unwrap();
    let goals = planner.goals().to_vec();
    let [(from_name, from), (to_name, to), ..] = &goals[..] else { panic!("two poses") };
    println!("{from_name} → {to_name}");
    let config = format!("{text}\n[[motion]]\nname = \"pick-up\"\nsteps = [{{ to = \"{to_name}\" }}]\n");
    let mut site = Site::new(&config);
    site.joints_rad = *from;
    // An impossible jump of the arm blocks motions for 2 s.
    site.run(2500);
    site.live.press(HandKey::Gesture(2), site.now_ms);
    site.run(100);
    let goals = site.goals();
    let [goal] = &goals[..] else { panic!("{:?}", site.events) };
    let last = goal.points.last().unwrap();
    for (got, expected) in last.positions.iter().zip(to) {
        // A continuous joint may differ by a complete turn.
        let off = (got - expected).rem_euclid(std::f64::consts::TAU);
        assert!(off.min(std::f64::consts::TAU - off) < 1e-6, "{:?} {to:?}", last.positions);
    }
    let limits = planner.limits().velocity_rad_s;
    let around = planner.world().around(host_bridge::plan::Placement::default());
    for point in &goal.points {
        let joints = joints::<7>(point.positions.clone().try_into().unwrap());
        assert!(around.arm_clearance(&joints).distance_m > 0.004, "at {:?}", point.time_from_start);
        for (speed, limit) in point.velocities.iter().zip(limits) {
            assert!(speed.abs() <= limit * (1.0 + 1e-9));
        }
    }
}

#[test]
fn a_base_driven_at_a_wall_is_held_back_before_it_and_the_operator_is_told_what_holds_it() {
    let wall = "[[box]]\nname = \"wall\"\ncenter_m = [2.0, 0.0, 0.25]\nsize_m = [0.2, 4.0, 0.5]\n";
    let mut site = Site::new(wall);
    let start_m = site.base.x_m;
    for _ in 0..200 {
        site.live.press(HandKey::Arrow(Heading::Forward), site.now_ms);
        site.run(33);
    }
    // The wall's surface is 1.9 m ahead, and the base's front 0.3 m.
    let driven_m = site.base.x_m - start_m;
    assert!((1.2..1.6).contains(&driven_m), "{driven_m}");
    assert_eq!(site.base.twist, Twist::ZERO);
    let held = site.events.iter().find_map(|event| match event {
        EventKind::BaseHeld { reason } => Some(reason.as_str()),
        _ => None,
    });
    assert!(held.is_some_and(|reason| reason.contains("wall")), "{held:?}");
    let snapshot = Snapshot::of(&site.live.now(site.now_ms));
    assert!(snapshot.held.is_some());
}

#[test]
fn without_odometry_a_scene_holds_the_base_and_says_so() {
    let config = Config::default();
    let planner = Planner::new(SerialArm::gen3(), Scene::parse("").unwrap()).unwrap();
    let stage = Stage::new(&config, Some(planner)).unwrap();
    let robot = RosRobot::new(&Ros2Config::default(), stage.limits, config.base);
    let mut live = live_before(stage.before(robot), &config, HandInput::Keyboard, HandInput::Keyboard, 0);
    let mut held = Vec::new();
    for now_ms in 1..2000 {
        if now_ms > 1000 {
            live.press(HandKey::Arrow(Heading::Forward), now_ms);
        }
        held.extend(live.advance(now_ms, [true; 2]).into_iter().filter_map(|event| match event {
            SessionEvent::Bridge(event) => match event.kind {
                EventKind::BaseHeld { reason } => Some(reason),
                _ => None,
            },
            _ => None,
        }));
        for output in live.door_mut().robot_mut().take_outputs() {
            assert_eq!(output, Output::Twist(Twist::ZERO));
        }
    }
    assert_eq!(held.len(), 1);
    assert!(held[0].contains("odometry"), "{held:?}");
}

#[test]
fn what_is_shown_is_what_the_robot_reports_and_where_it_should_be_stands_beside_it() {
    let mut site = Site::new("");
    site.joints_rad[1] += 0.2;
    site.run(20);
    site.live.press(HandKey::Gesture(2), site.now_ms);
    site.run(20);
    let robot = site.live.door_mut().robot_mut();
    robot.answer(1, host_bridge::ros2::answer::Answer::Accepted);
    site.run(3000);
    // The robot has not moved.
    let snapshot = Snapshot::of(&site.live.now(site.now_ms));
    assert_eq!(snapshot.arm.joints_rad, site.joints_rad);
    assert!(snapshot.arm_age_ms.is_some_and(|age_ms| age_ms <= 10));
    let asked = snapshot.reference_rad.unwrap();
    assert!(asked.iter().zip(site.joints_rad).any(|(a, b)| (a - b).abs() > 0.1), "{asked:?}");
    assert_eq!((snapshot.odometry.x_m, snapshot.base_age_ms.is_some()), (0.0, true));
}

#[test]
fn on_ros_2_too_the_base_turns_more_slowly_while_the_arm_is_stretched_out() {
    let turn_rate_rad_s = |joints_rad: Joints| {
        let mut site = Site::new("[[tool]]\nname = \"2f-85\"\n");
        site.joints_rad = joints_rad;
        // An impossible jump of the arm is forgotten after 2 s.
        site.run(2500);
        for _ in 0..60 {
            site.live.press(HandKey::Arrow(Heading::Left), site.now_ms);
            site.run(33);
        }
        site.base.twist.angular_rad_s
    };
    assert!((turn_rate_rad_s(HOME) - 0.5).abs() < 1e-9);
    let mut stretched = HOME;
    (stretched[1], stretched[3], stretched[5]) = (1.4, 0.0, 0.17);
    // The fingertips are 1.2 m from the middle of the base.
    let slow_rad_s = turn_rate_rad_s(stretched);
    println!("{slow_rad_s:.3} rad/s of 0.5");
    assert!((0.5 / 1.3..0.5 / 1.1).contains(&slow_rad_s), "{slow_rad_s}");
}
