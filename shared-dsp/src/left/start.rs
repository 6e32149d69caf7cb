//! Decides whether a tilt is intended, because walking or shaking a hand also tilts it.
//!
//! An accelerometer cannot distinguish a tilt from a push, and a push of 0.27 g looks like a tilt of 15°.
//! However, only an intended tilt persists.
//! A command therefore starts when the hand comes to rest beyond the threshold.
//! A command also starts when the tilt is clearly beyond the threshold for longer than a swing lasts.
//! No command starts while the hand swings to and fro.
//!
//! When a person walks, the hand is pushed by ±0.35 g twice per second.
//! If the pose of the hand is 5° off level, this looks like a tilt of up to 24°.
//! At the turning points of the swing, the hand stays within 1.2° for 68 ms. The tilt never exceeds 25°.
//! A hand that is shaken four times per second changes direction every 125 ms.

/// A hand is at rest if its tilt stays within a band of this width in milliradians: 2°.
pub const STEADY_MRAD: u16 = 35;
/// A resting hand starts a command after this number of samples beyond the threshold: 90 ms at 100 Hz.
pub const STEADY_SAMPLES: u8 = 10;
/// A tilt is clear if it exceeds the start threshold by this much, in milliradians: 10°.
pub const CLEAR_MRAD: u16 = 175;
/// A clear tilt starts a command after this number of samples, even if the hand moves: 90 ms.
pub const CLEAR_SAMPLES: u8 = 10;
/// Any tilt starts a command after this number of samples, unless it is decreasing: 130 ms.
pub const HELD_SAMPLES: u8 = 14;
/// A decrease of the tilt by more than this is a change of direction, in milliradians: 6°.
pub const TURN_MRAD: u16 = 105;
/// Two changes of direction belong to one swing if they are at most this far apart:
/// 320 ms, which is half a period of 1.6 Hz.
pub const SWING_SAMPLES: u8 = 32;
/// This number of consecutive swings is an oscillation.
pub const SWINGS: u8 = 2;
/// An oscillation ends when this number of samples has passed since the last change of direction: 500 ms.
pub const CALM_SAMPLES: u8 = 50;

/// A tilt that is beyond its threshold but has not started a command yet.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    peak_mrad: i16,
    low_mrad: i16,
    high_mrad: i16,
    steady: u8,
    clear: u8,
    held: u8,
}

impl Start {
    /// Creates the state for a tilt that has just crossed the threshold.
    pub fn new(tilt_mrad: i16) -> Self {
        Self { peak_mrad: tilt_mrad, low_mrad: tilt_mrad, high_mrad: tilt_mrad, steady: 0, clear: 0, held: 0 }
    }

    /// Adds the tilt of one sample. Returns true if the tilt is intended.
    pub fn step(&mut self, tilt_mrad: i16, start_mrad: u16) -> bool {
        self.low_mrad = self.low_mrad.min(tilt_mrad);
        self.high_mrad = self.high_mrad.max(tilt_mrad);
        if self.high_mrad.abs_diff(self.low_mrad) > STEADY_MRAD {
            (self.low_mrad, self.high_mrad, self.steady) = (tilt_mrad, tilt_mrad, 0);
        }
        self.steady = self.steady.saturating_add(1);
        // The sum fits in an i16, because sound thresholds are far below its maximum.
        let clear = tilt_mrad > (start_mrad + CLEAR_MRAD) as i16;
        self.clear = if clear { self.clear.saturating_add(1) } else { 0 };
        self.peak_mrad = self.peak_mrad.max(tilt_mrad);
        self.held = self.held.saturating_add(1);
        let falls = self.peak_mrad.abs_diff(tilt_mrad) > STEADY_MRAD;
        self.steady >= STEADY_SAMPLES || self.clear >= CLEAR_SAMPLES || (self.held >= HELD_SAMPLES && !falls)
    }
}

/// Detects whether one tilt oscillates.
#[derive(Clone, Copy, Debug)]
pub struct Swing {
    extreme_mrad: i16,
    rising: bool,
    since_turn: u8,
    swings: u8,
}

impl Default for Swing {
    fn default() -> Self {
        Self::new()
    }
}

impl Swing {
    /// Creates the state of a hand that has not moved.
    pub const fn new() -> Self {
        Self { extreme_mrad: 0, rising: true, since_turn: u8::MAX, swings: 0 }
    }

    /// Adds the tilt of one sample. Returns true while the tilt oscillates.
    pub fn step(&mut self, tilt_mrad: i16) -> bool {
        self.since_turn = self.since_turn.saturating_add(1);
        let beyond =
            if self.rising { tilt_mrad >= self.extreme_mrad } else { tilt_mrad <= self.extreme_mrad };
        if beyond {
            self.extreme_mrad = tilt_mrad;
        } else if tilt_mrad.abs_diff(self.extreme_mrad) > TURN_MRAD {
            self.swings = if self.since_turn <= SWING_SAMPLES { self.swings.saturating_add(1) } else { 0 };
            self.rising = !self.rising;
            self.extreme_mrad = tilt_mrad;
            self.since_turn = 0;
        }
        self.swings >= SWINGS && self.since_turn <= CALM_SAMPLES
    }
}
