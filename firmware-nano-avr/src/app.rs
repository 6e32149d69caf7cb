//! What goes in and out: samples to states, requests to acknowledgements, one status per second.

use crate::pins::Light;
use crate::restart::{self, Cause};
use crate::serial::{self, Serial};
use crate::store::{Progress, Store};
use crate::{adc, clock, stack};
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use embedded_hal::digital::OutputPin;
use embedded_io::{Read, ReadReady, Write};
use shared_dsp::left::{LeftHand, LeftOutput};
use shared_dsp::left_calibration::{self as calibration, Calibration, CaptureError, Stored};
use shared_dsp::left_guided::{Guided, GuidedAction};
use shared_dsp::tilt;
use shared_proto::frame::{DELIMITER, Decoder, HOST_TO_LEFT_FRAME_MAX, LEFT_BOARD_FRAME_MAX, encode_body};
use shared_proto::message::{
    Ack, AckResult, Board, BoardBody, CalibrationStep, Fault, FaultKind, Heading, Hello, LeftRequest,
    LeftState, Mode, PROTOCOL_MAJOR, PROTOCOL_MINOR, Pong, Status, TiltThresholds,
};

/// A state goes out with every second sample: 50 Hz.
const SAMPLES_PER_STATE: u8 = 2;
/// Received bytes handled in one go, so that a flood cannot keep a sample waiting.
const BYTES_AT_ONCE: usize = 16;

/// Who asked for the calibration step or the write that is under way.
enum Asker {
    Nobody,
    /// The laptop, with its request number.
    Host(u16),
    /// The pin at power-on.
    Pin {
        guided: Guided,
        /// What to go back to.
        before: Option<Calibration>,
    },
}

/// The whole board behind its registers.
pub struct App {
    hand: LeftHand,
    store: Store,
    decoder: Decoder<HOST_TO_LEFT_FRAME_MAX>,
    asker: Asker,
    boot_id: u32,
    mode: Mode,
    sequence: u16,
    period: u32,
    last_status_period: u32,
    samples_until_state: u8,
    sampled_in_period: bool,
    /// A change that found no room in the send buffer.
    owed: bool,
    hello_owed: bool,
    fault_owed: Option<FaultKind>,
}

/// The one [`App`]. In static memory, so that `.bss` shows what it takes.
static mut APP: MaybeUninit<App> = MaybeUninit::uninit();

/// Makes the [`App`]. Called once per start. Not inlined: its copy on the stack would stay there for ever.
#[inline(never)]
pub fn install(cause: Cause, boot_id: u32, guided: bool) -> &'static mut App {
    // Safety: the only use of `APP`, before interrupts are on; they never touch it.
    let place = unsafe { &mut *addr_of_mut!(APP) };
    place.write(App::new(cause, boot_id, guided))
}

impl App {
    /// Loads the calibration; `guided` starts the calibration that one light guides.
    pub fn new(cause: Cause, boot_id: u32, guided: bool) -> Self {
        let (store, stored) = Store::load();
        let calibration = match stored {
            Stored::Good { record, .. } => Some(record.calibration),
            Stored::Blank | Stored::Damaged => None,
        };
        let fault_owed = match (cause, stored) {
            (Cause::Watchdog, _) => Some(FaultKind::Watchdog),
            (Cause::Panic, _) => Some(FaultKind::Panic),
            (Cause::Ordinary, Stored::Damaged) => Some(FaultKind::CalibrationDamaged),
            (Cause::Ordinary, _) => None,
        };
        // Ends whatever half frame an earlier run left on the line.
        let _ = Serial.write(&[DELIMITER]);
        Self {
            hand: LeftHand::new(calibration, tilt::TiltThresholds::DEFAULT, 0),
            store,
            decoder: Decoder::new(),
            asker: if guided {
                Asker::Pin { guided: Guided::new(0), before: calibration }
            } else {
                Asker::Nobody
            },
            boot_id,
            mode: Mode::Classify,
            sequence: 0,
            period: 0,
            last_status_period: 0,
            samples_until_state: 1,
            sampled_in_period: true,
            owed: false,
            hello_owed: true,
            fault_owed,
        }
    }

    /// Is there anything to do? Interrupts are off.
    pub fn has_work(&self) -> bool {
        self.period != clock::periods() || adc::has_sample() || Serial.read_ready() == Ok(true)
    }

    /// Does all there is to do.
    pub fn poll(&mut self) {
        if let Some(counts) = adc::take_sample() {
            self.sampled_in_period = true;
            let output = self.hand.step(counts, self.now_ms());
            self.on_output(output);
        }
        let period = clock::periods();
        if period != self.period {
            self.period = period;
            self.on_period();
        }
        let mut bytes = [0; BYTES_AT_ONCE];
        if Serial.read_ready() == Ok(true)
            && let Ok(count) = Serial.read(&mut bytes)
        {
            for &byte in &bytes[..count] {
                self.on_byte(byte);
            }
        }
    }

    fn now_ms(&self) -> u32 {
        self.period.wrapping_mul(clock::PERIOD_MS)
    }

    /// A new period began; its sample follows 5 ms later.
    #[inline(never)]
    fn on_period(&mut self) {
        restart::all_is_well();
        let now_ms = self.now_ms();
        if !self.sampled_in_period {
            let output = self.hand.no_sample(now_ms);
            self.on_output(output);
        }
        self.sampled_in_period = false;
        self.calibrate(now_ms);
        if self.hello_owed {
            self.hello_owed = !self.send_hello();
        } else if let Some(kind) = self.fault_owed {
            if self.send(&Fault { uptime_ms: now_ms, kind, detail: 0 }) {
                self.fault_owed = None;
            }
        }
        let since_status = self.period.wrapping_sub(self.last_status_period);
        if since_status >= u32::from(clock::SAMPLE_HZ) {
            self.last_status_period = self.period;
            self.send_status(since_status);
        }
    }

    #[inline(never)]
    fn on_output(&mut self, output: LeftOutput) {
        self.owed |= output.changed;
        self.samples_until_state -= 1;
        let due = self.samples_until_state == 0;
        if due {
            self.samples_until_state = SAMPLES_PER_STATE;
        }
        if (due || self.owed) && self.mode == Mode::Classify {
            let state = LeftState {
                sequence: self.sequence,
                board_time_ms: self.now_ms(),
                pitch_mrad: output.pitch_mrad,
                roll_mrad: output.roll_mrad,
                heading: heading(output.heading),
                index_bends: output.index_bends,
                middle_bends: output.middle_bends,
                stop: output.stop,
                health: output.health,
            };
            if self.send(&state) {
                self.sequence = self.sequence.wrapping_add(1);
                self.owed = false;
            }
        }
    }

    /// Moves calibration along: steps that ended, bytes to write, the guide's light.
    #[inline(never)]
    fn calibrate(&mut self, now_ms: u32) {
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
                self.acknowledge(request, result);
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
                        let _ = Light.set_low();
                        return;
                    }
                }
                let light = guided.light(now_ms) || self.store.is_busy();
                let _ = Light.set_state(light.into());
                if kept != Progress::None {
                    self.asker = Asker::Nobody;
                }
            }
        }
    }

    #[inline(never)]
    fn on_byte(&mut self, byte: u8) {
        let Some(message) = self.decoder.push_left_request(byte) else { return };
        let (request, result) = match message {
            LeftRequest::HelloRequest => {
                self.hello_owed = true;
                return;
            }
            LeftRequest::Ping { id } => {
                let board_time_ms = self.now_ms();
                self.send(&Pong { id, board_time_ms });
                return;
            }
            LeftRequest::SetMode { request, mode: Mode::Record } => (request, AckResult::Unsupported),
            LeftRequest::SetMode { request, mode } => {
                self.mode = mode;
                (request, AckResult::Ok)
            }
            LeftRequest::Calibrate { request, step } => (request, self.start_calibration(request, step)),
            LeftRequest::SetThresholds { request, thresholds } => {
                let TiltThresholds { neutral_mrad, end_mrad, start_mrad } = thresholds;
                let taken =
                    self.hand.set_thresholds(tilt::TiltThresholds { neutral_mrad, end_mrad, start_mrad });
                (request, if taken { AckResult::Ok } else { AckResult::OutOfRange })
            }
        };
        self.acknowledge(request, result);
    }

    #[inline(never)]
    fn start_calibration(&mut self, request: u16, step: CalibrationStep) -> AckResult {
        if !matches!(self.asker, Asker::Nobody) || self.store.is_busy() {
            return AckResult::Busy;
        }
        let step = match step {
            CalibrationStep::Neutral => calibration::CalibrationStep::Neutral,
            CalibrationStep::Rest => calibration::CalibrationStep::Rest,
            CalibrationStep::Bend => calibration::CalibrationStep::Bend,
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

    #[inline(never)]
    fn acknowledge(&mut self, request: u16, result: AckResult) {
        self.send(&Ack { request, result, next_offset: 0 });
    }

    #[inline(never)]
    fn send_hello(&mut self) -> bool {
        self.send(&Hello {
            major: PROTOCOL_MAJOR,
            minor: PROTOCOL_MINOR,
            board: Board::LeftNano,
            firmware: env!("CARGO_PKG_VERSION"),
            boot_id: self.boot_id,
            model_id: 0,
            sample_hz: clock::SAMPLE_HZ,
        })
    }

    #[inline(never)]
    fn send_status(&mut self, periods: u32) {
        let status = Status {
            uptime_ms: self.now_ms(),
            dropped_samples: adc::dropped(),
            sensor_errors: adc::restarts(),
            bad_frames: self.decoder.counters().damaged().wrapping_add(u32::from(serial::lost())),
            free_stack_bytes: u32::from(stack::least_free()),
            load_permille: clock::take_load_permille(periods),
            mode: self.mode,
        };
        self.send(&status);
    }

    /// Queues a frame, whole or not at all: nothing here ever waits for the line.
    fn send<B: BoardBody>(&mut self, body: &B) -> bool {
        let mut buffer = [0; LEFT_BOARD_FRAME_MAX];
        match encode_body(body, &mut buffer) {
            Ok(frame) if frame.len() <= serial::room() => Serial.write_all(frame).is_ok(),
            _ => false,
        }
    }
}

fn heading(heading: tilt::Heading) -> Heading {
    match heading {
        tilt::Heading::Neutral => Heading::Neutral,
        tilt::Heading::Between => Heading::Between,
        tilt::Heading::Forward => Heading::Forward,
        tilt::Heading::Backward => Heading::Backward,
        tilt::Heading::Left => Heading::Left,
        tilt::Heading::Right => Heading::Right,
    }
}
