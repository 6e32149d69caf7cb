//! Boards behind pseudo-terminals: they run the boards' own code on recordings, and can be unplugged and restarted at
//! any moment.

use std::io::{Read as _, Write as _};
use std::os::fd::{FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use host_bridge::hands::ModelFile;
use host_bridge::hands::virtual_board::{PERIOD_MS, VirtualLeft, VirtualRight, onto};
use models::recording::Recording;
use serialport::{SerialPort as _, TTYPort};
use shared_board::Identity;
use shared_board::hand::CountHand;
use shared_board::memory::{RamEeprom, RamFlash, at_once};
use shared_board::models::{MappedFlash as _, ModelRequest, ModelStore, Runs};
use shared_dsp::decision::DecisionConfig;
use shared_dsp::left::AdcCounts;
use shared_dsp::mlp::Model;
use shared_dsp::right::RightHand;
use shared_proto::frame::{Decoder, HOST_FRAME_MAX};
use shared_proto::message::{Board, HostMessage, Mode};

/// A level left hand with straight fingers.
pub const LEVEL: [u16; 5] = [512, 512, 614, 704, 704];
/// The same, 30° forward.
pub const FORWARD: [u16; 5] = [563, 512, 601, 704, 704];
/// Level, both fingers bent.
pub const BENT: [u16; 5] = [512, 512, 614, 536, 536];

/// Scale of the LSM9DS1 as the right board uses it.
const SCALE: [f32; 3] = [0.000_732 * 9.806_65, 0.07, 0.014];

/// A program started while a pseudo-terminal is being made would inherit its board's end, and no cable
/// would ever be pulled: whoever starts one takes this first.
pub static STARTING: Mutex<()> = Mutex::new(());

pub fn board_and_laptop() -> (TTYPort, TTYPort) {
    let _alone = STARTING.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let (board, laptop) = TTYPort::pair().expect("a pseudo-terminal");
    // Safety: the port gives its descriptor away and is gone. The copy is not inherited by programs.
    let board = unsafe { OwnedFd::from_raw_fd(board.into_raw_fd()) };
    let copy = board.try_clone().expect("a descriptor");
    (unsafe { TTYPort::from_raw_fd(copy.into_raw_fd()) }, laptop)
}

/// What a test does to a board.
enum Order {
    /// The cable is pulled; the board stays powered (or not: it does not matter to the laptop).
    Pull,
    /// And plugged in again, which restarts a board without a battery.
    Plug {
        restarts: bool,
    },
    /// Reset without losing the port.
    Restart,
    /// The left hand holds this now.
    Hold([u16; 5]),
    End,
}

/// A board on a port; its thread ends with it.
pub struct Double {
    orders: Sender<Order>,
    mode: Arc<Mutex<Mode>>,
    thread: Option<JoinHandle<()>>,
    /// What to give to `--left` or `--right`: a link to the pseudo-terminal.
    pub port: PathBuf,
}

impl Double {
    /// A left hand at rest.
    pub fn left(folder: &Path) -> Self {
        let port = folder.join("left");
        Self::start(port, || Box::new(Left::new()))
    }

    /// A right hand that plays the demo's recording from `start_s` on, again and again.
    pub fn right(folder: &Path, start_s: f64) -> Self {
        let port = folder.join("right");
        Self::start(port, move || Box::new(Right::new(start_s)))
    }

    fn start(port: PathBuf, make: impl FnOnce() -> Box<dyn Hand> + Send + 'static) -> Self {
        let (orders, received) = channel();
        let place = port.clone();
        let (ready, is_ready) = channel();
        let mode = Arc::new(Mutex::new(Mode::Classify));
        let asked = Arc::clone(&mode);
        let thread = std::thread::spawn(move || Machine::new(make(), place, &ready).run(&received, &asked));
        is_ready.recv().expect("the board starts");
        Double { orders, mode, thread: Some(thread), port }
    }

    /// The last mode that it was asked for is not the one that records.
    pub fn classifies(&self) -> bool {
        *self.mode.lock().unwrap() == Mode::Classify
    }

    pub fn port(&self) -> String {
        self.port.display().to_string()
    }

    pub fn pull(&self) {
        self.orders.send(Order::Pull).unwrap();
    }

    pub fn plug(&self) {
        self.orders.send(Order::Plug { restarts: true }).unwrap();
    }

    /// The cable was loose for a moment; the board has its own battery.
    pub fn plug_without_restart(&self) {
        self.orders.send(Order::Plug { restarts: false }).unwrap();
    }

    pub fn restart(&self) {
        self.orders.send(Order::Restart).unwrap();
    }

    pub fn hold(&self, counts: [u16; 5]) {
        self.orders.send(Order::Hold(counts)).unwrap();
    }
}

impl Drop for Double {
    fn drop(&mut self) {
        let _ = self.orders.send(Order::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What differs between the hands.
trait Hand {
    /// The board starts; its clock is at 0.
    fn restart(&mut self, boot_id: u32);
    /// The sample of this time, every 10 ms.
    fn sample(&mut self, now_ms: u64, wire: &mut Vec<u8>);
    /// Bytes from the laptop.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);
    fn hold(&mut self, _counts: [u16; 5]) {}
}

struct Machine {
    hand: Box<dyn Hand>,
    place: PathBuf,
    port: Option<TTYPort>,
    boot_id: u32,
    started: Instant,
    next_sample_ms: u64,
}

impl Machine {
    fn new(hand: Box<dyn Hand>, place: PathBuf, ready: &Sender<()>) -> Self {
        let mut machine =
            Machine { hand, place, port: None, boot_id: 100, started: Instant::now(), next_sample_ms: 0 };
        machine.plug();
        machine.restart();
        ready.send(()).unwrap();
        machine
    }

    fn plug(&mut self) {
        let (mut board, laptop) = board_and_laptop();
        board.set_timeout(Duration::from_millis(1)).unwrap();
        let _ = std::fs::remove_file(&self.place);
        std::os::unix::fs::symlink(laptop.name().expect("a name"), &self.place).unwrap();
        self.port = Some(board);
    }

    fn restart(&mut self) {
        self.boot_id += 1;
        self.started = Instant::now();
        self.next_sample_ms = 0;
        self.hand.restart(self.boot_id);
    }

    fn write(&mut self, bytes: &[u8]) {
        if let Some(port) = &mut self.port {
            // Nobody there, or nobody reads: dropped, as on a real line.
            let _ = port.write(bytes);
        }
    }

    fn run(mut self, orders: &Receiver<Order>, asked: &Mutex<Mode>) {
        let mut decoder = Decoder::<HOST_FRAME_MAX>::new();
        loop {
            while let Ok(order) = orders.try_recv() {
                match order {
                    Order::Pull => {
                        self.port = None;
                        let _ = std::fs::remove_file(&self.place);
                    }
                    Order::Plug { restarts } => {
                        self.plug();
                        if restarts {
                            self.restart();
                        }
                    }
                    Order::Restart => self.restart(),
                    Order::Hold(counts) => self.hand.hold(counts),
                    Order::End => return,
                }
            }
            let mut buffer = [0; 512];
            let read = self.port.as_mut().map_or(0, |port| port.read(&mut buffer).unwrap_or(0));
            if read == 0 {
                std::thread::sleep(Duration::from_millis(1));
            }
            let mut wire = Vec::new();
            let now_ms = self.started.elapsed().as_millis() as u64;
            for &byte in &buffer[..read] {
                if let Some(HostMessage::SetMode { mode, .. }) = decoder.push_host(byte) {
                    *asked.lock().unwrap() = mode;
                }
            }
            self.hand.receive(&buffer[..read], now_ms, &mut wire);
            while self.next_sample_ms <= now_ms {
                self.hand.sample(self.next_sample_ms, &mut wire);
                self.next_sample_ms += PERIOD_MS;
            }
            if !wire.is_empty() {
                self.write(&wire);
            }
        }
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
        let identity = Identity { board: Board::LeftNano, firmware: "double", boot_id, sample_hz: 100 };
        VirtualLeft::start(identity, memory)
    }
}

impl Hand for Left {
    fn restart(&mut self, boot_id: u32) {
        self.board = Self::start(boot_id, self.board.clone().into_memory());
    }

    fn sample(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        // The last bit of a real converter is never still.
        self.dither ^= 1;
        let mut counts = AdcCounts::from_ten_bit(self.counts);
        counts.z += self.dither;
        self.board.period(Some(counts), now_ms, wire);
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        self.board.receive(bytes, now_ms, wire);
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
}

impl Right {
    fn new(start_s: f64) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/demo/right.csv");
        let recording = Recording::read(&file).unwrap().resampled();
        let count = |s: &[f32]| std::array::from_fn(|i| (s[i] / SCALE[i / 3]).round() as i16);
        let (board, store) = Self::start(0, RamFlash::blank());
        let start = (start_s * 100.0) as usize;
        Right { board, store, samples: recording.samples().map(count).collect(), start }
    }

    /// With the model in flash, or the bundled one.
    fn start(boot_id: u32, flash: RamFlash) -> (VirtualRight<CountHand<'static, 9>>, ModelStore<RamFlash>) {
        let (store, found) = ModelStore::open(flash, RUNS);
        let blob = match found.model {
            Some(place) => store.flash().mapped()[place.offset()..][..place.len].to_vec(),
            None => ModelFile::bundled().unwrap().blob().to_vec(),
        };
        let model = Model::parse(blob.leak()).unwrap();
        let hand = RightHand::new(model, DecisionConfig::default()).expect("9 axes");
        let identity = Identity { board: Board::RightNano33, firmware: "double", boot_id, sample_hz: 100 };
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
        self.board.sample(&counts, now_ms, wire);
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        let store = &mut self.store;
        self.board.receive(bytes, now_ms, wire, |request, wire| {
            // Flash is slow, and a test needs time to pull the cable. Erasing four pages takes a third of a second.
            let ms = if matches!(request, ModelRequest::Begin(_)) { 50 } else { 20 };
            std::thread::sleep(Duration::from_millis(ms));
            at_once(store.answer(request, async || (), &mut onto(wire)));
        });
    }
}
