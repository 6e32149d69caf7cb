//! The right board: converts samples to gestures or raw batches, and answers requests.

use crate::almost::Almost;
use crate::faults::FaultLog;
use crate::hand::Hand;
use crate::models::ModelRequest;
use crate::vibration::{Motor, Vibration};
use crate::{FrameOut, Identity, send};
use shared_dsp::right::features::HOP;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{MAX_AXES, MAX_LABELS};
use shared_proto::message::{
    About, Ack, AckResult, Board, BoardBody, Bytes, Fault, FaultKind, Hello, HostMessage, Mode, ModelInfo,
    Pong, RAW_COUNTS_MAX, RawImu, RightState, RightTilt, SCORES_MAX, Status, health,
};

/// [`RightBoard::silence`] is due after this time without a sample, and again after each further period.
/// The time is longer than the erasure of a flash page, during which samples wait in the sensor.
pub const SILENCE_MS: u32 = 120;

/// The state that the board's light shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Red: the sensor delivers no samples.
    SensorGone,
    /// Blue: raw samples are recorded.
    Recording,
    /// Green: gestures are recognised, or the board is idle.
    Well,
    /// Green, twice: a movement was nearly a gesture.
    Almost,
}

/// The right board without its registers. `H` recognises the gestures.
#[derive(Clone, Debug)]
pub struct RightBoard<H> {
    identity: Identity,
    hand: H,
    mode: Mode,
    sequence: u16,
    board_time_ms: u32,
    sensor_ok: bool,
    about: Option<About>,
    /// The description of the hardware that all links received last.
    told: Option<About>,
    vibration: Vibration,
    /// Whether a hello was sent since start.
    greeted: bool,
    raw: RawBatch,
    tilt: MeanTilt,
    faults: FaultLog,
    almost: Almost,
    /// Whether a movement was nearly a gesture since the light was last asked for.
    was_near: bool,
}

impl<H: Hand> RightBoard<H> {
    /// Creates a board that starts now, whose sensor has not delivered any samples.
    pub fn new(identity: Identity, hand: H) -> Self {
        let almost = Almost::new(hand.model().labels.0);
        Self {
            identity,
            hand,
            mode: Mode::Classify,
            sequence: 0,
            board_time_ms: 0,
            sensor_ok: false,
            about: None,
            told: None,
            vibration: Vibration::default(),
            greeted: false,
            raw: RawBatch::new(),
            tilt: MeanTilt::default(),
            faults: FaultLog::new(),
            almost,
            was_near: false,
        }
    }

    /// Processes the sample with this `number` since start, and its time.
    /// Returns whether [`RightBoard::send_due`] has something to send.
    ///
    /// This function only computes, and another function only sends.
    #[inline]
    pub fn sample(&mut self, sample: &H::Sample, time_ms: u32, number: u32) -> bool {
        match self.mode {
            Mode::Classify => {
                self.board_time_ms = time_ms;
                self.tilt.push(&self.hand, sample);
                if self.model_can_run() {
                    return self.hand.push(sample, time_ms);
                }
                // The laptop receives the reason why no gesture is recognised.
                // It receives this reason as often as it would otherwise receive states.
                self.hand.gap();
                number.is_multiple_of(HOP as u32)
            }
            mode => {
                // Samples that did not enter the window count as a gap.
                self.hand.gap();
                let mut counts = [0; MAX_AXES];
                mode == Mode::Record && {
                    let axes = self.hand.counts(sample, &mut counts).min(self.axes().unwrap_or(MAX_AXES));
                    self.raw.push(number, &counts[..axes])
                }
            }
        }
    }

    /// Sends the state or the batch that the last [`RightBoard::sample`] completed. The first call also sends a hello.
    pub fn send_due(&mut self, out: &mut impl FrameOut) {
        self.greet(out);
        match self.mode {
            Mode::Classify => self.send_state(out),
            Mode::Record => self.raw.send(self.hand.scale().unwrap_or_default(), out),
            Mode::Idle => {}
        }
    }

    /// Reports missing samples.
    pub fn gap(&mut self) {
        self.hand.gap();
        self.raw.clear();
        self.tilt.samples = 0;
    }

    /// Reports that no sample arrived for [`SILENCE_MS`]. This empties the window and informs the laptop.
    pub fn silence(&mut self, out: &mut impl FrameOut) {
        self.gap();
        self.greet(out);
        if self.mode == Mode::Classify {
            self.send_state(out);
        }
    }

    /// Sets whether the sensor delivers samples.
    pub fn set_sensor_ok(&mut self, ok: bool) {
        self.sensor_ok = ok;
    }

    /// Sets the description of the board's hardware, as far as the driver knows it.
    /// The description is sent after each hello.
    /// If it changes (for example because of the battery), it is also sent with the next status.
    pub fn set_about(&mut self, about: About) {
        self.about = Some(about);
    }

    /// Number of valid values per sample, once the sensor has been detected.
    fn axes(&self) -> Option<usize> {
        self.about.map(|about| usize::from(about.axes)).filter(|&axes| axes > 0)
    }

    /// Returns whether the sensor provides all values that the model reads.
    pub fn model_can_run(&self) -> bool {
        let model = self.hand.model();
        let runs_on = |axes| {
            FeatureKind::from_id(model.recipe).is_none_or(|r| r.runs_on(usize::from(model.axes), axes))
        };
        self.axes().is_none_or(runs_on)
    }

    /// Sets the kind of board that the driver has detected.
    pub fn set_board(&mut self, board: Board) {
        self.identity.board = board;
    }

    /// Sends a fault, and stores it for laptops that connect later.
    pub fn report(&mut self, kind: FaultKind, detail: u32, now_ms: u32, out: &mut impl FrameOut) {
        self.faults.report(Fault { uptime_ms: now_ms, kind, detail }, out);
    }

    /// Answers a message.
    /// The method does not answer messages about models, but returns them.
    /// A [`ModelStore`](crate::models::ModelStore) must answer these messages.
    ///
    /// `trusted` is true if the link may change settings and stored data (with Bluetooth, if it is bonded).
    pub fn receive<'r>(
        &mut self,
        message: &HostMessage<'r>,
        trusted: bool,
        now_ms: u32,
        out: &mut impl FrameOut,
    ) -> Option<ModelRequest<'r>> {
        if trusted {
            self.vibration.heard(now_ms);
        }
        let (request, result) = match *message {
            HostMessage::HelloRequest => {
                self.hello(out);
                return None;
            }
            HostMessage::Ping { id } => {
                send::<{ Pong::FRAME_MAX }>(&Pong { id, board_time_ms: now_ms }, out);
                return None;
            }
            HostMessage::Feel { signal } => {
                if trusted {
                    self.vibration.feel(signal, now_ms);
                }
                return None;
            }
            HostMessage::Calibrate { request, .. } => (request, AckResult::Unsupported),
            HostMessage::SetThresholds { request, .. } => (request, self.send_tilt(trusted)),
            HostMessage::SetMode { request, mode } => (request, self.set_mode(mode, trusted)),
            HostMessage::ModelBegin(_)
            | HostMessage::ModelChunk { .. }
            | HostMessage::ModelCommit { .. }
            | HostMessage::ImageBegin { .. }
            | HostMessage::ImageConfirm { .. }
                if trusted =>
            {
                return ModelRequest::of(message);
            }
            HostMessage::ModelBegin(begin) => (begin.request, AckResult::NotBonded),
            HostMessage::ModelChunk { request, .. }
            | HostMessage::ModelCommit { request, .. }
            | HostMessage::ImageBegin { request, .. }
            | HostMessage::ImageConfirm { request, .. } => (request, AckResult::NotBonded),
        };
        send::<{ Ack::FRAME_MAX }>(&Ack { request, result, next_offset: 0 }, out);
        None
    }

    /// Sends the counters of the drivers, together with the board's time and mode.
    /// Call this every [`STATUS_INTERVAL_MS`](crate::STATUS_INTERVAL_MS).
    pub fn status(&mut self, mut counted: Status, now_ms: u32, out: &mut impl FrameOut) {
        counted.uptime_ms = now_ms;
        counted.mode = self.mode;
        send::<{ Status::FRAME_MAX }>(&counted, out);
        if self.greeted && self.told != self.about {
            self.told = self.about;
            self.say_about(out);
        }
    }

    /// Returns the state of the vibration motor.
    /// Call this again at the returned time, and after each [`HostMessage::Feel`].
    pub fn motor(&mut self, now_ms: u32) -> Motor {
        self.vibration.motor(now_ms)
    }

    /// Returns the state of the light. Each nearly recognised gesture is returned once.
    pub fn light(&mut self) -> Light {
        let was_near = core::mem::take(&mut self.was_near);
        match (self.sensor_ok, self.mode) {
            (false, _) => Light::SensorGone,
            (true, Mode::Record) => Light::Recording,
            (true, Mode::Classify) if was_near => Light::Almost,
            (true, _) => Light::Well,
        }
    }

    /// Informs a connected laptop that the board has started.
    fn greet(&mut self, out: &mut impl FrameOut) {
        if !self.greeted {
            self.greeted = true;
            self.hello(out);
        }
    }

    /// Sends the identity and labels of this board, and repeats its faults.
    fn hello(&self, out: &mut impl FrameOut) {
        let model = self.hand.model();
        send::<{ Hello::FRAME_MAX }>(&self.identity.hello(model.model_id), out);
        send::<{ ModelInfo::FRAME_MAX }>(&model, out);
        self.say_about(out);
        self.faults.repeat(out);
    }

    fn say_about(&self, out: &mut impl FrameOut) {
        if let Some(about) = &self.about {
            send::<{ About::FRAME_MAX }>(about, out);
        }
    }

    fn set_mode(&mut self, mode: Mode, trusted: bool) -> AckResult {
        if !trusted {
            return AckResult::NotBonded;
        }
        if mode == Mode::Record && self.hand.scale().is_none() {
            return AckResult::Unsupported;
        }
        self.mode = mode;
        self.tilt.samples = 0;
        AckResult::Ok
    }

    /// Sends the tilt with each state from now on. The laptop applies the thresholds.
    fn send_tilt(&mut self, trusted: bool) -> AckResult {
        if !trusted {
            return AckResult::NotBonded;
        }
        if self.hand.scale().is_none() {
            return AckResult::Unsupported;
        }
        self.tilt.is_on = true;
        AckResult::Ok
    }

    fn send_state(&mut self, out: &mut impl FrameOut) {
        let output = self.hand.output();
        let mut flags = if self.model_can_run() { 0 } else { health::MODEL };
        if !self.sensor_ok {
            flags |= health::SENSOR;
        }
        if !output.full || output.replaced {
            flags |= health::GAP;
        }
        if output.full && flags & health::MODEL == 0 {
            self.was_near |= self.almost.see(output.scores(), output.is_event);
        } else {
            self.almost.reset();
        }
        let scores = output.score_bytes();
        let state = RightState {
            sequence: self.sequence,
            board_time_ms: self.board_time_ms,
            events: output.events,
            label: output.label,
            confidence: output.confidence,
            event_window_end_ms: output.event_window_end_ms,
            scores: Bytes(&scores[..output.scores().len()]),
            health: flags,
        };
        send::<{ RightState::FRAME_MAX }>(&state, out);
        self.tilt.send(self.sequence, self.hand.scale(), out);
        self.sequence = self.sequence.wrapping_add(1);
    }
}

/// Samples that will be sent in record mode, one hop at a time.
#[derive(Clone, Copy, Debug)]
struct RawBatch {
    sequence: u16,
    first: u32,
    samples: usize,
    axes: usize,
    bytes: [u8; RAW_COUNTS_MAX],
}

impl RawBatch {
    const fn new() -> Self {
        Self { sequence: 0, first: 0, samples: 0, axes: 0, bytes: [0; RAW_COUNTS_MAX] }
    }

    fn clear(&mut self) {
        self.samples = 0;
    }

    /// Adds a sample. Returns true if this fills the batch.
    fn push(&mut self, number: u32, counts: &[i16]) -> bool {
        // The samples of a batch must not have gaps.
        let expected = self.first.wrapping_add(self.samples as u32);
        if self.samples == 0 || self.samples == HOP || number != expected {
            self.samples = 0;
            self.first = number;
        }
        self.axes = counts.len();
        let places = self.bytes.chunks_exact_mut(2).skip(self.samples * counts.len());
        for (place, count) in places.zip(counts) {
            place.copy_from_slice(&count.to_le_bytes());
        }
        self.samples += 1;
        self.samples == HOP
    }

    fn send(&mut self, scale: [f32; 3], out: &mut impl FrameOut) {
        let used = (2 * self.samples * self.axes).min(RAW_COUNTS_MAX);
        let batch = RawImu {
            sequence: self.sequence,
            first_sample: self.first,
            axes: self.axes as u8,
            scale,
            counts: Bytes(&self.bytes[..used]),
        };
        send::<{ RawImu::FRAME_MAX }>(&batch, out);
        self.sequence = self.sequence.wrapping_add(1);
        self.clear();
    }
}

/// The acceleration of the current hop.
#[derive(Clone, Copy, Debug, Default)]
struct MeanTilt {
    is_on: bool,
    samples: usize,
    sum: [i32; 3],
}

impl MeanTilt {
    fn push<H: Hand>(&mut self, hand: &H, sample: &H::Sample) {
        if !self.is_on {
            return;
        }
        if self.samples == 0 {
            self.sum = [0; 3];
        }
        let mut counts = [0; MAX_AXES];
        hand.counts(sample, &mut counts);
        for (sum, count) in self.sum.iter_mut().zip(counts) {
            *sum = sum.wrapping_add(count.into());
        }
        self.samples += 1;
    }

    /// Sends the mean of a complete hop. A hop with missing samples has no tilt.
    fn send(&mut self, sequence: u16, scale: Option<[f32; 3]>, out: &mut impl FrameOut) {
        if let Some([m_s2, ..]) = scale.filter(|_| self.samples == HOP) {
            let factor = m_s2 * (1000.0 / HOP as f32);
            // The cast saturates.
            let acceleration_mm_s2 = self.sum.map(|sum| (sum as f32 * factor) as i16);
            send::<{ RightTilt::FRAME_MAX }>(&RightTilt { sequence, acceleration_mm_s2 }, out);
        }
        self.samples = 0;
    }
}

const _: () = assert!(HOP * MAX_AXES * 2 <= RAW_COUNTS_MAX && MAX_LABELS <= SCORES_MAX);
