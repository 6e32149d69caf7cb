//! Communicates with one board on one port.
//! The commands `list`, `doctor`, `calibrate`, `record` and `send-model` use this module.

use std::sync::Arc;
use std::time::Duration;

use shared_dsp::left::AdcCounts;
use shared_proto::frame::{BOARD_FRAME_MAX, DELIMITER, Decoder, HOST_FRAME_MAX, encode_host};
use shared_proto::message::{
    About, Ack, AckResult, Board, BoardMessage, Fault, HostMessage, LeftState, Pairing, Pong, RawAdc,
    RightTilt, Status,
};
use shared_proto::version;

use host_core::link::printable;

use crate::links::{Clock, EventReceiver, Link, News, SerialSettings, SystemClock, Waiter, is_ble, queue};

/// A request without an answer is repeated after this time.
const REPEAT_MS: u64 = 1000;

/// Additional time for a board behind Bluetooth, which must first be found and connected.
const BLE_MEET_MS: u64 = 30_000;

/// A message from a board or its link, without borrowed parts.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    /// The port is open.
    Opened,
    /// The port is closed, with the reason and a remedy.
    Closed(String),
    /// Who is there.
    Hello(Who),
    /// The requirements and labels of the board's model.
    Model(ModelNeeds),
    /// The hardware of a right hand's board.
    About(About),
    /// A left state.
    Left(LeftState),
    /// A right state: sequence number, board time, label of the last event, number of events, and health.
    Right {
        /// A number that increases with each state.
        sequence: u16,
        /// Time of the newest sample on the board's clock.
        board_time_ms: u32,
        /// Gestures so far.
        events: u8,
        /// The last one.
        label: u8,
        /// Health flags.
        health: u8,
    },
    /// Raw samples of a right hand.
    Raw(RawBatch),
    /// A raw sample of a left hand.
    RawLeft(RawAdc),
    /// The mean acceleration of a right hand's hop.
    Tilt(RightTilt),
    /// How a laptop pairs or has paired over Bluetooth.
    Pairing(Pairing),
    /// Counters.
    Status(Status),
    /// Trouble.
    Fault(Fault),
    /// Answer to a ping.
    Pong(Pong),
    /// Answer to a request.
    Ack(Ack),
}

/// A hello.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Who {
    /// Protocol version.
    pub version: (u8, u8),
    /// Kind of board.
    pub board: Board,
    /// Version of its firmware.
    pub firmware: String,
    /// Different after each start.
    pub boot_id: u32,
    /// CRC-32 of the board's model; 0 = none.
    pub model_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
    /// The reason why the board cannot be used, with a remedy.
    pub problem: Option<String>,
}

/// The requirements and labels of the running model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelNeeds {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// How features are made.
    pub recipe: u8,
    /// Number of values per sample that the model needs.
    pub axes: u8,
    /// Number of values per sample of the board. It equals the model's number if the board reports none.
    pub board_axes: u8,
    /// Samples per second.
    pub sample_hz: u16,
    /// Samples per window.
    pub window: u16,
    /// Names of the outputs in order.
    pub labels: Vec<String>,
}

/// Raw samples in the form in which they were sent.
#[derive(Clone, Debug, PartialEq)]
pub struct RawBatch {
    /// Number of the first sample since the board's start.
    pub first_sample: u32,
    /// Values per sample.
    pub axes: u8,
    /// Physical value of one count: m/s², deg/s, µT.
    pub scale: [f32; 3],
    /// Sample after sample.
    pub counts: Vec<i16>,
}

/// The reason for a failure, with a remedy in the text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TalkError {
    /// The port cannot be opened or was lost.
    #[error("{0}")]
    Closed(String),
    /// The port is open, but no hello arrives.
    #[error(
        "{port}: nobody answers; is the right board on this port, and has it been flashed? \
         `host-bridge list` asks all ports"
    )]
    Nobody {
        /// The port.
        port: String,
    },
    /// Something other than this project's firmware is on the line.
    #[error(
        "{port}: a program answers with text ({text:?}), not with this project's frames; flash the board with our firmware"
    )]
    Text {
        /// The port.
        port: String,
        /// The last part of the received text.
        text: String,
    },
    /// A board answers, but this program cannot use it.
    #[error("{0}")]
    Unusable(String),
    /// A request was not answered.
    #[error("{port}: the board did not answer a request; restart it and try again")]
    NoAnswer {
        /// The port.
        port: String,
    },
    /// A request was refused.
    #[error("{port}: {advice}")]
    Refused {
        /// The port.
        port: String,
        /// The board's answer to the request.
        result: AckResult,
        /// The meaning of the answer and a remedy.
        advice: String,
    },
}

/// Returns the meaning of an answer and a remedy.
pub fn advice(result: AckResult) -> &'static str {
    match result {
        AckResult::Ok => "done",
        AckResult::Started => "it has begun",
        AckResult::Busy => "the board is busy with another request; try again in a few seconds",
        AckResult::Unsupported => "this board does not do that; is it the other hand's port?",
        AckResult::OutOfRange => "a value is out of range for the board; update its firmware",
        AckResult::Unsteady => "the hand moved, or the pose cannot be right; hold still and try again",
        AckResult::ModelDoesNotFit => {
            "the model does not fit the board: recipe, axes, rate, window and size must; train it again \
             with this version's `models train`, or flash the firmware for its axes"
        }
        AckResult::WrongOffset => "the board lost its place in the model; send it again",
        AckResult::BadChecksum => "the model arrived damaged; send it again",
        AckResult::StorageFailed => {
            "the board's memory did not take the data; try again, or replace the board"
        }
        AckResult::NotBonded => {
            "Bluetooth writes need pairing; pair in the system's settings, or use the cable"
        }
        AckResult::ImageRefused => {
            "the board does not accept this image: it is for another board, or over Bluetooth its signature is not \
             that of the key in the board; build or download the file for this board, or sign it with that key"
        }
        AckResult::ImageWentBack => {
            "the board went back to its old image, because the new one did not say hello before a restart"
        }
        AckResult::Unknown(_) => {
            "the board gave an answer that this version does not know; update host-bridge"
        }
    }
}

/// A port with its board and its messages.
pub struct Talk {
    link: Link,
    events: EventReceiver<()>,
    clock: Arc<dyn Clock>,
    waiter: Waiter,
    decoder: Decoder<BOARD_FRAME_MAX>,
    said: std::collections::VecDeque<(u64, Said)>,
    text: TextHeard,
    request: u16,
}

impl Talk {
    /// Opens a port. The result arrives as an event.
    pub fn open(port: &str, settings: SerialSettings) -> Self {
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
        let waiter = clock.waiter();
        let (sender, events) = queue();
        let link = Link::start((), port, settings, Arc::clone(&clock), sender);
        Talk {
            link,
            events,
            clock,
            waiter,
            decoder: Decoder::new(),
            said: Default::default(),
            text: TextHeard::default(),
            request: 0,
        }
    }

    /// The port's name.
    pub fn port(&self) -> &str {
        self.link.port()
    }

    /// Strength of the radio signal in dBm when the board was found, if it is behind Bluetooth.
    pub fn signal_dbm(&self) -> Option<i16> {
        self.link.signal_dbm()
    }

    /// Returns the time on the clock of the events.
    pub fn now_ms(&self) -> u64 {
        self.clock.now_ms()
    }

    /// Returns the waiter of the communicating thread, for all waits except those for events.
    pub fn waiter(&self) -> &Waiter {
        &self.waiter
    }

    /// Returns the total number of frames and the number of damaged frames.
    pub fn frames(&self) -> (u32, u32) {
        let counters = self.decoder.counters();
        (counters.frames, counters.damaged())
    }

    /// Returns whether bytes can be sent now. This is not possible soon after the port was opened.
    pub fn is_ready(&self) -> bool {
        self.link.is_ready()
    }

    /// Sends a message. Returns false if it cannot be sent now.
    pub fn send(&self, message: &HostMessage<'_>) -> bool {
        let mut buffer = [0; HOST_FRAME_MAX];
        encode_host(message, &mut buffer).is_ok_and(|frame| self.link.send(frame))
    }

    /// Returns a number for the next request.
    pub fn next_request(&mut self) -> u16 {
        self.request = self.request.wrapping_add(1);
        self.request
    }

    /// Waits for at most this long for the next event, and returns the event with its time of arrival.
    pub fn next(&mut self, patience_ms: u64) -> Option<(u64, Said)> {
        let until_ms = self.now_ms() + patience_ms;
        let mut asked = false;
        loop {
            if let Some(said) = self.said.pop_front() {
                return Some(said);
            }
            let left_ms = until_ms.saturating_sub(self.now_ms());
            // A board that floods the link counts as silent.
            if left_ms == 0 && asked {
                return None;
            }
            asked = true;
            let event = self.waiter.hear(&self.events, Duration::from_millis(left_ms)).ok()?;
            match event.news {
                News::Opened => self.said.push_back((event.at_ms, Said::Opened)),
                News::Closed(why) => self.said.push_back((event.at_ms, Said::Closed(why))),
                News::Bytes(bytes) => {
                    self.text.take(&bytes);
                    for byte in bytes {
                        if let Some(said) = self.decoder.push_board(byte).and_then(|m| owned(&m)) {
                            self.said.push_back((event.at_ms, said));
                        }
                    }
                }
            }
        }
    }

    /// Asks the board for its identity, twice per second as soon as this is safe.
    ///
    /// # Errors
    /// Returns [`TalkError`] if the port does not open, no answer arrives in time, or the board cannot be used.
    pub fn hello(&mut self, patience_ms: u64) -> Result<Who, TalkError> {
        let who = self.meet(patience_ms)?;
        match &who.problem {
            Some(problem) => Err(TalkError::Unusable(format!("{}: {problem}", self.port()))),
            None => Ok(who),
        }
    }

    /// Like [`Talk::hello`], but also accepts a board that cannot be used.
    ///
    /// # Errors
    /// Returns [`TalkError`] if the port does not open or no answer arrives in time.
    pub fn meet(&mut self, patience_ms: u64) -> Result<Who, TalkError> {
        let patience_ms = if is_ble(self.port()) { patience_ms.max(BLE_MEET_MS) } else { patience_ms };
        let until_ms = self.now_ms() + patience_ms;
        let mut asked_ms = None;
        while self.now_ms() < until_ms {
            let due = asked_ms.is_none_or(|t| self.now_ms() - t >= 500);
            if due && self.is_ready() && self.send(&HostMessage::HelloRequest) {
                asked_ms = Some(self.now_ms());
            }
            match self.next(20) {
                Some((_, Said::Hello(who))) => return Ok(who),
                Some((_, Said::Closed(why))) => return Err(TalkError::Closed(why)),
                _ => {}
            }
        }
        let port = self.port().to_owned();
        match self.text.line() {
            Some(text) => Err(TalkError::Text { port, text }),
            None => Err(TalkError::Nobody { port }),
        }
    }

    /// Returns the requirements of a right hand's model, or `None` if the board does not report them.
    pub fn model(&mut self, patience_ms: u64) -> Option<ModelNeeds> {
        let until_ms = self.now_ms() + patience_ms;
        let mut asked_ms = self.now_ms();
        while self.now_ms() < until_ms {
            match self.next(50) {
                Some((_, Said::Model(model))) => return Some(self.with_axes(model)),
                _ if self.now_ms() - asked_ms > 700 => {
                    asked_ms = self.now_ms();
                    self.send(&HostMessage::HelloRequest);
                }
                _ => {}
            }
        }
        None
    }

    /// Returns what a right hand's board reports about its hardware after each hello, or `None` if it does not.
    pub fn about(&mut self, patience_ms: u64) -> Option<About> {
        let until_ms = self.now_ms() + patience_ms;
        let mut asked_ms = None;
        while self.now_ms() < until_ms {
            let due = asked_ms.is_none_or(|t| self.now_ms() - t >= REPEAT_MS);
            if due && self.send(&HostMessage::HelloRequest) {
                asked_ms = Some(self.now_ms());
            }
            if let Some((_, Said::About(about))) = self.next(20) {
                return Some(about);
            }
        }
        None
    }

    /// Adds the axes of the board, which boards since protocol 1.1 report after their model.
    fn with_axes(&mut self, mut model: ModelNeeds) -> ModelNeeds {
        const AT_ONCE_MS: u64 = 100;
        let until_ms = self.now_ms() + AT_ONCE_MS;
        while self.now_ms() < until_ms {
            if let Some((_, Said::About(about))) = self.next(20) {
                // Without a detected sensor, the number of axes is unknown.
                if about.axes != 0 {
                    model.board_axes = about.axes;
                }
                break;
            }
        }
        model
    }

    /// Sends a request every second until its final answer arrives; `Started` only extends the wait.
    ///
    /// # Errors
    /// Returns [`TalkError`] if the link fails, no answer arrives in time, or the board refuses.
    pub fn request(
        &mut self,
        patience_ms: u64,
        make: impl Fn(u16) -> HostMessage<'static>,
    ) -> Result<Ack, TalkError> {
        let request = self.next_request();
        let until_ms = self.now_ms() + patience_ms;
        let (mut asked_ms, mut started) = (None, false);
        while self.now_ms() < until_ms {
            let due = asked_ms.is_none_or(|t| self.now_ms() - t >= REPEAT_MS);
            if due && !started && self.send(&make(request)) {
                asked_ms = Some(self.now_ms());
            }
            match self.next(20) {
                Some((_, Said::Ack(ack))) if ack.request == request => match ack.result {
                    AckResult::Started => started = true,
                    AckResult::Ok => return Ok(ack),
                    result => {
                        return Err(TalkError::Refused {
                            port: self.port().to_owned(),
                            result,
                            advice: advice(result).to_owned(),
                        });
                    }
                },
                Some((_, Said::Closed(why))) => return Err(TalkError::Closed(why)),
                // A restart forgets the request.
                Some((_, Said::Hello(_))) if asked_ms.is_some() => started = false,
                _ => {}
            }
        }
        Err(TalkError::NoAnswer { port: self.port().to_owned() })
    }
}

/// Returns a message without its borrowed parts, or `None` if its content contradicts itself.
pub(crate) fn owned(message: &BoardMessage<'_>) -> Option<Said> {
    Some(match message {
        BoardMessage::Hello(hello) => Said::Hello(Who {
            version: (hello.major, hello.minor),
            board: hello.board,
            firmware: printable(&hello.firmware),
            boot_id: hello.boot_id,
            model_id: hello.model_id,
            sample_hz: hello.sample_hz,
            problem: version::check(hello).err().map(|mismatch| mismatch.to_string()),
        }),
        BoardMessage::ModelInfo(info) => Said::Model(ModelNeeds {
            model_id: info.model_id,
            recipe: info.recipe,
            axes: info.axes,
            board_axes: info.axes,
            sample_hz: info.sample_hz,
            window: info.window,
            labels: info.labels.split(',').map(printable).collect(),
        }),
        BoardMessage::About(about) => Said::About(*about),
        BoardMessage::Left(state) => Said::Left(*state),
        BoardMessage::Right(state) => Said::Right {
            sequence: state.sequence,
            board_time_ms: state.board_time_ms,
            events: state.events,
            label: state.label,
            health: state.health,
        },
        BoardMessage::RawImu(raw) => {
            let whole =
                matches!(raw.axes, 3 | 6 | 9) && raw.counts.len().is_multiple_of(2 * usize::from(raw.axes));
            if !whole || raw.scale.iter().any(|s| !s.is_finite()) {
                return None;
            }
            let counts = raw.counts.chunks_exact(2).map(|b| i16::from_le_bytes([b[0], b[1]])).collect();
            Said::Raw(RawBatch { first_sample: raw.first_sample, axes: raw.axes, scale: raw.scale, counts })
        }
        BoardMessage::RawAdc(raw) => {
            return raw.counts.iter().all(|sum| *sum <= AdcCounts::MAX).then_some(Said::RawLeft(*raw));
        }
        BoardMessage::Tilt(tilt) => Said::Tilt(*tilt),
        BoardMessage::Pairing(pairing) => Said::Pairing(*pairing),
        BoardMessage::Status(status) => Said::Status(*status),
        BoardMessage::Fault(fault) => Said::Fault(*fault),
        BoardMessage::Pong(pong) => Said::Pong(*pong),
        BoardMessage::Ack(ack) => Said::Ack(*ack),
    })
}

/// Detects text on a line that should carry frames.
#[derive(Clone, Debug, Default)]
struct TextHeard {
    last: Vec<u8>,
    frames: bool,
}

impl TextHeard {
    /// A run of this many characters without the byte that ends every frame counts as text.
    const LEAST: usize = 8;

    fn take(&mut self, bytes: &[u8]) {
        self.frames |= bytes.contains(&DELIMITER);
        let printable = |byte: &&u8| matches!(byte, b' '..=b'~');
        self.last.extend(bytes.iter().filter(printable));
        let beyond = self.last.len().saturating_sub(40);
        self.last.drain(..beyond);
    }

    /// Returns the last part of the received data, if the data is text.
    fn line(&self) -> Option<String> {
        (!self.frames && self.last.len() >= Self::LEAST)
            .then(|| String::from_utf8_lossy(&self.last).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_told_from_frames_and_silence() {
        let heard = |parts: &[&[u8]]| {
            let mut text = TextHeard::default();
            parts.iter().for_each(|part| text.take(part));
            text.line()
        };
        assert_eq!(heard(&[b"aX,aY,aZ\r\n", b"0.1,0.2,0.9\r\n"]).as_deref(), Some("aX,aY,aZ0.1,0.2,0.9"));
        assert_eq!(heard(&[&[0, 5, 17], b"hello hello\n", &[0]]), None);
        assert_eq!((heard(&[]), heard(&[&[0xff; 60]])), (None, None));
    }
}
