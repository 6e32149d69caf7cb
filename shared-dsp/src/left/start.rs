//! When a tilt is meant: the hand of a person who walks, or who shakes it, tilts, too, without meaning a command.
//!
//! An accelerometer cannot tell a tilt from a push, and 15° are a push of 0.27 g. What tells them apart is
//! that a tilt stays. So a command starts once the hand has come to rest beyond the threshold, or has been
//! clearly beyond it for longer than a swing is; and not while the hand swings to and fro.
//!
//! A walker's hand is pushed by ±0.35 g twice a second: up to 24° from a pose 5° off level. Within 1.2° of
//! one value it stays for 68 ms at its turning points, and beyond 25° it never is. A hand that is shaken
//! four times a second turns every 125 ms.

/// A hand is at rest while its tilt stays within a band of this width, in milliradians: 2°.
pub const STEADY_MRAD: u16 = 35;
/// A tilt at rest for this many samples starts a command: 90 ms at 100 Hz.
pub const STEADY_SAMPLES: u8 = 10;
/// A tilt this far beyond the start threshold is clear, in milliradians: 10°.
pub const CLEAR_MRAD: u16 = 175;
/// A clear tilt for this many samples starts a command, at rest or not: 90 ms.
pub const CLEAR_SAMPLES: u8 = 10;
/// A tilt held for this many samples starts a command unless it is on its way back: 130 ms.
pub const HELD_SAMPLES: u8 = 14;
/// A tilt that goes back by more than this has turned, in milliradians: 6°.
pub const TURN_MRAD: u16 = 105;
/// Turns no further apart than this belong to one swing: 320 ms, half a period of 1.6 Hz.
pub const SWING_SAMPLES: u8 = 32;
/// This many swings, one after the other, are an oscillation.
pub const SWINGS: u8 = 2;
/// An oscillation is over when so many samples have passed since its last turn: 500 ms.
pub const CALM_SAMPLES: u8 = 50;

/// One tilt beyond its threshold that is not a command yet.
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
    /// The tilt has just crossed the threshold.
    pub fn new(tilt_mrad: i16) -> Self {
        Self { peak_mrad: tilt_mrad, low_mrad: tilt_mrad, high_mrad: tilt_mrad, steady: 0, clear: 0, held: 0 }
    }

    /// Takes the tilt of one more sample; true when it is meant.
    pub fn step(&mut self, tilt_mrad: i16, start_mrad: u16) -> bool {
        self.low_mrad = self.low_mrad.min(tilt_mrad);
        self.high_mrad = self.high_mrad.max(tilt_mrad);
        if self.high_mrad.abs_diff(self.low_mrad) > STEADY_MRAD {
            (self.low_mrad, self.high_mrad, self.steady) = (tilt_mrad, tilt_mrad, 0);
        }
        self.steady = self.steady.saturating_add(1);
        // Sound thresholds and this are far below an i16's maximum.
        let clear = tilt_mrad > (start_mrad + CLEAR_MRAD) as i16;
        self.clear = if clear { self.clear.saturating_add(1) } else { 0 };
        self.peak_mrad = self.peak_mrad.max(tilt_mrad);
        self.held = self.held.saturating_add(1);
        let falls = self.peak_mrad.abs_diff(tilt_mrad) > STEADY_MRAD;
        self.steady >= STEADY_SAMPLES || self.clear >= CLEAR_SAMPLES || (self.held >= HELD_SAMPLES && !falls)
    }
}

/// Sees one tilt swing to and fro.
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
    /// A hand that has not moved.
    pub const fn new() -> Self {
        Self { extreme_mrad: 0, rising: true, since_turn: u8::MAX, swings: 0 }
    }

    /// Takes the tilt of one sample; true while it oscillates.
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
