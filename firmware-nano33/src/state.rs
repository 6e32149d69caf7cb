//! Values shared between tasks. Each one is a single word, so plain atomics are sufficient.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use embassy_time::Instant;
use shared_proto::message::FaultKind;

use crate::board;
use crate::link::Everywhere;

/// Number of samples that were not taken or not processed in time.
pub static DROPPED_SAMPLES: AtomicU32 = AtomicU32::new(0);
/// Number of failed transfers to the sensor.
pub static SENSOR_ERRORS: AtomicU32 = AtomicU32::new(0);
/// The sensor delivers.
pub static SENSOR_OK: AtomicBool = AtomicBool::new(false);
/// Different after each start.
pub static BOOT_ID: AtomicU32 = AtomicU32::new(0);

/// One bit per monitored task. Each task sets its bit, and the watchdog task clears all bits.
pub static ALIVE: AtomicU8 = AtomicU8::new(0);
/// The sampling task's bit.
pub const ALIVE_SAMPLE: u8 = 1 << 0;
/// The classifying task's bit.
pub const ALIVE_CLASSIFY: u8 = 1 << 1;

/// Marks a task as alive.
pub fn alive(bit: u8) {
    critical_section::with(|_| ALIVE.store(ALIVE.load(Ordering::Relaxed) | bit, Ordering::Relaxed));
}

/// Time since start in milliseconds. It wraps after 49 days.
pub fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

/// Reports a fault on every link. The board also stores the fault for laptops that connect later.
pub fn report(kind: FaultKind, detail: u32) {
    defmt::warn!("fault {} detail {:#x}", defmt::Debug2Format(&kind), detail);
    board::with(|board| board.report(kind, detail, now_ms(), &mut Everywhere));
}
