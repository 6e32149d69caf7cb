//! Determines the maximum age of a frame from the board's clock.
//! The times are arguments, because this module reads no clock.
//!
//! A frame contains the time of its newest sample on the board's clock.
//! Only a round trip relates this clock to the laptop's.
//! A board that answers a ping reads its clock *after* the ping was sent.
//! A sample whose board time is D later was therefore taken at least D after the ping was sent.
//! The resulting age is an **upper bound**. It is too large by the travel time of the ping, but never too small.
//! Constant delays, growing queues and clock drift can only increase the computed age.
//!
//! ```text
//! laptop  ──┬────────────────────────────────┬──►   age ≤ now − sent − (sample − pong)
//!      sent ╲                                ╱ now
//! board  ────╲──┬────────────┬──────────────╱──►
//!              pong        sample
//! ```

/// Maximum drift of a board's clock relative to the laptop's, in parts per million.
/// No board needs so much: the resonator of an Arduino Nano has only 5,000.
/// With ten pings per second, this drift adds 5 ms.
pub const DRIFT_PPM: u32 = 50_000;

/// Converts a board's time to the laptop's time, and limits the age of the board's messages.
///
/// The laptop's time is in milliseconds, on any clock that never steps back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardClock {
    anchor: Option<Anchor>,
}

/// The board's clock cannot have shown `board_ms` before the laptop's clock showed `host_us`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Anchor {
    board_ms: u32,
    host_us: i64,
}

impl Anchor {
    /// Returns the earliest time on the laptop's clock at which the board's clock can have shown `board_ms`.
    /// Because the clock wraps, `board_ms` can stand for several points in time.
    /// The result uses the time within 24 days of the anchor.
    fn earliest_us(&self, board_ms: u32) -> i64 {
        let step_ms = i64::from(board_ms.wrapping_sub(self.board_ms) as i32);
        // Both time stamps are rounded down to milliseconds, so the true difference may be one millisecond shorter.
        self.host_us + (step_ms - 1) * 1000 - step_ms.abs() * i64::from(DRIFT_PPM) / 1000
    }
}

/// Converts to microseconds, and keeps differences of two such times in range.
fn micros(ms: u64) -> i64 {
    const LIMIT_MS: u64 = i64::MAX as u64 / 4000;
    ms.min(LIMIT_MS) as i64 * 1000
}

impl BoardClock {
    /// Creates a clock that has had no round trip, for which everything is infinitely old.
    pub const fn new() -> Self {
        Self { anchor: None }
    }

    /// Forgets all round trips, because the board and its clock have restarted.
    pub fn rebase(&mut self) {
        self.anchor = None;
    }

    /// Adds a pong that arrived at `now_ms` and answers the ping sent at `sent_ms`.
    /// Between these two times, the board's clock showed `board_time_ms`.
    /// Returns false if the board's time is earlier than in a previous pong.
    /// In this case, the board must have restarted, and its clock is unknown.
    pub fn pong(&mut self, board_time_ms: u32, sent_ms: u64, now_ms: u64) -> bool {
        let fresh = Anchor { board_ms: board_time_ms, host_us: micros(sent_ms.min(now_ms)) };
        let Some(old) = self.anchor else {
            self.anchor = Some(fresh);
            return true;
        };
        if (board_time_ms.wrapping_sub(old.board_ms) as i32) < 0 {
            self.anchor = None;
            return false;
        }
        // Uses the round trip with the stricter bound, unless this would mean that the board's clock is faster than allowed.
        let known_us = old.earliest_us(board_time_ms).min(micros(now_ms));
        self.anchor = Some(Anchor { host_us: fresh.host_us.max(known_us), ..fresh });
        true
    }

    /// Returns the maximum age in milliseconds of a time on the board's clock.
    /// Examples are the times of a frame's newest sample and of the end of a window.
    /// The age is `u64::MAX` if no ping has been answered.
    pub fn age_ms(&self, board_time_ms: u32, now_ms: u64) -> u64 {
        let Some(anchor) = &self.anchor else { return u64::MAX };
        // The time on the laptop's clock is also rounded down.
        let now_us = micros(now_ms) + 999;
        (now_us - anchor.earliest_us(board_time_ms)).max(0) as u64 / 1000
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A clock that has heard one answer: the ping was sent at 1000, when the board's clock showed 0.
    fn anchored() -> BoardClock {
        let mut clock = BoardClock::new();
        assert!(clock.pong(0, 1000, 1004));
        clock
    }

    #[test]
    fn without_a_round_trip_everything_is_too_old() {
        assert_eq!(BoardClock::new().age_ms(0, 0), u64::MAX);
    }

    #[test]
    fn a_frame_is_as_old_as_it_can_be_with_the_path_of_the_ping_added() {
        let clock = anchored();
        // The sample was taken 20 ms after the pong, so not before 1020. Time stamps and drift add 1 ms each.
        assert_eq!(clock.age_ms(20, 1024), 6);
        assert_eq!(clock.age_ms(20, 1324), 306);
    }

    #[test]
    fn a_delay_that_every_frame_and_every_pong_shares_is_seen() {
        let mut clock = BoardClock::new();
        // All data from the board takes 1.5 s to arrive, but pings arrive immediately.
        for k in 0..20u64 {
            let sent = 10_000 + 100 * k;
            assert!(clock.pong(sent as u32, sent, sent + 1500));
        }
        let age = clock.age_ms(13_000, 14_500);
        assert!((1500..1600).contains(&age), "{age} ms");
    }

    #[test]
    fn a_link_that_became_slow_stays_old_for_ever() {
        let mut clock = anchored();
        // For half an hour, a pong arrives every 100 ms with a delay of 1.5 s.
        for k in 1..18_000u64 {
            let sent = 1000 + 100 * k;
            clock.pong((100 * k) as u32, sent, sent + 1500);
            assert!(clock.age_ms((100 * k) as u32, sent + 1500) >= 1500);
        }
    }

    #[test]
    fn frames_that_a_stalled_laptop_reads_at_once_are_each_as_old_as_they_are() {
        let clock = anchored();
        for k in 1..=100u64 {
            let (age, truth) = (clock.age_ms((k * 20) as u32, 3000), 2000 - k * 20);
            // The bound includes 1 ms for time stamps, and the possible drift since the pong.
            assert!((truth..=truth + 2 + k).contains(&age), "frame {k}: {age}");
        }
    }

    #[test]
    fn a_clock_that_steps_back_is_a_restart_and_nothing_is_known() {
        let mut clock = BoardClock::new();
        assert!(clock.pong(600_000, 1_000_000, 1_000_004));
        assert!(clock.age_ms(20, 1_000_020) > 590_000);
        assert!(!clock.pong(30, 1_000_030, 1_000_034));
        assert_eq!(clock.age_ms(40, 1_000_040), u64::MAX);
    }

    #[test]
    fn extreme_times_do_not_panic() {
        for now in [0, 1, u64::MAX / 2, u64::MAX] {
            for board in [0, 1, u32::MAX / 2, u32::MAX] {
                let mut clock = BoardClock::new();
                clock.pong(board, now, now);
                clock.pong(!board, u64::MAX, now);
                clock.pong(board.wrapping_add(1), !now, now);
                clock.age_ms(board, u64::MAX);
            }
        }
    }

    /// Returns the time in whole milliseconds on a board's clock that is `ppm` faster than the laptop's.
    fn board_ms(host_us: i64, ppm: i64, start_ms: u32) -> u32 {
        start_ms.wrapping_add(((host_us + host_us * ppm / 1_000_000) / 1000) as u32)
    }

    proptest! {
        /// No computed age is below the true age.
        /// This holds for any allowed drift and any delays of pings, pongs and frames.
        /// No computed age exceeds the true age by more than the travel time of the fastest recent ping.
        #[test]
        fn ages_are_never_too_young_and_too_old_by_the_path_of_a_ping_only(
            ppm in -50_000i64..=50_000,
            start_ms in prop_oneof![any::<u32>(), (u32::MAX - 30_000)..=u32::MAX],
            paths_us in prop::collection::vec((0i64..400_000, 0i64..3_000_000, 0i64..3_000_000), 1..200),
        ) {
            let mut clock = BoardClock::new();
            for (k, &(there, back, delay)) in paths_us.iter().enumerate() {
                // Times on the laptop in microseconds, rounded down when they are read.
                let sent = 5_000_000 + k as i64 * 100_000 + k as i64 * 137;
                let at_board = sent + there.min(99_000);
                let ms = |us: i64| (us / 1000) as u64;
                clock.pong(board_ms(at_board, ppm, start_ms), ms(sent), ms(at_board + back));
                let sample = at_board + 20_123;
                let arrival = sample + delay;
                let age = clock.age_ms(board_ms(sample, ppm, start_ms), ms(arrival)) as i64 * 1000;
                prop_assert!(age >= delay - 1000, "age {} of {}", age, delay);
                prop_assert!(age <= delay + there.min(99_000) + 20_123 / 10 + 5000, "age {} of {}", age, delay);
            }
        }

        /// Even if a clock is 20 % too fast, the error is limited to what the clock gains between two pongs.
        #[test]
        fn a_clock_far_faster_than_allowed_hides_little(back_ms in 0u64..30) {
            let mut clock = BoardClock::new();
            for k in 1..6000u64 {
                let host = 100 * k;
                clock.pong((host * 6 / 5) as u32, host, host + back_ms);
                let age = clock.age_ms(((host + 90) * 6 / 5) as u32, host + 90 + 200);
                prop_assert!(age + 25 + back_ms >= 200, "{} ms of 200", age);
            }
        }

        /// The board's clock may start at any value, including values shortly before it wraps.
        #[test]
        fn ages_do_not_depend_on_where_the_board_clock_stands(
            start_ms: u32,
            steps in prop::collection::vec((0u32..1_000_000, 0u64..1_000_000), 1..50),
        ) {
            let (mut plain, mut shifted) = (BoardClock::new(), BoardClock::new());
            let (mut board, mut now) = (0u32, 0u64);
            for (board_step, now_step) in steps {
                board += board_step;
                now += now_step;
                plain.pong(board, now / 2, now);
                shifted.pong(board.wrapping_add(start_ms), now / 2, now);
                prop_assert_eq!(
                    plain.age_ms(board + 7, now),
                    shifted.age_ms(board.wrapping_add(start_ms).wrapping_add(7), now)
                );
            }
        }
    }
}
