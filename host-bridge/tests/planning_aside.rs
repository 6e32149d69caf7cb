//! Motions that are planned beside the control thread: what stops the robot throws the plan away, a plan that is late or that no
//! longer fits is not begun, and a session from its file is the same.

mod support;

use std::time::{Duration, Instant};

use host_bridge::arm::Director;
use host_bridge::arm::model::SerialArm;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::plan::Planner;
use host_bridge::robot::{Door as _, Leg, MotionName, NotStarted, Report, Twist};
use host_bridge::scene::Scene;
use host_bridge::sim::Simulator;
use support::{Rig, Virtual as _, moving};

type Robot = Director<Simulator>;

fn robot() -> Robot {
    let scene = Scene::parse(include_str!("../scenes/posts.toml")).unwrap();
    moving::in_scene(Planner::new(SerialArm::gen3(), scene).unwrap())
}

fn goal(robot: &Robot) -> MotionName {
    let last = robot.motions().names().last().map(|name| name.to_string());
    MotionName::from(last.expect("the scene has poses").as_str())
}

/// Until the thread is done; how long that takes is asserted nowhere.
fn planned(robot: &Robot) {
    let began = Instant::now();
    while !robot.plan_is_ready() {
        assert!(began.elapsed() < Duration::from_secs(240), "the plan never comes");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn alive(robot: &mut Robot, ms: u64) {
    for _ in 0..ms / 20 {
        robot.drive(Twist::ZERO);
        robot.pass(20);
    }
}

#[test]
fn a_motion_is_planned_while_time_goes_on_and_begins_as_it_would_have_at_once() {
    let (mut aside, mut at_once) = (robot().planning_aside(), robot());
    let goal = goal(&aside);
    aside.start_motion(&goal).unwrap();
    at_once.start_motion(&goal).unwrap();
    assert_eq!(aside.picture().arm.running, Some((goal.clone(), Leg::Planning)));
    assert!(matches!(aside.start_motion(&goal), Err(NotStarted::Busy(_))), "one at a time");
    assert!(aside.can_jog().is_err());
    alive(&mut aside, 200);
    assert!(aside.at_rest());
    planned(&aside);
    assert!(aside.at_rest(), "it begins only when that is said");
    aside.begin_planned();
    alive(&mut aside, 1000);
    alive(&mut at_once, 1000);
    assert!(!aside.at_rest());
    assert_eq!(aside.picture().arm.joints_rad, at_once.picture().arm.joints_rad, "the same plan");
}

#[test]
fn what_stops_the_arm_while_it_is_planned_throws_the_plan_away() {
    type Stop = fn(&mut Robot);
    let stops: [Stop; 2] = [|robot| robot.halt(), |robot| robot.halt_arm()];
    for stop in stops {
        let mut robot = robot().planning_aside();
        let goal = goal(&robot);
        robot.start_motion(&goal).unwrap();
        stop(&mut robot);
        assert_eq!(robot.picture().arm.running, None);
        let ended = Report::MotionEnded { motion: goal.clone(), reached: false };
        assert!(robot.take_reports().contains(&ended));
        alive(&mut robot, 500);
        assert!(!robot.plan_is_ready() && robot.at_rest());
        robot.begin_planned();
        alive(&mut robot, 500);
        assert!(robot.at_rest());
        // And the next one is planned as ever.
        robot.start_motion(&goal).unwrap();
        planned(&robot);
        robot.begin_planned();
        alive(&mut robot, 500);
        assert!(!robot.at_rest());
    }
}

#[test]
fn a_plan_is_not_begun_after_a_silence() {
    let mut robot = robot().planning_aside();
    let goal = goal(&robot);
    robot.start_motion(&goal).unwrap();
    planned(&robot);
    robot.pass(400);
    robot.begin_planned();
    alive(&mut robot, 500);
    assert!(robot.at_rest());
    let refused = |report: &Report| matches!(report, Report::MotionRefused { reason, .. } if reason.contains("commanded"));
    assert!(robot.take_reports().iter().any(refused));
}

#[test]
fn a_motion_without_a_way_is_refused_with_its_reason_when_that_is_known() {
    let walls = "[[box]]\nname = \"right wall\"\ncenter_m = [0.1, -0.77, 0.95]\nsize_m = [0.02, 1.3, 1.9]\n\
                 [[box]]\nname = \"left wall\"\ncenter_m = [0.1, 0.77, 0.95]\nsize_m = [0.02, 1.3, 1.9]\n\
                 [[box]]\nname = \"lintel\"\ncenter_m = [0.1, 0.0, 1.375]\nsize_m = [0.02, 0.24, 1.05]\n\
                 [[pose]]\nname = \"ready\"\njoints_rad = [0.0, 1.2, 3.14159, -1.5, 0.0, 0.5, 1.57]\n\
                 [[pose]]\nname = \"pick-up\"\njoints_rad = [3.14159, 1.2, 3.14159, -1.5, 0.0, 0.5, 1.57]\n";
    let mut rig = Rig::armed();
    let planner = Planner::new(SerialArm::gen3(), Scene::parse(walls).unwrap()).unwrap();
    rig.robot = moving::in_scene(planner).planning_aside();
    let ahead_ms = rig.now_ms;
    rig.robot.pass(ahead_ms);
    rig.gesture(2);
    assert_eq!(rig.take_outcomes(), [GestureOutcome::Started(MotionName::from("pick-up"))]);
    planned(&rig.robot);
    rig.robot.begin_planned();
    rig.run(100);
    let reason = rig.events.iter().find_map(|event| match event {
        EventKind::MotionRefused { motion, reason } if *motion == *"pick-up" => Some(reason.clone()),
        _ => None,
    });
    println!("{reason:?}");
    assert!(reason.is_some_and(|reason| reason.contains("no safe way")));
    assert!(rig.robot.at_rest() && rig.robot.picture().arm.running.is_none());
}
