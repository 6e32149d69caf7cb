//! Owns the left hand's board state, which all tasks share.
//! All tasks run in one executor, and no task borrows the state across an `await`.

use core::cell::RefCell;
use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::ThreadModeMutex;
use embassy_sync::once_lock::OnceLock;
use nano33_sensor::found::Kind;
use shared_board::eeprom_log::EepromLog;
use shared_board::faults::FaultLog;
use shared_board::left::{LeftBoard, Start};
use shared_board::right::Light;
use shared_board::{FrameOut, Identity};
use shared_proto::message::{Board as BoardKind, Fault, FaultKind, LeftRequest, Status};

use super::memory::{self, Memory};
use crate::link::{Everywhere, WayOut};
use crate::sample::SAMPLE_HZ;
use crate::state::{self, SENSOR_OK};
use crate::storage::{Calibrations, Flash, Region};

/// Whatever is stored in flash.
pub type Kept<F> = EepromLog<Calibrations<F>>;

/// The board's logic, and the faults so far for laptops that connect later.
pub struct Board {
    hand: LeftBoard<Memory>,
    faults: FaultLog,
}

static BOARD: OnceLock<ThreadModeMutex<RefCell<Board>>> = OnceLock::new();

/// Sends to every link with a listener. Returns false if there is none, so that the board repeats its hello later.
pub struct Listeners;

impl FrameOut for Listeners {
    fn send(&mut self, frame: &[u8]) -> bool {
        let is_heard = [WayOut::Uart, WayOut::Usb, WayOut::Ble].iter().any(|way| way.outbox().is_open());
        Everywhere.send(frame);
        is_heard
    }
}

/// Loads the calibration and creates the board. This must be called once, before any task runs.
pub fn install<F: Flash>(flash: F) -> Kept<F> {
    let log = EepromLog::open(Region(flash));
    memory::fill(log.bytes());
    let identity = Identity {
        board: BoardKind::LeftXiao,
        firmware: env!("CARGO_PKG_VERSION"),
        boot_id: state::BOOT_ID.load(Ordering::Relaxed),
        sample_hz: SAMPLE_HZ as u16,
    };
    let hand = LeftBoard::start(identity, Memory, Start::default(), &mut Listeners);
    let board = Board { hand, faults: FaultLog::new() };
    if BOARD.init(ThreadModeMutex::new(RefCell::new(board))).is_err() {
        defmt::unreachable!("installed once");
    }
    log
}

/// Calls `act` with the board.
pub fn with<R>(act: impl FnOnce(&mut Board) -> R) -> R {
    let Some(board) = BOARD.try_get() else { defmt::unreachable!("installed before any task runs") };
    board.lock(|board| act(&mut board.borrow_mut()))
}

/// A sensor was detected. The left hand needs only its accelerometer, which every sensor has.
pub fn found(kind: Kind, _axes: usize) {
    defmt::info!("sensor {}", kind as u8);
}

/// Sends the status. Returns the light for it.
pub fn status(counted: Status) -> Light {
    with(|board| board.hand.status(counted, state::now_ms(), &mut Listeners));
    if SENSOR_OK.load(Ordering::Relaxed) { Light::Well } else { Light::SensorGone }
}

impl Board {
    /// The logic.
    pub fn hand(&mut self) -> &mut LeftBoard<Memory> {
        &mut self.hand
    }

    /// Stores and sends a fault.
    pub fn report(&mut self, kind: FaultKind, detail: u32, now_ms: u32, out: &mut impl FrameOut) {
        self.faults.report(Fault { uptime_ms: now_ms, kind, detail }, out);
    }

    /// Answers a request. A laptop that asks for the hello also receives the faults so far.
    pub fn answer(&mut self, request: LeftRequest, out: &mut impl FrameOut) {
        if request == LeftRequest::HelloRequest {
            self.faults.repeat(out);
        }
        self.hand.answer(request, state::now_ms(), out);
    }
}
