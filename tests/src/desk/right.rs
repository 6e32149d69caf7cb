//! The right hand on the desk: the Nano 33's image in unicorn, its USB cable, and a simulated wearer.

use std::cell::RefCell;
use std::rc::Rc;

use models::synth::{IdleKind, Motion as Doing, Segment, Wearer, session};

use super::program::Desk;
use super::station::{Board, Station};
use crate::nrf::board::{self, Boot};
use crate::nrf::build::{Variant, image};
use crate::nrf::controller::{Air, Controller};
use crate::nrf::lsm9ds1::Motion;
use crate::nrf::time::{HZ, ms};
use crate::nrf::usb_host::UsbHost;

/// Sample rate of simulated recordings, 100 Hz.
const ROWS_PER_S: f64 = 100.0;
const IDLE_S: f64 = 20.0;

/// The wearer's movement, which a test controls while the board runs.
struct Hand {
    wearer: Wearer,
    idle: Vec<[f64; 9]>,
    rows: Vec<[f64; 9]>,
    start_s: f64,
    take: u64,
}

fn rows(wearer: &Wearer, take: u64, script: &[Segment]) -> Vec<[f64; 9]> {
    let recording = session(wearer, take, script);
    recording.samples().map(|sample| std::array::from_fn(|i| f64::from(sample[i]))).collect()
}

impl Hand {
    fn new(wearer: Wearer) -> Self {
        let idle = rows(&wearer, 1000, &[Segment::new(Doing::IDLE, IDLE_S)]);
        Self { wearer, idle, rows: Vec::new(), start_s: 0.0, take: 0 }
    }

    fn at(&self, seconds: f64) -> [f64; 9] {
        let place = (seconds - self.start_s) * ROWS_PER_S;
        if place >= 0.0 && place + 1.0 < self.rows.len() as f64 {
            return between(&self.rows, place);
        }
        // The movement is played to its end and then backwards, so that there is no jump.
        let turn = (self.idle.len() - 2) as f64;
        let place = (seconds * ROWS_PER_S).rem_euclid(2.0 * turn);
        between(&self.idle, if place < turn { place } else { 2.0 * turn - place })
    }
}

fn between(rows: &[[f64; 9]], place: f64) -> [f64; 9] {
    let (index, part) = (place as usize, place.fract());
    std::array::from_fn(|i| rows[index][i] + (rows[index + 1][i] - rows[index][i]) * part)
}

struct Shared(Rc<RefCell<Hand>>);

impl Motion for Shared {
    fn at(&self, seconds: f64) -> [f64; 9] {
        self.0.borrow().at(seconds)
    }
}

/// The board on a wearer's hand.
pub struct Right {
    board: board::Board,
    hand: Rc<RefCell<Hand>>,
    usb: UsbHost,
    /// Number of resets when the port appeared.
    resets: usize,
    /// The board has restarted by itself. Its port then disappears, but its power stays on.
    is_powered: bool,
}

/// A right hand on a desk.
pub type RightStation = Station<Right>;

impl Right {
    fn settle_usb(&mut self) {
        let ready = (0..6000).any(|_| {
            self.board.run_ms(1);
            self.usb.step(&mut self.board);
            self.usb.is_ready()
        });
        assert!(ready, "no serial port: {:?}", self.usb);
    }

    /// Starts a board with the stock bootloader and only the compiled-in model, on this wearer's still hand.
    /// The board's port on the desk has the name `name`.
    pub fn start(desk: &Desk, name: &str, wearer: Wearer) -> RightStation {
        Self::start_with(desk, name, wearer, |motion| {
            board::Board::new(image(Variant::Bootloader), Boot::StockBootloader, motion)
        })
    }

    /// Starts a board with the image that has Bluetooth linked in, behind its second stage.
    /// Bumble simulates the radio, and no laptop connects.
    pub fn start_linked(desk: &Desk, name: &str, wearer: Wearer) -> RightStation {
        Self::start_with(desk, name, wearer, |motion| {
            let image = image(Variant::Trouble).behind(image(Variant::Stage), None);
            let controller = Controller::new(&image.symbols, Air::start(), 0);
            let mut board = board::Board::new(image, Boot::StockBootloader, motion);
            board.answer_controller(controller);
            board
        })
    }

    fn start_with(
        desk: &Desk,
        name: &str,
        wearer: Wearer,
        board: impl FnOnce(Box<dyn Motion>) -> board::Board,
    ) -> RightStation {
        let hand = Rc::new(RefCell::new(Hand::new(wearer)));
        let board = board(Box::new(Shared(Rc::clone(&hand))));
        let (usb, resets, is_powered) = (UsbHost::default(), 0, false);
        Station::start(desk.time(), &desk.path(name), Self { board, hand, usb, resets, is_powered })
    }

    /// Returns whether the board has restarted by itself since its port appeared.
    pub fn has_restarted(&self) -> bool {
        self.board.resets.len() > self.resets
    }

    /// Returns whether an image runs behind the second stage.
    /// A sleeping core shows this, because the second stage never sleeps.
    pub fn is_running(&self) -> bool {
        self.board.is_asleep()
    }

    /// Returns the content of the flash.
    pub fn flash(&mut self) -> Vec<u8> {
        self.board.soc().flash.to_vec()
    }

    /// Performs this movement for this many seconds, and then rests.
    pub fn perform(&mut self, motion: Doing, seconds: f64) {
        self.play(&[Segment::new(motion, seconds)]);
    }

    /// Performs idle movements between gestures for this many seconds.
    pub fn be_idle(&mut self, seconds: f64) {
        let kinds = IdleKind::ALL;
        let part = seconds / kinds.len() as f64;
        self.play(&kinds.map(|kind| Segment::new(Doing::Idle(kind), part)));
    }

    /// Number of words written to flash since power-up, which indicates how much of a model has been stored.
    pub fn words_written(&mut self) -> u64 {
        self.board.soc().nvmc.written
    }

    /// Plays a script and then rests.
    pub fn play(&mut self, script: &[Segment]) {
        let mut hand = self.hand.borrow_mut();
        hand.take += 1;
        hand.start_s = self.board.seconds();
        hand.rows = rows(&hand.wearer, hand.take, script);
    }
}

impl Board for Right {
    fn now_ms(&self) -> u64 {
        self.board.now() / ms(1)
    }

    fn run_until_ms(&mut self, until_ms: u64) {
        self.board.run_until(until_ms * (HZ / 1000));
    }

    fn sent(&mut self) -> Vec<u8> {
        // The UART at D0 has no listener.
        self.board.uart_out();
        self.usb.read(&mut self.board)
    }

    fn receive(&mut self, bytes: &[u8]) {
        self.usb.write(&mut self.board, bytes);
    }

    fn opened(&mut self, open: bool) {
        if self.usb.is_ready() {
            self.usb.open(open);
            self.settle_usb();
        }
    }

    fn pulled(&mut self) {
        self.is_powered = self.has_restarted();
        self.usb.unplug(&mut self.board);
    }

    fn plugged(&mut self) {
        // The cable is also the power supply.
        if !self.is_powered {
            self.board.soc().nvic.reset_wanted = true;
            self.board.run_ms(50);
        }
        self.usb.plug_in(&mut self.board);
        self.settle_usb();
        self.resets = self.board.resets.len();
        // No program has opened the port yet.
        self.opened(false);
    }

    fn restart(&mut self) -> bool {
        true
    }
}
