//! The left hand on the desk: the Nano's image in simavr, with its bootloader and its USB-serial chip.
//! The chip resets the board whenever a program opens the port.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use fastrand::Rng;

use super::program::{Desk, Running};
use super::station::{Board, Station};
use crate::avr::image;
use crate::avr::nano::Nano;
use crate::avr::session::BLANK;
use crate::avr::wearer::{Hand, Sensors, Wearer};

/// Time for which the bootloader waits silently after a reset.
const BOOTLOADER_MS: u64 = 700;

/// The board on a wearer's hand.
pub struct Left {
    nano: Nano,
    hand: Rc<RefCell<Hand>>,
    /// Remaining time of the bootloader.
    bootloader_ms: u64,
    /// Total running time of the bootloader, which the emulated program does not see.
    skipped_ms: u64,
    powered: bool,
}

/// A left hand on a desk.
pub type LeftStation = Station<Left>;

impl LeftStation {
    /// Takes the poses that `host-bridge calibrate` requests: level, straight, bent.
    pub fn take_three_poses(&self, calibrate: &mut Running) {
        for (step, depth) in [("1.", 0.0), ("2.", 0.0), ("3.", 1.0)] {
            calibrate.wait(&[step, "press Enter"]);
            self.with(move |board| board.bend(depth));
            self.time().pass(Duration::from_millis(600));
            calibrate.type_line("");
        }
    }
}

impl Left {
    /// Starts an uncalibrated board on a level hand with straight fingers.
    /// The board's port on the desk has this name.
    pub fn start(desk: &Desk, name: &str) -> LeftStation {
        let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(7));
        let nano = Nano::new(&image::path(), &BLANK, Box::new(wearer));
        let board = Self { nano, hand, bootloader_ms: 0, skipped_ms: 0, powered: false };
        Station::start(desk.time(), &desk.path(name), board)
    }

    /// Tilts the hand forward by this many radians.
    pub fn tilt(&mut self, forward_rad: f64) {
        self.lean(forward_rad, 0.0);
    }

    /// Tilts the hand forward and to the left by this many radians.
    pub fn lean(&mut self, forward_rad: f64, left_rad: f64) {
        let now_s = self.nano.now_ms() / 1000.0;
        self.hand.borrow_mut().tilt(forward_rad, left_rad, now_s, 0.15);
    }

    /// Bends both fingers: 0 is straight, and 1 is as far as comfortable.
    pub fn bend(&mut self, depth: f64) {
        let now_s = self.nano.now_ms() / 1000.0;
        (0..2).for_each(|finger| self.hand.borrow_mut().bend(finger, depth, now_s, 0.1));
    }

    fn reset(&mut self) {
        self.nano.reset();
        self.bootloader_ms = BOOTLOADER_MS;
    }
}

impl Board for Left {
    fn now_ms(&self) -> u64 {
        self.nano.now_ms() as u64 + self.skipped_ms
    }

    fn run_until_ms(&mut self, ms: u64) {
        let mut left_ms = ms.saturating_sub(self.now_ms());
        let skipped = if self.powered { left_ms.min(self.bootloader_ms) } else { left_ms };
        self.bootloader_ms = self.bootloader_ms.saturating_sub(skipped);
        self.skipped_ms += skipped;
        left_ms -= skipped;
        if left_ms > 0 {
            self.nano.run_ms(left_ms as f64);
        }
    }

    fn sent(&mut self) -> Vec<u8> {
        std::iter::from_fn(|| self.nano.sent()).map(|(_, byte)| byte).collect()
    }

    fn receive(&mut self, bytes: &[u8]) {
        if self.bootloader_ms == 0 {
            self.nano.send(bytes);
        }
    }

    fn opened(&mut self, open: bool) {
        if open {
            self.reset();
        }
    }

    fn pulled(&mut self) {
        self.powered = false;
    }

    fn plugged(&mut self) {
        self.powered = true;
        self.reset();
    }

    fn restart(&mut self) -> bool {
        self.reset();
        false
    }
}
