//! A session with real links: bytes of boards (or keys) in, frames for boards and robot motion out.
//!
//! Sans-IO like the rest: whoever owns the links and the clock calls [`Live::receive`] and [`Live::step`].

use shared_proto::frame::{HOST_FRAME_MAX, encode_host};
use shared_proto::message::{HostMessage, Mode, TiltThresholds};

use crate::arm::ArmMotion;
use crate::arm::sequencer::{ArmReport, ArmState, NotStarted};
use crate::base::{Odometry, Twist};
use crate::bridge::{Bridge, BridgeEvent, EventKind};
use crate::config::{Config, Place};
use crate::keyboard::{HandKey, KeyLeft, KeyRight};
use crate::observe::{Now, OperatorKey, Tap, Turn};
use crate::robot::Robot;
use crate::ros2::RosRobot;
use crate::safety::Hand;
use crate::session::SessionEvent;
use crate::sim::{SimConfig, Simulator};

/// What stands for a hand.
enum Source {
    Nobody,
    /// A link elsewhere; what waits to be sent, newest last.
    Board(Vec<Vec<u8>>),
    KeyLeft(Box<KeyLeft>),
    KeyRight(Box<KeyRight>),
}

/// See the module.
pub struct Live {
    bridge: Bridge,
    robot: Simulator,
    /// The robot has been simulated up to here.
    robot_ms: u64,
    /// A robot on a ROS 2 graph, driven too.
    ros: Option<RosRobot>,
    sources: [Source; 2],
    tilt: TiltThresholds,
    request: u16,
    /// Request number of the set-up that a hand's board has not acknowledged, and when it was sent.
    set_ups: [Option<(u16, Option<u64>)>; 2],
    tap: Tap,
}

/// A set-up without an answer is sent again after this long.
const SET_UP_INTERVAL_MS: u64 = 1000;

impl Live {
    /// A session that starts at `now_ms` with the configured robot at rest, and nothing around it.
    pub fn new(config: &Config, left: Place, right: Place, now_ms: u64) -> Self {
        let sim = SimConfig { base: config.base, arm_limits: config.arm_limits(), ..SimConfig::default() };
        Live::with_robot(config, left, right, Simulator::new(sim), now_ms)
    }

    /// The same with a robot of your own.
    pub fn with_robot(config: &Config, left: Place, right: Place, robot: Simulator, now_ms: u64) -> Self {
        let source = |place, keys: Source| match place {
            Place::Nobody => Source::Nobody,
            Place::Board => Source::Board(Vec::new()),
            Place::Keyboard => keys,
        };
        Live {
            bridge: Bridge::with(config.motion_map(), config.speed, config.safety).awaiting([left, right]),
            robot,
            robot_ms: now_ms,
            ros: None,
            sources: [
                source(left, Source::KeyLeft(Box::new(KeyLeft::new(config.keyboard)))),
                source(right, Source::KeyRight(Box::new(KeyRight::new()))),
            ],
            tilt: config.tilt.into(),
            request: 0,
            set_ups: [None; 2],
            tap: Tap::default(),
        }
    }

    /// Where observers look on.
    pub fn tap_mut(&mut self) -> &mut Tap {
        &mut self.tap
    }

    /// The state at `now_ms`, as observers see it.
    pub fn now(&self, now_ms: u64) -> Now<'_> {
        Now { time_ms: now_ms, bridge: &self.bridge, robot: &self.robot }
    }

    /// Drives this robot too. Where it has an arm, that arm says whether a motion may start and how it ended;
    /// the simulator then only shows what was asked for.
    pub fn with_ros(mut self, robot: RosRobot) -> Self {
        self.ros = Some(robot);
        self
    }

    /// That robot.
    pub fn ros_mut(&mut self) -> Option<&mut RosRobot> {
        self.ros.as_mut()
    }

    /// The bridge.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The robot.
    pub fn robot(&self) -> &Simulator {
        &self.robot
    }

    /// Bytes of a hand's board. `now_ms` is the time at which they are *handled*: bytes that waited
    /// somewhere are thereby as old as they are, and dropped if they are too old.
    pub fn receive(&mut self, hand: Hand, bytes: &[u8], now_ms: u64) {
        self.tap.show(|observer| observer.received(now_ms, hand, bytes));
        let mut robot = both(&mut self.robot, &mut self.ros, now_ms);
        self.bridge.receive(hand, bytes, now_ms, &mut robot);
    }

    /// A key of those that stand for a hand.
    pub fn press(&mut self, key: HandKey, now_ms: u64) {
        for source in &mut self.sources {
            match source {
                Source::KeyLeft(hand) => hand.press(key, now_ms),
                Source::KeyRight(hand) => hand.press(key, now_ms),
                Source::Nobody | Source::Board(_) => {}
            }
        }
    }

    /// Such a key is up.
    pub fn release_hand_key(&mut self, key: HandKey) {
        if let Source::KeyLeft(hand) = &mut self.sources[0] {
            hand.release(key);
        }
    }

    /// The operator's stop.
    pub fn stop_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::Stop));
        let mut robot = both(&mut self.robot, &mut self.ros, now_ms);
        self.bridge.stop_key(now_ms, &mut robot);
    }

    /// The release key, pressed and confirmed.
    pub fn release_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::Release));
        let mut robot = both(&mut self.robot, &mut self.ros, now_ms);
        self.bridge.release_key(now_ms, &mut robot);
    }

    /// Lets the time become `now_ms`; call it every few milliseconds. `ready` says which hands' links
    /// take bytes now. What happened comes back; what is to be sent waits in [`Live::take_outgoing`].
    pub fn step(&mut self, now_ms: u64, ready: [bool; 2]) -> Vec<BridgeEvent> {
        // First what has passed: after a pause of this program the robot has stopped by itself, as a
        // real one would have.
        let passed_ms = now_ms.saturating_sub(self.robot_ms);
        self.tap.show(|observer| observer.turned(Turn::Moved(passed_ms)));
        self.robot.step(passed_ms);
        self.robot_ms = self.robot_ms.max(now_ms);
        if let Some(ros) = &mut self.ros {
            ros.step(now_ms);
        }
        for hand in [Hand::Left, Hand::Right] {
            self.play_keys(hand, now_ms);
            if ready[hand as usize] || !matches!(self.sources[hand as usize], Source::Board(_)) {
                let wanted = [self.bridge.poll(hand, now_ms), self.bridge.ping(hand, now_ms)];
                for message in wanted.into_iter().flatten() {
                    self.send(hand, &message, now_ms);
                }
            }
        }
        self.tap.show(|observer| observer.turned(Turn::Decided(now_ms)));
        self.bridge.step(now_ms, &mut both(&mut self.robot, &mut self.ros, now_ms));
        let events = self.bridge.take_events();
        for event in &events {
            if let EventKind::HandStarted { hand, .. } = event.kind {
                self.request = self.request.wrapping_add(1);
                self.set_ups[hand as usize] = Some((self.request, None));
            }
        }
        for hand in [Hand::Left, Hand::Right] {
            if ready[hand as usize] {
                self.set_up(hand, now_ms);
            }
        }
        if !self.tap.is_idle() {
            for event in &events {
                let event = SessionEvent::Bridge(event.clone());
                self.tap.show(|observer| observer.happened(&event));
            }
            let now = Now { time_ms: now_ms, bridge: &self.bridge, robot: &self.robot };
            self.tap.show(|observer| observer.state(&now));
        }
        events
    }

    /// The frames that wait for a hand's board.
    pub fn take_outgoing(&mut self, hand: Hand) -> Vec<Vec<u8>> {
        match &mut self.sources[hand as usize] {
            Source::Board(frames) => std::mem::take(frames),
            _ => Vec::new(),
        }
    }

    /// A board that has just started gets the thresholds; one that was left in record mode is called back.
    /// Asked until it answers.
    fn set_up(&mut self, hand: Hand, now_ms: u64) {
        let Some((request, sent_ms)) = self.set_ups[hand as usize] else { return };
        let answered = self.bridge.last_ack(hand).is_some_and(|ack| ack.request == request);
        if answered || !matches!(self.sources[hand as usize], Source::Board(_)) {
            self.set_ups[hand as usize] = None;
            return;
        }
        if sent_ms.is_some_and(|sent| now_ms.saturating_sub(sent) < SET_UP_INTERVAL_MS) {
            return;
        }
        self.set_ups[hand as usize] = Some((request, Some(now_ms)));
        let message = match hand {
            Hand::Left => HostMessage::SetThresholds { request, thresholds: self.tilt },
            Hand::Right => HostMessage::SetMode { request, mode: Mode::Classify },
        };
        self.send(hand, &message, now_ms);
    }

    fn send(&mut self, hand: Hand, message: &HostMessage<'_>, now_ms: u64) {
        let mut buffer = [0; HOST_FRAME_MAX];
        let Ok(frame) = encode_host(message, &mut buffer) else { return };
        self.tap.show(|observer| observer.sent(now_ms, hand, frame));
        let mut wire = Vec::new();
        match &mut self.sources[hand as usize] {
            Source::Nobody => {}
            Source::Board(frames) => frames.push(frame.to_vec()),
            Source::KeyLeft(keys) => keys.receive(frame, now_ms, &mut wire),
            Source::KeyRight(keys) => keys.receive(frame, now_ms, &mut wire),
        }
        if !wire.is_empty() {
            self.receive(hand, &wire, now_ms);
        }
    }

    fn play_keys(&mut self, hand: Hand, now_ms: u64) {
        let mut wire = Vec::new();
        match &mut self.sources[hand as usize] {
            Source::KeyLeft(keys) => keys.step(now_ms, &mut wire),
            Source::KeyRight(keys) => keys.step(now_ms, &mut wire),
            Source::Nobody | Source::Board(_) => {}
        }
        if !wire.is_empty() {
            self.receive(hand, &wire, now_ms);
        }
    }
}

/// The simulator and a robot elsewhere as one.
struct Both<'a> {
    simulator: &'a mut Simulator,
    ros: Option<&'a mut RosRobot>,
}

fn both<'a>(simulator: &'a mut Simulator, ros: &'a mut Option<RosRobot>, now_ms: u64) -> Both<'a> {
    let mut ros = ros.as_mut();
    if let Some(ros) = &mut ros {
        ros.at(now_ms);
    }
    Both { simulator, ros }
}

impl Both<'_> {
    fn arm_elsewhere(&mut self) -> Option<&mut RosRobot> {
        self.ros.as_deref_mut().filter(|ros| ros.moves_arm())
    }
}

impl Robot for Both<'_> {
    fn drive(&mut self, twist: Twist) {
        self.simulator.drive(twist);
        if let Some(ros) = &mut self.ros {
            ros.drive(twist);
        }
    }

    fn start_motion(&mut self, motion: ArmMotion) -> Result<(), NotStarted> {
        let Some(ros) = self.arm_elsewhere() else { return self.simulator.start_motion(motion) };
        ros.start_motion(motion)?;
        // Only a picture: it may still be busy with the last one.
        let _ = self.simulator.start_motion(motion);
        Ok(())
    }

    fn halt(&mut self) {
        self.simulator.halt();
        if let Some(ros) = &mut self.ros {
            ros.halt();
        }
    }

    fn arm(&self) -> ArmState {
        match &self.ros {
            Some(ros) if ros.moves_arm() => ros.arm(),
            _ => self.simulator.arm(),
        }
    }

    fn odometry(&self) -> Odometry {
        self.simulator.odometry()
    }

    fn take_arm_report(&mut self) -> Option<ArmReport> {
        let simulated = self.simulator.take_arm_report();
        match self.arm_elsewhere() {
            Some(ros) => ros.take_arm_report(),
            None => simulated,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bridge::GestureOutcome;
    use crate::safety::State;
    use shared_proto::message::Heading;

    const FORWARD: HandKey = HandKey::Arrow(Heading::Forward);

    struct Rig {
        live: Live,
        now_ms: u64,
        events: Vec<EventKind>,
    }

    impl Rig {
        fn new(left: Place, right: Place) -> Self {
            let live = Live::new(&Config::default(), left, right, 0);
            let mut rig = Rig { live, now_ms: 0, events: Vec::new() };
            rig.run(1000);
            rig
        }

        fn run(&mut self, ms: u64) {
            for _ in 0..ms {
                self.now_ms += 1;
                let events = self.live.step(self.now_ms, [true; 2]);
                self.events.extend(events.into_iter().map(|event| event.kind));
            }
        }

        fn press(&mut self, key: HandKey) {
            self.live.press(key, self.now_ms);
        }

        fn speed_m_s(&self) -> f64 {
            self.live.robot().odometry().twist.linear_m_s
        }
    }

    #[test]
    fn keys_arm_by_themselves_and_an_arrow_drives_for_600_ms_at_most() {
        let mut rig = Rig::new(Place::Keyboard, Place::Keyboard);
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
        let mut rig = Rig::new(Place::Keyboard, Place::Nobody);
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
        let mut rig = Rig::new(Place::Keyboard, Place::Keyboard);
        rig.press(FORWARD);
        rig.run(400);
        // The laptop was suspended: the robot's own timeout acts before the next step.
        rig.now_ms += 3000;
        rig.run(1);
        assert!(rig.live.robot().at_rest());
        assert_eq!(rig.live.bridge().twist().linear_m_s, 0.0);
    }

    #[test]
    fn q_and_z_change_the_cap_and_numbers_start_motions() {
        let mut rig = Rig::new(Place::Keyboard, Place::Keyboard);
        rig.press(HandKey::Faster);
        rig.press(HandKey::Faster); // the same press, repeated by the terminal
        rig.run(300);
        assert!((rig.live.bridge().caps().linear_m_s - 0.55).abs() < 1e-9);
        rig.press(HandKey::Slower);
        rig.run(100);
        assert!((rig.live.bridge().caps().linear_m_s - 0.495).abs() < 1e-9);
        rig.press(HandKey::Gesture(6));
        rig.run(100);
        rig.press(HandKey::Gesture(6));
        rig.run(100);
        let outcomes: Vec<_> = rig
            .events
            .iter()
            .filter_map(|event| match event {
                EventKind::Gesture { label, outcome, .. } => Some((label.as_str(), *outcome)),
                _ => None,
            })
            .collect();
        assert_eq!(
            outcomes,
            [("circle", GestureOutcome::Started(crate::arm::ArmMotion::RandomTop))],
            "a key held down is one gesture"
        );
    }

    #[test]
    fn a_stop_is_released_by_a_second_of_neutral_and_key_1() {
        let mut rig = Rig::new(Place::Keyboard, Place::Keyboard);
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
    fn a_robot_elsewhere_is_driven_too_and_its_arm_decides() {
        use crate::arm::profile::JointLimits;
        use crate::ros2::{Output, Ros2Config};
        let config = Config::default();
        let ros = RosRobot::new(&Ros2Config::default(), JointLimits::paper());
        let live = Live::new(&config, Place::Keyboard, Place::Keyboard, 0).with_ros(ros);
        let mut rig = Rig { live, now_ms: 0, events: Vec::new() };
        rig.run(1000);
        assert!(rig.live.ros_mut().unwrap().take_outputs().is_empty(), "armed, at rest");
        rig.press(FORWARD);
        rig.run(300);
        let sent = rig.live.ros_mut().unwrap().take_outputs();
        assert_eq!(sent, [Output::Twist(Twist { linear_m_s: 0.5, angular_rad_s: 0.0 })], "the newest");
        assert!(rig.speed_m_s() > 0.2, "the picture drives, too");
        rig.press(HandKey::Gesture(6));
        rig.run(100);
        let refused = |event: &EventKind| matches!(event, EventKind::MotionRefused { .. });
        assert!(rig.events.iter().any(refused), "nobody has told where the joints are");
        assert!(rig.live.robot().arm().at_rest(), "the picture does not run ahead");
    }

    #[test]
    fn a_new_board_is_told_its_thresholds_until_it_has_heard() {
        let mut live = Live::new(&Config::default(), Place::Board, Place::Nobody, 0);
        live.step(1, [false; 2]);
        assert!(live.take_outgoing(Hand::Left).is_empty(), "nothing is sent into a bootloader");
        live.step(2, [true; 2]);
        assert_eq!(live.take_outgoing(Hand::Left).len(), 1, "who is there?");
        let mut wire = Vec::new();
        send_hello(&mut wire);
        live.receive(Hand::Left, &wire, 3);
        let told = |live: &mut Live, now_ms: u64, ready: bool| {
            live.step(now_ms, [ready; 2]);
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
    }

    fn send_hello(wire: &mut Vec<u8>) {
        let mut keys = KeyLeft::new(crate::keyboard::KeyTimes::default());
        let mut buffer = [0; HOST_FRAME_MAX];
        let request = encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap();
        keys.receive(request, 0, wire);
    }
}
