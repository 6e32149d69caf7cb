//! A keyboard in the place of a hand, so that one board (or none) is enough to start.
//!
//! | key | as which hand | does |
//! |---|---|---|
//! | arrows | left | forward, backward, turn left, turn right, while held |
//! | `q`, `z` | left | one step faster, slower (index bend, middle bend) |
//! | `1` … `6` | right | the six gestures in the order of the labels |
//!
//! Each is a board like any other: it sends the same frames through the same link, so the dead-man, the
//! caps and the stop hold for it too. A terminal tells presses and repeats, no releases. So an arrow
//! counts for [`KeyTimes::first_press_ms`] after the press (until the terminal begins to repeat it) and
//! for [`KeyTimes::repeat_ms`] after each repeat; then the hand is neutral again.

use serde::{Deserialize, Serialize};
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX, encode_board};
use shared_proto::message::{
    Board, BoardMessage, Heading, Hello, HostMessage, LeftState, ModelInfo, PROTOCOL_MAJOR, PROTOCOL_MINOR,
    Pong, RightState,
};

/// The gestures of keys 1 to 6 with the resting class before them: the paper's labels.
pub const LABELS: &str = "idle,up-down,to-fro,left-right,rectangle,rectangle-flat,circle";
const LABEL_COUNT: usize = 7;

const LEFT_INTERVAL_MS: u64 = 20;
const RIGHT_INTERVAL_MS: u64 = 80;
/// A key held down repeats; nobody wants thirty steps a second.
const STEP_INTERVAL_MS: u64 = 200;

/// How long a key counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyTimes {
    /// After the first press. A little more than terminals wait before they repeat.
    pub first_press_ms: u64,
    /// After each repeat.
    pub repeat_ms: u64,
}

impl Default for KeyTimes {
    fn default() -> Self {
        KeyTimes { first_press_ms: 600, repeat_ms: 200 }
    }
}

pub use host_core::source::HandKey;
use host_core::source::HandSource;

fn hello(board: Board) -> BoardMessage<'static> {
    BoardMessage::Hello(Hello {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        board,
        firmware: "keyboard",
        boot_id: 1,
        model_id: 0,
        sample_hz: 50,
    })
}

fn send(message: &BoardMessage<'_>, wire: &mut Vec<u8>) {
    let mut buffer = [0; BOARD_FRAME_MAX];
    if let Ok(frame) = encode_board(message, &mut buffer) {
        wire.extend_from_slice(frame);
    }
}

/// What both hands answer: who they are, and what time it is.
fn answer(
    decoder: &mut Decoder<HOST_FRAME_MAX>,
    bytes: &[u8],
    now_ms: u64,
    wire: &mut Vec<u8>,
    say_hello: fn(&mut Vec<u8>),
) {
    for &byte in bytes {
        match decoder.push_host(byte) {
            Some(HostMessage::HelloRequest) => say_hello(wire),
            Some(HostMessage::Ping { id }) => {
                send(&BoardMessage::Pong(Pong { id, board_time_ms: now_ms as u32 }), wire);
            }
            _ => {}
        }
    }
}

/// Arrows, q and z as a left hand.
#[derive(Clone, Debug)]
pub struct KeyLeft {
    times: KeyTimes,
    decoder: Decoder<HOST_FRAME_MAX>,
    /// The arrow that counts, and until when.
    held: Option<(Heading, u64)>,
    last_step_ms: Option<u64>,
    state: LeftState,
    sent_ms: Option<u64>,
}

impl KeyLeft {
    /// A hand at neutral.
    pub fn new(times: KeyTimes) -> Self {
        let state = LeftState { heading: Heading::Neutral, ..LeftState::default() };
        KeyLeft { times, decoder: Decoder::new(), held: None, last_step_ms: None, state, sent_ms: None }
    }
}

impl HandSource for KeyLeft {
    fn press(&mut self, key: HandKey, now_ms: u64) {
        match key {
            HandKey::Arrow(heading) => {
                let repeated = self.held.is_some_and(|(h, until)| h == heading && now_ms < until);
                let first_ms = self.times.first_press_ms;
                self.held = Some(match self.held {
                    // A repeat never shortens the time that the first press still has.
                    Some((_, until)) if repeated => (heading, until.max(now_ms + self.times.repeat_ms)),
                    _ => (heading, now_ms + first_ms),
                });
            }
            HandKey::Faster | HandKey::Slower => {
                if self.last_step_ms.is_some_and(|t| now_ms.saturating_sub(t) < STEP_INTERVAL_MS) {
                    return;
                }
                self.last_step_ms = Some(now_ms);
                let bends = if key == HandKey::Faster {
                    &mut self.state.index_bends
                } else {
                    &mut self.state.middle_bends
                };
                *bends = bends.wrapping_add(1);
            }
            HandKey::Gesture(_) => {}
        }
    }

    fn release(&mut self, key: HandKey) {
        if let (HandKey::Arrow(heading), Some((held, _))) = (key, self.held)
            && heading == held
        {
            self.held = None;
        }
    }

    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        self.held = self.held.filter(|&(_, until)| now_ms < until);
        let heading = self.held.map_or(Heading::Neutral, |(heading, _)| heading);
        let due = self.sent_ms.is_none_or(|sent| now_ms.saturating_sub(sent) >= LEFT_INTERVAL_MS);
        if due || heading != self.state.heading {
            self.sent_ms = Some(now_ms);
            self.state.heading = heading;
            self.state.board_time_ms = now_ms as u32;
            self.state.sequence = self.state.sequence.wrapping_add(1);
            send(&BoardMessage::Left(self.state), wire);
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        answer(&mut self.decoder, bytes, now_ms, wire, |wire| send(&hello(Board::LeftReplay), wire));
    }
}

/// Keys 1 to 6 as a right hand.
#[derive(Clone, Debug, Default)]
pub struct KeyRight {
    decoder: Decoder<HOST_FRAME_MAX>,
    sequence: u16,
    events: u8,
    label: u8,
    event_ms: u64,
    /// The last state reported the event: from the next one on the hand rests.
    resting: bool,
    sent_ms: Option<u64>,
    last_press_ms: Option<u64>,
}

impl KeyRight {
    /// A hand at rest.
    pub fn new() -> Self {
        KeyRight { label: u8::MAX, resting: true, ..KeyRight::default() }
    }
}

impl HandSource for KeyRight {
    fn press(&mut self, key: HandKey, now_ms: u64) {
        let HandKey::Gesture(number @ 1..=6) = key else { return };
        // Held keys repeat after about half a second, then quickly.
        let repeat = self.last_press_ms.is_some_and(|t| now_ms.saturating_sub(t) < 700);
        self.last_press_ms = Some(now_ms);
        if repeat && number == self.label {
            return;
        }
        self.events = self.events.wrapping_add(1);
        self.label = number;
        self.event_ms = now_ms;
        self.resting = false;
        self.sent_ms = None;
    }

    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        if self.sent_ms.is_some_and(|sent| now_ms.saturating_sub(sent) < RIGHT_INTERVAL_MS) {
            return;
        }
        self.sent_ms = Some(now_ms);
        self.sequence = self.sequence.wrapping_add(1);
        let top = if self.resting { 0 } else { usize::from(self.label) };
        self.resting = true;
        let scores: [u8; LABEL_COUNT] = std::array::from_fn(|i| if i == top { 0x7F } else { 0x80 });
        send(
            &BoardMessage::Right(RightState {
                sequence: self.sequence,
                board_time_ms: now_ms as u32,
                events: self.events,
                label: self.label,
                confidence: u8::MAX,
                event_window_end_ms: self.event_ms as u32,
                scores: &scores,
                health: 0,
            }),
            wire,
        );
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        answer(&mut self.decoder, bytes, now_ms, wire, |wire| {
            send(&hello(Board::RightReplay), wire);
            send(
                &BoardMessage::ModelInfo(ModelInfo {
                    model_id: 0,
                    recipe: 0,
                    axes: 0,
                    sample_hz: 0,
                    window: 0,
                    labels: LABELS,
                }),
                wire,
            );
        });
    }
}
