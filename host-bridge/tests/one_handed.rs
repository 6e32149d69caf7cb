//! Tests one-handed mode in virtual time: the tilt of the right hand drives, its gestures stop the base,
//! and every rule of the left hand stays in force.
//!
//! Labels by number: 1 up-down (home, releases), 2 to-fro (pick-up), 6 circle.

#[path = "support/one_hand.rs"]
mod one_hand;
mod support;
#[path = "support/wrist.rs"]
mod wrist;

use std::collections::VecDeque;

use host_bridge::bridge::{BridgeEvent, EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::demo::Demo;
use host_bridge::describe;
use host_bridge::observe::{Now, SessionEvent, Snapshot};
use host_bridge::robot::Twist;
use host_bridge::safety::{HaltReason, Hand, State};
use host_bridge::worn::{Handedness, Level};
use models::synth::{IdleKind, Motion, Segment, Wearer, session as play};
use one_hand::Session;
use shared_proto::message::{
    Ack, AckResult, Board, BoardMessage, Hello, PROTOCOL_MAJOR, RightTilt, Text, health,
};
use support::{LABELS, Rig, Virtual as _, encode, model};
use wrist::Wrist;

const HOP_MS: u64 = 80;
/// Hops until the base follows a tilt, with a margin.
const TO_DRIVE: u32 = 12;
/// Braking from 0.5 m/s at 1 m/s² takes 0.5 s.
const REST_MS: u64 = 520;

fn config(more: &str) -> Config {
    Config::parse(&format!("[one_handed]\non = true\n{more}")).unwrap()
}

/// Mean acceleration of a hop at this tilt, in the default axes.
fn tilted(pitch_deg: f64, roll_deg: f64) -> [i16; 3] {
    let (pitch, roll) = (pitch_deg.to_radians(), roll_deg.to_radians());
    [-pitch.sin(), -pitch.cos() * roll.sin(), pitch.cos() * roll.cos()].map(|a| (9807.0 * a).round() as i16)
}

/// One hand whose states and tilts the test sets.
struct Driver {
    rig: Rig,
    sends_states: bool,
    sends_tilts: bool,
    /// Frames that arrive this many hops late.
    late_hops: usize,
    waiting: VecDeque<Vec<u8>>,
}

impl Driver {
    /// Creates a wearer whose board has started.
    fn new(more: &str) -> Self {
        let mut rig = Rig::empty();
        let config = config(more);
        rig.bridge = config.bridge(config.motion_map()).awaiting(Hand::Right);
        let ahead_ms = rig.now_ms;
        rig.robot.pass(ahead_ms);
        rig.connect(Hand::Right, 1);
        rig.talking.right = false;
        Driver { rig, sends_states: true, sends_tilts: true, late_hops: 0, waiting: VecDeque::new() }
    }

    fn armed() -> Self {
        let mut wearer = Driver::new("");
        wearer.hold(0.0, 0.0, 6);
        assert_eq!(wearer.rig.state(), State::Armed);
        wearer
    }

    /// Returns the state and the tilt of the next hop.
    fn frames(&mut self, pitch_deg: f64, roll_deg: f64) -> [Vec<u8>; 2] {
        let state = self.rig.right_frame();
        let sequence = self.rig.right.sequence;
        let tilt = RightTilt { sequence, acceleration_mm_s2: tilted(pitch_deg, roll_deg) };
        [state, encode(&BoardMessage::Tilt(tilt))]
    }

    /// Keeps a tilt for some hops of 80 ms.
    fn hold(&mut self, pitch_deg: f64, roll_deg: f64, hops: u32) {
        for _ in 0..hops {
            let [state, tilt] = self.frames(pitch_deg, roll_deg);
            let mut bytes = Vec::new();
            if self.sends_states {
                bytes.extend(state);
            }
            if self.sends_tilts {
                bytes.extend(tilt);
            }
            self.waiting.push_back(bytes);
            while self.waiting.len() > self.late_hops
                && let Some(bytes) = self.waiting.pop_front()
            {
                self.rig.send(Hand::Right, &bytes);
            }
            self.rig.run(HOP_MS);
        }
    }

    /// Draws a gesture for a second, and reports it at the end.
    fn draw(&mut self, label: u8) {
        self.rig.right.top = label;
        self.hold(20.0, 30.0, 12);
        self.rig.right.events = self.rig.right.events.wrapping_add(1);
        self.rig.right.label = label;
        self.rig.right.event_window_end_ms = self.rig.board_time_ms();
        self.hold(20.0, -10.0, 1);
        self.rig.right.top = 0;
    }

    fn asked_m_s(&self) -> f64 {
        self.rig.bridge.twist().linear_m_s
    }

    fn halts(&self) -> Vec<HaltReason> {
        let halt = |event: &EventKind| match event {
            EventKind::Halt { reason } => Some(*reason),
            _ => None,
        };
        self.rig.events.iter().filter_map(halt).collect()
    }

    fn problems(&self) -> Vec<String> {
        let problem = |event: &EventKind| match event {
            EventKind::HandUnusable { hand: Hand::Right, problem } => Some(problem.clone()),
            _ => None,
        };
        self.rig.events.iter().filter_map(problem).collect()
    }
}

#[test]
fn the_tilt_of_the_right_hand_drives_and_nothing_moves_before_it_was_level() {
    let mut wearer = Driver::new("");
    wearer.hold(25.0, 0.0, 40);
    assert_eq!(wearer.rig.state(), State::Waiting);
    assert!(!wearer.rig.take_moved());
    wearer.hold(0.0, 0.0, 6);
    assert_eq!(wearer.rig.state(), State::Armed);
    assert!(!wearer.rig.take_moved());
    for (pitch, roll, twist) in [
        (25.0, 0.0, (0.5, 0.0)),
        (-25.0, 0.0, (-0.5, 0.0)),
        (0.0, 25.0, (0.0, 0.5)),
        (0.0, -25.0, (0.0, -0.5)),
    ] {
        wearer.hold(pitch, roll, TO_DRIVE);
        let asked = wearer.rig.bridge.twist();
        assert_eq!((asked.linear_m_s, asked.angular_rad_s), twist, "{pitch}° {roll}°");
        wearer.hold(0.0, 0.0, 2);
        let asked = wearer.rig.bridge.twist();
        assert_eq!((asked.linear_m_s, asked.angular_rad_s), (0.0, 0.0));
    }
    // The page shows the tilt as that of the left hand.
    wearer.hold(25.0, 0.0, 1);
    assert!((wearer.rig.bridge.left_hand().0 - 436).abs() <= 2);
}

#[test]
fn a_gesture_stops_the_base_at_its_first_state_and_driving_again_needs_neutral() {
    let mut wearer = Driver::armed();
    wearer.hold(25.0, 0.0, TO_DRIVE);
    assert_eq!(wearer.asked_m_s(), 0.5);
    wearer.rig.right.top = 2;
    wearer.hold(25.0, 0.0, 1);
    assert_eq!(wearer.asked_m_s(), 0.0);
    wearer.draw(2);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::Started("pick-up".into())]);
    assert!(wearer.rig.arm_moves());
    wearer.hold(25.0, 0.0, 40);
    assert_eq!((wearer.asked_m_s(), wearer.rig.state()), (0.0, State::Armed), "not level since");
    wearer.hold(0.0, 0.0, 2);
    wearer.hold(25.0, 0.0, TO_DRIVE);
    assert_eq!(wearer.asked_m_s(), 0.5);
}

#[test]
fn silence_and_a_missing_tilt_halt_the_base_within_250_ms_and_for_good() {
    for (states, tilts) in [(false, false), (true, false), (false, true)] {
        let mut wearer = Driver::armed();
        wearer.hold(25.0, 0.0, TO_DRIVE);
        (wearer.sends_states, wearer.sends_tilts) = (states, tilts);
        // The newest sample is 80 ms old already.
        wearer.hold(25.0, 0.0, 1);
        assert_eq!(wearer.asked_m_s(), 0.5, "not before 250 ms");
        wearer.hold(25.0, 0.0, 2);
        assert_eq!((wearer.asked_m_s(), wearer.rig.state()), (0.0, State::Stale), "{states} {tilts}");
        assert_eq!(wearer.halts(), [HaltReason::Silence(Hand::Right)]);
        wearer.rig.run(REST_MS);
        assert!(wearer.rig.robot.at_rest());
        (wearer.sends_states, wearer.sends_tilts) = (true, true);
        wearer.rig.take_moved();
        wearer.hold(25.0, 0.0, 40);
        assert!(!wearer.rig.take_moved(), "tilted still");
        wearer.hold(0.0, 0.0, 6);
        assert_eq!(wearer.rig.state(), State::Armed);
        assert!(!wearer.rig.take_moved());
        wearer.hold(25.0, 0.0, TO_DRIVE);
        assert_eq!(wearer.asked_m_s(), 0.5);
    }
}

#[test]
fn late_tilts_neither_drive_nor_count_as_neutral() {
    let mut wearer = Driver::armed();
    wearer.hold(25.0, 0.0, TO_DRIVE);
    wearer.late_hops = 4;
    wearer.hold(25.0, 0.0, 6);
    assert_eq!((wearer.asked_m_s(), wearer.rig.state()), (0.0, State::Stale));
    wearer.rig.run(REST_MS);
    wearer.rig.take_moved();
    wearer.hold(0.0, 0.0, 40);
    wearer.hold(25.0, 0.0, 40);
    assert_eq!(wearer.rig.state(), State::Stale);
    assert!(!wearer.rig.take_moved());
}

#[test]
fn a_hand_in_doubt_halts_and_a_restarted_one_must_be_level_first() {
    let mut wearer = Driver::armed();
    wearer.hold(25.0, 0.0, TO_DRIVE);
    wearer.rig.right.health = health::GAP;
    wearer.hold(25.0, 0.0, 1);
    assert_eq!((wearer.asked_m_s(), wearer.rig.state()), (0.0, State::Stale));
    assert_eq!(wearer.halts(), [HaltReason::Unhealthy(Hand::Right)]);
    wearer.rig.right.health = 0;
    wearer.hold(25.0, 0.0, 20);
    assert_eq!(wearer.asked_m_s(), 0.0);
    wearer.hold(0.0, 0.0, 6);
    wearer.hold(25.0, 0.0, TO_DRIVE);
    assert_eq!(wearer.asked_m_s(), 0.5);
    wearer.rig.connect(Hand::Right, 2);
    wearer.rig.talking.right = false;
    assert_eq!(wearer.asked_m_s(), 0.0);
    wearer.hold(25.0, 0.0, 40);
    assert_eq!(wearer.asked_m_s(), 0.0);
    wearer.hold(0.0, 0.0, 6);
    wearer.hold(25.0, 0.0, TO_DRIVE);
    assert_eq!(wearer.asked_m_s(), 0.5);
}

#[test]
fn a_stop_is_released_by_up_down_after_a_second_of_rest_in_the_level_pose() {
    let mut wearer = Driver::armed();
    wearer.hold(25.0, 0.0, TO_DRIVE);
    let now_ms = wearer.rig.now_ms;
    wearer.rig.bridge.stop_key(now_ms, &mut wearer.rig.robot);
    assert_eq!((wearer.asked_m_s(), wearer.rig.state()), (0.0, State::Stopped));
    // The hand rests, but it is not level.
    wearer.hold(25.0, 0.0, 20);
    wearer.draw(1);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::NotArmed]);
    wearer.hold(0.0, 0.0, 10);
    wearer.draw(1);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::NotArmed], "only 0.8 s");
    wearer.hold(0.0, 0.0, 16);
    wearer.draw(1);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::Released]);
    wearer.hold(25.0, 0.0, 20);
    assert_eq!(wearer.asked_m_s(), 0.0, "the release moves nothing, and the hand was not level since");
    wearer.hold(0.0, 0.0, 2);
    wearer.hold(25.0, 0.0, TO_DRIVE);
    assert_eq!(wearer.asked_m_s(), 0.5);
}

#[test]
fn the_clutch_lends_the_tilt_to_the_arm_and_drawing_is_no_rest() {
    let mut wearer = Driver::new("[jog]\nlabel = 'circle'\n");
    wearer.hold(0.0, 0.0, 6);
    wearer.draw(6);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::Lent]);
    wearer.hold(0.0, 0.0, 6);
    assert_eq!(wearer.rig.state(), State::Armed);
    wearer.hold(35.0, 0.0, TO_DRIVE);
    assert!(wearer.rig.arm_moves());
    assert_eq!((wearer.asked_m_s(), wearer.rig.speed_m_s()), (0.0, 0.0));
    wearer.rig.right.top = 2;
    wearer.hold(35.0, 0.0, 1);
    assert!(wearer.halts().contains(&HaltReason::NotAtRest));
    assert_eq!(wearer.rig.state(), State::Waiting);
}

/// Starts a board whose hello has this minor version.
fn of_version(minor: u8, labels: &str) -> Driver {
    let mut wearer = Driver::new("");
    let hello = Hello {
        major: PROTOCOL_MAJOR,
        minor,
        board: Board::RightNano33,
        firmware: Text("old"),
        boot_id: 2,
        model_id: 1,
        sample_hz: 100,
    };
    wearer.rig.send(Hand::Right, &encode(&BoardMessage::Hello(hello)));
    wearer.rig.send(Hand::Right, &model(labels));
    wearer
}

fn never_moves(wearer: &mut Driver) {
    wearer.hold(0.0, 0.0, 20);
    wearer.hold(25.0, 0.0, 20);
    wearer.draw(2);
    assert_eq!(wearer.rig.state(), State::Stale);
    assert!(!wearer.rig.take_moved());
}

#[test]
fn a_board_that_cannot_send_its_tilt_is_refused_by_name_and_moves_nothing() {
    let mut old = of_version(5, LABELS);
    never_moves(&mut old);
    let [problem] = &old.problems()[..] else { panic!("{:?}", old.problems()) };
    assert!(problem.contains("wire 1.5") && problem.contains("update the board to wire 1.6"), "{problem}");

    let mut restless = of_version(6, "wave,circle");
    never_moves(&mut restless);
    let [problem] = &restless.problems()[..] else { panic!("{:?}", restless.problems()) };
    assert!(problem.contains("resting class"), "{problem}");

    for (result, word) in
        [(AckResult::Unsupported, "update the board"), (AckResult::NotBonded, "pair the board")]
    {
        let mut wearer = of_version(6, LABELS);
        let ack = Ack { request: 1, result, next_offset: 0 };
        wearer.rig.send(Hand::Right, &encode(&BoardMessage::Ack(ack)));
        wearer.rig.send(Hand::Right, &encode(&BoardMessage::Ack(ack)));
        never_moves(&mut wearer);
        let [problem] = &wearer.problems()[..] else { panic!("{:?}", wearer.problems()) };
        assert!(problem.contains(word), "{problem}");
        // A board that can starts anew.
        wearer.rig.connect(Hand::Right, 3);
        wearer.rig.talking.right = false;
        wearer.hold(0.0, 0.0, 6);
        assert_eq!(wearer.rig.state(), State::Armed);
    }
}

#[test]
fn lines_and_pictures_name_the_right_hand_and_never_a_left_one() {
    let mut wearer = Driver::new("[jog]\nlabel = 'circle'\n");
    wearer.hold(0.0, 0.0, 6);
    wearer.hold(25.0, 0.0, TO_DRIVE);
    wearer.hold(0.0, 0.0, 6);
    wearer.hold(0.0, -25.0, TO_DRIVE);
    wearer.hold(0.0, 0.0, 6);
    wearer.draw(6);
    wearer.hold(0.0, 0.0, 6);
    wearer.draw(6);
    wearer.hold(0.0, 0.0, 6);
    wearer.sends_tilts = false;
    wearer.hold(0.0, 0.0, 6);
    let events =
        wearer.rig.events.iter().map(|kind| {
            describe::text(&SessionEvent::Bridge(BridgeEvent { time_ms: 0, kind: kind.clone() }))
        });
    let lines: Vec<String> = events.collect();
    assert!(lines.iter().all(|line| !line.contains("left hand")), "{lines:#?}");
    for line in [
        "right hand: forward at 0.50 m/s",
        "right hand: turn right at 29°/s",
        "right hand: base halts",
        "jogging: the right hand moves the arm's tool, the base stands still",
        "jogging ends: the right hand drives the base",
        "HALT: nothing valid from the right hand for 250 ms",
    ] {
        assert!(lines.iter().any(|said| said == line), "{line} in {lines:#?}");
    }
    let rig = &wearer.rig;
    let now = Now { time_ms: rig.now_ms, bridge: &rig.bridge, robot: &rig.robot };
    let snapshot = Snapshot::of(&now);
    assert!(snapshot.one_handed && !snapshot.left.link.connected && snapshot.right.link.connected);
}

#[test]
fn with_two_hands_the_tilt_of_the_right_one_has_no_effect() {
    let mut rig = Rig::armed();
    rig.talking.right = false;
    for _ in 0..40 {
        rig.send_right();
        let sequence = rig.right.sequence;
        let tilt = RightTilt { sequence, acceleration_mm_s2: tilted(25.0, 0.0) };
        rig.send(Hand::Right, &encode(&BoardMessage::Tilt(tilt)));
        rig.run(HOP_MS);
    }
    assert_eq!(rig.state(), State::Armed);
    assert!(!rig.take_moved());
}

/// Samples in which the demo's wearer only rests.
const RESTING: std::ops::Range<usize> = 4250..5100;

/// The wrist of the demo's wearer.
fn demo_wrist() -> Wrist {
    let recording = Demo::bundled().right.resampled();
    let rows = recording.samples().map(|sample| std::array::from_fn(|axis| sample[axis].into())).collect();
    Wrist::new(rows, RESTING)
}

#[test]
fn one_hand_drives_a_square_with_the_bundled_model_and_its_gestures_move_the_arm_alone() {
    let mut session = Session::new(&config(""), demo_wrist());
    session.run(4000);
    assert_eq!(session.engine.bridge().safety().state(), State::Armed);
    for side in 0..4 {
        let path_m = session.path_m();
        session.wrist().tilt(25.0, 0.0);
        session.until(|robot| robot.odometry().path_m > path_m + 0.9);
        session.level();
        let target_rad = f64::from(side + 1) * std::f64::consts::FRAC_PI_2 - 0.14;
        session.wrist().tilt(0.0, 25.0);
        session.until(|robot| robot.odometry().heading_rad > target_rad);
        session.level();
    }
    let end = session.engine.door().odometry();
    println!(
        "square: x {:.2} m, y {:.2} m, heading {:.2} rad, path {:.2} m",
        end.x_m, end.y_m, end.heading_rad, end.path_m
    );
    assert!(end.x_m.hypot(end.y_m) < 0.3, "back at the start");
    assert!((end.heading_rad - std::f64::consts::TAU).abs() < 0.3);
    assert!((3.6..5.2).contains(&end.path_m));
    assert_eq!(session.outcomes(), [], "driving is no gesture");

    // Start of each of the demo's gestures in s, and its motion.
    let gestures = [
        (3.0, "home"),
        (8.8, "pick-up"),
        (24.6, "place"),
        (38.0, "place-top-right"),
        (51.8, "place-bottom-right"),
        (66.4, "random-top"),
    ];
    for (onset_s, motion) in gestures {
        session.events.clear();
        let path_m = session.path_m();
        let onset = (100.0 * onset_s) as usize;
        session.wrist().drawing = Some(onset - 30..onset + 400);
        session.run(5000);
        let moved_m = session.path_m() - path_m;
        println!("{motion}: the base moves {:.1} cm while the gesture is drawn", 100.0 * moved_m);
        assert_eq!(session.outcomes(), [GestureOutcome::Started(motion.into())]);
        assert!(moved_m < 0.000_5, "{motion}: {moved_m} m");
        session.until(|robot| robot.arm().at_rest());
        session.run(1000);
    }
}

/// A wearer whom neither the model nor any constant of the mode was chosen for.
fn stranger(number: u32) -> Wearer {
    Wearer::evaluation(41, number)
}

/// Plays this script on the wearer's wrist. The board's axes are found as `calibrate --one-handed` finds them.
fn played(wearer: &Wearer, take: u64, script: &[Segment]) -> Session {
    let rows: wrist::Rows = play(wearer, take, script)
        .samples()
        .map(|sample| std::array::from_fn(|axis| sample[axis].into()))
        .collect();
    let tilted = |deg: [f64; 2]| {
        let rows: wrist::Rows = rows[..60].iter().map(|row| wrist::tilted(*row, deg)).collect();
        wrist::mean_mm_s2(&rows)
    };
    let mut config = config("");
    let level = Level::of(tilted([0.0, 0.0])).unwrap();
    config.one_handed = level.forward(config.one_handed, Handedness::Right, tilted([30.0, 0.0])).unwrap();
    level.check_left(&config.one_handed, tilted([0.0, 30.0])).unwrap();
    let all = 0..rows.len();
    Session::new(&config, Wrist::new(rows, all))
}

/// The base brakes at the latest with the fourth hop that ends after a gesture has begun.
/// The first hop contains only a part of the first stroke, which begins at rest.
const BRAKES_WITHIN_MS: u64 = 4 * HOP_MS;

#[test]
fn a_gesture_that_begins_while_the_base_drives_brakes_it_within_four_hops() {
    let Config { speed, base, .. } = config("");
    let braking_m_s2 = base.wheel_acceleration_max_rad_s2 * base.wheel_radius_m;
    let limit_m = speed.start * 0.001 * BRAKES_WITHIN_MS as f64 + speed.start.powi(2) / (2.0 * braking_m_s2);
    let wearers = if std::env::var_os("BIMANUAL_FULL").is_some() { 60 } else { 10 };
    let (mut rolled_m, mut brakes_ms) = (Vec::new(), Vec::new());
    for number in 1..=wearers {
        for (motion, gesture) in Motion::GESTURES.into_iter().enumerate() {
            // The gesture begins anywhere in a hop, and in each of the four headings.
            let start_ms = 7000 + 10 * ((7 * u64::from(number) + 3 * motion as u64) % 8);
            let [pitch_deg, roll_deg] =
                [[25.0, 0.0], [-25.0, 0.0], [0.0, 25.0], [0.0, -25.0]][number as usize % 4];
            let idle = Segment::new(Motion::IDLE, start_ms as f64 / 1000.0);
            let script = [idle, Segment::new(gesture, 2.5), Segment::new(Motion::IDLE, 1.5)];
            let mut session = played(&stranger(number), motion as u64, &script);
            session.run(4500);
            session.wrist().tilt(pitch_deg, roll_deg);
            session.run(start_ms - 4500);
            let path_m = session.path_m();
            if session.engine.bridge().twist() == Twist::ZERO {
                // The model saw no rest in this hand, so it did not drive.
                continue;
            }
            let brakes = (1..3000).find(|_| {
                session.run(1);
                session.engine.bridge().twist() == Twist::ZERO
            });
            session.run(REST_MS);
            assert!(session.engine.door().at_rest());
            brakes_ms.push(brakes.unwrap());
            rolled_m.push(session.path_m() - path_m);
        }
    }
    rolled_m.sort_by(f64::total_cmp);
    brakes_ms.sort_unstable();
    let count = brakes_ms.len();
    let (worst_ms, worst_m) = (brakes_ms[count - 1], rolled_m[count - 1]);
    let what = "a gesture begins while one hand drives";
    println!(
        "row: {what}: brakes | {count} | {worst_ms} ms, median {} ms | {BRAKES_WITHIN_MS} ms",
        brakes_ms[count / 2]
    );
    println!(
        "row: {what}: rolls on | {count} | {worst_m:.3} m, median {:.3} m | {limit_m:.3} m",
        rolled_m[count / 2]
    );
    // Nearly all of them drove.
    assert!(10 * count >= 8 * 6 * wearers as usize, "{count}");
    assert!(worst_ms <= BRAKES_WITHIN_MS, "{worst_ms} ms");
    assert!(worst_m <= limit_m, "{worst_m} m");
}

#[test]
fn a_wearer_who_walks_can_drive() {
    let (mut drove_ms, mut all_ms) = (0, 0);
    for number in 1..=6 {
        let script = [
            Segment::new(Motion::IDLE, 5.0),
            Segment::new(Motion::Idle(IdleKind::Walk), 12.0),
            Segment::new(Motion::Circle, 1.0),
        ];
        let mut session = played(&stranger(number), 0, &script);
        // The wearer walks before the hand tilts.
        session.run(6000);
        // If the base does not follow for 2 s, the wearer levels the hand for a second.
        let mut waits_ms = 0;
        for _ in 0..1000 {
            session.wrist().tilt(if waits_ms > 2000 { 0.0 } else { 25.0 }, 0.0);
            session.run(10);
            let drives = session.asked_m_s() > 0.0;
            waits_ms = if drives || waits_ms > 3000 { 0 } else { waits_ms + 10 };
            (drove_ms, all_ms) = (drove_ms + if drives { 10 } else { 0 }, all_ms + 10);
        }
    }
    println!(
        "wearers who walk drive in {:.0} % of the time",
        100.0 * f64::from(drove_ms) / f64::from(all_ms)
    );
    // Walking alone often looks like no tilt, or like no rest. The rule for sudden movements must not add to that.
    assert!(3 * drove_ms > all_ms, "{drove_ms} of {all_ms} ms");
}

/// What goes wrong while one hand drives.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// Nothing arrives, and nobody answers.
    Cut,
    /// The states are missing, or the tilts.
    NoStates,
    NoTilts,
    /// The board repeats its last state and its last tilt.
    Frozen,
    /// The numbers of the board's states increase, but its clock stands still.
    ClockStopped,
    /// States and tilts arrive, but no answers to pings.
    Unanswered,
}

#[test]
fn a_cut_link_a_silent_and_a_frozen_board_halt_a_base_that_one_hand_drives() {
    use Fault::{ClockStopped, Cut, Frozen, NoStates, NoTilts, Unanswered};
    for fault in [Cut, NoStates, NoTilts, Frozen, ClockStopped, Unanswered] {
        let limit_ms = if fault == Unanswered { 500 } else { 250 };
        let mut worst_ms = 0;
        let phases = 40;
        for phase in 0..phases {
            let mut wearer = Driver::armed();
            wearer.hold(25.0, 0.0, TO_DRIVE);
            // The newest sample was sent now.
            let last = wearer.frames(25.0, 0.0).concat();
            wearer.rig.send(Hand::Right, &last);
            let from_ms = wearer.rig.now_ms;
            wearer.rig.run(phase);
            wearer.rig.answering.right = !matches!(fault, Cut | Unanswered);
            let stopped_ms = wearer.rig.board_time_ms();
            let mut halted_ms = None;
            for ms in 1..1000_u64 {
                if ms.is_multiple_of(HOP_MS) {
                    let [state, tilt] = wearer.frames(25.0, 0.0);
                    match fault {
                        Cut => {}
                        NoStates => wearer.rig.send(Hand::Right, &tilt),
                        NoTilts => wearer.rig.send(Hand::Right, &state),
                        Frozen => wearer.rig.send(Hand::Right, &last),
                        ClockStopped => {
                            let ahead_ms = wearer.rig.board_ahead_ms;
                            let passed_ms = wearer.rig.board_time_ms().wrapping_sub(stopped_ms);
                            wearer.rig.board_ahead_ms = ahead_ms.wrapping_sub(passed_ms);
                            let stale = wearer.frames(25.0, 0.0).concat();
                            wearer.rig.board_ahead_ms = ahead_ms;
                            wearer.rig.send(Hand::Right, &stale);
                        }
                        Unanswered => wearer.rig.send(Hand::Right, &[state, tilt].concat()),
                    }
                }
                wearer.rig.run(1);
                if wearer.rig.bridge.twist() == Twist::ZERO {
                    halted_ms = Some(wearer.rig.now_ms - from_ms);
                    break;
                }
            }
            let halted_ms = halted_ms.unwrap_or_else(|| panic!("{fault:?} {phase}: no halt"));
            // Samples and answers are as old as the link, or the board's clock, that stopped in this phase.
            let ends = matches!(fault, Unanswered | ClockStopped);
            let since_fault_ms = if ends { halted_ms - phase } else { halted_ms };
            worst_ms = worst_ms.max(since_fault_ms);
            assert!(since_fault_ms <= limit_ms, "{fault:?} {phase}: {since_fault_ms} ms");
            assert_ne!(wearer.rig.state(), State::Armed);
            wearer.rig.run(REST_MS);
            assert!(wearer.rig.robot.at_rest());
        }
        println!(
            "row: one hand drives: {fault:?} | {phases} phases | halt after {worst_ms} ms | {limit_ms} ms"
        );
    }
}
