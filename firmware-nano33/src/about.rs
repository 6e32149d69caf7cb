//! Stores facts about the board that do not change during a run: its sensor and the cause of its last reset.

use core::sync::atomic::{AtomicU8, AtomicU16, Ordering};

use nano33_sensor::found::Kind;
use shared_proto::message::{About, Image, ResetCause};

/// Sensor, axes and reset cause as protocol bytes. They are atomics, so that any task can read them.
static SENSOR: AtomicU8 = AtomicU8::new(0);
static AXES: AtomicU8 = AtomicU8::new(0);
static RESET: AtomicU8 = AtomicU8::new(0);
/// Millivolts; 0 = unknown.
static BATTERY: AtomicU16 = AtomicU16::new(0);

const IMAGE: Image = if cfg!(feature = "trouble") {
    Image::Linked
} else if cfg!(feature = "xiao") {
    Image::Uf2
} else if cfg!(feature = "ble") {
    Image::S140
} else {
    Image::Bootloader
};

/// Stores why the board started. `reasons` is the value of RESETREAS at start.
pub fn started(reasons: u32) {
    const PIN: u32 = 1 << 0;
    const WATCHDOG: u32 = 1 << 1;
    const SOFT: u32 = 1 << 2;
    let cause = match reasons {
        0 => ResetCause::PowerUp,
        r if r & WATCHDOG != 0 => ResetCause::Watchdog,
        r if r & PIN != 0 => ResetCause::Pin,
        r if r & SOFT != 0 => ResetCause::Software,
        _ => ResetCause::Other,
    };
    RESET.store(cause.into(), Ordering::Relaxed);
}

/// Stores the detected sensor and its number of axes. The laptop converts the sensor's number to a name.
pub fn found(kind: Kind, axes: usize) {
    SENSOR.store(kind as u8, Ordering::Relaxed);
    AXES.store(axes as u8, Ordering::Relaxed);
}

/// The battery was measured.
#[cfg(feature = "xiao")]
pub fn battery(millivolts: u16) {
    BATTERY.store(millivolts, Ordering::Relaxed);
}

/// Returns the facts known so far.
pub fn now() -> About {
    About {
        sensor: SENSOR.load(Ordering::Relaxed).into(),
        axes: AXES.load(Ordering::Relaxed),
        image: IMAGE,
        reset: RESET.load(Ordering::Relaxed).into(),
        battery_mv: BATTERY.load(Ordering::Relaxed),
    }
}
