//! How old a frame is: the board's clock seen from the laptop. No clock inside; time comes in.
//!
//! A frame says when its newest sample was taken on the board's clock. The frame with the shortest way
//! shows how that clock stands to the laptop's; every other frame's age is how much later it came than
//! that one would have. Ages are therefore short by the shortest way itself (a few ms), and by a delay
//! that *every* frame since the restart has shared. A round trip ([`BoardClock::pong`]) bounds both.

use crate::message::Board;

/// Drift allowed for a board with a crystal, in parts per million of the time passed.
pub const CRYSTAL_DRIFT_PPM: u32 = 500;
/// Drift allowed for an Arduino Nano, whose 16 MHz come from a ceramic resonator (0.5 % and ageing).
pub const RESONATOR_DRIFT_PPM: u32 = 10_000;

/// Maps one board's time onto the laptop's and tells the age of its frames.
///
/// The laptop's time is milliseconds on any clock that never steps back. A board whose clock runs slow
/// seems to send ever later; up to the allowed drift that is not taken for age. The price: a queue that
/// grows more slowly than that goes unseen until a pong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardClock {
    drift_ppm: u32,
    base: Option<Base>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Base {
    /// Newest board time, as sent and without the wrap.
    newest_ms: u32,
    newest_unwrapped_ms: i64,
    /// Laptop minus board, on the shortest way: microseconds, for slow drift over short times.
    offset_us: i64,
    /// Laptop time at which `offset_us` held.
    at_us: i64,
}

impl Base {
    /// Board time without the wrap: the one nearest to the newest known, up to 24 days either way.
    fn unwrapped_ms(&self, board_time_ms: u32) -> i64 {
        let step = board_time_ms.wrapping_sub(self.newest_ms) as i32;
        self.newest_unwrapped_ms + i64::from(step)
    }

    fn offset_us(&self, now_us: i64, drift_ppm: u32) -> i64 {
        let passed_us = (now_us - self.at_us).max(0);
        // Dividing first keeps centuries within range.
        self.offset_us.saturating_add((passed_us / 1000).saturating_mul(i64::from(drift_ppm)) / 1000)
    }
}

/// Also keeps differences of two such times within range.
fn micros(ms: u64) -> i64 {
    const LIMIT_MS: u64 = i64::MAX as u64 / 4000;
    ms.min(LIMIT_MS) as i64 * 1000
}

impl BoardClock {
    /// A clock without a base that allows this much drift, in parts per million.
    pub const fn new(drift_ppm: u32) -> Self {
        Self { drift_ppm, base: None }
    }

    /// A clock without a base, with the drift that this board's clock may have.
    pub const fn for_board(board: Board) -> Self {
        Self::new(match board {
            Board::LeftNano => RESONATOR_DRIFT_PPM,
            _ => CRYSTAL_DRIFT_PPM,
        })
    }

    /// Forgets the base: the board has restarted, and its clock with it.
    pub fn rebase(&mut self) {
        self.base = None;
    }

    /// A frame with this board time has arrived: its age in milliseconds.
    ///
    /// The first one is the base and has age 0. A board that restarted unseen (its clock is back at 0)
    /// shows an age as long as its former run: ask it for a hello.
    pub fn arrived(&mut self, board_time_ms: u32, now_ms: u64) -> u64 {
        self.learn(board_time_ms, now_ms, now_ms, false);
        self.age_ms(board_time_ms, now_ms)
    }

    /// A pong has arrived for the ping sent at `sent_ms`: the board's clock stood at `board_time_ms`
    /// somewhere between. Afterwards ages are wrong by no more than this round trip took.
    pub fn pong(&mut self, board_time_ms: u32, sent_ms: u64, now_ms: u64) {
        self.learn(board_time_ms, sent_ms.min(now_ms), now_ms, true);
    }

    /// Age of anything stamped with board time, such as the end of a window; learns nothing.
    /// Without a base as old as can be: `u64::MAX`.
    pub fn age_ms(&self, board_time_ms: u32, now_ms: u64) -> u64 {
        let Some(base) = &self.base else { return u64::MAX };
        let now_us = micros(now_ms);
        let way_us = now_us - base.unwrapped_ms(board_time_ms) * 1000;
        (way_us - base.offset_us(now_us, self.drift_ppm)).max(0) as u64 / 1000
    }

    /// The board's clock stood at `board_time_ms` before `now_ms`, and (if `round_trip`) after `sent_ms`.
    fn learn(&mut self, board_time_ms: u32, sent_ms: u64, now_ms: u64, round_trip: bool) {
        let now_us = micros(now_ms);
        let base = self.base.get_or_insert(Base {
            newest_ms: board_time_ms,
            newest_unwrapped_ms: i64::from(board_time_ms),
            offset_us: i64::MAX,
            at_us: now_us,
        });
        let board_ms = base.unwrapped_ms(board_time_ms);
        let mut offset_us = base.offset_us(now_us, self.drift_ppm).min(now_us - board_ms * 1000);
        if round_trip {
            // Both clocks show whole milliseconds, so the board's may have been almost one further.
            offset_us = offset_us.max(micros(sent_ms) - (board_ms + 1) * 1000);
        }
        base.offset_us = offset_us;
        base.at_us = base.at_us.max(now_us);
        if board_ms > base.newest_unwrapped_ms {
            base.newest_ms = board_time_ms;
            base.newest_unwrapped_ms = board_ms;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_late_frame_shows_its_age_and_the_next_one_does_not() {
        let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
        assert_eq!(clock.arrived(1000, 50_003), 0);
        assert_eq!(clock.arrived(1020, 50_023), 0);
        assert_eq!(clock.arrived(1040, 50_343), 299); // 300 late, less the allowed drift of 0.16 ms
        assert_eq!(clock.arrived(1340, 50_343), 0);
    }

    #[test]
    fn frames_that_a_stalled_laptop_reads_at_once_are_each_as_old_as_they_are() {
        let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
        clock.arrived(0, 10_000);
        for k in 1..=100 {
            let age = clock.arrived(k * 20, 12_000);
            // Less the drift allowed in those 2 s.
            assert_eq!(age, (2000 - u64::from(k) * 20).saturating_sub(1), "frame {k}");
        }
    }

    #[test]
    fn without_a_base_everything_is_too_old() {
        assert_eq!(BoardClock::new(0).age_ms(0, 0), u64::MAX);
    }

    #[test]
    fn a_restart_is_a_huge_age_until_it_is_known() {
        let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
        clock.arrived(600_000, 1_000_000);
        assert!(clock.arrived(20, 1_000_020) > 590_000);
        clock.rebase();
        assert_eq!(clock.arrived(40, 1_000_040), 0);
    }

    #[test]
    fn a_pong_uncovers_a_delay_that_every_frame_has_shared() {
        let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
        assert_eq!(clock.arrived(0, 400), 0); // 400 ms late: nobody can know yet
        clock.pong(410, 405, 415);
        // 400 ms, less the pong's 5 ms of way back and a trace of drift.
        assert_eq!(clock.arrived(20, 420), 394);
    }

    #[test]
    fn pongs_hold_a_clock_that_is_far_slower_than_allowed() {
        let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
        let mut worst = 0;
        for host_ms in (0..600_000u64).step_by(20) {
            let board_ms = (host_ms * 98 / 100) as u32;
            if host_ms % 1000 == 0 {
                clock.pong(board_ms, host_ms, host_ms);
            }
            worst = worst.max(clock.arrived(board_ms, host_ms));
        }
        assert!(worst <= 21, "{worst} ms"); // 2 % of the second between pongs, and 1 for whole ms
    }

    #[test]
    fn extreme_times_do_not_panic() {
        for now in [0, 1, u64::MAX / 2, u64::MAX] {
            for board in [0, 1, u32::MAX / 2, u32::MAX] {
                let mut clock = BoardClock::new(u32::MAX);
                clock.arrived(board, now);
                clock.pong(!board, u64::MAX, now);
                clock.arrived(!board, !now);
                clock.age_ms(board, u64::MAX);
            }
        }
    }

    /// A board that runs `ppm` fast against the laptop.
    fn board_ms(host_us: i64, ppm: i64, start_ms: u32) -> u32 {
        start_ms.wrapping_add(((host_us + host_us * ppm / 1_000_000) / 1000) as u32)
    }

    proptest! {
        /// Whatever the drift within the allowance, ages never fall short by more than the drift that
        /// the allowance could hide since the last prompt frame, nor exceed the true delay by more than
        /// a clock tick. Start near the wrap included.
        #[test]
        fn ages_are_true_within_the_drift_since_the_last_prompt_frame(
            ppm in -500i64..=500,
            start_ms in prop_oneof![any::<u32>(), (u32::MAX - 30_000)..=u32::MAX],
            way_ms in 0i64..30,
            delays_ms in prop::collection::vec(prop_oneof![3 => Just(0i64), 1 => 0i64..2000], 1..2000),
        ) {
            let mut clock = BoardClock::new(CRYSTAL_DRIFT_PPM);
            let mut prompt_us = 0;
            for (k, &extra) in delays_ms.iter().enumerate() {
                let sample_us = k as i64 * 20_000;
                let extra = if k == 0 { 0 } else { extra };
                let arrival_us = sample_us + (way_ms + extra) * 1000;
                if extra == 0 {
                    prompt_us = arrival_us;
                }
                let age = clock.arrived(board_ms(sample_us, ppm, start_ms), (arrival_us / 1000) as u64) as i64;
                // A late one is seen among frames that were prompt meanwhile: time has stepped back
                // here, which the clock must take as standing still.
                let hidden_ms = 1 + (arrival_us - prompt_us) / 1_000_000;
                prop_assert!(age >= extra - hidden_ms - 1, "age {} of {}", age, extra);
                prop_assert!(age <= extra + 1, "age {} of {}", age, extra);
            }
        }

        /// Where the board's clock stood at its start makes no difference, wrap or not.
        #[test]
        fn ages_do_not_depend_on_where_the_board_clock_stands(
            start_ms: u32,
            steps in prop::collection::vec((0u32..1_000_000, 0u64..1_000_000), 1..50),
        ) {
            let (mut plain, mut shifted) = (BoardClock::new(0), BoardClock::new(0));
            let (mut board, mut now) = (0u32, 0u64);
            for (board_step, now_step) in steps {
                board += board_step;
                now += now_step;
                prop_assert_eq!(
                    plain.arrived(board, now),
                    shifted.arrived(board.wrapping_add(start_ms), now)
                );
            }
        }

        /// After a round trip, the age of a frame is wrong by no more than that round trip.
        #[test]
        fn a_round_trip_bounds_the_error_of_ages(
            there_ms in 0u64..500,
            back_ms in 0u64..500,
            first_delay_ms in 0u64..5000,
            delay_ms in 0u64..5000,
            board_ahead_ms: u32,
        ) {
            let mut clock = BoardClock::new(0);
            let board = |host_ms: u64| (host_ms as u32).wrapping_add(board_ahead_ms);
            clock.arrived(board(1000), 1000 + first_delay_ms);
            let sent = 7000;
            clock.pong(board(sent + there_ms), sent, sent + there_ms + back_ms);
            let age = clock.arrived(board(9000), 9000 + delay_ms);
            let low = delay_ms.saturating_sub(back_ms.min(first_delay_ms));
            prop_assert!(age >= low, "{} < {}", age, low);
            prop_assert!(age <= delay_ms + there_ms + 1);
        }
    }
}
