//! The few numbers that tasks share. Each is a single word, so plain atomics do.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use critical_section::Mutex;
use embassy_time::Instant;
use shared_proto::message::{BoardMessage, Fault, FaultKind, Mode};

use crate::link::{Link, broadcast};

static MODE: AtomicU8 = AtomicU8::new(0);

/// Samples that could not be taken or kept in time.
pub static DROPPED_SAMPLES: AtomicU32 = AtomicU32::new(0);
/// Failed transfers to the sensor.
pub static SENSOR_ERRORS: AtomicU32 = AtomicU32::new(0);
/// The sensor delivers.
pub static SENSOR_OK: AtomicBool = AtomicBool::new(false);
/// The sensors of a Rev2 board were found.
pub static REV2: AtomicBool = AtomicBool::new(false);
/// Different after each start.
pub static BOOT_ID: AtomicU32 = AtomicU32::new(0);

/// One bit per task that must not stand still; the watchdog task clears them.
pub static ALIVE: AtomicU8 = AtomicU8::new(0);
/// The sampling task's bit.
pub const ALIVE_SAMPLE: u8 = 1 << 0;
/// The classifying task's bit.
pub const ALIVE_CLASSIFY: u8 = 1 << 1;

/// Says that a task is alive.
pub fn alive(bit: u8) {
    critical_section::with(|_| ALIVE.store(ALIVE.load(Ordering::Relaxed) | bit, Ordering::Relaxed));
}

/// Time since start, wrapping after 49 days.
pub fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

/// What the board does now.
pub fn mode() -> Mode {
    match MODE.load(Ordering::Relaxed) {
        1 => Mode::Record,
        2 => Mode::Idle,
        _ => Mode::Classify,
    }
}

/// Changes what the board does.
pub fn set_mode(mode: Mode) {
    let value = match mode {
        Mode::Classify => 0,
        Mode::Record => 1,
        Mode::Idle => 2,
    };
    MODE.store(value, Ordering::Relaxed);
}

/// Faults that a laptop which connects later should still hear of: those of the start, and the newest.
const KEPT: usize = 4;
static FAULTS: Mutex<Cell<[Option<Fault>; KEPT]>> = Mutex::new(Cell::new([None; KEPT]));

/// Reports a fault on every link, and keeps it for those who connect later.
pub fn report(kind: FaultKind, detail: u32) {
    let fault = Fault { uptime_ms: now_ms(), kind, detail };
    defmt::warn!("fault {} detail {:#x}", defmt::Debug2Format(&kind), detail);
    critical_section::with(|cs| {
        let mut kept = FAULTS.borrow(cs).get();
        let same = kept.iter().position(|f| f.is_some_and(|f| f.kind == kind));
        let free = kept.iter().position(Option::is_none);
        kept[same.or(free).unwrap_or(KEPT - 1)] = Some(fault);
        FAULTS.borrow(cs).set(kept);
    });
    broadcast(&BoardMessage::Fault(fault));
}

/// Sends the kept faults on one link.
pub fn repeat_faults(link: Link) {
    let kept = critical_section::with(|cs| FAULTS.borrow(cs).get());
    for fault in kept.into_iter().flatten() {
        link.send(&BoardMessage::Fault(fault));
    }
}
