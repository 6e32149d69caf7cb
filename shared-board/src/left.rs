//! The left board: converts samples to states, answers requests, and sends a status each second.

use crate::calibration_store::{CalibrationStore, Eeprom, Progress};
use crate::{FrameOut, Identity, STATUS_INTERVAL_MS};
use shared_dsp::left::calibration::{Calibration, CaptureError, CaptureStep, Stored};
use shared_dsp::left::guided::{Guided, GuidedAction};
use shared_dsp::left::{AdcCounts, LeftHand, LeftOutput};
use shared_proto::frame::{DELIMITER, Decoder, HOST_TO_LEFT_FRAME_MAX, LEFT_BOARD_FRAME_MAX};
use shared_proto::message::{
    Ack, AckResult, BoardBody, CalibrationStep, Fault, FaultKind, LeftRequest, LeftState, Mode, Pong, RawAdc,
    Status, TiltThresholds,
};

/// A state is sent with every second sample, which is at 50 Hz.
const SAMPLES_PER_STATE: u8 = 2;

/// The origin of the current calibration step or of the current write.
#[derive(Clone, Copy, Debug)]
enum Asker {
    Nobody,
    /// The laptop requested the step; the value is the number of its request.
    Host(u16),
    /// The calibration pin was grounded at power-on.
    Pin {
        guided: Guided,
        /// The calibration that is restored after a failure.
        before: Option<Calibration>,
    },
}

/// The circumstances of a start.
#[derive(Clone, Copy, Debug, Default)]
pub struct Start {
    /// The reason why the previous run ended, such as a watchdog or a panic.
    pub fault: Option<FaultKind>,
    /// Whether to calibrate now without a laptop, guided by the light.
    pub guided: bool,
}

/// The left board without its registers. `M` is the memory for the calibration.
///
/// All times are those at which the current sampling period began, on the board's clock.
#[derive(Clone, Debug)]
pub struct LeftBoard<M> {
    identity: Identity,
    hand: LeftHand,
    store: CalibrationStore<M>,
    decoder: Decoder<HOST_TO_LEFT_FRAME_MAX>,
    asker: Asker,
    mode: Mode,
    sequence: u16,
    last_status_ms: u32,
    samples_until_state: u8,
    sampled_in_period: bool,
    /// Whether a change still has to be sent, because the line had no room for it.
    owed: bool,
    hello_owed: bool,
    fault_owed: Option<FaultKind>,
    light: bool,
}

impl<M: Eeprom> LeftBoard<M> {
    /// Loads the calibration, and terminates any partial frame of an earlier run.
    pub fn start(identity: Identity, memory: M, start: Start, out: &mut impl FrameOut) -> Self {
        let (store, stored) = CalibrationStore::load(memory);
        let calibration = match stored {
            Stored::Good { record, .. } => Some(record.calibration),
            Stored::Blank | Stored::Damaged => None,
        };
        let damaged = matches!(stored, Stored::Damaged).then_some(FaultKind::CalibrationDamaged);
        out.send(&[DELIMITER]);
        Self {
            identity,
            hand: LeftHand::new(calibration, TiltThresholds::DEFAULT, 0),
            store,
            decoder: Decoder::new(),
            asker: if start.guided {
                Asker::Pin { guided: Guided::new(0), before: calibration }
            } else {
                Asker::Nobody
            },
            mode: Mode::Classify,
            sequence: 0,
            last_status_ms: 0,
            samples_until_state: 1,
            sampled_in_period: true,
            owed: false,
            hello_owed: true,
            fault_owed: start.fault.or(damaged),
            light: false,
        }
    }

    /// Processes the sample of this period.
    #[inline(never)]
    pub fn sample(&mut self, counts: AdcCounts, now_ms: u32, out: &mut impl FrameOut) {
        self.sampled_in_period = true;
        if self.mode == Mode::Record {
            // If there is no room, the sample is lost, and the laptop notices this from the times.
            send(&RawAdc { board_time_ms: now_ms, counts: counts.as_array() }, out);
        }
        let output = self.hand.step(counts, now_ms);
        self.on_output(output, now_ms, out);
    }

    /// Begins a new period, whose sample follows. Returns whether [`LeftBoard::status`] is due.
    #[inline(never)]
    pub fn period(&mut self, now_ms: u32, out: &mut impl FrameOut) -> bool {
        if !self.sampled_in_period {
            let output = self.hand.no_sample(now_ms);
            self.on_output(output, now_ms, out);
        }
        self.sampled_in_period = false;
        self.calibrate(now_ms, out);
        if self.hello_owed {
            self.hello_owed = !send(&self.identity.hello(0), out);
        } else if let Some(kind) = self.fault_owed
            && send(&Fault { uptime_ms: now_ms, kind, detail: 0 }, out)
        {
            self.fault_owed = None;
        }
        let due = now_ms.wrapping_sub(self.last_status_ms) >= STATUS_INTERVAL_MS;
        if due {
            self.last_status_ms = now_ms;
        }
        due
    }

    /// Sends the counters of the drivers, together with the board's time, damaged frames and mode.
    /// The drivers use `bad_frames` for the number of bytes that arrived too fast.
    #[inline]
    pub fn status(&self, mut counted: Status, now_ms: u32, out: &mut impl FrameOut) {
        counted.uptime_ms = now_ms;
        counted.bad_frames = counted.bad_frames.wrapping_add(self.decoder.counters().damaged());
        counted.mode = self.mode;
        send(&counted, out);
    }

    /// Processes a byte from the laptop. Answers are sent immediately, except a hello, which is sent in the next period.
    #[inline(never)]
    pub fn receive(&mut self, byte: u8, now_ms: u32, out: &mut impl FrameOut) {
        let Some(message) = self.decoder.push_left_request(byte) else { return };
        self.answer(message, now_ms, out);
    }

    /// Processes a request, like [`LeftBoard::receive`]. Boards with several links decode the bytes of each link themselves.
    #[inline]
    pub fn answer(&mut self, message: LeftRequest, now_ms: u32, out: &mut impl FrameOut) {
        let (request, result) = match message {
            LeftRequest::HelloRequest => {
                self.hello_owed = true;
                return;
            }
            LeftRequest::Ping { id } => {
                send(&Pong { id, board_time_ms: now_ms }, out);
                return;
            }
            LeftRequest::SetMode { request, mode } => {
                self.mode = mode;
                (request, AckResult::Ok)
            }
            LeftRequest::Calibrate { request, step } => (request, self.start_calibration(request, step)),
            LeftRequest::SetThresholds { request, thresholds } => {
                let taken = self.hand.set_thresholds(thresholds);
                (request, if taken { AckResult::Ok } else { AckResult::OutOfRange })
            }
        };
        acknowledge(request, result, out);
    }

    /// Returns whether the light is on. The light guides a calibration without a laptop and is otherwise off.
    pub fn light(&self) -> bool {
        self.light
    }

    /// The active calibration.
    pub fn calibration(&self) -> &Calibration {
        self.hand.calibration()
    }

    /// Returns the memory, for use at the board's next start.
    pub fn into_memory(self) -> M {
        self.store.into_memory()
    }

    #[inline(never)]
    fn on_output(&mut self, output: LeftOutput, now_ms: u32, out: &mut impl FrameOut) {
        self.owed |= output.changed;
        self.samples_until_state -= 1;
        let due = self.samples_until_state == 0;
        if due {
            self.samples_until_state = SAMPLES_PER_STATE;
        }
        if (due || self.owed) && self.mode == Mode::Classify {
            let state = LeftState {
                sequence: self.sequence,
                board_time_ms: now_ms,
                pitch_mrad: output.pitch_mrad,
                roll_mrad: output.roll_mrad,
                heading: output.heading,
                index_bends: output.index_bends,
                middle_bends: output.middle_bends,
                stop: output.stop,
                health: output.health,
            };
            if send(&state, out) {
                self.sequence = self.sequence.wrapping_add(1);
                self.owed = false;
            }
        }
    }

    /// Advances the calibration. It handles completed steps, bytes to write, and the light.
    #[inline(never)]
    fn calibrate(&mut self, now_ms: u32, out: &mut impl FrameOut) {
        let ended = self.hand.take_captured();
        let kept = self.store.poll();
        match &mut self.asker {
            Asker::Nobody => {}
            Asker::Host(request) => {
                let request = *request;
                let result = match (ended, kept) {
                    (Some(Ok(new)), _) => {
                        self.hand.set_calibration(Some(new));
                        self.store.keep(&new);
                        return;
                    }
                    (Some(Err(CaptureError::Moved | CaptureError::Impossible)), _) => AckResult::Unsteady,
                    (None, Progress::Done) => AckResult::Ok,
                    (None, Progress::Failed) => AckResult::StorageFailed,
                    (None, Progress::None) => return,
                };
                self.asker = Asker::Nobody;
                acknowledge(request, result, out);
            }
            Asker::Pin { guided, before } => {
                let taken = ended.map(|outcome| outcome.is_ok());
                if let Some(Ok(new)) = ended {
                    self.hand.set_calibration(Some(new));
                }
                match guided.step(taken, now_ms) {
                    GuidedAction::Wait => {}
                    GuidedAction::Start(step) => {
                        self.hand.start_capture(step);
                    }
                    GuidedAction::Keep => self.store.keep(self.hand.calibration()),
                    GuidedAction::GiveUp => {
                        self.hand.set_calibration(*before);
                        self.asker = Asker::Nobody;
                        self.light = false;
                        return;
                    }
                }
                self.light = guided.light(now_ms) || self.store.is_busy();
                if kept != Progress::None {
                    self.asker = Asker::Nobody;
                }
            }
        }
    }

    #[inline(never)]
    fn start_calibration(&mut self, request: u16, step: CalibrationStep) -> AckResult {
        if !matches!(self.asker, Asker::Nobody) || self.store.is_busy() {
            return AckResult::Busy;
        }
        let step = match step {
            CalibrationStep::Neutral => CaptureStep::Neutral,
            CalibrationStep::Rest => CaptureStep::Rest,
            CalibrationStep::Bend => CaptureStep::Bend,
            CalibrationStep::Reset => {
                self.hand.set_calibration(None);
                self.store.forget();
                self.asker = Asker::Host(request);
                return AckResult::Started;
            }
        };
        self.hand.start_capture(step);
        self.asker = Asker::Host(request);
        AckResult::Started
    }
}

#[inline(never)]
fn acknowledge(request: u16, result: AckResult, out: &mut impl FrameOut) {
    send(&Ack { request, result, next_offset: 0 }, out);
}

/// All messages share one buffer size, because the left board has no room for several versions of this code.
fn send(body: &impl BoardBody, out: &mut impl FrameOut) -> bool {
    crate::send::<LEFT_BOARD_FRAME_MAX>(body, out)
}
