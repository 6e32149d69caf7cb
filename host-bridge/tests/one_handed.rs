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

use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::demo::Demo;
use host_bridge::safety::{HaltReason, Hand, State};
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
struct Wearer {
    rig: Rig,
    sends_states: bool,
    sends_tilts: bool,
    /// Frames that arrive this many hops late.
    late_hops: usize,
    waiting: VecDeque<Vec<u8>>,
}

impl Wearer {
    /// Creates a wearer whose board has started.
    fn new(more: &str) -> Self {
        let mut rig = Rig::empty();
        let config = config(more);
        rig.bridge = config.bridge(config.motion_map()).awaiting(Hand::Right);
        let ahead_ms = rig.now_ms;
        rig.robot.pass(ahead_ms);
        rig.connect(Hand::Right, 1);
        rig.talking.right = false;
        Wearer { rig, sends_states: true, sends_tilts: true, late_hops: 0, waiting: VecDeque::new() }
    }

    fn armed() -> Self {
        let mut wearer = Wearer::new("");
        wearer.hold(0.0, 0.0, 6);
        assert_eq!(wearer.rig.state(), State::Armed);
        wearer
    }

    /// Keeps a tilt for some hops of 80 ms.
    fn hold(&mut self, pitch_deg: f64, roll_deg: f64, hops: u32) {
        for _ in 0..hops {
            let state = self.rig.right_frame();
            let tilt = RightTilt {
                sequence: self.rig.right.sequence,
                acceleration_mm_s2: tilted(pitch_deg, roll_deg),
            };
            let mut bytes = Vec::new();
            if self.sends_states {
                bytes.extend(state);
            }
            if self.sends_tilts {
                bytes.extend(encode(&BoardMessage::Tilt(tilt)));
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
    let mut wearer = Wearer::new("");
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
    let mut wearer = Wearer::armed();
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
        let mut wearer = Wearer::armed();
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
    let mut wearer = Wearer::armed();
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
    let mut wearer = Wearer::armed();
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
    let mut wearer = Wearer::armed();
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
    let mut wearer = Wearer::new("[jog]\nlabel = 'circle'\n");
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
fn of_version(minor: u8, labels: &str) -> Wearer {
    let mut wearer = Wearer::new("");
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

fn never_moves(wearer: &mut Wearer) {
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
        assert!(moved_m < 0.05, "{motion}: {moved_m} m");
        session.until(|robot| robot.arm().at_rest());
        session.run(1000);
    }
}

#[test]
fn zz_exp() {
    use models::synth::{IdleKind, Motion, Segment, Wearer, session as play};
    use host_bridge::worn::Level;
    let rows_of = |w: &Wearer, take, script: &[Segment]| -> wrist::Rows {
        play(w, take, script).samples().map(|s| std::array::from_fn(|i| f64::from(s[i]))).collect()
    };
    let mk = |r: &wrist::Rows| {
        let level = wrist::mean_mm_s2(&r[..200]);
        let tl = |p, q| { let rr: wrist::Rows = r[..200].iter().map(|v| wrist::tilted(*v, [p, q])).collect(); wrist::mean_mm_s2(&rr) };
        let l = Level::of(level).unwrap();
        let mut c = config("");
        c.one_handed = l.forward(c.one_handed, tl(30.0, 0.0)).unwrap();
        l.check_left(&c.one_handed, tl(0.0, 30.0)).unwrap();
        c
    };
    // idle kinds
    if std::env::var("IDLE").is_ok() {
    for kind in [IdleKind::Still, IdleKind::Fidget, IdleKind::Walk, IdleKind::Lift] {
        let (mut drove, mut total, mut stops) = (0, 0, 0);
        for w in 1..=8u32 {
            let wearer = Wearer::evaluation(31, w);
            let r = rows_of(&wearer, 60, &[Segment::new(Motion::IDLE, 6.5), Segment::new(Motion::Idle(kind), 20.0), Segment::new(Motion::Circle, 1.0)]);
            let c = mk(&r);
            let n = r.len();
            let mut s = Session::new(&c, Wrist::new(r, 0..n));
            s.run(4500);
            s.wrist().tilt(25.0, 0.0);
            s.run(2500);
            let mut was = s.asked_m_s() != 0.0;
            for _ in 0..1900 { s.run(10); let d = s.asked_m_s() != 0.0; total += 1; drove += u32::from(d); stops += u32::from(was && !d); was = d; }
        }
        println!("{kind:?}: drove {:.1} % of the time, {stops} stops in {} s", 100.0 * f64::from(drove) / f64::from(total), total / 100);
    }
    }
    let mut all = vec![];
    for w in 1..=12u32 {
        let wearer = Wearer::evaluation(31, w);
        for (g, gesture) in Motion::GESTURES.into_iter().enumerate() {
            let phase = (w as usize * 7 + g * 3) % 8;
            let start = 700 + phase;
            let r = rows_of(&wearer, g as u64, &[Segment::new(Motion::IDLE, start as f64 / 100.0), Segment::new(gesture, 2.5), Segment::new(Motion::IDLE, 1.5)]);
            let c = mk(&r);
            let n = r.len();
            let mut s = Session::new(&c, Wrist::new(r, 0..n));
            s.run(4500);
            s.wrist().tilt(25.0, 0.0);
            s.run(start as u64 * 10 - 4500);
            let speed = s.asked_m_s();
            let path = s.path_m();
            let mut rest = 0;
            let mut braked = 0;
            for ms in 1..3000 { s.run(1); if braked == 0 && s.asked_m_s() == 0.0 { braked = ms; } if rest == 0 && s.engine.door().at_rest() { rest = ms; } }
            let roll = s.path_m() - path;
            all.push(roll);
            println!("{} {gesture:?}: asked {speed}, brakes after {braked} ms, rests after {rest} ms, rolled {roll:.3} m {:?}", wearer.name, s.outcomes());
        }
    }
    all.sort_by(f64::total_cmp);
    println!("median {:.3} worst {:.3} of {}", all[all.len()/2], all[all.len()-1], all.len());
}
