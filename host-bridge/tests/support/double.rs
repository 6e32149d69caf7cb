//! Boards on a desk: they run the hands' own code on recordings, answer the laptop as the firmware does, and can be
//! unplugged and restarted at any moment.

use std::collections::VecDeque;
use std::path::Path;

use host_bridge::hands::{ModelFile, heading_on_the_wire, model_info_on_the_wire};
use models::recording::Recording;
use shared_dsp::decision::DecisionConfig;
use shared_dsp::left::{AdcCounts, LeftHand};
use shared_dsp::left_calibration::CalibrationStep as Step;
use shared_dsp::mlp::{Model, crc32};
use shared_dsp::right::RightHand;
use shared_dsp::tilt::TiltThresholds;
use shared_proto::frame::{BOARD_FRAME_MAX, DELIMITER, Decoder, HOST_FRAME_MAX, encode_board};
use shared_proto::message::{
    Ack, AckResult, Board as Kind, BoardMessage, CalibrationStep, Hello, HostMessage, LeftState, Mode,
    PROTOCOL_MAJOR, PROTOCOL_MINOR, Pong, RawImu, RightState, Status, health,
};

use crate::desk::program::Desk;
use crate::desk::station::{Board, Station};

/// A level left hand with straight fingers.
pub const LEVEL: [u16; 5] = [512, 512, 614, 704, 704];
/// The same, 30° forward.
pub const FORWARD: [u16; 5] = [563, 512, 601, 704, 704];
/// Level, both fingers bent.
pub const BENT: [u16; 5] = [512, 512, 614, 536, 536];

/// Scale of the LSM9DS1 as the right board uses it.
const SCALE: [f32; 3] = [0.000_732 * 9.806_65, 0.07, 0.014];

/// A board on a port.
pub struct Double(Station<Machine>);

impl Double {
    /// A left hand at rest.
    pub fn left(desk: &Desk) -> Self {
        Self::left_named(desk, "left")
    }

    /// The same with a port of another name.
    pub fn left_named(desk: &Desk, name: &str) -> Self {
        Self::start(desk, name, Box::new(Left::new()))
    }

    /// A right hand that plays the demo's recording from `start_s` on, again and again.
    pub fn right(desk: &Desk, start_s: f64) -> Self {
        Self::start(desk, "right", Box::new(Right::new(start_s)))
    }

    fn start(desk: &Desk, name: &str, hand: Box<dyn Hand>) -> Self {
        Double(Station::start(desk.time(), &desk.path(name), Machine::new(hand)))
    }

    /// What to give to `--left` or `--right`.
    pub fn port(&self) -> String {
        self.0.port()
    }

    /// The cable is pulled.
    pub fn pull(&self) {
        self.0.pull();
    }

    /// And plugged in again, which restarts a board without a battery.
    pub fn plug(&self) {
        self.0.plug();
    }

    /// The cable was loose for a moment; the board has its own battery.
    pub fn plug_without_restart(&self) {
        self.0.with(|machine| machine.has_battery = true);
        self.0.plug();
        self.0.with(|machine| machine.has_battery = false);
    }

    /// Reset without losing the port.
    pub fn restart(&self) {
        self.0.restart();
    }

    /// The left hand holds this now.
    pub fn hold(&self, counts: [u16; 5]) {
        self.0.with(|machine| machine.hand.hold(counts));
    }
}

/// What a board does only after a while, and is busy until then.
#[derive(Default)]
struct Later {
    ms: u64,
    bytes: Vec<u8>,
}

/// What differs between the hands.
trait Hand {
    /// The board starts; its clock is at 0.
    fn reset(&mut self);
    fn hello(&self, boot_id: u32, out: &mut Vec<u8>);
    /// The sample of this time, every 10 ms.
    fn sample(&mut self, now_ms: u32, mode: Mode, out: &mut Vec<u8>);
    /// A request that is not for both hands.
    fn request(&mut self, message: &HostMessage<'_>, out: &mut Vec<u8>, later: &mut Later);
    fn hold(&mut self, _counts: [u16; 5]) {}
}

fn put(message: &BoardMessage<'_>, out: &mut Vec<u8>) {
    let mut buffer = [0; BOARD_FRAME_MAX];
    out.extend_from_slice(encode_board(message, &mut buffer).expect("fits"));
}

fn ack(request: u16, result: AckResult, next_offset: u32, out: &mut Vec<u8>) {
    put(&BoardMessage::Ack(Ack { request, result, next_offset }), out);
}

struct Machine {
    hand: Box<dyn Hand>,
    decoder: Decoder<HOST_FRAME_MAX>,
    mode: Mode,
    boot_id: u32,
    /// Since power-on, and when it started last.
    now_ms: u64,
    started_ms: u64,
    has_battery: bool,
    busy_until_ms: u64,
    later: Later,
    incoming: VecDeque<u8>,
    outgoing: Vec<u8>,
}

impl Machine {
    fn new(hand: Box<dyn Hand>) -> Self {
        Machine {
            hand,
            decoder: Decoder::new(),
            mode: Mode::Classify,
            boot_id: 100,
            now_ms: 0,
            started_ms: 0,
            has_battery: false,
            busy_until_ms: 0,
            later: Later::default(),
            incoming: VecDeque::new(),
            outgoing: Vec::new(),
        }
    }

    fn boot(&mut self) {
        self.boot_id += 1;
        self.started_ms = self.now_ms;
        self.busy_until_ms = 0;
        self.later = Later::default();
        self.incoming.clear();
        self.mode = Mode::Classify;
        self.decoder = Decoder::new();
        self.hand.reset();
        self.outgoing.push(DELIMITER);
        self.hand.hello(self.boot_id, &mut self.outgoing);
    }

    fn listen(&mut self) {
        let mut decoder = std::mem::take(&mut self.decoder);
        while self.now_ms >= self.busy_until_ms {
            self.outgoing.append(&mut self.later.bytes);
            let Some(byte) = self.incoming.pop_front() else { break };
            let (out, board_time_ms) = (&mut self.outgoing, (self.now_ms - self.started_ms) as u32);
            match decoder.push_host(byte) {
                Some(HostMessage::HelloRequest) => self.hand.hello(self.boot_id, out),
                Some(HostMessage::Ping { id }) => put(&BoardMessage::Pong(Pong { id, board_time_ms }), out),
                Some(HostMessage::SetMode { request, mode }) => {
                    self.mode = mode;
                    ack(request, AckResult::Ok, 0, out);
                }
                Some(message) => {
                    self.later.ms = 0;
                    self.hand.request(&message, out, &mut self.later);
                    self.busy_until_ms = self.now_ms + self.later.ms;
                }
                None => {}
            }
        }
        self.decoder = decoder;
    }
}

impl Board for Machine {
    fn now_ms(&self) -> u64 {
        self.now_ms
    }

    fn run_until_ms(&mut self, until_ms: u64) {
        while self.now_ms < until_ms {
            self.now_ms += 1;
            self.listen();
            let time_ms = self.now_ms - self.started_ms;
            if time_ms.is_multiple_of(10) {
                self.hand.sample(time_ms as u32, self.mode, &mut self.outgoing);
            }
            if time_ms.is_multiple_of(1000) {
                let status = Status { uptime_ms: time_ms as u32, mode: self.mode, ..Status::default() };
                put(&BoardMessage::Status(status), &mut self.outgoing);
            }
        }
    }

    fn sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outgoing)
    }

    fn receive(&mut self, bytes: &[u8]) {
        self.incoming.extend(bytes);
    }

    fn opened(&mut self, _: bool) {}

    fn pulled(&mut self) {}

    fn plugged(&mut self) {
        if !self.has_battery {
            self.boot();
        }
    }

    fn restart(&mut self) -> bool {
        self.boot();
        false
    }
}

struct Left {
    hand: LeftHand,
    counts: [u16; 5],
    dither: u16,
    sequence: u16,
    asked: Option<u16>,
}

impl Left {
    fn new() -> Self {
        let hand = LeftHand::new(None, TiltThresholds::DEFAULT, 0);
        Left { hand, counts: LEVEL, dither: 0, sequence: 0, asked: None }
    }
}

impl Hand for Left {
    fn reset(&mut self) {
        // The calibration is in EEPROM.
        let kept = *self.hand.calibration();
        let is_kept = kept != Default::default();
        self.hand = LeftHand::new(is_kept.then_some(kept), TiltThresholds::DEFAULT, 0);
        (self.sequence, self.asked) = (0, None);
    }

    fn hello(&self, boot_id: u32, out: &mut Vec<u8>) {
        put(
            &BoardMessage::Hello(Hello {
                major: PROTOCOL_MAJOR,
                minor: PROTOCOL_MINOR,
                board: Kind::LeftNano,
                firmware: "double",
                boot_id,
                model_id: 0,
                sample_hz: 100,
            }),
            out,
        );
    }

    fn sample(&mut self, now_ms: u32, mode: Mode, out: &mut Vec<u8>) {
        // The last bit of a real converter is never still.
        self.dither ^= 1;
        let mut counts = AdcCounts::from_ten_bit(self.counts);
        counts.z += self.dither;
        let output = self.hand.step(counts, now_ms);
        if let (Some(ended), Some(request)) = (self.hand.take_captured(), self.asked) {
            self.asked = None;
            let result = match ended {
                Ok(calibration) => {
                    self.hand.set_calibration(Some(calibration));
                    AckResult::Ok
                }
                Err(_) => AckResult::Unsteady,
            };
            ack(request, result, 0, out);
        }
        if mode == Mode::Classify && (now_ms.is_multiple_of(20) || output.changed) {
            self.sequence = self.sequence.wrapping_add(1);
            put(
                &BoardMessage::Left(LeftState {
                    sequence: self.sequence,
                    board_time_ms: now_ms,
                    pitch_mrad: output.pitch_mrad,
                    roll_mrad: output.roll_mrad,
                    heading: heading_on_the_wire(output.heading),
                    index_bends: output.index_bends,
                    middle_bends: output.middle_bends,
                    stop: output.stop,
                    health: output.health,
                }),
                out,
            );
        }
    }

    fn request(&mut self, message: &HostMessage<'_>, out: &mut Vec<u8>, _: &mut Later) {
        match *message {
            HostMessage::Calibrate { request, step } => {
                let step = match step {
                    CalibrationStep::Neutral => Step::Neutral,
                    CalibrationStep::Rest => Step::Rest,
                    CalibrationStep::Bend => Step::Bend,
                    CalibrationStep::Reset => {
                        self.hand.set_calibration(None);
                        return ack(request, AckResult::Ok, 0, out);
                    }
                };
                let started = self.hand.start_capture(step);
                if started {
                    self.asked = Some(request);
                }
                ack(request, if started { AckResult::Started } else { AckResult::Busy }, 0, out);
            }
            HostMessage::SetThresholds { request, thresholds: t } => {
                let (neutral_mrad, end_mrad, start_mrad) = (t.neutral_mrad, t.end_mrad, t.start_mrad);
                let taken = self.hand.set_thresholds(TiltThresholds { neutral_mrad, end_mrad, start_mrad });
                ack(request, if taken { AckResult::Ok } else { AckResult::OutOfRange }, 0, out);
            }
            _ => {}
        }
    }

    fn hold(&mut self, counts: [u16; 5]) {
        self.counts = counts;
    }
}

struct Right {
    blob: &'static [u8],
    hand: RightHand<'static, 9>,
    samples: Vec<[i16; 9]>,
    start: usize,
    sequence: u16,
    raw: Vec<[i16; 9]>,
    raw_sequence: u16,
    announced: Option<(u32, u32, Vec<u8>)>,
    /// Kept by a commit, used from the next start on.
    stored: Option<&'static [u8]>,
}

fn right_hand(blob: &'static [u8]) -> RightHand<'static, 9> {
    RightHand::new(Model::parse(blob).unwrap(), DecisionConfig::default()).expect("9 axes")
}

impl Right {
    fn new(start_s: f64) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/demo/right.csv");
        let recording = Recording::read(&file).unwrap().resampled();
        let count = |s: &[f32]| std::array::from_fn(|i| (s[i] / SCALE[i / 3]).round() as i16);
        let blob: &'static [u8] = ModelFile::bundled().unwrap().blob().to_vec().leak();
        Right {
            blob,
            hand: right_hand(blob),
            samples: recording.samples().map(count).collect(),
            start: (start_s * 100.0) as usize,
            sequence: 0,
            raw: Vec::new(),
            raw_sequence: 0,
            announced: None,
            stored: None,
        }
    }
}

impl Hand for Right {
    fn reset(&mut self) {
        self.blob = self.stored.unwrap_or(self.blob);
        self.hand = right_hand(self.blob);
        self.sequence = 0;
        self.raw.clear();
        self.announced = None;
    }

    fn hello(&self, boot_id: u32, out: &mut Vec<u8>) {
        let model = Model::parse(self.blob).unwrap();
        let info = model.info();
        put(
            &BoardMessage::Hello(Hello {
                major: PROTOCOL_MAJOR,
                minor: PROTOCOL_MINOR,
                board: Kind::RightNano33,
                firmware: "double",
                boot_id,
                model_id: info.model_id,
                sample_hz: info.sample_hz,
            }),
            out,
        );
        put(&BoardMessage::ModelInfo(model_info_on_the_wire(info)), out);
    }

    fn sample(&mut self, now_ms: u32, mode: Mode, out: &mut Vec<u8>) {
        let number = now_ms as usize / 10;
        let counts = self.samples[(self.start + number) % self.samples.len()];
        let sample: [f32; 9] = std::array::from_fn(|i| f32::from(counts[i]) * SCALE[i / 3]);
        if let Some(output) = self.hand.push(&sample, now_ms)
            && mode == Mode::Classify
        {
            self.sequence = self.sequence.wrapping_add(1);
            let scores = output.score_bytes();
            let used = if output.full { output.scores().len() } else { 0 };
            put(
                &BoardMessage::Right(RightState {
                    sequence: self.sequence,
                    board_time_ms: output.window_end_ms,
                    events: output.events,
                    label: output.label,
                    confidence: output.confidence,
                    event_window_end_ms: output.event_window_end_ms,
                    scores: &scores[..used],
                    health: if output.full { 0 } else { health::GAP },
                }),
                out,
            );
        }
        self.raw.push(counts);
        if self.raw.len() == 8 {
            let bytes: Vec<u8> = self.raw.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
            self.raw.clear();
            if mode == Mode::Record {
                self.raw_sequence = self.raw_sequence.wrapping_add(1);
                put(
                    &BoardMessage::RawImu(RawImu {
                        sequence: self.raw_sequence,
                        first_sample: number as u32 - 7,
                        axes: 9,
                        scale: SCALE,
                        counts: &bytes,
                    }),
                    out,
                );
            }
        }
    }

    /// As `firmware-nano33/src/transfer.rs`.
    fn request(&mut self, message: &HostMessage<'_>, out: &mut Vec<u8>, later: &mut Later) {
        let (request, result) = match *message {
            HostMessage::ModelBegin(begin) => {
                if begin.info.axes != 9 {
                    return ack(begin.request, AckResult::ModelDoesNotFit, 0, out);
                }
                self.announced = Some((begin.size, begin.info.model_id, Vec::new()));
                ack(begin.request, AckResult::Started, 0, out);
                // Erasing four pages takes a third of a second.
                later.ms = 50;
                (begin.request, AckResult::Ok)
            }
            HostMessage::ModelChunk { request, offset, data } => {
                // Flash is slow, and a test needs time to pull the cable.
                later.ms = 20;
                match &mut self.announced {
                    Some((_, _, blob)) if blob.len() == offset as usize => {
                        blob.extend_from_slice(data);
                        (request, AckResult::Ok)
                    }
                    _ => (request, AckResult::WrongOffset),
                }
            }
            HostMessage::ModelCommit { request, crc32: crc } => match self.announced.take() {
                Some((size, id, blob)) if size as usize == blob.len() => {
                    if id == crc && crc32(&blob) == crc && Model::parse(&blob).is_ok() {
                        self.stored = Some(blob.leak());
                        (request, AckResult::Ok)
                    } else {
                        (request, AckResult::BadChecksum)
                    }
                }
                kept => {
                    self.announced = kept;
                    (request, AckResult::WrongOffset)
                }
            },
            HostMessage::Calibrate { request, .. } | HostMessage::SetThresholds { request, .. } => {
                (request, AckResult::Unsupported)
            }
            _ => return,
        };
        let next = self.announced.as_ref().map_or(0, |(_, _, blob)| blob.len() as u32);
        ack(request, result, next, &mut later.bytes);
    }
}
