//! Readings that no working left hand can give: open or shorted channels, impossible gravity, a stuck converter.
//!
//! A channel at a rail is a fault at once; impossible gravity after [`GRAVITY_MS`]; a converter that repeats
//! itself, or delivers nothing, after [`STUCK_MS`] and [`SILENT_MS`]. A fault ends when its cause has
//! been gone for [`CLEAR_MS`]; but a channel whose fault comes back within [`RETURN_MS`] is loose or hums, and
//! its fault stays until somebody calibrates or restarts the board.

use crate::left::tilt::Acceleration;
use crate::left::{AdcCounts, ONE_G, OVERSAMPLING, health};

/// Impossible gravity for this long is a fault; shorter is a jolt.
pub const GRAVITY_MS: u32 = 200;
/// The same five readings, noise and all, for this long: the converter repeats itself.
pub const STUCK_MS: u32 = 1000;
/// No reading for this long: the converter has stopped.
pub const SILENT_MS: u32 = 100;
/// Time without its cause after which a fault ends.
pub const CLEAR_MS: u32 = 200;
/// A channel's fault that comes back within this time after it ended stays.
pub const RETURN_MS: u32 = 10_000;
/// No finger moves its reading by more than this from one sample to the next and as much back in the one
/// after: 32 of 1024. A pin that hangs in the air hums with the mains, twice as fast as it is sampled.
const MOST_RETURN: u16 = 32 * OVERSAMPLING;
/// Readings of 0 to 40 and 983 to 1023 of the converter are no signal. The ADXL335's ±3.6 g leave
/// 143 to 881, and a 7 to 110 kΩ flex sensor over 22 kΩ 170 to 776.
const RAIL: u16 = 40 * OVERSAMPLING;
/// A hand at rest feels 1 g; 10 % of sensitivity and a neutral pose 10° off level leave 0.7 to 1.3.
const LEAST_GRAVITY: u32 = (ONE_G as u32) / 2;
/// See [`LEAST_GRAVITY`]; a moving hand may feel more, but not for 200 ms.
const MOST_GRAVITY: u32 = (ONE_G as u32) * 16 / 10;

/// Watches the readings of one hand.
#[derive(Clone, Copy, Debug)]
pub struct FaultWatch {
    last: AdcCounts,
    /// The flex readings of the sample before that.
    flex_before: [u16; 2],
    last_change_ms: u32,
    last_sample_ms: u32,
    gravity_good_ms: u32,
    /// When the cause of each fault was last seen, for the bits in `health`.
    seen_ms: [u32; 4],
    health: u8,
    /// When the faults of the channels ended last, where that is less than [`RETURN_MS`] ago.
    ended_ms: [Option<u32>; 2],
    /// Bits of faults that stay.
    staying: u8,
}

/// The faults of this module, in the order of [`FaultWatch::seen_ms`].
const BITS: [u8; 4] = [health::SENSOR, health::FLEX, health::GRAVITY, health::STUCK];

impl FaultWatch {
    /// Starts watching at `now_ms`, without a fault.
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

    /// Faults that stay end like others from now on.
    pub fn forgive(&mut self) {
        self.staying = 0;
        self.ended_ms = [None; 2];
    }

    /// Takes one sample, raw and as acceleration relative to zero; returns bits of [`health`].
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

    /// Makes a channel's fault stay that was over, and has come back soon.
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

    /// Was gravity possible in the sample of `now_ms`? If not, its direction means nothing.
    pub fn gravity_is_possible(&self, now_ms: u32) -> bool {
        self.gravity_good_ms == now_ms
    }

    /// Says that time has passed without a sample; returns bits of [`health`].
    pub fn no_sample(&mut self, now_ms: u32) -> u8 {
        if now_ms.wrapping_sub(self.last_sample_ms) >= SILENT_MS {
            self.health |= health::STUCK;
            self.seen_ms[3] = now_ms;
        }
        self.health
    }
}

/// Does the newest of three readings undo what the one before it did?
fn returns(now: u16, last: u16, before: u16) -> bool {
    (now > last) == (before > last) && now.abs_diff(last).min(before.abs_diff(last)) > MOST_RETURN
}
