//! The link of one hand: converts bytes and the time to states with ages.
//!
//! ```text
//! bytes ──► Decoder ──► hello?  version, side, boot id ──► Started (re-bases everything below)
//!                  └──► state?  sequence: newer than all before?  clock: how old?
//!                               counters: which events in it are new? ──────► Left / Right
//! ```
//! States before the first hello, repeated states and overtaken states are counted and dropped here.
//! [`crate::safety`] decides on the maximum age, because even a late state can stop the robot.
//!
//! Ages are upper bounds, derived from round trips.
//! Pings are sent ten times per second, even if earlier ones are unanswered.
//! If a board answers no ping, all its states are too old.

use std::collections::VecDeque;

use serde::Serialize;
use shared_proto::clock::{BoardClock, DRIFT_PPM};
use shared_proto::counter::{CounterTracker, Order, SequenceTracker};
use shared_proto::frame::{BOARD_FRAME_MAX, Counters, Decoder};
use shared_proto::message::{
    About, Ack, BoardMessage, Fault, Hello, HostMessage, LeftState, ModelInfo, Pairing, Pong, RightState,
    RightTilt,
};
use shared_proto::version;

use crate::one_handed::TiltReport;
use crate::safety::Hand;

/// Interval for requesting a hello as long as no usable data arrives.
pub const HELLO_INTERVAL_MS: u64 = 500;

/// Interval for pinging a known board. The replies limit the age of its states.
pub const PING_INTERVAL_MS: u64 = 100;

/// A board that has answered no ping for this long counts as silent, even if it sends other data.
pub const ANSWER_PATIENCE_MS: u64 = 500;

/// Maximum number of unanswered pings. An answer after more than 6 s does not count.
const PINGS_IN_FLIGHT: usize = 64;

/// This many consecutive overtaken states mean that the board restarted and its hello was lost.
const OVERTAKEN_MEANS_RESTART: u32 = 3;

/// The identity of the board on the link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// Kind of board as a text for users.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// A number that is different after each start.
    pub boot_id: u32,
    /// CRC-32 of the board's model; 0 = none.
    pub model_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
}

/// The requirements and labels of the right hand's model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ModelSummary {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// Values per sample.
    pub axes: u8,
    /// Names of the outputs in order.
    pub labels: Vec<String>,
}

/// The parts of received messages that a session needs.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// A hello with a new boot id.
    Started(Identity),
    /// A board that cannot be used here, with the reason and a remedy.
    Unusable(String),
    /// The model that runs on the hand.
    Model(ModelSummary),
    /// A left state that is newer than all earlier ones.
    Left {
        /// Upper bound of the sample's age.
        age_ms: u64,
        /// As received.
        state: LeftState,
        /// Bends of the index finger since the last state.
        index_bends: u8,
        /// Bends of the middle finger since the last state.
        middle_bends: u8,
    },
    /// A right state that is newer than all earlier ones.
    Right(RightReport),
    /// The tilt of a right hand, which belongs to the newest state.
    Tilt(TiltReport),
    /// A problem that the user should know about.
    Fault(Fault),
    /// How a laptop pairs or has paired over Bluetooth, if this is new.
    Pairing(Pairing),
    /// Answer to a request.
    Ack(Ack),
}

/// A right state without its borrowed scores.
#[derive(Clone, Debug, PartialEq)]
pub struct RightReport {
    /// Upper bound of the newest sample's age.
    pub age_ms: u64,
    /// Time of the newest sample on the board's clock.
    pub board_time_ms: u32,
    /// Bits of [`shared_words::health`].
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
    /// Time of the deciding window's end on the board's clock.
    pub window_end_ms: u32,
    /// Upper bound of the time since that window's end.
    pub age_ms: u64,
    /// Number of earlier gestures whose label is unknown because their frames were lost.
    pub unnamed: u8,
}

/// Statistics of received frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkCounters {
    /// Intact frames.
    pub frames: u32,
    /// Number of damaged frames, detected by checksum, delimiters or length.
    pub damaged: u32,
    /// Intact frames with a message that this version does not know or cannot read.
    pub unreadable: u32,
    /// States that never arrived, according to their sequence numbers.
    pub lost: u32,
    /// States that arrived twice.
    pub duplicates: u32,
    /// States that arrived after a newer one.
    pub overtaken: u32,
    /// Messages that arrived before a usable hello.
    pub before_hello: u32,
    /// States of the other hand that arrived on this link.
    pub misdirected: u32,
}

/// The receiving side of one hand's link.
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
    /// Minor version of the board's wire protocol, and its hardware.
    minor: u8,
    about: Option<About>,
    pairing: Option<Pairing>,
    counters: LinkCounters,
    overtaken_in_a_row: u32,
    /// Sequence number and board time of the newest right state, until its tilt arrives.
    waits_for_tilt: Option<(u16, u32)>,
    last_state_ms: Option<u64>,
    last_request_ms: Option<u64>,
    /// Ids and times of the unanswered pings, oldest first.
    pings: VecDeque<(u32, u64)>,
    /// Id and time of the last ping.
    pinged: Option<(u32, u64)>,
    /// Round-trip time of the newest answered ping, and the time of its answer.
    round_trip: Option<(u64, u64)>,
    /// Whether the board's clock has stepped back. From then on, all data is ignored until a hello arrives.
    restarted: bool,
}

impl HandLink {
    /// Creates a link on which no hello has arrived.
    pub fn new(hand: Hand) -> Self {
        HandLink {
            hand,
            decoder: Decoder::new(),
            clock: BoardClock::new(),
            sequence: SequenceTracker::new(),
            index: CounterTracker::new(),
            middle: CounterTracker::new(),
            gestures: CounterTracker::new(),
            identity: None,
            model: None,
            minor: 0,
            about: None,
            pairing: None,
            counters: LinkCounters::default(),
            overtaken_in_a_row: 0,
            waits_for_tilt: None,
            last_state_ms: None,
            last_request_ms: None,
            pings: VecDeque::new(),
            pinged: None,
            round_trip: None,
            restarted: false,
        }
    }

    /// Returns the identity of the board after a usable hello.
    pub fn identity(&self) -> Option<&Identity> {
        self.identity.as_ref()
    }

    /// Returns the model of a right hand, once it has been reported.
    pub fn model(&self) -> Option<&ModelSummary> {
        self.model.as_ref()
    }

    /// Returns the minor version of the board's wire protocol; 0 before a usable hello.
    pub fn minor(&self) -> u8 {
        self.minor
    }

    /// Returns the voltage of the board's battery in millivolts, if reported.
    pub fn battery_mv(&self) -> Option<u16> {
        self.about.map(|about| about.battery_mv).filter(|&mv| mv > 0)
    }

    /// Returns the statistics of all frames received so far.
    pub fn counters(&self) -> LinkCounters {
        let Counters { frames, unknown, malformed, .. } = self.decoder.counters();
        LinkCounters {
            frames,
            damaged: self.decoder.counters().damaged(),
            unreadable: unknown.wrapping_add(malformed),
            ..self.counters
        }
    }

    /// Processes bytes in portions of any size, and appends the received messages to `heard`.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64, heard: &mut Vec<Heard>) {
        // The message borrows the decoder's buffer, while its processing needs the rest of the link.
        let mut decoder = std::mem::take(&mut self.decoder);
        for &byte in bytes {
            if let Some(message) = decoder.push_board(byte) {
                heard.extend(self.handle(message, now_ms));
            }
        }
        self.decoder = decoder;
    }

    /// Returns the message to send to the board now, if any.
    pub fn poll(&mut self, now_ms: u64) -> Option<HostMessage<'static>> {
        let silent = |since: Option<u64>| since.is_none_or(|t| now_ms.saturating_sub(t) >= HELLO_INTERVAL_MS);
        let known = self.identity.is_some() && (self.hand == Hand::Left || self.model.is_some());
        let restarted = self.restarted || self.overtaken_in_a_row >= OVERTAKEN_MEANS_RESTART;
        if (!known || restarted || silent(self.last_state_ms)) && silent(self.last_request_ms) {
            self.last_request_ms = Some(now_ms);
            return Some(HostMessage::HelloRequest);
        }
        None
    }

    /// Returns the ping that is due for a known board. Call it only if the ping can be sent immediately.
    pub fn ping(&mut self, now_ms: u64) -> Option<HostMessage<'static>> {
        let due = self.pinged.is_none_or(|(_, sent)| now_ms.saturating_sub(sent) >= PING_INTERVAL_MS);
        if self.identity.is_none() || !due {
            return None;
        }
        let id = self.pinged.map_or(0, |(id, _)| id.wrapping_add(1));
        self.pinged = Some((id, now_ms));
        if self.pings.len() == PINGS_IN_FLIGHT {
            self.pings.pop_front();
        }
        self.pings.push_back((id, now_ms));
        Some(HostMessage::Ping { id })
    }

    /// Returns the round-trip time of the newest answered ping.
    pub fn round_trip_ms(&self) -> Option<u64> {
        self.round_trip.map(|(took_ms, _)| took_ms)
    }

    /// Returns whether the board has answered a ping within the last [`ANSWER_PATIENCE_MS`].
    pub fn answers(&self, now_ms: u64) -> bool {
        self.round_trip.is_some_and(|(_, at_ms)| now_ms.saturating_sub(at_ms) < ANSWER_PATIENCE_MS)
    }

    /// Returns whether the board has not answered any ping for [`ANSWER_PATIENCE_MS`].
    pub fn stopped_answering(&self, now_ms: u64) -> bool {
        self.round_trip.is_some() && !self.answers(now_ms)
    }

    /// Returns whether the newest round trip is recent and took less than `limit_ms`.
    /// In addition, no later ping may have been unanswered for longer than this.
    pub fn is_prompt(&self, limit_ms: u64, now_ms: u64) -> bool {
        let waiting = self.pings.front().is_some_and(|&(_, sent)| now_ms.saturating_sub(sent) >= limit_ms);
        self.answers(now_ms) && !waiting && self.round_trip.is_some_and(|(took, _)| took < limit_ms)
    }

    fn pong(&mut self, pong: &Pong, now_ms: u64) {
        // An answer is useless if a later answer has overtaken it, or if no ping matches.
        let Some(at) = self.pings.iter().position(|&(id, _)| id == pong.id) else { return };
        let Some((_, sent_ms)) = self.pings.drain(..=at).next_back() else { return };
        if self.clock.pong(pong.board_time_ms, sent_ms, now_ms) {
            self.round_trip = Some((now_ms.saturating_sub(sent_ms), now_ms));
        } else {
            self.round_trip = None;
            self.restarted = true;
        }
    }

    fn handle(&mut self, message: BoardMessage<'_>, now_ms: u64) -> Option<Heard> {
        if let BoardMessage::Hello(hello) = message {
            return self.hello(&hello);
        }
        // A left hand says this before the hello that it was asked for.
        if let BoardMessage::Pairing(pairing) = message {
            return (self.pairing.replace(pairing) != Some(pairing)).then_some(Heard::Pairing(pairing));
        }
        if self.identity.is_none() {
            self.counters.before_hello += 1;
            return None;
        }
        match message {
            BoardMessage::About(about) => {
                self.about = Some(about);
                None
            }
            BoardMessage::Left(state) => self.left(state, now_ms),
            BoardMessage::Right(state) => self.right(&state, now_ms),
            BoardMessage::Tilt(tilt) => self.tilt(tilt, now_ms),
            BoardMessage::ModelInfo(info) => self.model_info(&info),
            BoardMessage::Fault(fault) => Some(Heard::Fault(fault)),
            BoardMessage::Pong(pong) => {
                self.pong(&pong, now_ms);
                None
            }
            BoardMessage::Ack(ack) => Some(Heard::Ack(ack)),
            // Other messages are irrelevant for a session.
            _ => None,
        }
    }

    fn hello(&mut self, hello: &Hello<'_>) -> Option<Heard> {
        let problem = match (version::check(hello), hello.board.hand()) {
            (Err(mismatch), _) => Some(mismatch.to_string()),
            (Ok(_), Some(hand)) if hand != self.hand => Some(format!(
                "{} answers where the {} hand is expected: swap the ports",
                hello.board, self.hand
            )),
            (Ok(_), None) => Some(format!("{} is not known here: update host-bridge", hello.board)),
            (Ok(_), Some(_)) => None,
        };
        if let Some(problem) = problem {
            (self.identity, self.model, self.minor) = (None, None, 0);
            return Some(Heard::Unusable(problem));
        }
        self.restarted = false;
        if self.identity.as_ref().is_some_and(|known| known.boot_id == hello.boot_id) {
            return None;
        }
        let identity = Identity {
            board: hello.board.to_string(),
            firmware: printable(&hello.firmware),
            boot_id: hello.boot_id,
            model_id: hello.model_id,
            sample_hz: hello.sample_hz,
        };
        self.clock.rebase();
        // Answers sent before the board's restart refer to another clock.
        self.pings.clear();
        self.round_trip = None;
        if let Some((_, sent_ms)) = &mut self.pinged {
            // The next ping is due immediately.
            *sent_ms = 0;
        }
        self.sequence.rebase();
        self.index.rebase();
        self.middle.rebase();
        self.gestures.rebase();
        (self.overtaken_in_a_row, self.waits_for_tilt) = (0, None);
        (self.model, self.about) = (None, None);
        self.minor = hello.minor;
        self.identity = Some(identity.clone());
        Some(Heard::Started(identity))
    }

    fn model_info(&mut self, info: &ModelInfo<'_>) -> Option<Heard> {
        let model = ModelSummary {
            model_id: info.model_id,
            axes: info.axes,
            labels: info.labels.split(',').map(printable).collect(),
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
        self.waits_for_tilt = Some((state.sequence, state.board_time_ms));
        let age_ms = self.age_of_state(state.board_time_ms, now_ms);
        let new = self.gestures.see(state.events);
        let gesture = (new > 0).then(|| NewGesture {
            label: state.label,
            confidence: f32::from(state.confidence) / 255.0,
            window_end_ms: state.event_window_end_ms,
            // The event's age is derived from the state's age, so that it is never smaller.
            age_ms: age_ms.saturating_add(with_drift(
                state.board_time_ms.wrapping_sub(state.event_window_end_ms).into(),
            )),
            unnamed: new - 1,
        });
        Some(Heard::Right(RightReport {
            age_ms,
            board_time_ms: state.board_time_ms,
            health: state.health,
            // Bytes of int8 scores: (score + 128) / 256.
            scores: state.scores.iter().map(|&s| f32::from((s as i8) as i16 + 128) / 256.0).collect(),
            gesture,
        }))
    }

    /// A tilt counts only together with the state of the same hop, and only once.
    fn tilt(&mut self, tilt: RightTilt, now_ms: u64) -> Option<Heard> {
        let (_, board_time_ms) = self.waits_for_tilt.take_if(|(sequence, _)| *sequence == tilt.sequence)?;
        let age_ms = self.age_of_state(board_time_ms, now_ms);
        Some(Heard::Tilt(TiltReport { age_ms, board_time_ms, tilt }))
    }

    fn age_of_state(&mut self, board_time_ms: u32, now_ms: u64) -> u64 {
        let known = !self.restarted && self.answers(now_ms);
        let age_ms = if known { self.clock.age_ms(board_time_ms, now_ms) } else { u64::MAX };
        if age_ms < HELLO_INTERVAL_MS {
            self.last_state_ms = Some(now_ms);
        }
        age_ms
    }
}

/// Returns the latest possible time on the laptop's clock for a time on a board's clock.
fn with_drift(board_ms: u64) -> u64 {
    board_ms + board_ms * u64::from(DRIFT_PPM) / 1_000_000
}

/// Removes characters from a board's text that a terminal would interpret.
/// Such characters are control characters, and characters that change the writing direction.
pub fn printable(text: &str) -> String {
    let obeyed = |c: char| {
        c.is_control()
            || matches!(c, '\u{200e}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    text.chars().map(|c| if obeyed(c) { char::REPLACEMENT_CHARACTER } else { c }).collect()
}
