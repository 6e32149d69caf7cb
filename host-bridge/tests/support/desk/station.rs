//! One board on a desk, with its port, its time and the actions of a test.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::{Rc, Weak};
use std::time::Duration;

use super::port::Port;
use super::time::{Time, Turn};

/// Time that an operating system needs to notice that a device was removed or added.
const GONE: Duration = Duration::from_millis(200);

/// Functions of a board that a station needs.
pub trait Board {
    /// Milliseconds since power-on, including resets.
    fn now_ms(&self) -> u64;
    /// Runs until this time. The board's start may already have passed this time.
    fn run_until_ms(&mut self, ms: u64);
    /// Returns the bytes sent since the last call.
    fn sent(&mut self) -> Vec<u8>;
    /// Processes bytes from the laptop.
    fn receive(&mut self, bytes: &[u8]);
    /// Called when the laptop opens or closes the port.
    fn opened(&mut self, open: bool);
    /// Called when the cable is disconnected. The cable may be the board's only power supply.
    fn pulled(&mut self);
    /// Called when the cable is connected. The board starts, and its port exists when this function returns.
    fn plugged(&mut self);
    /// Presses the reset button.
    /// Returns true if the port disappears and returns, as on a board with native USB.
    fn restart(&mut self) -> bool;
}

type Moment<B> = Box<dyn FnMut(&mut B) -> bool>;

/// A board with its port. The board stops when this is dropped.
pub struct Station<B> {
    place: PathBuf,
    time: Time,
    desk: Rc<RefCell<Desk<B>>>,
}

impl<B: Board + 'static> Station<B> {
    /// Powers a board, whose port then has the path `place`.
    pub fn start(time: &Time, place: &Path, board: B) -> Self {
        let mut desk = Desk {
            board,
            port: Port::new(place.to_path_buf()),
            open: false,
            pull_when: None,
            pace: 1.0,
            since_ms: time.now_ms(),
            from_ms: 0,
            now_ms: time.now_ms(),
        };
        desk.plug();
        desk.from_ms = desk.board.now_ms();
        let desk = Rc::new(RefCell::new(desk));
        let turn: Weak<RefCell<Desk<B>>> = Rc::downgrade(&desk);
        time.add(turn);
        Self { place: place.to_path_buf(), time: time.clone(), desk }
    }

    /// The value for `--left`, `--right` or `--port`.
    pub fn port(&self) -> String {
        self.place.display().to_string()
    }

    /// Returns the simulated time that the station uses.
    pub fn time(&self) -> &Time {
        &self.time
    }

    /// Milliseconds that the board has run.
    pub fn board_ms(&self) -> u64 {
        self.desk.borrow().board.now_ms()
    }

    /// Calls `deed` with the board.
    pub fn with<T>(&self, deed: impl FnOnce(&mut B) -> T) -> T {
        deed(&mut self.desk.borrow_mut().board)
    }

    /// Pulls the cable.
    pub fn pull(&self) {
        self.desk.borrow_mut().pull();
    }

    /// Disconnects the cable as soon as `moment` returns true.
    pub fn pull_when(&self, moment: impl FnMut(&mut B) -> bool + 'static) {
        self.desk.borrow_mut().pull_when = Some(Box::new(moment));
    }

    /// Connects the cable again. The port exists when this returns.
    pub fn plug(&self) {
        self.desk.borrow_mut().plug();
    }

    /// Presses the reset button. The port exists when this returns.
    pub fn restart(&self) {
        let goes = self.desk.borrow_mut().board.restart();
        if goes {
            self.pull();
            self.time.pass(GONE);
            self.plug();
        }
    }

    /// Sets how many milliseconds the board runs per simulated millisecond. With 0, the board's program hangs.
    pub fn pace(&self, factor: f64) {
        let mut desk = self.desk.borrow_mut();
        desk.from_ms = desk.wanted_ms();
        desk.since_ms = desk.now_ms;
        desk.pace = factor;
    }
}

struct Desk<B> {
    board: B,
    port: Port,
    open: bool,
    pull_when: Option<Moment<B>>,
    pace: f64,
    now_ms: u64,
    /// Simulated time that corresponds to the board's time `from_ms`.
    since_ms: u64,
    from_ms: u64,
}

impl<B: Board> Desk<B> {
    fn wanted_ms(&self) -> u64 {
        self.from_ms + ((self.now_ms - self.since_ms) as f64 * self.pace) as u64
    }

    fn plug(&mut self) {
        if !self.port.is_plugged() {
            self.board.plugged();
            self.board.sent();
            self.port.plug();
        }
    }

    fn pull(&mut self) {
        self.port.pull();
        self.open = false;
        self.board.pulled();
    }
}

impl<B: Board> Turn for Desk<B> {
    fn run(&mut self, now_ms: u64) {
        self.now_ms = now_ms;
        let wanted_ms = self.wanted_ms();
        if self.board.now_ms() < wanted_ms {
            self.board.run_until_ms(wanted_ms);
        }
        if self.pull_when.as_mut().is_some_and(|moment| moment(&mut self.board)) {
            self.pull_when = None;
            self.pull();
        }
    }

    fn exchange(&mut self) {
        let sent = self.board.sent();
        self.port.write(&sent);
        let mut bytes = Vec::new();
        let open = self.port.read(&mut bytes);
        if open != self.open {
            self.open = open;
            self.board.opened(open);
        }
        if !bytes.is_empty() {
            self.board.receive(&bytes);
        }
    }
}
