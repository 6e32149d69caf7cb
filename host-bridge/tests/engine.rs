//! Tests the engine with keyboard hands and boards in virtual time.

use host_bridge::arm::Motions;
use host_bridge::arm::gen3::paper_limits;
use host_bridge::base::BaseConfig;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::keyboard::{HandKey, KeyLeft, KeyTimes};
use host_bridge::observe::SessionEvent;
use host_bridge::ros2::{Output, Ros2Config, RosRobot};
use host_bridge::safety::{Hand, State};
use host_bridge::source::HandSource as _;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX, encode_board, encode_host};
use shared_proto::message::{Board, BoardMessage, Heading, Hello, HostMessage, Mode, Signal, Text};

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _};

type Live = Engine<'static, Robot>;

const FORWARD: HandKey = HandKey::Arrow(Heading::Forward);

struct Rig {
    live: Live,
    now_ms: u64,
    events: Vec<EventKind>,
}

impl Rig {
    fn new(left: HandInput, right: HandInput) -> Self {
        let live = moving::live(&Config::default(), left, right);
        let mut rig = Rig { live, now_ms: 0, events: Vec::new() };
        rig.run(1000);
        rig
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ms += 1;
            let events = self.live.advance(self.now_ms, [true; 2]);
            self.events.extend(events.into_iter().filter_map(|event| match event {
                SessionEvent::Bridge(event) => Some(event.kind),
                _ => None,
            }));
        }
    }

    fn press(&mut self, key: HandKey) {
        self.live.press(key, self.now_ms);
    }

    fn speed_m_s(&self) -> f64 {
        self.live.door().odometry().twist.linear_m_s
    }
}

#[test]
fn keys_arm_by_themselves_and_an_arrow_drives_for_600_ms_at_most() {
    let mut rig = Rig::new(HandInput::Keyboard, HandInput::Keyboard);
    assert_eq!(rig.live.bridge().safety().state(), State::Armed);
    rig.press(FORWARD);
    rig.run(590);
    assert!(rig.speed_m_s() > 0.3, "{}", rig.speed_m_s());
    assert_eq!(rig.live.bridge().twist().linear_m_s, 0.5);
    rig.run(30);
    assert_eq!(rig.live.bridge().twist().linear_m_s, 0.0);
}

#[test]
fn a_held_arrow_drives_until_200_ms_after_its_last_repeat() {
    let mut rig = Rig::new(HandInput::Keyboard, HandInput::Nobody);
    rig.press(FORWARD);
    rig.run(500);
    for _ in 0..60 {
        rig.press(FORWARD);
        rig.run(33);
        assert_eq!(rig.live.bridge().twist().linear_m_s, 0.5);
    }
    rig.run(150);
    assert_eq!(rig.live.bridge().twist().linear_m_s, 0.5);
    rig.run(40);
    assert_eq!(rig.live.bridge().twist().linear_m_s, 0.0);
}

#[test]
fn a_bridge_that_stands_still_stops_a_held_arrow_like_any_silent_hand() {
    let mut rig = Rig::new(HandInput::Keyboard, HandInput::Keyboard);
    rig.press(FORWARD);
    rig.run(400);
    // The laptop was suspended. The robot's own timeout therefore takes effect before the next step.
    rig.now_ms += 3000;
    rig.run(1);
    assert!(rig.live.door().at_rest());
    assert_eq!(rig.live.bridge().twist().linear_m_s, 0.0);
}

#[test]
fn q_and_z_change_the_cap_and_numbers_start_motions() {
    let mut rig = Rig::new(HandInput::Keyboard, HandInput::Keyboard);
    rig.press(HandKey::Faster);
    rig.press(HandKey::Faster); // the same key press, repeated by the terminal
    rig.run(300);
    assert!((rig.live.bridge().caps().linear_m_s - 0.55).abs() < 1e-9);
    rig.press(HandKey::Slower);
    // A bend that is held counts after 130 ms, according to the board's rules.
    rig.run(200);
    assert!((rig.live.bridge().caps().linear_m_s - 0.495).abs() < 1e-9);
    rig.press(HandKey::Gesture(6));
    rig.run(100);
    rig.press(HandKey::Gesture(6));
    rig.run(100);
    let outcomes: Vec<_> = rig
        .events
        .iter()
        .filter_map(|event| match event {
            EventKind::Gesture { label, outcome, .. } => Some((label.as_str(), outcome.clone())),
            _ => None,
        })
        .collect();
    assert_eq!(
        outcomes,
        [("circle", GestureOutcome::Started("random-top".into()))],
        "a key held down is one gesture"
    );
}

#[test]
fn a_stop_is_released_by_a_second_of_neutral_and_key_1() {
    let mut rig = Rig::new(HandInput::Keyboard, HandInput::Keyboard);
    rig.live.stop_key(rig.now_ms);
    rig.run(500);
    rig.press(HandKey::Gesture(1));
    rig.run(800);
    assert_eq!(rig.live.bridge().safety().state(), State::Stopped);
    rig.press(HandKey::Gesture(1));
    rig.run(100);
    assert_eq!(rig.live.bridge().safety().state(), State::Armed);
}

#[test]
fn a_robot_on_a_graph_is_driven_by_the_same_engine_and_without_angles_nothing_starts() {
    let ros = RosRobot::new(&Ros2Config::default(), paper_limits(), BaseConfig::default());
    let door = host_bridge::arm::Director::new(ros, Motions::paper());
    let mut live = moving::live_before(door, &Config::default(), HandInput::Keyboard, HandInput::Keyboard, 0);
    let mut events = Vec::new();
    let mut now_ms = 0;
    let mut run = |live: &mut Engine<'static, _>, ms: u64| {
        for _ in 0..ms {
            now_ms += 1;
            events.extend(live.advance(now_ms, [true; 2]));
        }
        now_ms
    };
    let now_ms = run(&mut live, 1000);
    assert!(live.door_mut().robot_mut().take_outputs().is_empty(), "armed, at rest");
    live.press(FORWARD, now_ms);
    let now_ms = run(&mut live, 300);
    let sent = live.door_mut().robot_mut().take_outputs();
    let half = host_bridge::base::Twist { linear_m_s: 0.5, angular_rad_s: 0.0 };
    assert_eq!(sent, [Output::Twist(half)], "the newest");
    live.press(HandKey::Gesture(6), now_ms);
    run(&mut live, 100);
    let refused = |event: &SessionEvent| matches!(event, SessionEvent::Bridge(event) if matches!(event.kind, EventKind::MotionRefused { .. }));
    assert!(events.iter().any(refused), "nobody has told where the joints are");
    let snapshot = host_bridge::observe::Snapshot::of(&live.now(now_ms));
    assert_eq!((snapshot.arm_age_ms, snapshot.base_age_ms), (None, None), "nothing is known of the robot");
}

#[test]
fn a_new_board_is_told_its_thresholds_until_it_has_heard() {
    let mut live = moving::live(&Config::default(), HandInput::Board, HandInput::Nobody);
    live.advance(1, [false; 2]);
    assert!(live.take_outgoing(Hand::Left).is_empty(), "nothing is sent into a bootloader");
    live.advance(2, [true; 2]);
    assert_eq!(live.take_outgoing(Hand::Left).len(), 1, "who is there?");
    let mut wire = Vec::new();
    send_hello(&mut wire);
    live.receive(Hand::Left, &wire, 3);
    let told = |live: &mut Live, now_ms: u64, ready: bool| {
        live.advance(now_ms, [ready; 2]);
        let mut decoder = shared_proto::frame::Decoder::<HOST_FRAME_MAX>::new();
        let mut seen = Vec::new();
        for &byte in live.take_outgoing(Hand::Left).iter().flatten() {
            if let Some(HostMessage::SetThresholds { request, thresholds }) = decoder.push_host(byte) {
                assert_eq!(thresholds.start_mrad, 262);
                seen.push(request);
            }
        }
        seen
    };
    assert!(told(&mut live, 3, false).is_empty(), "the link takes nothing yet");
    assert_eq!(told(&mut live, 4, true), [1]);
    assert!(told(&mut live, 1003, true).is_empty());
    assert_eq!(told(&mut live, 1004, true), [1], "no answer");
    let ack = shared_proto::message::Ack {
        request: 1,
        result: shared_proto::message::AckResult::Ok,
        next_offset: 0,
    };
    let mut buffer = [0; shared_proto::frame::BOARD_FRAME_MAX];
    let message = shared_proto::message::BoardMessage::Ack(ack);
    let frame = shared_proto::frame::encode_board(&message, &mut buffer).unwrap();
    live.receive(Hand::Left, frame, 1005);
    assert!(told(&mut live, 5000, true).is_empty());
    // The board must also not remain in record mode.
    live.advance(7000, [true; 2]);
    let mut decoder = shared_proto::frame::Decoder::<HOST_FRAME_MAX>::new();
    let frames = live.take_outgoing(Hand::Left).concat();
    let mut messages = frames.iter().filter_map(|&byte| {
        let message = decoder.push_host(byte)?;
        Some(matches!(message, HostMessage::SetMode { request: 2, mode: Mode::Classify }))
    });
    assert!(messages.any(|back| back), "called back, again");
}

fn send_hello(wire: &mut Vec<u8>) {
    let mut keys = KeyLeft::new(KeyTimes::default());
    let mut buffer = [0; HOST_FRAME_MAX];
    let request = encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap();
    keys.receive(request, 0, wire);
    // Frames that are still due are sent in the next period.
    keys.step(0, wire);
}

/// Returns the vibration signals that a right board receives at its start and at a stop.
/// The board has this minor version of the protocol.
fn felt(wired: bool, minor: u8, ready: bool) -> Vec<Signal> {
    let mut config = Config::default();
    config.vibration.wired = wired;
    let mut live = moving::live(&config, HandInput::Nobody, HandInput::Board);
    let hello = BoardMessage::Hello(Hello {
        major: 1,
        minor,
        board: Board::RightXiao,
        firmware: Text("test"),
        boot_id: 1,
        model_id: 1,
        sample_hz: 100,
    });
    let mut buffer = [0; BOARD_FRAME_MAX];
    live.receive(Hand::Right, encode_board(&hello, &mut buffer).unwrap(), 1);
    live.advance(2, [ready; 2]);
    live.stop_key(3);
    live.advance(4, [ready; 2]);
    let mut decoder = Decoder::<HOST_FRAME_MAX>::new();
    let mut felt = Vec::new();
    for &byte in live.take_outgoing(Hand::Right).iter().flatten() {
        if let Some(HostMessage::Feel { signal }) = decoder.push_host(byte) {
            felt.push(signal);
        }
    }
    felt
}

#[test]
fn a_stop_is_felt_only_where_a_motor_is_wired_and_the_board_knows_how() {
    assert_eq!(felt(true, 2, true), [Signal::Ready, Signal::Stopped]);
    assert_eq!(felt(true, 3, true), [Signal::Ready, Signal::Stopped], "a later version");
    assert!(felt(true, 1, true).is_empty(), "an older board is not sent what it does not know");
    assert!(felt(false, 2, true).is_empty(), "not configured");
    assert!(felt(true, 2, false).is_empty(), "late is dropped");
}
