//! Bits of a hand's health flags. Any bit set means: do not act on this hand.

/// The accelerometer (or the IMU) does not answer, or a channel of it is open or shorted.
pub const SENSOR: u8 = 1 << 0;
/// A flex channel is open, shorted or hums.
pub const FLEX: u8 = 1 << 1;
/// Gravity has had an impossible magnitude for 200 ms.
pub const GRAVITY: u8 = 1 << 2;
/// The converter repeats itself or delivers nothing.
pub const STUCK: u8 = 1 << 3;
/// No good calibration was found, and defaults are in use. (A warning: the only bit one may act on.)
pub const DEFAULT_CALIBRATION: u8 = 1 << 4;
/// The window has a gap.
pub const GAP: u8 = 1 << 5;
/// The model cannot run on this board.
pub const MODEL: u8 = 1 << 6;

/// May one act on a hand with these flags?
pub const fn is_fit(flags: u8) -> bool {
    flags & !DEFAULT_CALIBRATION == 0
}
