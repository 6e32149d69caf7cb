//! Owns the one board state that all tasks share.
//! All tasks run in one executor, and no task borrows the state across an `await`.

use core::cell::RefCell;
use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::ThreadModeMutex;
use embassy_sync::once_lock::OnceLock;
use nano33_sensor::found::Kind;
use shared_board::hand::CountHand;
use shared_board::models::Runs;
use shared_board::right::{Light, RightBoard};
use shared_dsp::right::Windows;
use shared_proto::message::{FaultKind, Status};

use crate::link::Everywhere;
use crate::sample::{AXES, SAMPLE_HZ};
use crate::state::{self, SENSOR_OK};
use crate::{about, boards};

/// The board's logic. Its windows are static, because they are too large to be built on the stack.
pub type Board = RightBoard<CountHand<'static, AXES, &'static mut Windows<AXES>>>;

/// Requirements that a model must meet to run on this image, if the sensor has all nine axes.
pub const RUNS: Runs = Runs { axes: AXES as u8, sample_hz: SAMPLE_HZ as u16 };

static BOARD: OnceLock<ThreadModeMutex<RefCell<Board>>> = OnceLock::new();

/// Stores the board. This must be called once, before any task runs.
pub fn install(board: Board) {
    if BOARD.init(ThreadModeMutex::new(RefCell::new(board))).is_err() {
        defmt::unreachable!("installed once");
    }
}

/// Updates the board with the sensor's detected properties, and then calls `act` with it.
pub fn with<R>(act: impl FnOnce(&mut Board) -> R) -> R {
    let Some(board) = BOARD.try_get() else { defmt::unreachable!("installed before any task runs") };
    board.lock(|board| {
        let mut board = board.borrow_mut();
        board.set_sensor_ok(SENSOR_OK.load(Ordering::Relaxed));
        let about = about::now();
        board.set_board(boards::kind(about.sensor));
        board.set_about(about);
        act(&mut board)
    })
}

/// A sensor was detected. The laptop is notified if the model cannot run on it.
pub fn found(kind: Kind, axes: usize) {
    about::found(kind, axes);
    if !with(|board| board.model_can_run()) {
        state::report(FaultKind::NoMagnetometer, axes as u32);
    }
}

/// Sends the status. Returns the light for it.
pub fn status(counted: Status) -> Light {
    with(|board| {
        board.status(counted, state::now_ms(), &mut Everywhere);
        board.light()
    })
}
