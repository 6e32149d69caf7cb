//! Tests the bundled session and recordings in general, from raw samples to the robot.

use std::path::Path;

use host_bridge::adc::AdcRecording;
use host_bridge::bridge::GestureOutcome;
use host_bridge::demo::Demo;
use host_bridge::hands::{LeftBoard, ModelFile, RightBoard, Wired};
use host_bridge::intent::MotionMap;
use host_bridge::safety::HaltReason;
use host_bridge::script::Script;
use host_bridge::session::{Session, Summary};
use host_bridge::source::{HandSource, Source};
use models::recording::Recording;

#[path = "support/moving.rs"]
mod moving;

#[allow(dead_code)]
#[path = "../examples/make-demo-session.rs"]
mod make_demo_session;

fn committed(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/demo").join(name);
    std::fs::read_to_string(path).unwrap()
}

fn left() -> AdcRecording {
    Demo::bundled().left
}

fn right() -> Recording {
    Demo::bundled().right
}

fn script() -> Script {
    Demo::bundled().script
}

/// Plays the session to its end.
fn run(left: Option<AdcRecording>, right: Option<Recording>, map: MotionMap) -> Summary {
    let model = ModelFile::bundled().unwrap();
    let left = left.map_or(Source::Nobody, |left| {
        Source::here(Wired::new(LeftBoard::new(left, Some(script().calibration.into()), 1)))
    });
    let right = right
        .map_or(Source::Nobody, |right| Source::here(Wired::new(RightBoard::new(right, &model, 1).unwrap())));
    let mut session = Session::new([left, right], map, moving::bare());
    while !session.finished() {
        session.step();
    }
    session.summary()
}

#[test]
fn every_gesture_of_the_demo_is_executed_in_order_and_the_base_ends_where_the_script_says() {
    let summary = run(Some(left()), Some(right()), MotionMap::default());
    let checks = script().expect.check(&summary);
    for check in &checks {
        println!("{check:?}");
    }
    println!("{:?}", summary.latency);
    papers_rows(&summary);
    assert!(checks.iter().all(|check| check.ok));
    assert!(summary.seconds < 100.0);
    assert_eq!(summary.latency.window_end_to_arm.count, 6);
    assert!(summary.latency.window_end_to_arm.worst_ms.unwrap() <= 50);
    assert!(summary.latency.sample_to_wheels.worst_ms.unwrap() <= 40);
    assert_eq!(summary.robot_timeouts, 0);
}

/// Prints the rows for `cargo xtask paper`: the start of each motion in the demo, and the components of the latency.
fn papers_rows(summary: &Summary) {
    let from_home_s = [3.3, 5.7, 6.1, 6.4, 7.1, 5.9];
    for (pose, paper_s) in summary.poses_reached.iter().zip(from_home_s) {
        let started = summary.gestures.iter().rfind(|gesture| gesture.time_ms < pose.time_ms);
        let gesture = started.expect("a gesture started it");
        let here_s = (pose.time_ms - gesture.time_ms) as f64 / 1000.0;
        println!(
            "paper: demo: time from gesture {} until pose {} is reached | {paper_s:.1} s from home | {here_s:.1} s",
            gesture.label, pose.motion
        );
    }
    let arm = summary.latency.window_end_to_arm;
    let wheels = summary.latency.sample_to_wheels;
    let ms = |value: Option<u64>| value.map_or_else(|| "–".to_owned(), |ms| ms.to_string());
    println!(
        "paper: demo: time from a gesture's last window until the arm starts, median and maximum | not stated | {} and {} ms",
        ms(arm.median_ms),
        ms(arm.worst_ms)
    );
    println!(
        "paper: demo: time from the left hand's sample until the wheels react, median and maximum | not stated | {} and {} ms",
        ms(wheels.median_ms),
        ms(wheels.worst_ms)
    );
}

#[test]
fn by_gestures_a_cup_is_picked_up_carried_while_the_base_drives_and_put_down_on_another_table() {
    let text = include_str!("../scenes/pick-and-place.toml");
    let scene = host_bridge::scene::Scene::parse(text).unwrap();
    let demo = Demo::named(scene.demo.as_deref()).unwrap();
    let expect = demo.script.expect.clone();
    let planner = host_bridge::plan::Planner::new(host_bridge::arm::model::SerialArm::gen3(), scene).unwrap();
    let model = ModelFile::bundled().unwrap();
    let mut session = demo.session(&model, MotionMap::default(), moving::in_scene(planner)).unwrap();
    while !session.finished() {
        session.step();
    }
    let summary = session.summary();
    let checks = expect.check(&summary);
    assert!(checks.iter().any(|check| check.what == "object"));
    assert!(checks.iter().all(|check| check.ok), "{checks:?}");
    let told: Vec<String> = summary.events.iter().map(|event| format!("{:?}", event.kind)).collect();
    let place = |words: &str| told.iter().position(|text| text.contains(words)).unwrap();
    assert!(place("has cup (60 mm)") < place("put cup down on other table"), "{told:#?}");
    assert_eq!(summary.robot_timeouts, 0);
    assert!(Demo::named(Some("nothing")).is_err());
}

#[test]
fn the_same_session_gives_the_same_summary() {
    let once = || run(Some(left()), Some(right()), MotionMap::default());
    assert_eq!(once(), once());
}

#[test]
fn the_demo_session_can_be_made_again() {
    let files = make_demo_session::files();
    assert!(files == make_demo_session::files(), "the same bytes each time");
    // Another machine may round the sine differently.
    // The last digit may then differ from the committed files.
    for (name, made) in files {
        let kept = committed(name);
        assert_eq!(made.lines().count(), kept.lines().count(), "{name}: run the example again");
        for (a, b) in made.lines().zip(kept.lines()) {
            let values =
                |line: &str| -> Option<Vec<f64>> { line.split(',').map(|v| v.parse().ok()).collect() };
            match (values(a), values(b)) {
                (Some(a), Some(b)) => {
                    let near = a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1.0);
                    assert!(near, "{name}: {a:?} is not {b:?}; run the example again");
                }
                _ => assert_eq!(a, b, "{name}: run the example again"),
            }
        }
    }
}

#[test]
fn a_recording_that_ends_leaves_the_robot_at_rest() {
    let mut cut = left();
    // The recording ends in the middle of the first drive.
    cut.samples.truncate(600);
    let summary = run(Some(cut), None, MotionMap::default());
    assert!(summary.odometry.path_m > 0.5);
    assert!(summary.at_rest);
    assert!(matches!(summary.halts[..], [halt] if matches!(halt.reason, HaltReason::Silence(_))));
}

#[test]
fn one_hand_alone_does_its_part() {
    let summary = run(None, Some(right()), MotionMap::default());
    assert_eq!(summary.odometry.path_m, 0.0);
    // Without a left hand there is no stop.
    // The second up-down therefore moves the arm home, and left-right arrives during that motion.
    assert_eq!(summary.poses_reached.len(), 6);
    assert_eq!(summary.drops.gestures_while_busy, 1);
    assert!(summary.frames.left.is_none());
    let summary = run(Some(left()), None, MotionMap::default());
    // Without a right hand the stop is never released, so later commands are dropped.
    assert_eq!((summary.stops, summary.releases), (1, 0));
    assert!(summary.odometry.path_m < 4.0);
    assert!(summary.gestures.is_empty());
}

#[test]
fn a_map_changes_what_a_gesture_does() {
    let mut map = MotionMap::default();
    map.assign("to-fro=place").unwrap();
    let summary = run(None, Some(right()), map);
    let outcome = &summary.gestures.iter().find(|gesture| gesture.label == "to-fro").unwrap().outcome;
    assert_eq!(*outcome, GestureOutcome::Started("place".into()));
}

/// A board with a bad cable. One byte in a thousand is damaged, and one in ten thousand is lost.
struct BadCable<B> {
    board: B,
    state: u32,
}

impl<B> BadCable<B> {
    fn random(&mut self, below: u32) -> u32 {
        self.state = self.state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.state >> 8) % below
    }
}

impl<B: HandSource> HandSource for BadCable<B> {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        let mut clean = Vec::new();
        self.board.step(now_ms, &mut clean);
        for byte in clean {
            match self.random(10_000) {
                0 => {}
                1..=10 => wire.push(byte ^ (1 << self.random(8))),
                _ => wire.push(byte),
            }
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        self.board.receive(bytes, now_ms, wire);
    }

    fn ended(&self) -> bool {
        self.board.ended()
    }
}

#[test]
fn a_bad_cable_costs_frames_but_no_gesture_no_bend_and_no_safety() {
    let model = ModelFile::bundled().unwrap();
    let left = LeftBoard::new(left(), Some(script().calibration.into()), 1);
    let right = RightBoard::new(right(), &model, 1).unwrap();
    let cables = [
        Source::here(BadCable { board: Wired::new(left), state: 1 }),
        Source::here(BadCable { board: Wired::new(right), state: 2 }),
    ];
    let mut session = Session::new(cables, MotionMap::default(), moving::bare());
    while !session.finished() {
        session.step();
    }
    let summary = session.summary();
    let frames = summary.frames;
    println!("{frames:?}");
    let (left, right) = (frames.left.unwrap(), frames.right.unwrap());
    assert!(left.damaged > 50 && right.damaged > 20);
    // Two frames that a damaged delimiter has joined count as a single damaged frame.
    // Damaged frames that do not count as lost are ping replies and status frames.
    // Ping replies and status frames have no sequence number.
    let unnumbered = summary.seconds as u32 * 11;
    assert!(left.lost > 20 && left.lost + unnumbered / 20 >= left.damaged, "{left:?}");
    assert!(right.lost > 10 && right.lost + unnumbered / 20 >= right.damaged, "{right:?}");
    assert!(script().expect.check(&summary).iter().all(|check| check.ok), "{summary:?}");
}
