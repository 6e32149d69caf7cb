//! Tests motions that are planned beside the control thread.
//! Whatever stops the robot discards the plan. A plan that is late or no longer fits is not begun.
//! A session that is replayed from its file gives the same result.

mod support;

use std::time::{Duration, Instant};

use host_bridge::arm::Director;
use host_bridge::arm::model::SerialArm;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::{Config, HandInput};
use host_bridge::keyboard::HandKey;
use host_bridge::plan::Planner;
use host_bridge::robot::{Door as _, Grip, Leg, MotionName, NotStarted, Report, Robot as _, Twist};
use host_bridge::safety::State;
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

/// Waits until the thread has finished. No test checks how long this takes.
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
        // The next motion is planned as usual.
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

/// Returns the reason why a motion was not begun, if there was such a case.
fn refusal(robot: &mut Robot) -> Option<String> {
    robot.take_reports().into_iter().find_map(|report| match report {
        Report::MotionRefused { reason, .. } => Some(reason),
        _ => None,
    })
}

#[test]
fn a_plan_that_is_there_after_a_pause_of_the_whole_program_begins_from_then_on_or_never() {
    for pause_ms in [200, 300, 1500] {
        let config = Config::parse("[motions]\nto-fro = \"gap 5\"\n").unwrap();
        let keys = HandInput::Keyboard;
        let asked = || {
            let mut live = moving::live_before(robot().planning_aside(), &config, keys, keys, 0);
            let mut now_ms = 0;
            while now_ms < 1000 {
                now_ms += 2;
                live.advance(now_ms, [true; 2]);
            }
            assert_eq!(live.bridge().safety().state(), State::Armed);
            live.press(HandKey::Gesture(2), now_ms);
            while live.door().picture().arm.running.is_none() {
                now_ms += 2;
                assert!(now_ms < 5000, "nothing is planned");
                live.advance(now_ms, [true; 2]);
            }
            let is_planning = live.door().picture().arm.running.is_some_and(|(_, leg)| leg == Leg::Planning);
            is_planning.then_some((live, now_ms))
        };
        // On a busy machine, a plan may be there before anyone looks, and its motion has begun. Then the test asks again.
        let (mut live, mut now_ms) = (0..100).find_map(|_| asked()).expect("a plan takes some time");
        let there = live.door().arm().joints_rad;
        planned(live.door());
        now_ms += pause_ms;
        live.advance(now_ms, [true; 2]);
        assert_eq!(live.door().arm().joints_rad, there, "{pause_ms}: it moved during the pause");
        let begins = pause_ms < 250;
        assert_eq!(live.door().picture().arm.running.is_some(), begins, "{pause_ms}");
        for _ in 0..250 {
            now_ms += 2;
            live.advance(now_ms, [true; 2]);
        }
        assert_eq!(live.door().arm().joints_rad != there, begins, "{pause_ms}");
    }
}

#[test]
fn a_plan_that_does_not_come_within_two_seconds_is_refused_live_and_from_the_file() {
    for mut robot in [robot().planning_aside(), robot().planning_held()] {
        let goal = goal(&robot);
        robot.start_motion(&goal).unwrap();
        alive(&mut robot, 2000);
        assert_eq!((refusal(&mut robot), robot.picture().arm.running.is_some()), (None, true));
        alive(&mut robot, 20);
        assert!(refusal(&mut robot).unwrap().contains("not planned after 2 s"));
        assert!(robot.picture().arm.running.is_none() && !robot.plan_is_ready(), "it is not busy");
        robot.begin_planned();
        alive(&mut robot, 500);
        assert!(robot.at_rest());
    }
}

#[test]
fn where_the_base_has_moved_meanwhile_a_plan_is_begun_only_if_its_way_is_clear_from_there() {
    // Posts surround the robot. Each goal lies in a gap between two posts, 20 degrees from each of them.
    for (turned_rad, begins) in [(0.05, true), (0.35, false)] {
        let mut robot = robot().planning_aside();
        let goal = goal(&robot);
        robot.start_motion(&goal).unwrap();
        let heading_rad = |robot: &Robot| robot.odometry().heading_rad;
        while heading_rad(&robot) < turned_rad {
            robot.drive(Twist { linear_m_s: 0.0, angular_rad_s: if begins { 0.1 } else { 0.5 } });
            robot.pass(20);
        }
        while !robot.at_rest() {
            robot.drive(Twist::ZERO);
            robot.pass(20);
        }
        println!("turned by {:.3} rad after {} ms", heading_rad(&robot), robot.now_ms());
        planned(&robot);
        robot.begin_planned();
        alive(&mut robot, 500);
        assert_eq!(robot.at_rest(), !begins);
        let reason = refusal(&mut robot);
        assert_eq!(reason.is_some_and(|reason| reason.contains("the base has moved")), !begins);
    }
}

#[test]
fn a_plan_for_other_fingers_is_not_begun() {
    let mut there = moving::pose("home");
    there[0] += 0.3;
    let scene =
        format!("[[tool]]\nname = \"2f-85\"\n[[pose]]\nname = \"aside\"\njoints_rad = {:?}\n", &there[..7]);
    let planner = Planner::new(SerialArm::gen3(), Scene::parse(&scene).unwrap()).unwrap();
    let mut robot = moving::in_scene(planner).planning_held();
    // Waits until the gripper has reported the distance between its fingers.
    alive(&mut robot, 20);
    robot.start_motion(&MotionName::from("aside")).unwrap();
    robot.robot_mut().grip(Grip { opening_m: 0.02, effort_n: None, between_m: None }).unwrap();
    alive(&mut robot, 1500);
    robot.begin_planned();
    let reason = refusal(&mut robot);
    assert!(reason.as_ref().is_some_and(|reason| reason.contains("the gripper has moved")), "{reason:?}");
}
