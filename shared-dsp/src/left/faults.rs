//! Detects readings that no working left hand can produce.
//! Examples are open or shorted channels, impossible gravity and a stuck converter.
//!
//! A channel at a rail is a fault immediately, and impossible gravity is a fault after [`GRAVITY_MS`].
//! If a converter repeats its readings, this is a fault after [`STUCK_MS`]. Missing readings are a fault after [`SILENT_MS`].
//! A fault ends [`CLEAR_MS`] after its cause has disappeared.
//! If a channel's fault returns within [`RETURN_MS`], its wire is loose or picks up mains hum.
//! Such a fault persists until the hand is calibrated or the board restarts.

use crate::left::tilt::Acceleration;
use crate::left::{AdcCounts, ONE_G, OVERSAMPLING, health};

/// Impossible gravity that lasts this long is a fault; anything shorter is a jolt.
pub const GRAVITY_MS: u32 = 200;
/// If five readings are exactly equal for this long, without even noise, the converter repeats itself.
pub const STUCK_MS: u32 = 1000;
/// If no reading arrives for this long, the converter has stopped.
pub const SILENT_MS: u32 = 100;
/// A fault ends this long after its cause has disappeared.
pub const CLEAR_MS: u32 = 200;
/// A fault of a channel persists if it returns within this time after its end.
pub const RETURN_MS: u32 = 10_000;
/// Maximum change of a flex reading that the next sample may undo: 32 of 1024.
/// No finger moves that fast, but mains hum on an open pin does, because its period is about two samples.
const MOST_RETURN: u16 = 32 * OVERSAMPLING;
/// Readings of 0 to 40 and of 983 to 1023 do not come from a working sensor.
/// The ADXL335 gives 143 to 881 at ±3.6 g, and a flex sensor of 7 to 110 kΩ over 22 kΩ gives 170 to 776.
const RAIL: u16 = 40 * OVERSAMPLING;
/// A hand at rest measures 1 g.
/// With a sensitivity error of 10 % and a neutral pose 10° off level, the result is between 0.7 and 1.3 g.
const LEAST_GRAVITY: u32 = (ONE_G as u32) / 2;
/// See [`LEAST_GRAVITY`]. A moving hand may exceed this limit, but for less than 200 ms.
const MOST_GRAVITY: u32 = (ONE_G as u32) * 16 / 10;

/// Detects faults in the readings of one hand.
#[derive(Clone, Copy, Debug)]
pub struct FaultWatch {
    last: AdcCounts,
    /// The flex readings of the sample before the last one.
    flex_before: [u16; 2],
    last_change_ms: u32,
    last_sample_ms: u32,
    gravity_good_ms: u32,
    /// For each fault in `health`, the time when its cause was last present.
    seen_ms: [u32; 4],
    health: u8,
    /// The time when a channel's fault last ended, if that was less than [`RETURN_MS`] ago.
    ended_ms: [Option<u32>; 2],
    /// Bits of persistent faults.
    staying: u8,
}

/// The faults that this module detects, in the order of [`FaultWatch::seen_ms`].
const BITS: [u8; 4] = [health::SENSOR, health::FLEX, health::GRAVITY, health::STUCK];

impl FaultWatch {
    /// Starts at `now_ms`, without a fault.
    pub fn new(now_ms: u32) -> Self {
        Self {
            last: AdcCounts::default(),
            flex_before: [0; 2],
            last_change_ms: now_ms,
            last_sample_ms: now_ms,
            gravity_good_ms: now_ms,
            seen_ms: [now_ms; 4],
            health: 0,
            ended_ms: [None; 2],
            staying: 0,
        }
    }

    /// Makes persistent faults normal again, so that they end when their cause disappears.
    pub fn forgive(&mut self) {
        self.staying = 0;
        self.ended_ms = [None; 2];
    }

    /// Checks one sample, both as raw readings and as acceleration relative to zero. Returns bits of [`health`].
    #[inline(never)]
    pub fn step(&mut self, counts: AdcCounts, a: Acceleration, now_ms: u32) -> u8 {
        let at_rail = |v: u16| !(RAIL..=AdcCounts::MAX - RAIL).contains(&v);
        let accelerometer_gone = at_rail(counts.x) || at_rail(counts.y) || at_rail(counts.z);
        self.last_sample_ms = now_ms;
        let hums = returns(counts.index, self.last.index, self.flex_before[0])
            || returns(counts.middle, self.last.middle, self.flex_before[1]);
        self.flex_before = [self.last.index, self.last.middle];
        if counts != self.last {
            self.last = counts;
            self.last_change_ms = now_ms;
        }
        let square = |v: i16| u32::from(v.unsigned_abs()) * u32::from(v.unsigned_abs());
        let squared = square(a.x).saturating_add(square(a.y)).saturating_add(square(a.z));
        let possible = (LEAST_GRAVITY * LEAST_GRAVITY..=MOST_GRAVITY * MOST_GRAVITY).contains(&squared);
        if possible {
            self.gravity_good_ms = now_ms;
        }
        let causes = [
            accelerometer_gone,
            hums || at_rail(counts.index) || at_rail(counts.middle),
            now_ms.wrapping_sub(self.gravity_good_ms) >= GRAVITY_MS,
            now_ms.wrapping_sub(self.last_change_ms) >= STUCK_MS,
        ];
        let before = self.health;
        for ((bit, seen_ms), cause) in BITS.into_iter().zip(&mut self.seen_ms).zip(causes) {
            if cause {
                self.health |= bit;
                *seen_ms = now_ms;
            } else if now_ms.wrapping_sub(*seen_ms) >= CLEAR_MS {
                self.health &= !bit;
            }
        }
        self.keep_what_returns(before, now_ms);
        self.health
    }

    /// Makes a channel's fault persistent if it returned soon after its end.
    fn keep_what_returns(&mut self, before: u8, now_ms: u32) {
        for (bit, ended_ms) in [health::SENSOR, health::FLEX].into_iter().zip(&mut self.ended_ms) {
            let (was, is) = (before & bit != 0, self.health & bit != 0);
            if let Some(ended) = *ended_ms
                && now_ms.wrapping_sub(ended) >= RETURN_MS
            {
                *ended_ms = None;
            }
            if is && !was && ended_ms.is_some() {
                self.staying |= bit;
            } else if was && !is {
                *ended_ms = Some(now_ms);
            }
        }
        self.health |= self.staying;
    }

    /// Returns whether gravity was plausible in the sample of `now_ms`. If not, its direction is meaningless.
    pub fn gravity_is_possible(&self, now_ms: u32) -> bool {
        self.gravity_good_ms == now_ms
    }

    /// Reports that a sample is missing at this time. Returns bits of [`health`].
    pub fn no_sample(&mut self, now_ms: u32) -> u8 {
        if now_ms.wrapping_sub(self.last_sample_ms) >= SILENT_MS {
            self.health |= health::STUCK;
            self.seen_ms[3] = now_ms;
        }
        self.health
    }
}

/// Returns whether the newest of three readings undoes the previous change.
fn returns(now: u16, last: u16, before: u16) -> bool {
    (now > last) == (before > last) && now.abs_diff(last).min(before.abs_diff(last)) > MOST_RETURN
}
