//! A wearer shows each gesture a few times.
//! The board then receives a model trained on these gestures. Sans-IO.
//!
//! ```text
//! Asking ─Ok─► Ready ⇄ Taking … ─► Back ─Ok─► Learning ─model─► Sending ─► Kept ─restart─► over
//!   └ record mode: the board sends samples but no states, so the robot stands still during every gesture ┘
//! ```
//!
//! The owner sends the messages of [`Showing::poll`] and passes on the board's bytes.
//! All functions here return quickly, so the training on the data of [`Showing::take_shown`] runs elsewhere.

use models::recording::Recording;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder};
use shared_proto::message::{AckResult, HostMessage, Mode};

use crate::capture::Collector;
use crate::talk::{Said, advice, owned};
use crate::upload::{Stage, Upload};

/// Number of times that each gesture is shown.
pub const TIMES: usize = 3;
/// Duration of one take, counted from the word "now".
const TAKE_MS: u64 = 3000;
/// Time to get ready.
/// The first value is for another gesture, and the second value for a repetition of the same gesture.
const READY_MS: u64 = 3000;
const AGAIN_MS: u64 = 1200;
/// A request without an answer is repeated after the first of these times. It fails after the second one.
const REPEAT_MS: u64 = 1000;
const ANSWER_MS: u64 = 5000;
/// If no samples come for this long, the board is not recording.
const SILENCE_MS: u64 = 3000;
/// Maximum number of consecutive takes that may be spoilt.
const SPOILT_MAX: u32 = 3;
/// A transfer without progress for this long is abandoned.
const SENDING_MS: u64 = 60_000;
/// A hand counts as moving if acceleration or rotation varies by more than this (root of the summed variances).
const MOVES_M_S2: f64 = 0.8;
const MOVES_DEG_S: f64 = 30.0;

/// The gestures that were shown, as labels and recordings.
pub type Shown = Vec<(String, Recording)>;

/// See the module.
pub struct Showing {
    labels: Vec<String>,
    sample_hz: u16,
    boot_id: u32,
    decoder: Decoder<BOARD_FRAME_MAX>,
    /// The number of the next request.
    request: u16,
    phase: Phase,
    /// Start of the phase, and the time of the phase's last request.
    since_ms: u64,
    asked_ms: Option<u64>,
    shown: Shown,
    spoilt: u32,
    /// The problem with the last take.
    remark: Option<String>,
    /// Whether the board is in record mode, as far as this program knows.
    records: bool,
}

enum Phase {
    /// Record mode was requested from the board.
    Asking,
    /// The wearer gets ready.
    Ready { until_ms: u64 },
    /// The wearer draws.
    Taking { collector: Collector, heard_ms: u64 },
    /// The board returns to its normal mode before this next phase begins.
    Back(After),
    /// A model is being trained on the gestures that were shown.
    Learning { taken: bool },
    /// The new model is being sent.
    Sending { upload: Upload, reached: usize },
    /// The board has stored the model, and will use it after its next start.
    Kept { model_id: u32 },
    /// The work is done or was abandoned; the text says which.
    Over(String),
}

enum After {
    Learn,
    GiveUp(String),
}

impl Showing {
    /// Creates a request for these gestures. `boot_id` identifies the board's start.
    /// The requests are numbered from `request`.
    pub fn new(labels: Vec<String>, sample_hz: u16, boot_id: u32, request: u16, now_ms: u64) -> Self {
        let phase = if labels.is_empty() {
            Phase::Over("the model knows no gesture that could be shown".to_owned())
        } else {
            Phase::Asking
        };
        Showing { phase, ..Self::begin(labels, sample_hz, boot_id, request, now_ms) }
    }

    /// Begins to send a model that was trained earlier. `boot_id` identifies the start of the board.
    pub fn sending(upload: Upload, boot_id: u32, now_ms: u64) -> Self {
        let phase = Phase::Sending { upload, reached: 0 };
        Showing { phase, ..Self::begin(Vec::new(), 0, boot_id, 0, now_ms) }
    }

    fn begin(labels: Vec<String>, sample_hz: u16, boot_id: u32, request: u16, now_ms: u64) -> Self {
        Showing {
            labels,
            sample_hz,
            boot_id,
            decoder: Decoder::new(),
            request,
            phase: Phase::Asking,
            since_ms: now_ms,
            asked_ms: None,
            shown: Vec::new(),
            spoilt: 0,
            remark: None,
            records: false,
        }
    }

    /// Returns the current request or message for the wearer.
    pub fn text(&self) -> String {
        let still = "the robot stands still meanwhile";
        match &self.phase {
            Phase::Asking => format!("the board is asked for its samples; {still}"),
            Phase::Ready { .. } => {
                let (label, time) = self.place();
                let remark = self.remark.as_ref().map(|remark| format!("{remark}; ")).unwrap_or_default();
                format!("{remark}get ready: {label}, {time} of {TIMES} ({still})")
            }
            Phase::Taking { .. } => {
                let (label, time) = self.place();
                format!("NOW draw {label}, {time} of {TIMES}, for {} s ({still})", TAKE_MS / 1000)
            }
            Phase::Back(After::Learn) | Phase::Learning { .. } => {
                format!("{} recordings are learnt; put your hand down", self.shown.len())
            }
            Phase::Back(After::GiveUp(why)) => format!("given up: {why}"),
            Phase::Sending { upload, .. } => {
                let (done, all) = upload.progress();
                format!("the board gets the model: {done} of {all} bytes; gestures have no effect yet")
            }
            Phase::Kept { model_id } => {
                format!("the board has model {model_id:08x}; press its reset button, and it is used")
            }
            Phase::Over(text) => text.clone(),
        }
    }

    /// Returns the current effect of the key or button.
    pub fn button(&self) -> Option<&'static str> {
        match self.phase {
            Phase::Over(_) => None,
            Phase::Kept { .. } => Some("later"),
            _ => Some("give up"),
        }
    }

    /// Returns the gesture to show next, and the number of its repetition.
    fn place(&self) -> (&str, usize) {
        let label = self.labels.get(self.shown.len() / TIMES).map_or("", String::as_str);
        (label, self.shown.len() % TIMES + 1)
    }

    /// Returns whether the work is over.
    pub fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Over(_))
    }

    /// Returns whether gestures have no effect, because they are being shown or their model is being sent.
    pub fn holds_gestures(&self) -> bool {
        !matches!(self.phase, Phase::Kept { .. } | Phase::Over(_))
    }

    /// Returns all recordings once when they are complete. They are used for training, and [`Showing::learnt`] follows.
    pub fn take_shown(&mut self) -> Option<Shown> {
        match &mut self.phase {
            Phase::Learning { taken } if !*taken => {
                *taken = true;
                Some(self.shown.clone())
            }
            _ => None,
        }
    }

    /// Passes on the trained model, or the reason why there is none.
    pub fn learnt(&mut self, blob: Result<Vec<u8>, String>, now_ms: u64) {
        if !matches!(self.phase, Phase::Learning { .. }) {
            return;
        }
        let upload =
            blob.and_then(|blob| Upload::new(&blob, self.request).map_err(|error| error.to_string()));
        self.phase = match upload {
            Ok(upload) => Phase::Sending { upload, reached: 0 },
            Err(why) => Phase::Over(why),
        };
        self.since_ms = now_ms;
    }

    /// The wearer gives up. The board continues to use its current model.
    pub fn cancel(&mut self, why: &str, now_ms: u64) {
        if let Phase::Kept { model_id } = self.phase {
            self.phase = Phase::Over(format!("the board uses model {model_id:08x} from its next start on"));
        } else if matches!(self.phase, Phase::Back(After::GiveUp(_))) {
            // The wearer has already given up.
        } else if self.records {
            self.go(Phase::Back(After::GiveUp(why.to_owned())), now_ms);
        } else if !self.is_over() {
            self.phase = Phase::Over(format!("given up: {why}"));
        }
    }

    /// Returns the message to send to the board now, if any. Call this only if it can really be sent.
    pub fn poll(&mut self, now_ms: u64) -> Option<HostMessage<'_>> {
        self.advance(now_ms);
        let mode = match &mut self.phase {
            Phase::Asking => Mode::Record,
            Phase::Back(_) => Mode::Classify,
            Phase::Sending { upload, .. } => return upload.poll(now_ms),
            _ => return None,
        };
        if self.asked_ms.is_some_and(|asked| now_ms.saturating_sub(asked) < REPEAT_MS) {
            return None;
        }
        self.asked_ms = Some(now_ms);
        self.records |= mode == Mode::Record;
        Some(HostMessage::SetMode { request: self.request, mode })
    }

    /// Processes bytes from the board, in portions of any size.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64) {
        for &byte in bytes {
            let said = self.decoder.push_board(byte).and_then(|message| owned(&message));
            if let Some(said) = said {
                self.hear(&said, now_ms);
            }
        }
    }

    fn go(&mut self, phase: Phase, now_ms: u64) {
        self.phase = phase;
        self.since_ms = now_ms;
        self.asked_ms = None;
        self.request = self.request.wrapping_add(1);
    }

    /// Handles everything that depends only on the time.
    fn advance(&mut self, now_ms: u64) {
        let passed_ms = now_ms.saturating_sub(self.since_ms);
        match &mut self.phase {
            Phase::Asking if passed_ms >= ANSWER_MS => {
                self.cancel("the board does not answer; check the link, and try again", now_ms);
            }
            Phase::Ready { until_ms } if now_ms >= *until_ms => {
                let wanted = TAKE_MS as usize * usize::from(self.sample_hz.max(1)) / 1000;
                let collector = Collector::new(wanted, self.sample_hz);
                self.go(Phase::Taking { collector, heard_ms: now_ms }, now_ms);
            }
            Phase::Taking { heard_ms, .. } if now_ms.saturating_sub(*heard_ms) > SILENCE_MS => {
                self.cancel("no samples for 3 s; restart the board, and try again", now_ms);
            }
            // After each start, `run` ends the record mode of a board.
            Phase::Back(after) if passed_ms >= ANSWER_MS => {
                let text = match after {
                    After::Learn => "the board did not go back to classifying".to_owned(),
                    After::GiveUp(why) => why.clone(),
                };
                self.records = false;
                self.phase = Phase::Over(format!("{text}; restart the board"));
            }
            Phase::Sending { upload, reached } => {
                let done = upload.progress().0;
                let stage = upload.stage().clone();
                if done != *reached {
                    *reached = done;
                    self.since_ms = now_ms;
                } else if passed_ms >= SENDING_MS {
                    let text = "the transfer made no progress for a minute; the board keeps its old model. Check the \
                                link and try again";
                    self.phase = Phase::Over(text.to_owned());
                    return;
                }
                match stage {
                    Stage::Done => {
                        let model_id = upload.model_id();
                        self.go(Phase::Kept { model_id }, now_ms);
                    }
                    Stage::Failed(why) => self.phase = Phase::Over(why),
                    _ => {}
                }
            }
            _ => {}
        }
    }

    fn hear(&mut self, said: &Said, now_ms: u64) {
        match said {
            Said::Hello(who) if who.boot_id != self.boot_id => {
                self.boot_id = who.boot_id;
                self.restarted(who.model_id, now_ms);
            }
            Said::Ack(ack) => match &mut self.phase {
                Phase::Sending { upload, .. } => upload.ack(ack),
                Phase::Asking if ack.request == self.request => match ack.result {
                    AckResult::Ok => self.get_ready(READY_MS, now_ms),
                    AckResult::Started => {}
                    AckResult::Unsupported => self.refused(
                        "this board's firmware sends no samples; flash it with the one of this version",
                    ),
                    result => self.refused(advice(result)),
                },
                Phase::Back(_) if ack.request == self.request && ack.result == AckResult::Ok => {
                    self.records = false;
                    match std::mem::replace(&mut self.phase, Phase::Asking) {
                        Phase::Back(After::GiveUp(why)) => {
                            self.phase = Phase::Over(format!("given up: {why}"));
                        }
                        _ => self.go(Phase::Learning { taken: false }, now_ms),
                    }
                }
                _ => {}
            },
            Said::Raw(batch) => {
                let Phase::Taking { collector, heard_ms } = &mut self.phase else { return };
                *heard_ms = now_ms;
                match collector.push(batch) {
                    Ok(false) => {}
                    Ok(true) => {
                        let recording = collector.clone().recording();
                        self.taken(recording, now_ms);
                    }
                    Err(problem) => self.spoil(&problem.to_string(), now_ms),
                }
            }
            _ => {}
        }
    }

    fn restarted(&mut self, model_id: u32, now_ms: u64) {
        match &mut self.phase {
            Phase::Sending { upload, .. } => upload.restarted(),
            Phase::Kept { model_id: wanted } => {
                self.phase = Phase::Over(if *wanted == model_id {
                    format!("the board runs model {model_id:08x} now: draw, and see")
                } else {
                    format!(
                        "the board started with model {model_id:08x}, not with the new one; send it again"
                    )
                });
            }
            Phase::Learning { .. } | Phase::Over(_) => {}
            // A board starts in its usual mode.
            _ => {
                self.records = false;
                self.cancel("the board restarted; check its power and cable, and try again", now_ms);
            }
        }
    }

    fn refused(&mut self, why: &str) {
        self.records = false;
        self.phase = Phase::Over(why.to_owned());
    }

    fn get_ready(&mut self, time_ms: u64, now_ms: u64) {
        self.go(Phase::Ready { until_ms: now_ms + time_ms }, now_ms);
    }

    fn taken(&mut self, recording: Recording, now_ms: u64) {
        let (label, _) = self.place();
        let label = label.to_owned();
        if !moves(&recording) {
            return self.spoil("the hand hardly moved", now_ms);
        }
        self.shown.push((label, recording));
        (self.spoilt, self.remark) = (0, None);
        if self.shown.len() == TIMES * self.labels.len() {
            self.go(Phase::Back(After::Learn), now_ms);
        } else {
            let is_other = self.shown.len().is_multiple_of(TIMES);
            self.get_ready(if is_other { READY_MS } else { AGAIN_MS }, now_ms);
        }
    }

    fn spoil(&mut self, why: &str, now_ms: u64) {
        self.spoilt += 1;
        if self.spoilt >= SPOILT_MAX {
            return self.cancel(&format!("{why}, {SPOILT_MAX} times"), now_ms);
        }
        self.remark = Some(format!("{why}: once more"));
        self.get_ready(READY_MS, now_ms);
    }
}

/// Returns whether a hand moves in a recording, as it does in any gesture.
fn moves(recording: &Recording) -> bool {
    let spread = |axes: std::ops::Range<usize>| {
        let count = recording.len().max(1) as f64;
        let variance = |axis: usize| {
            let values = || recording.samples().map(|sample| f64::from(sample[axis]));
            let mean = values().sum::<f64>() / count;
            values().map(|value| (value - mean).powi(2)).sum::<f64>() / count
        };
        axes.map(variance).sum::<f64>().sqrt()
    };
    spread(0..3) > MOVES_M_S2 || (recording.axes() >= 6 && spread(3..6) > MOVES_DEG_S)
}
