//! A laptop at the emulated board's serial port or Bluetooth, which sends requests and receives messages.

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host, parse_board};
use shared_proto::message::{
    About, Ack, Board as BoardKind, BoardMessage, Fault, Hello, HostMessage, LeftState, Pairing, Status,
};

use super::air_host::AirHost;
use super::ble_host::BleHost;
use super::board::{Board, Boot, Kind};
use super::build::{Variant, image};
use super::controller::{Air, Controller};
use super::image::Image;
use super::lsm9ds1::{Motion, Still};
use super::softdevice::central::Happening;

/// A state of the right hand, without borrowed parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Right {
    /// Cycle at which the frame was complete on the wire.
    pub at: u64,
    /// Sequence number of the frame.
    pub sequence: u16,
    /// Time of the window's newest sample on the board's clock.
    pub board_time_ms: u32,
    /// Number of gestures since the start. The number wraps.
    pub events: u8,
    /// Index of the last event's gesture; 255 before the first event.
    pub label: u8,
    /// Confidence of the last event, where 0 to 255 means 0 to 1.
    pub confidence: u8,
    /// End of the window that triggered the last event.
    pub event_window_end_ms: u32,
    /// The network's int8 outputs as bytes, one per label.
    pub scores: Vec<u8>,
    /// Bits of the health; 0 means no problem.
    pub health: u8,
}

/// All messages from the board so far.
#[derive(Default)]
pub struct Heard {
    /// Boot ids and model ids from hello messages.
    pub hellos: Vec<(u32, u32)>,
    /// The kind of board in the newest hello message.
    pub kind: Option<BoardKind>,
    /// The firmware versions in the hello messages that were received.
    pub versions: Vec<String>,
    /// States of the hand.
    pub states: Vec<Right>,
    /// States of a left hand, each with the cycle at which its frame was complete.
    pub lefts: Vec<(u64, LeftState)>,
    /// Counters from status messages.
    pub statuses: Vec<Status>,
    /// Fault reports.
    pub faults: Vec<Fault>,
    /// Replies to requests.
    pub acks: Vec<Ack>,
    /// Raw samples: the number of the first sample, and the counts.
    pub raw: Vec<(u32, Vec<i16>)>,
    /// The board's newest description of its hardware.
    pub about: Option<About>,
    /// What the board says about its pairing.
    pub pairings: Vec<Pairing>,
    /// Replies to pings.
    pub pongs: usize,
}

/// Decodes bytes from the board.
#[derive(Default)]
pub struct Listener {
    /// All messages that the board sent.
    pub heard: Heard,
    decoder: Decoder<BOARD_FRAME_MAX>,
}

/// A board with the laptops that are connected to it.
pub struct RightRig {
    /// The emulated board.
    pub board: Board,
    /// Messages from the board to this laptop.
    pub heard: Heard,
    decoder: Decoder<BOARD_FRAME_MAX>,
    /// The Bluetooth of the laptop, if it uses Bluetooth. Another laptop is then connected at D0.
    pub ble: Option<BleHost>,
    /// Bumble's Bluetooth, if the laptop uses bumble. Another laptop is then connected at D0 as well.
    pub air: Option<AirHost>,
    /// Messages that the other laptop, at D0, received.
    pub uart: Listener,
}

impl RightRig {
    /// Starts the image with the stock bootloader and a laptop at D0 and D1.
    pub fn uart(motion: Box<dyn Motion>) -> Self {
        Self::new(Board::new(image(Variant::Bootloader), Boot::StockBootloader, motion), None)
    }

    /// Starts the image with S140 and a laptop that connects automatically over Bluetooth.
    pub fn ble(motion: Box<dyn Motion>) -> Self {
        Self::ble_of_kind(Kind::Nano33, motion)
    }

    /// Starts a Bluetooth session with a board of this kind.
    pub fn ble_of_kind(kind: Kind, motion: Box<dyn Motion>) -> Self {
        let variant = if kind == Kind::Xiao { Variant::Xiao } else { Variant::Ble };
        let mut board = Board::of_kind(kind, image(variant), Boot::SoftDevice, motion);
        let mut host = BleHost::default();
        host.connect(&mut board);
        Self::new(board, Some(host))
    }

    /// Starts a Bluetooth session with a board at rest.
    /// Waits until the laptop is connected, bonded and subscribed.
    pub fn ble_ready() -> Self {
        let mut session = Self::ble(Box::new(Still));
        session.wait_until_ready();
        session
    }

    /// Starts a board of this kind with a laptop at its serial port.
    /// A Nano 33 uses the stock bootloader, and a XIAO uses S140 with the USB cable plugged in.
    pub fn of_kind(kind: Kind, motion: Box<dyn Motion>) -> Self {
        if kind != Kind::Xiao {
            let image = image(Variant::Bootloader);
            return Self::new(Board::of_kind(kind, image, Boot::StockBootloader, motion), None);
        }
        let board = Board::of_kind(kind, image(Variant::Xiao), Boot::SoftDevice, motion);
        let mut session = Self::new(board, None);
        session.charge();
        session
    }

    /// Starts the image that contains Nordic's controller. The board's own bootloader starts first.
    /// Bumble simulates the radio and the laptop, which does nothing yet.
    pub fn air(kind: Kind, motion: Box<dyn Motion>) -> Self {
        Self::air_of(image(Variant::Trouble), kind, motion)
    }

    /// Starts a session over Bluetooth with a left hand, whose second stage starts the image.
    /// [`set_flex`](super::left_hand::set_flex) sets its flex sensors.
    pub fn left_air(motion: Box<dyn Motion>) -> Self {
        let image = image(Variant::XiaoLeft).behind(image(Variant::XiaoStage), None);
        Self::air_of(image, Kind::Xiao, motion)
    }

    /// Starts a session over Bluetooth with this image.
    pub fn air_of(image: Image, kind: Kind, motion: Box<dyn Motion>) -> Self {
        let controller = Controller::new(&image.symbols, Air::start(), 0);
        let mut board = Board::of_kind(kind, image, Boot::StockBootloader, motion);
        board.answer_controller(controller);
        let mut rig = Self::new(board, None);
        rig.air = Some(AirHost::default());
        rig
    }

    fn new(board: Board, ble: Option<BleHost>) -> Self {
        let (heard, decoder, uart) = (Heard::default(), Decoder::new(), Listener::default());
        Self { board, heard, decoder, ble, air: None, uart }
    }

    /// Plugs in the USB cable with a charger.
    /// With S140, the UART at D0 works only while the cable is plugged in.
    pub fn charge(&mut self) {
        let soc = self.board.soc();
        soc.power.set_vbus(true, soc.now);
        soc.settle();
    }

    /// Runs the board and receives its data.
    pub fn run_ms(&mut self, milliseconds: u64) {
        // The laptop's Bluetooth reacts to new events.
        let step = if self.ble.is_some() || self.air.is_some() { 5 } else { milliseconds };
        let mut left = milliseconds;
        while left > 0 {
            self.board.run_ms(left.min(step));
            left -= left.min(step);
            self.listen();
        }
    }

    /// Runs in steps of a millisecond until a condition holds or the time is over.
    /// Returns whether the condition held.
    pub fn run_until_that(&mut self, milliseconds: u64, mut holds: impl FnMut(&mut Self) -> bool) -> bool {
        for _ in 0..milliseconds {
            if holds(self) {
                return true;
            }
            self.run_ms(1);
        }
        holds(self)
    }

    /// Runs until the laptop is connected over Bluetooth and subscribed.
    ///
    /// # Panics
    /// Panics if the board is not ready after five seconds.
    pub fn wait_until_ready(&mut self) {
        let is_ready = self.run_until_that(5000, |s| s.ble.as_ref().is_some_and(|b| b.is_ready()));
        assert!(is_ready, "{:?}", self.board.softdevice().central.log);
    }

    /// Returns the events that the laptop's Bluetooth has recorded.
    pub fn log(&mut self) -> Vec<Happening> {
        self.board.softdevice().central.log.iter().map(|(_, what)| what.clone()).collect()
    }

    /// Sends a message to the board.
    pub fn send(&mut self, message: &HostMessage<'_>) {
        let mut buffer = [0; 512];
        let frame = encode_host(message, &mut buffer).expect("fits a frame").to_vec();
        match (&mut self.ble, &mut self.air) {
            (Some(host), _) => host.send(&mut self.board, &frame),
            (_, Some(host)) => host.send(&mut self.board, &frame),
            _ => self.board.uart_in(&frame),
        }
    }

    /// Sends a message and waits for the acknowledgement with this request number.
    pub fn ask(&mut self, request: u16, message: &HostMessage<'_>) -> Option<Ack> {
        let before = self.heard.acks.len();
        self.send(message);
        let found = |s: &Self| s.heard.acks[before..].iter().rev().find(|a| a.request == request).copied();
        self.run_until_that(200, |s| found(s).is_some());
        found(self)
    }

    /// Returns the fraction of time awake that the board reported, in parts per thousand.
    ///
    /// # Panics
    /// Panics if the board has sent no status.
    pub fn board_load(&self) -> u16 {
        self.heard.statuses.last().expect("a status").load_permille
    }

    /// Returns the number of damaged frames from the board.
    pub fn damaged(&self) -> u32 {
        self.decoder.counters().damaged()
    }

    fn listen(&mut self) {
        let uart = self.board.soc().uart.take_sent();
        let air = match (&mut self.ble, &mut self.air) {
            (Some(host), _) => {
                host.step(&mut self.board);
                host.read(&mut self.board)
            }
            (_, Some(host)) => host.read(&mut self.board),
            _ => return uart.into_iter().for_each(|(at, byte)| self.heard.push(&mut self.decoder, at, byte)),
        };
        for (at, byte) in air {
            self.heard.push(&mut self.decoder, at, byte);
        }
        for (at, byte) in uart {
            self.uart.heard.push(&mut self.uart.decoder, at, byte);
        }
    }
}

impl Heard {
    fn push(&mut self, decoder: &mut Decoder<BOARD_FRAME_MAX>, at: u64, byte: u8) {
        let Some(payload) = decoder.push(byte) else { return };
        match parse_board(payload).expect("a message of this version") {
            BoardMessage::Hello(Hello { boot_id, model_id, board, firmware, .. }) => {
                self.kind = Some(board);
                self.hellos.push((boot_id, model_id));
                self.versions.push(firmware.to_string());
            }
            BoardMessage::Left(left) => self.lefts.push((at, left)),
            BoardMessage::Right(r) => self.states.push(Right {
                at,
                sequence: r.sequence,
                board_time_ms: r.board_time_ms,
                events: r.events,
                label: r.label,
                confidence: r.confidence,
                event_window_end_ms: r.event_window_end_ms,
                scores: r.scores.to_vec(),
                health: r.health,
            }),
            BoardMessage::Status(s) => self.statuses.push(s),
            BoardMessage::Fault(f) => self.faults.push(f),
            BoardMessage::Ack(a) => self.acks.push(a),
            BoardMessage::Pong(_) => self.pongs += 1,
            BoardMessage::RawImu(raw) => {
                let counts = raw.counts.chunks_exact(2).map(|c| i16::from_le_bytes([c[0], c[1]])).collect();
                self.raw.push((raw.first_sample, counts));
            }
            BoardMessage::About(about) => self.about = Some(about),
            BoardMessage::Pairing(pairing) => self.pairings.push(pairing),
            BoardMessage::ModelInfo(_) | BoardMessage::RawAdc(_) | BoardMessage::Tilt(_) => {}
        }
    }
}
