//! Resamples a sensor that has its own clock to the 100 Hz grid of the board's crystal.
//!
//! The LSM9DS1's nominal 238 Hz may be wrong by some per cent and drifts with temperature.
//! The sensor's interrupt line is not connected on this board.
//! However, each poll of the sensor's FIFO returns a known number of sets, and the newest set is less than one period old.
//! [`Grid`] estimates the age of the newest set and advances the estimate with the board's clock.
//! If the estimate leaves its limits, [`Grid`] corrects both the age and the estimated period.
//! Because the phase between the two clocks drifts, the limits become narrow.
//! After a second, the error of the estimated age is about equal to the jitter of the polls.
//!
//! A grid sample is a linear interpolation between the two neighbouring sets.
//! For a movement of frequency f in Hz, the error is at most (π·f/238)²/2 of the amplitude: 0.2 % at 5 Hz.
//! The sample is taken [`Grid::delay_us`] before its grid time, so that the later of the two sets has always arrived.

use crate::Set;

/// Number of stored sets. It exceeds the size of the sensor's FIFO because a grid time may be processed late.
const HISTORY: usize = 64;

/// Maximum age of a grid time relative to the newest set, in sets. An older grid time counts as a gap.
const OLDEST: f32 = (HISTORY - 2) as f32;

/// The resampler. All times are in microseconds of the board's clock.
#[derive(Clone, Debug)]
pub struct Grid {
    history: [Set; HISTORY],
    /// Number of sets since the start or the last gap.
    count: u32,
    period_us: f32,
    nominal_us: f32,
    /// Age of the newest set at the last poll.
    age_us: f32,
    last_poll_us: u64,
    polls: u32,
    since_poll: u32,
}

impl Grid {
    /// Creates a resampler for a sensor with this nominal rate.
    pub fn new(nominal_hz: f32) -> Self {
        let nominal_us = 1e6 / nominal_hz;
        Self {
            history: [[0; 6]; HISTORY],
            count: 0,
            period_us: nominal_us,
            nominal_us,
            age_us: nominal_us / 2.0,
            last_poll_us: 0,
            polls: 0,
            since_poll: 0,
        }
    }

    /// Discards the sets after a gap. The estimated rate of the sensor does not change.
    pub fn restart(&mut self) {
        self.count = 0;
        self.polls = 0;
        self.since_poll = 0;
        self.age_us = self.period_us / 2.0;
    }

    /// Delay between a grid sample and its grid time.
    pub fn delay_us(&self) -> f32 {
        // The delay is a tenth longer than the nominal period, because the sensor may be slower than nominal.
        self.nominal_us * 1.1
    }

    /// Estimated time between two sets.
    pub fn period_us(&self) -> f32 {
        self.period_us
    }

    /// Takes sets, oldest first.
    pub fn push(&mut self, sets: &[Set]) {
        for &set in sets {
            self.history[self.count as usize % HISTORY] = set;
            self.count = self.count.wrapping_add(1);
            self.since_poll = self.since_poll.saturating_add(1);
        }
    }

    /// Call this after all sets up to this time were [pushed](Self::push).
    pub fn synchronise(&mut self, poll_us: u64) {
        let elapsed_us = poll_us.saturating_sub(self.last_poll_us) as f32;
        let sets = core::mem::take(&mut self.since_poll) as f32;
        self.last_poll_us = poll_us;
        if self.count == 0 {
            return;
        }
        self.polls = self.polls.saturating_add(1);
        if self.polls == 1 {
            return;
        }
        let age_us = self.age_us + elapsed_us - sets * self.period_us;
        self.age_us = between(age_us, 0.0, self.period_us);
        // If the age is below its bound, sets come faster than estimated.
        let error_us = age_us - self.age_us;
        let gain = if self.polls < 200 { 1.0 / 32.0 } else { 1.0 / 256.0 };
        self.period_us =
            between(self.period_us + error_us * gain, self.nominal_us * 0.9, self.nominal_us * 1.1);
    }

    /// Returns the sample at this grid time, or `None` if the neighbouring sets are not stored.
    pub fn sample(&self, grid_us: u64) -> Option<Set> {
        // Distance from the requested time to the newest set, in sets.
        let before_poll_us = self.last_poll_us as i64 - grid_us as i64;
        let behind = (before_poll_us as f32 + self.delay_us() - self.age_us) / self.period_us;
        // Because of jitter in the first polls, the requested time may be slightly later than the newest set.
        let behind = behind.max(0.0);
        if behind > OLDEST || behind + 2.0 > self.count as f32 {
            return None;
        }
        let whole = behind as u32;
        // Weight of the later set in units of 1/16384, so that its product with a difference of two i16 values fits an i32.
        let part = ((behind - whole as f32) * 16384.0) as i32;
        let newer = &self.history[(self.count - 1 - whole) as usize % HISTORY];
        let older = &self.history[(self.count - 2 - whole) as usize % HISTORY];
        let mut sample = *newer;
        for (s, &o) in sample.iter_mut().zip(older) {
            let step = (i32::from(o) - i32::from(*s)) * part + 8192;
            *s = (i32::from(*s) + (step >> 14)) as i16;
        }
        Some(sample)
    }
}

/// Replaces `clamp`, whose error message about bounds in the wrong order would add 15 kB of code that prints floats.
fn between(value: f32, low: f32, high: f32) -> f32 {
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    extern crate std;

    /// Returns the worst error for a simulated sensor that outputs a ramp.
    /// The sensor's clock is wrong by `ratio`, and the sensor is polled every 10 ms with jitter.
    fn worst_error_us(ratio: f64, jitter_us: u64) -> f64 {
        let mut grid = Grid::new(238.0);
        let period = 1e6 / 238.0 * ratio;
        let mut taken = 0u64;
        let mut random = 1u64;
        let mut worst: f64 = 0.0;
        for k in 1..3000u64 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let poll = k * 10_000 + (random >> 33) % (jitter_us + 1);
            let due = ((poll as f64 - 700.0) / period) as u64;
            let mut sets = std::vec::Vec::new();
            while taken < due {
                taken += 1;
                // One count per 100 µs. The value does not wrap within this test.
                let value = (taken as f64 * period + 700.0) / 1000.0;
                sets.push([(value - 15_000.0) as i16; 6]);
            }
            grid.push(&sets);
            grid.synchronise(poll);
            let sample = grid.sample(k * 10_000);
            if k > 300 {
                let ms = f64::from(sample.expect("sets are known")[0]) + 15_000.0;
                let wanted = (k * 10_000) as f64 - f64::from(grid.delay_us());
                worst = worst.max((ms * 1000.0 - wanted).abs());
            }
        }
        worst
    }

    #[test]
    fn a_sensor_clock_that_is_off_is_followed() {
        for ratio in [0.95, 0.99, 1.0, 1.003, 1.05] {
            // The truncated ramp itself has a resolution of 1000 µs.
            let worst = worst_error_us(ratio, 100);
            assert!(worst < 1600.0, "ratio {ratio}: {worst} us");
        }
    }

    #[test]
    fn no_sample_is_made_up_before_the_sets_are_there() {
        let mut grid = Grid::new(238.0);
        assert_eq!(grid.sample(10_000), None);
        grid.push(&[[1; 6]]);
        grid.synchronise(10_000);
        assert_eq!(grid.sample(10_000), None);
        grid.push(&[[2; 6], [3; 6]]);
        grid.synchronise(20_000);
        assert!(grid.sample(20_000).is_some());
        grid.restart();
        assert_eq!(grid.sample(20_000), None);
    }

    #[test]
    fn extreme_steps_do_not_overflow() {
        let mut grid = Grid::new(238.0);
        grid.push(&[[i16::MIN; 6], [i16::MAX; 6], [i16::MIN; 6], [i16::MAX; 6]]);
        grid.synchronise(10_000);
        for us in 0..100 {
            grid.sample(9_000 + us * 100);
        }
    }
}
