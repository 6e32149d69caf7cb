//! Bits of a hand's health. If any bit is set, do not act on this hand.

/// The accelerometer (or IMU) does not answer, or one of its channels is open or shorted.
pub const SENSOR: u8 = 1 << 0;
/// A flex channel is open, shorted or noisy.
pub const FLEX: u8 = 1 << 1;
/// Gravity has had an impossible magnitude for 200 ms.
pub const GRAVITY: u8 = 1 << 2;
/// The converter repeats its values, or delivers none.
pub const STUCK: u8 = 1 << 3;
/// No valid calibration was found, so the default is used. This is only a warning, and the hand may be used.
pub const DEFAULT_CALIBRATION: u8 = 1 << 4;
/// The window has a gap.
pub const GAP: u8 = 1 << 5;
/// The model cannot run on this board.
pub const MODEL: u8 = 1 << 6;

/// Returns whether a hand with these flags may be used.
pub const fn is_fit(flags: u8) -> bool {
    flags & !DEFAULT_CALIBRATION == 0
}
