//! Tests the complete path from both emulated boards to a robot on ROS 2.
//! The path consists of the flashed images behind pseudo-terminals, the program, and DDS.
//! It ends at a robot on Eclipse Cyclone DDS (`tests/ros2/peer.py`).
//! `cargo xtask test --only "ROS 2"` runs this test and sets BIMANUAL_ROS2_PYTHON.
//!
//! DDS and the robot use wall-clock time.
//! Boards and program share a time that is never faster than the wall clock.
#![cfg(all(feature = "avr", feature = "nrf", unix))]

use std::time::Duration;

use host_bridge::arm::Motions;
use models::synth::{Motion, Wearer};
use serde_json::{Value, json};
use tests::desk::graph::{
    DECISION_MS, SILENCE_MS, Teller, armed, bridge, delay_ms, desk, domain, gestures, is, is_full,
    middle_and_worst, number, peer, site, speed, started, wall_s,
};
use tests::desk::lateness::Lateness;
use tests::desk::left::{Left, LeftStation};
use tests::desk::right::Right;

/// Maximum number of attempts. The model does not recognise every simulated gesture.
const DRAWINGS: u32 = 4;
/// Limit in wall-clock time. A gesture takes 4 s of the boards' time.
const SOON: Duration = Duration::from_secs(60);
/// Speed factor of the robot's arm, whose motions take 3 to 7 s with this factor.
const PACE: &str = "8";

fn is_armed(bridge: &mut Teller) -> bool {
    bridge.catch_up();
    bridge.seen.iter().rev().find(|(_, v)| is(v, "state")).is_some_and(|(_, v)| armed(v))
}

/// Holds the hand level and then at this tilt until the robot has this speed.
/// Returns the first message with this speed.
fn tilt(
    (bridge, robot): (&mut Teller, &mut Teller),
    left: &LeftStation,
    (pitch_rad, roll_rad): (f64, f64),
    wanted: (f64, f64),
) -> Value {
    left.with(|board| board.tilt(0.0));
    if !is_armed(bridge) {
        bridge.wait("armed", armed);
    }
    left.with(move |board| board.lean(pitch_rad, roll_rad));
    let first = robot.wait("it moves", |v| speed(v).is_some_and(|s| s != (0.0, 0.0)));
    assert_eq!(speed(&first), Some(wanted));
    first
}

fn is_zero(message: &Value) -> bool {
    speed(message) == Some((0.0, 0.0))
}

#[test]
fn both_boards_reach_a_robot_on_the_graph_in_time_and_a_silent_one_stops_it() {
    let Some(site) = site("both_boards_reach_a_robot_on_the_graph_in_time_and_a_silent_one_stops_it", true)
    else {
        return;
    };
    let desk = desk("ros2");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let domain = domain();
    let mut robot = peer(&desk, &site.python, domain, &["--robot", "--action", "--pace", PACE]);
    robot.has("ready", |v| is(v, "ready"));
    let ports = ["--left", &left.port(), "--right", &right.port()];
    let mut bridge = bridge(&desk, domain, "arm = 'action'\n", &ports);
    bridge.has("the robot's reader", |v| {
        is(v, "robot") && v["text"].as_str().is_some_and(|text| text.contains("1 reader on /cmd_vel"))
    });
    bridge.has("armed", armed);
    robot.catch_up();
    assert!(!robot.seen.iter().any(|(_, v)| speed(v).is_some()), "nothing is sent while nothing moves");

    // The hand tilts in each of the paper's four directions. Both caps start at 0.5.
    let lateness = Lateness::watch();
    let mut delays_ms = Vec::new();
    let directions = [
        ((0.6, 0.0), (0.5, 0.0)),
        ((-0.6, 0.0), (-0.5, 0.0)),
        ((0.0, 0.6), (0.0, 0.5)),
        ((0.0, -0.6), (0.0, -0.5)),
    ];
    for _ in 0..if is_full() { 25 } else { 2 } {
        for (angles, wanted) in directions {
            let first = tilt((&mut bridge, &mut robot), &left, angles, wanted);
            assert_eq!((&first["frame"], &first["became"]), (&json!("base_link"), &json!("acted")));
            assert_eq!(first["rest"], json!([0.0, 0.0, 0.0, 0.0]));
            delays_ms.push(delay_ms(&first));
            left.with(|board| board.tilt(0.0));
            delays_ms.push(delay_ms(&robot.wait("zero", is_zero)));
        }
    }
    let tilts = delays_ms.len();

    // A gesture appears as a name in the diagnostics and as a goal of the arm.
    let mut told = None;
    for _ in 0..DRAWINGS {
        if !is_armed(&mut bridge) {
            bridge.wait("armed", armed);
        }
        robot.catch_up();
        let before = robot.seen.iter().map(|(_, v)| gestures(v)).max().unwrap_or(0);
        right.with(|board| board.perform(Motion::Circle, 4.0));
        let is_new = |v: &Value| started(v).is_some() && gestures(v) > before;
        let Some(came) = robot.wait_for(SOON, is_new) else { continue };
        if started(&came).is_some_and(|gesture| gesture["message"] == "circle") {
            told = Some(came);
            break;
        }
        // Even this network makes errors, and the arm must be at rest before the next attempt.
        println!("not a circle: {}", came["status"]["bimanual: gesture"]);
        bridge.wait("the other motion's end", |v| is(v, "motion-ended"));
    }
    let Some(told) = told else { bridge.fail("no circle starts a motion") };
    let gesture = started(&told).expect("as waited for");
    assert_eq!(gesture["outcome"], "started random-top");
    for part in ["bridge", "left hand", "right hand"] {
        let status = &told["status"][format!("bimanual: {part}")];
        assert_eq!(status["level"], 0, "{part}: {status}");
    }
    delays_ms.push(delay_ms(&told));
    let (middle_ms, worst_ms) = middle_and_worst(delays_ms);
    let quiet = lateness.was_quiet();

    let stamp_s = number(&told["stamp"]);
    let goal = robot.wait_from(0, "its goal", |v| is(v, "goal") && number(&v["t"]) >= stamp_s);
    let goal = robot.seen[goal].1.clone();
    println!(
        "boards to robot, decision to arrival: {tilts} tilts and a gesture, median {middle_ms:.2} ms, worst \
         {worst_ms:.2} ms; the gesture's diagnostics {:.2} ms, its goal {:.2} ms",
        delay_ms(&told),
        (number(&goal["t"]) - stamp_s) * 1000.0
    );
    assert!(!quiet || middle_ms <= DECISION_MS);
    let joints: Vec<String> = (1..=7).map(|joint| format!("joint_{joint}")).collect();
    assert_eq!(goal["joints"], json!(joints));
    let points = goal["points"].as_array().expect("points");
    let near = |point: &Value, pose: host_bridge::robot::Joints| {
        (0..7).all(|j| (number(&point[1][j]) - pose[j]).abs() < 0.05)
    };
    let last = &points[points.len() - 1];
    assert!(
        (1..=8).filter_map(|i| Motions::paper().pose(&format!("top-{i}"))).any(|pose| near(last, pose)),
        "it ends in the gesture's pose: {last}"
    );
    assert!((0..7).all(|j| number(&last[2][j]) == 0.0), "it ends at rest: {last}");
    let finished = robot.wait("the arm arrives", |v| is(v, "finished") && v["id"] == goal["id"]);
    assert_eq!(finished["status"], 4);
    bridge.has("arrival", |v| is(v, "motion-ended") && v["reached"] == true);

    // There are two types of silence: a disconnected cable, and a board whose program hangs while its port is open.
    type Silence = fn(&LeftStation);
    let silences: [(&str, Silence); 2] =
        [("its cable is pulled", |left| left.pull()), ("its program hangs", |left| left.pace(0.0))];
    let pulls = if is_full() { 10 } else { 1 };
    for (how, fall_silent) in std::iter::repeat_n(silences[0], pulls).chain([silences[1]]) {
        tilt((&mut bridge, &mut robot), &left, (0.6, 0.0), (0.5, 0.0));
        desk.pass(Duration::from_millis(400));
        bridge.catch_up();
        let (before, lateness, silent_s) = (bridge.seen.len(), Lateness::watch(), wall_s());
        fall_silent(&left);
        let zero = robot.wait("zero", is_zero);
        let silence_ms = (number(&zero["t"]) - silent_s) * 1000.0;
        println!("a board falls silent, {how}: zero at the robot after {silence_ms:.0} ms");
        assert!(!lateness.was_quiet() || silence_ms <= SILENCE_MS);
        bridge.wait_from(before, "the halt", |v| is(v, "halt"));
        left.plug();
    }
}
