//! A recording that starts later than the session.

use super::Board;
use host_core::observe::Sample;

/// A board that is switched on some milliseconds after the start of the session.
pub struct Delayed<B> {
    board: B,
    by_ms: u64,
    on: bool,
}

impl<B: Board> Delayed<B> {
    /// Creates a board that is switched on after `by_ms`; 0 means immediately.
    pub fn new(board: B, by_ms: u64) -> Self {
        Delayed { board, by_ms, on: false }
    }
}

impl<B: Board> Board for Delayed<B> {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        if let Some(since_ms) = now_ms.checked_sub(self.by_ms) {
            self.on = true;
            self.board.step(since_ms, wire);
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        // Earlier messages are lost, as on a line without a board.
        if self.on && now_ms >= self.by_ms {
            self.board.receive(bytes, now_ms - self.by_ms, wire);
        }
    }

    fn sample(&self) -> Option<Sample<'_>> {
        if self.on { self.board.sample() } else { None }
    }

    fn ended(&self) -> bool {
        self.on && self.board.ended()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hand that sends the current time in each step.
    struct Clock(u64);

    impl Board for Clock {
        fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
            self.0 = now_ms;
            wire.push(now_ms as u8);
        }

        fn receive(&mut self, bytes: &[u8], _now_ms: u64, wire: &mut Vec<u8>) {
            wire.extend_from_slice(bytes);
        }

        fn ended(&self) -> bool {
            self.0 >= 20
        }
    }

    #[test]
    fn a_late_board_is_silent_until_its_time_and_then_has_a_clock_of_its_own() {
        let mut board = Delayed::new(Clock(99), 30);
        let mut wire = Vec::new();
        board.receive(&[7], 0, &mut wire);
        board.step(20, &mut wire);
        assert!(wire.is_empty() && !board.ended() && board.sample().is_none());
        board.step(30, &mut wire);
        board.step(40, &mut wire);
        board.receive(&[7], 40, &mut wire);
        board.step(50, &mut wire);
        assert_eq!(wire, [0, 10, 7, 20]);
        assert!(board.ended());
    }
}
