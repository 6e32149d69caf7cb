//! Simulated boards on a desk. They run the boards' own code with recordings.
//! Tests can unplug and restart the boards.

use std::collections::VecDeque;
use std::path::Path;

use host_bridge::hands::ModelFile;
use host_bridge::hands::virtual_board::{PERIOD_MS, VirtualLeft, VirtualRight, onto};
use models::recording::Recording;
use shared_board::Identity;
use shared_board::hand::CountHand;
use shared_board::memory::{RamEeprom, RamFlash, at_once};
use shared_board::models::{MappedFlash as _, ModelRequest, ModelStore, Runs};
use shared_dsp::left::AdcCounts;
use shared_dsp::right::RightHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_proto::frame::{Decoder, HOST_FRAME_MAX};
use shared_proto::message::{Board as Kind, HostMessage, Mode};

use crate::desk::program::Desk;
use crate::desk::station::{Board, Station};
use crate::wrist::Turning;

/// Counts of a level left hand with straight fingers.
pub const LEVEL: [u16; 5] = [512, 512, 614, 704, 704];
/// The same hand, tilted 30° forward.
pub const FORWARD: [u16; 5] = [563, 512, 601, 704, 704];
/// A level hand with both fingers bent.
pub const BENT: [u16; 5] = [512, 512, 614, 536, 536];

/// Scale of the LSM9DS1 on the right board.
const SCALE: [f32; 3] = [0.000_732 * 9.806_65, 0.07, 0.014];

/// A board on a port.
pub struct Double(Station<Machine>);

impl Double {
    /// Creates a left hand at rest.
    pub fn left(desk: &Desk) -> Self {
        Self::left_named(desk, "left")
    }

    /// Creates a left hand with this port name.
    pub fn left_named(desk: &Desk, name: &str) -> Self {
        Self::start(desk, name, Box::new(Left::new()))
    }

    /// Creates a right hand that repeats the demo's recording, from `start_s`.
    pub fn right(desk: &Desk, start_s: f64) -> Self {
        Self::right_named(desk, "right", start_s)
    }

    /// Creates a right hand with this port name.
    pub fn right_named(desk: &Desk, name: &str, start_s: f64) -> Self {
        Self::start(desk, name, Box::new(Right::new(start_s)))
    }

    fn start(desk: &Desk, name: &str, hand: Box<dyn Hand>) -> Self {
        Double(Station::start(desk.time(), &desk.path(name), Machine::new(hand)))
    }

    /// The value for `--left` or `--right`.
    pub fn port(&self) -> String {
        self.0.port()
    }

    /// Disconnects the cable.
    pub fn pull(&self) {
        self.0.pull();
    }

    /// Connects the cable, which restarts a board without a battery.
    pub fn plug(&self) {
        self.0.plug();
    }

    /// Reconnects the cable of a board that kept running on its own battery.
    pub fn plug_without_restart(&self) {
        self.0.with(|machine| machine.has_battery = true);
        self.0.plug();
        self.0.with(|machine| machine.has_battery = false);
    }

    /// Resets the board while its port stays open.
    pub fn restart(&self) {
        self.0.restart();
    }

    /// Returns whether the last requested mode is not the record mode.
    pub fn classifies(&self) -> bool {
        self.0.with(|machine| machine.asked == Mode::Classify)
    }

    /// Sets the pose of the left hand.
    pub fn hold(&self, counts: [u16; 5]) {
        self.0.with(|machine| machine.hand.hold(counts));
    }

    /// Tilts the right hand by this pitch (positive = forward) and this roll (positive = left).
    pub fn tilt(&self, pitch_deg: f64, roll_deg: f64) {
        self.0.with(|machine| machine.hand.tilt([pitch_deg, roll_deg]));
    }

    /// Makes the right hand continue its recording from this time.
    pub fn jump(&self, to_s: f64) {
        self.0.with(|machine| machine.hand.jump(to_s, machine.now_ms - machine.started_ms));
    }
}

/// The differences between left and right boards.
trait Hand {
    /// Starts the board with its clock at 0.
    fn restart(&mut self, boot_id: u32);
    /// Processes the sample of this time, every 10 ms.
    fn sample(&mut self, now_ms: u64, wire: &mut Vec<u8>);
    /// Processes a byte from the laptop. Returns how many milliseconds the board is busy before it replies.
    fn receive(&mut self, byte: u8, now_ms: u64, wire: &mut Vec<u8>) -> u64;
    fn hold(&mut self, _counts: [u16; 5]) {}
    fn tilt(&mut self, _deg: [f64; 2]) {}
    fn jump(&mut self, _to_s: f64, _now_ms: u64) {}
}

struct Machine {
    hand: Box<dyn Hand>,
    decoder: Decoder<HOST_FRAME_MAX>,
    asked: Mode,
    boot_id: u32,
    /// Time since power-on, and the time of the last start.
    now_ms: u64,
    started_ms: u64,
    has_battery: bool,
    busy_until_ms: u64,
    incoming: VecDeque<u8>,
    /// Data that is sent when the board is no longer busy.
    later: Vec<u8>,
    wire: Vec<u8>,
}

impl Machine {
    fn new(hand: Box<dyn Hand>) -> Self {
        Machine {
            hand,
            decoder: Decoder::new(),
            asked: Mode::Classify,
            boot_id: 100,
            now_ms: 0,
            started_ms: 0,
            has_battery: false,
            busy_until_ms: 0,
            incoming: VecDeque::new(),
            later: Vec::new(),
            wire: Vec::new(),
        }
    }

    fn boot(&mut self) {
        self.boot_id += 1;
        self.started_ms = self.now_ms;
        self.busy_until_ms = self.now_ms;
        self.incoming.clear();
        self.later.clear();
        self.hand.restart(self.boot_id);
    }

    fn listen(&mut self, time_ms: u64) {
        while self.now_ms >= self.busy_until_ms {
            self.wire.append(&mut self.later);
            let Some(byte) = self.incoming.pop_front() else { break };
            if let Some(HostMessage::SetMode { mode, .. }) = self.decoder.push_host(byte) {
                self.asked = mode;
            }
            let busy_ms = self.hand.receive(byte, time_ms, &mut self.later);
            self.busy_until_ms = self.now_ms + busy_ms;
        }
    }
}

impl Board for Machine {
    fn now_ms(&self) -> u64 {
        self.now_ms
    }

    fn run_until_ms(&mut self, until_ms: u64) {
        while self.now_ms < until_ms {
            let time_ms = self.now_ms - self.started_ms;
            self.listen(time_ms);
            if time_ms.is_multiple_of(PERIOD_MS) {
                self.hand.sample(time_ms, &mut self.wire);
            }
            self.now_ms += 1;
        }
    }

    fn sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.wire)
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
    board: VirtualLeft,
    counts: [u16; 5],
    dither: u16,
}

impl Left {
    fn new() -> Self {
        Left { board: Self::start(0, RamEeprom::blank()), counts: LEVEL, dither: 0 }
    }

    fn start(boot_id: u32, memory: RamEeprom) -> VirtualLeft {
        let identity = Identity { board: Kind::LeftNano, firmware: "double", boot_id, sample_hz: 100 };
        VirtualLeft::start(identity, memory)
    }
}

impl Hand for Left {
    fn restart(&mut self, boot_id: u32) {
        self.board = Self::start(boot_id, self.board.clone().into_memory());
    }

    fn sample(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        // The last bit of a real converter always varies.
        self.dither ^= 1;
        let mut counts = AdcCounts::from_ten_bit(self.counts);
        counts.z += self.dither;
        self.board.period(Some(counts), now_ms, wire);
    }

    fn receive(&mut self, byte: u8, now_ms: u64, wire: &mut Vec<u8>) -> u64 {
        self.board.receive(&[byte], now_ms, wire);
        0
    }

    fn hold(&mut self, counts: [u16; 5]) {
        self.counts = counts;
    }
}

const RUNS: Runs = Runs { axes: 9, sample_hz: 100 };

struct Right {
    board: VirtualRight<CountHand<'static, 9>>,
    store: ModelStore<RamFlash>,
    samples: Vec<[i16; 9]>,
    start: usize,
    turning: Turning,
}

impl Right {
    fn new(start_s: f64) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/demo/right.csv");
        let recording = Recording::read(&file).unwrap().resampled();
        let count = |s: &[f32]| std::array::from_fn(|i| (s[i] / SCALE[i / 3]).round() as i16);
        let (board, store) = Self::start(0, RamFlash::blank());
        let start = (start_s * 100.0) as usize;
        Right {
            board,
            store,
            samples: recording.samples().map(count).collect(),
            start,
            turning: Turning::default(),
        }
    }

    /// Starts with the model in flash, or otherwise with the bundled model.
    fn start(boot_id: u32, flash: RamFlash) -> (VirtualRight<CountHand<'static, 9>>, ModelStore<RamFlash>) {
        let (store, found) = ModelStore::open(flash, RUNS);
        let blob = match found.model {
            Some(place) => store.flash().mapped()[place.offset()..][..place.len].to_vec(),
            None => ModelFile::bundled().unwrap().blob().to_vec(),
        };
        let model = Model::parse(blob.leak()).unwrap();
        let hand = RightHand::new(model, DecisionConfig::default()).expect("9 axes");
        let identity = Identity { board: Kind::RightNano33, firmware: "double", boot_id, sample_hz: 100 };
        (VirtualRight::start(identity, CountHand::new(hand, SCALE)), store)
    }
}

impl Hand for Right {
    fn restart(&mut self, boot_id: u32) {
        (self.board, self.store) = Self::start(boot_id, self.store.flash().clone());
    }

    fn sample(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        let number = (now_ms / PERIOD_MS) as usize;
        let counts = self.samples[(self.start + number) % self.samples.len()];
        let scale = |axis: usize| f64::from(SCALE[axis / 3]);
        let values = self.turning.step(std::array::from_fn(|axis| f64::from(counts[axis]) * scale(axis)));
        let counts = std::array::from_fn(|axis| (values[axis] / scale(axis)).round() as i16);
        self.board.sample(&counts, now_ms, wire);
    }

    fn tilt(&mut self, deg: [f64; 2]) {
        self.turning.to_deg = deg;
    }

    fn jump(&mut self, to_s: f64, now_ms: u64) {
        let (number, to) = ((now_ms / PERIOD_MS) as usize, (to_s * 100.0) as usize);
        let length = self.samples.len();
        self.start = (to + length - number % length) % length;
    }

    fn receive(&mut self, byte: u8, now_ms: u64, wire: &mut Vec<u8>) -> u64 {
        let (store, mut busy_ms) = (&mut self.store, 0);
        self.board.receive(&[byte], now_ms, wire, |request, wire| {
            // Writing flash takes long, and the tests need time to disconnect the cable.
            // Erasing four pages takes a third of a second.
            busy_ms += if matches!(request, ModelRequest::Begin(_)) { 50 } else { 20 };
            at_once(store.answer(request, async || (), &mut onto(wire)));
        });
        busy_ms
    }
}
