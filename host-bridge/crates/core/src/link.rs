//! One hand's link: bytes and the time in, states with their ages out.
//!
//! ```text
//! bytes ──► Decoder ──► hello?  version, side, boot id ──► Started (re-bases everything below)
//!                  └──► state?  sequence: newer than all before?  clock: how old?
//!                               counters: what is new in it? ──────► Left / Right
//! ```
//! States before the first hello, repeated ones and overtaken ones are counted and dropped here. How
//! old a state may be is for [`crate::safety`] to say: a late state can still stop the robot.

use serde::Serialize;
use shared_proto::clock::BoardClock;
use shared_proto::counter::{CounterTracker, Order, SequenceTracker};
use shared_proto::frame::{BOARD_FRAME_MAX, Counters, Decoder};
use shared_proto::message::{
    Ack, Board, BoardMessage, Fault, Hello, HostMessage, LeftState, ModelInfo, Pong, RightState, Status,
    health,
};
use shared_proto::version;

use crate::safety::Hand;

/// While nothing usable comes, ask who is there this often.
pub const HELLO_INTERVAL_MS: u64 = 500;

/// A known board is pinged this often, so that the error of ages stays bounded.
pub const PING_INTERVAL_MS: u64 = 1000;

/// This many overtaken states in a row mean that the board restarted and its hello was lost.
const OVERTAKEN_MEANS_RESTART: u32 = 3;

/// Who is on the link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// Kind of board, as a text for people.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// Different after each start.
    pub boot_id: u32,
    /// CRC-32 of its model; 0 = none.
    pub model_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
}

/// What the right hand's model expects and names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ModelSummary {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// Values per sample.
    pub axes: u8,
    /// Names of the outputs in order.
    pub labels: Vec<String>,
}

/// What a stretch of bytes had to say.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// A hello with a new boot id.
    Started(Identity),
    /// A board that cannot be used here; the text says why and what to do.
    Unusable(String),
    /// The model that runs on the hand.
    Model(ModelSummary),
    /// A left state, newer than all before it.
    Left {
        /// Age of the sample.
        age_ms: u64,
        /// As received.
        state: LeftState,
        /// Bends of the index finger since the last state.
        index_bends: u8,
        /// Bends of the middle finger since the last state.
        middle_bends: u8,
    },
    /// A right state, newer than all before it.
    Right(RightReport),
    /// Counters of the board.
    Status(Status),
    /// Something is wrong that a person should know.
    Fault(Fault),
    /// Answer to a ping.
    Pong(Pong),
    /// Answer to another request.
    Ack(Ack),
}

/// A right state without its borrowed scores.
#[derive(Clone, Debug, PartialEq)]
pub struct RightReport {
    /// Age of the newest sample.
    pub age_ms: u64,
    /// Board clock at the newest sample.
    pub board_time_ms: u32,
    /// Bits of [`health`].
    pub health: u8,
    /// Probability of each label, 0 to 1; empty until the first window is full.
    pub scores: Vec<f32>,
    /// The last gesture, if it is new.
    pub gesture: Option<NewGesture>,
}

/// A gesture that a state reports for the first time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewGesture {
    /// Index in the model's labels.
    pub label: u8,
    /// 0 to 1.
    pub confidence: f32,
    /// Board clock at the end of the deciding window.
    pub window_end_ms: u32,
    /// Age of that window's end.
    pub age_ms: u64,
    /// Gestures before it whose label nobody will know: their frames were lost.
    pub unnamed: u8,
}

/// May one act on a state with these health flags?
pub fn is_healthy(flags: u8) -> bool {
    flags & !health::DEFAULT_CALIBRATION == 0
}

/// Frames that came and what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkCounters {
    /// Intact frames.
    pub frames: u32,
    /// Damaged frames: checksum, delimiters, length.
    pub damaged: u32,
    /// Intact frames with a message that this version does not know or cannot read.
    pub unreadable: u32,
    /// States that never came, by their sequence numbers.
    pub lost: u32,
    /// States that came twice.
    pub duplicates: u32,
    /// States that came after a newer one.
    pub overtaken: u32,
    /// Messages before a usable hello.
    pub before_hello: u32,
    /// States of the other hand on this link.
    pub misdirected: u32,
}

/// The receiving end of one hand's link.
#[derive(Clone, Debug)]
pub struct HandLink {
    hand: Hand,
    decoder: Decoder<BOARD_FRAME_MAX>,
    clock: BoardClock,
    sequence: SequenceTracker,
    index: CounterTracker,
    middle: CounterTracker,
    gestures: CounterTracker,
    identity: Option<Identity>,
    model: Option<ModelSummary>,
    counters: LinkCounters,
    overtaken_in_a_row: u32,
    last_state_ms: Option<u64>,
    last_request_ms: Option<u64>,
    /// Id and time of the last ping.
    pinged: Option<(u32, u64)>,
    round_trip_ms: Option<u64>,
}

impl HandLink {
    /// A link on which nobody has said hello.
    pub fn new(hand: Hand) -> Self {
        HandLink {
            hand,
            decoder: Decoder::new(),
            clock: BoardClock::for_board(Board::LeftNano),
            sequence: SequenceTracker::new(),
            index: CounterTracker::new(),
            middle: CounterTracker::new(),
            gestures: CounterTracker::new(),
            identity: None,
            model: None,
            counters: LinkCounters::default(),
            overtaken_in_a_row: 0,
            last_state_ms: None,
            last_request_ms: None,
            pinged: None,
            round_trip_ms: None,
        }
    }

    /// Who is there, once a usable hello has come.
    pub fn identity(&self) -> Option<&Identity> {
        self.identity.as_ref()
    }

    /// The model of a right hand, once it has been named.
    pub fn model(&self) -> Option<&ModelSummary> {
        self.model.as_ref()
    }

    /// What became of the frames so far.
    pub fn counters(&self) -> LinkCounters {
        let Counters { frames, unknown, malformed, .. } = self.decoder.counters();
        LinkCounters {
            frames,
            damaged: self.decoder.counters().damaged(),
            unreadable: unknown.wrapping_add(malformed),
            ..self.counters
        }
    }

    /// Takes bytes in any slicing, as they arrive; what they say is appended to `heard`.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64, heard: &mut Vec<Heard>) {
        for &byte in bytes {
            // The decoder lends its buffer to the message, and handling one needs the rest of the link.
            let mut decoder = std::mem::take(&mut self.decoder);
            if let Some(message) = decoder.push_board(byte) {
                heard.extend(self.handle(message, now_ms));
            }
            self.decoder = decoder;
        }
    }

    /// What to send to the board now, if anything.
    pub fn poll(&mut self, now_ms: u64) -> Option<HostMessage<'static>> {
        let silent = |since: Option<u64>| since.is_none_or(|t| now_ms.saturating_sub(t) >= HELLO_INTERVAL_MS);
        let known = self.identity.is_some() && (self.hand == Hand::Left || self.model.is_some());
        let restarted = self.overtaken_in_a_row >= OVERTAKEN_MEANS_RESTART;
        if (!known || restarted || silent(self.last_state_ms)) && silent(self.last_request_ms) {
            self.last_request_ms = Some(now_ms);
            return Some(HostMessage::HelloRequest);
        }
        None
    }

    /// The ping to send to a known board now, if one is due. Ask only when it can really be sent.
    pub fn ping(&mut self, now_ms: u64) -> Option<HostMessage<'static>> {
        let due = self.pinged.is_none_or(|(_, sent)| now_ms.saturating_sub(sent) >= PING_INTERVAL_MS);
        if self.identity.is_none() || !due {
            return None;
        }
        let id = self.pinged.map_or(0, |(id, _)| id.wrapping_add(1));
        self.pinged = Some((id, now_ms));
        Some(HostMessage::Ping { id })
    }

    /// How long the last ping took, there and back.
    pub fn round_trip_ms(&self) -> Option<u64> {
        self.round_trip_ms
    }

    fn pong(&mut self, pong: &Pong, now_ms: u64) {
        // The answer to an earlier ping has been overtaken, and says less than the next one will.
        if let Some((id, sent_ms)) = self.pinged
            && id == pong.id
        {
            self.clock.pong(pong.board_time_ms, sent_ms, now_ms);
            self.round_trip_ms = Some(now_ms.saturating_sub(sent_ms));
        }
    }

    fn handle(&mut self, message: BoardMessage<'_>, now_ms: u64) -> Option<Heard> {
        if let BoardMessage::Hello(hello) = message {
            return self.hello(&hello);
        }
        if self.identity.is_none() {
            self.counters.before_hello += 1;
            return None;
        }
        match message {
            BoardMessage::Hello(_) | BoardMessage::RawImu(_) => None,
            BoardMessage::Left(state) => self.left(state, now_ms),
            BoardMessage::Right(state) => self.right(&state, now_ms),
            BoardMessage::ModelInfo(info) => self.model_info(&info),
            BoardMessage::Status(status) => Some(Heard::Status(status)),
            BoardMessage::Fault(fault) => Some(Heard::Fault(fault)),
            BoardMessage::Pong(pong) => {
                self.pong(&pong, now_ms);
                Some(Heard::Pong(pong))
            }
            BoardMessage::Ack(ack) => Some(Heard::Ack(ack)),
        }
    }

    fn hello(&mut self, hello: &Hello<'_>) -> Option<Heard> {
        let problem = match (version::check(hello), hand_of(hello.board)) {
            (Err(mismatch), _) => Some(mismatch.to_string()),
            (Ok(_), Some(hand)) if hand != self.hand => Some(format!(
                "{} answers where the {} hand is expected: swap the ports",
                hello.board, self.hand
            )),
            (Ok(_), None) => Some(format!("{} is not known here: update host-bridge", hello.board)),
            (Ok(_), Some(_)) => None,
        };
        if let Some(problem) = problem {
            self.identity = None;
            self.model = None;
            return Some(Heard::Unusable(problem));
        }
        if self.identity.as_ref().is_some_and(|known| known.boot_id == hello.boot_id) {
            return None;
        }
        let identity = Identity {
            board: hello.board.to_string(),
            firmware: hello.firmware.to_owned(),
            boot_id: hello.boot_id,
            model_id: hello.model_id,
            sample_hz: hello.sample_hz,
        };
        self.clock = BoardClock::for_board(hello.board);
        self.sequence.rebase();
        self.index.rebase();
        self.middle.rebase();
        self.gestures.rebase();
        self.overtaken_in_a_row = 0;
        self.model = None;
        self.identity = Some(identity.clone());
        Some(Heard::Started(identity))
    }

    fn model_info(&mut self, info: &ModelInfo<'_>) -> Option<Heard> {
        let model = ModelSummary {
            model_id: info.model_id,
            axes: info.axes,
            labels: info.labels.split(',').map(str::to_owned).collect(),
        };
        if self.model.as_ref() == Some(&model) {
            return None;
        }
        self.model = Some(model.clone());
        Some(Heard::Model(model))
    }

    fn is_next(&mut self, hand: Hand, sequence: u16) -> bool {
        if hand != self.hand {
            self.counters.misdirected += 1;
            return false;
        }
        match self.sequence.see(sequence) {
            Order::New { lost } => {
                self.counters.lost += u32::from(lost);
                self.overtaken_in_a_row = 0;
                true
            }
            Order::Duplicate => {
                self.counters.duplicates += 1;
                false
            }
            Order::Old => {
                self.counters.overtaken += 1;
                self.overtaken_in_a_row += 1;
                false
            }
        }
    }

    fn left(&mut self, state: LeftState, now_ms: u64) -> Option<Heard> {
        if !self.is_next(Hand::Left, state.sequence) {
            return None;
        }
        let age_ms = self.age_of_state(state.board_time_ms, now_ms);
        Some(Heard::Left {
            age_ms,
            index_bends: self.index.see(state.index_bends),
            middle_bends: self.middle.see(state.middle_bends),
            state,
        })
    }

    fn right(&mut self, state: &RightState<'_>, now_ms: u64) -> Option<Heard> {
        if !self.is_next(Hand::Right, state.sequence) {
            return None;
        }
        let age_ms = self.age_of_state(state.board_time_ms, now_ms);
        let new = self.gestures.see(state.events);
        let gesture = (new > 0).then(|| NewGesture {
            label: state.label,
            confidence: f32::from(state.confidence) / 255.0,
            window_end_ms: state.event_window_end_ms,
            // By the state's own age, so that an event's age never falls below it.
            age_ms: age_ms
                .saturating_add(u64::from(state.board_time_ms.wrapping_sub(state.event_window_end_ms))),
            unnamed: new - 1,
        });
        Some(Heard::Right(RightReport {
            age_ms,
            board_time_ms: state.board_time_ms,
            health: state.health,
            // Bytes of int8: (score + 128) / 256.
            scores: state.scores.iter().map(|&s| f32::from((s as i8) as i16 + 128) / 256.0).collect(),
            gesture,
        }))
    }

    fn age_of_state(&mut self, board_time_ms: u32, now_ms: u64) -> u64 {
        let age_ms = self.clock.arrived(board_time_ms, now_ms);
        if age_ms < HELLO_INTERVAL_MS {
            self.last_state_ms = Some(now_ms);
        }
        age_ms
    }
}

/// Which hand a board is for, if it is known.
fn hand_of(board: Board) -> Option<Hand> {
    match board {
        Board::LeftNano | Board::LeftReplay => Some(Hand::Left),
        Board::RightNano33 | Board::RightNano33Rev2 | Board::RightReplay => Some(Hand::Right),
        _ => None,
    }
}
