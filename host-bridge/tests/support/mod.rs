//! Two hands controlled by the test, connected to a bridge and the simulated robot, in virtual time.
#![allow(dead_code)] // each test file uses its own part

use host_bridge::bridge::{Bridge, EventKind, GestureOutcome};
use host_bridge::intent::MotionMap;
use host_bridge::safety::{Hand, PerHand, State};
use shared_proto::frame::{BOARD_FRAME_MAX, encode_board};
use shared_proto::message::{
    Board, BoardMessage, Bytes, Heading, Hello, HostMessage, LeftState, ModelInfo, PROTOCOL_MAJOR,
    PROTOCOL_MINOR, Pong, RightState, Text,
};

#[path = "moving.rs"]
pub mod moving;

#[allow(unused_imports)] // each test file uses its own part
pub use moving::{Robot, Virtual, bare, pose};

pub const LABELS: &str = "idle,up-down,to-fro,left-right,rectangle,rectangle-flat,circle";

pub fn encode(message: &BoardMessage<'_>) -> Vec<u8> {
    encode_board(message, &mut [0; BOARD_FRAME_MAX]).unwrap().to_vec()
}

pub fn hello(hand: Hand, boot_id: u32) -> Vec<u8> {
    let board = if hand == Hand::Left { Board::LeftNano } else { Board::RightNano33 };
    hello_of(board, boot_id, PROTOCOL_MAJOR)
}

pub fn hello_of(board: Board, boot_id: u32, major: u8) -> Vec<u8> {
    let (minor, firmware) = (PROTOCOL_MINOR, Text("test"));
    encode(&BoardMessage::Hello(Hello {
        major,
        minor,
        board,
        firmware,
        boot_id,
        model_id: 1,
        sample_hz: 100,
    }))
}

pub fn model(labels: &str) -> Vec<u8> {
    let labels = Text(labels);
    let (model_id, recipe, axes, sample_hz, window) = (1, 0, 9, 100, 200);
    encode(&BoardMessage::ModelInfo(ModelInfo { model_id, recipe, axes, sample_hz, window, labels }))
}

/// The right hand's state, set by the test.
#[derive(Clone, Copy)]
pub struct RightHand {
    pub sequence: u16,
    pub events: u8,
    pub label: u8,
    pub event_window_end_ms: u32,
    /// The label with the highest score.
    pub top: u8,
    pub health: u8,
}

/// Both hands, the bridge and the robot.
pub struct Rig {
    pub bridge: Bridge,
    pub robot: Robot,
    pub now_ms: u64,
    pub left: LeftState,
    pub right: RightHand,
    /// Whether each hand sends its state regularly.
    pub talking: PerHand<bool>,
    /// Whether each hand replies to pings immediately.
    pub answering: PerHand<bool>,
    /// Offset of the boards' clocks from the laptop's clock.
    pub board_ahead_ms: u32,
    pub events: Vec<EventKind>,
    /// Whether the robot has moved since the last query.
    pub moved: bool,
}

impl Rig {
    /// Creates a rig without a connected hand.
    pub fn empty() -> Self {
        let neutral = LeftState { heading: Heading::Neutral, ..LeftState::default() };
        Rig {
            bridge: Bridge::new(MotionMap::default()),
            robot: bare(),
            now_ms: 10_000,
            left: neutral,
            right: RightHand {
                sequence: 0,
                events: 0,
                label: 255,
                event_window_end_ms: 0,
                top: 0,
                health: 0,
            },
            talking: PerHand::default(),
            answering: [true; 2].into(),
            board_ahead_ms: 0x8000_0000,
            events: Vec::new(),
            moved: false,
        }
    }

    pub fn with(hands: &[Hand]) -> Self {
        let mut rig = Rig::empty();
        for &hand in hands {
            rig.connect(hand, 1);
        }
        rig
    }

    /// Creates a rig with both hands connected, neutral and armed.
    pub fn armed() -> Self {
        let mut rig = Rig::with(&[Hand::Left, Hand::Right]);
        rig.run(200);
        assert_eq!(rig.state(), State::Armed);
        rig
    }

    pub fn connect(&mut self, hand: Hand, boot_id: u32) {
        self.send(hand, &hello(hand, boot_id));
        if hand == Hand::Right {
            self.send(hand, &model(LABELS));
        }
        self.talking[hand] = true;
    }

    pub fn send(&mut self, hand: Hand, bytes: &[u8]) {
        self.bridge.receive(hand, bytes, self.now_ms, &mut self.robot);
    }

    pub fn board_time_ms(&self) -> u32 {
        (self.now_ms as u32).wrapping_add(self.board_ahead_ms)
    }

    pub fn left_frame(&mut self) -> Vec<u8> {
        self.left.sequence = self.left.sequence.wrapping_add(1);
        self.left.board_time_ms = self.board_time_ms();
        encode(&BoardMessage::Left(self.left))
    }

    pub fn right_frame(&mut self) -> Vec<u8> {
        self.right.sequence = self.right.sequence.wrapping_add(1);
        let mut scores = [0x80_u8; 7];
        scores[usize::from(self.right.top)] = 0x7F;
        let right = self.right;
        encode(&BoardMessage::Right(RightState {
            sequence: right.sequence,
            board_time_ms: self.board_time_ms(),
            events: right.events,
            label: right.label,
            confidence: 250,
            event_window_end_ms: right.event_window_end_ms,
            scores: Bytes(&scores),
            health: right.health,
        }))
    }

    pub fn send_left(&mut self) {
        let frame = self.left_frame();
        self.send(Hand::Left, &frame);
    }

    pub fn send_right(&mut self) {
        let frame = self.right_frame();
        self.send(Hand::Right, &frame);
    }

    fn answer_ping(&mut self, hand: Hand) {
        if let Some(HostMessage::Ping { id }) = self.bridge.ping(hand, self.now_ms)
            && self.answering[hand]
        {
            let board_time_ms = self.board_time_ms();
            self.send(hand, &encode(&BoardMessage::Pong(Pong { id, board_time_ms })));
        }
    }

    /// Advances the time. Meanwhile, hands that talk send a state every 20 ms, and hands that answer reply to pings.
    pub fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.answer_ping(Hand::Left);
            self.answer_ping(Hand::Right);
            if self.now_ms.is_multiple_of(20) {
                if self.talking.left {
                    self.send_left();
                }
                if self.talking.right {
                    self.send_right();
                }
            }
            self.bridge.step(self.now_ms, &mut self.robot);
            self.robot.pass(1);
            self.now_ms += 1;
            self.moved |= !self.robot.at_rest();
            self.events.extend(self.bridge.take_events().into_iter().map(|event| event.kind));
        }
    }

    pub fn state(&self) -> State {
        self.bridge.safety().state()
    }

    /// Sets the left hand's heading and advances the time.
    pub fn point(&mut self, heading: Heading, ms: u64) {
        self.left.heading = heading;
        self.run(ms);
    }

    /// The right hand performs a gesture, which its next state reports, and then rests.
    pub fn gesture(&mut self, label: u8) {
        self.right.events = self.right.events.wrapping_add(1);
        self.right.label = label;
        self.right.event_window_end_ms = self.board_time_ms();
        self.right.top = label;
        self.run(100);
        self.right.top = 0;
        self.run(100);
    }

    /// Bends both fingers for a while.
    pub fn stop(&mut self) {
        self.left.stop = true;
        self.run(100);
        self.left.stop = false;
    }

    pub fn speed_m_s(&self) -> f64 {
        self.robot.odometry().twist.linear_m_s
    }

    pub fn arm_moves(&self) -> bool {
        !self.robot.arm().at_rest()
    }

    /// Returns whether anything has moved since the last call.
    pub fn take_moved(&mut self) -> bool {
        std::mem::take(&mut self.moved)
    }

    /// Returns and clears the outcomes of the gestures so far.
    pub fn take_outcomes(&mut self) -> Vec<GestureOutcome> {
        let outcomes = self.events.iter().filter_map(|event| match event {
            EventKind::Gesture { outcome, .. } => Some(outcome.clone()),
            _ => None,
        });
        let outcomes = outcomes.collect();
        self.events.clear();
        outcomes
    }
}
