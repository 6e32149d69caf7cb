//! The schedule of messages, from the tap to an output.

use super::messages::{Entry, Origin};
use host_core::observe::SessionEvent;
use host_core::observe::{Now, Observer, OperatorKey, Sample, Turn};
use host_core::safety::Hand;

/// Maximum number of steps in one message.
const TURNS_MAX: usize = 1000;

const JOINTS_INTERVAL_MS: u64 = 10;
const ODOMETRY_INTERVAL_MS: u64 = 20;
const HANDS_INTERVAL_MS: u64 = 50;

/// Receives messages in order. It is called within the session's loop.
pub trait Outlet {
    /// One more.
    fn put(&mut self, entry: Entry);
}

/// The observer that creates all messages of a session.
/// Rates: joints 100 Hz; odometry, speeds and transforms 50 Hz; hands 20 Hz. Other messages follow events.
#[derive(Debug)]
pub struct Teller<O: Outlet> {
    origin: Origin,
    outlet: O,
    turns: Vec<Turn>,
    time_ms: u64,
    /// Times for publishing joints, odometry and hands.
    due_ms: [u64; 3],
}

impl<O: Outlet> Teller<O> {
    /// Connects an output to a session whose clock was zero at `origin`.
    pub fn new(origin: Origin, outlet: O) -> Self {
        Teller { origin, outlet, turns: Vec::new(), time_ms: 0, due_ms: [0; 3] }
    }

    fn put(&mut self, entry: Entry) {
        self.outlet.put(entry);
    }

    /// Writes all steps so far, before a message whose position relative to the steps matters.
    fn put_turns(&mut self) {
        if !self.turns.is_empty() {
            let entry = self.origin.turns(self.time_ms, &self.turns);
            self.turns.clear();
            self.put(entry);
        }
    }

    fn is_due(&mut self, which: usize, time_ms: u64, interval_ms: u64) -> bool {
        let due = time_ms >= self.due_ms[which];
        if due {
            self.due_ms[which] = time_ms - time_ms % interval_ms + interval_ms;
        }
        due
    }
}

impl<O: Outlet> Observer for Teller<O> {
    fn received(&mut self, time_ms: u64, hand: Hand, bytes: &[u8]) {
        self.put_turns();
        self.put(self.origin.bytes(time_ms, hand, true, bytes));
    }

    fn sent(&mut self, time_ms: u64, hand: Hand, frame: &[u8]) {
        self.put_turns();
        self.put(self.origin.bytes(time_ms, hand, false, frame));
    }

    fn sampled(&mut self, time_ms: u64, sample: &Sample<'_>) {
        for entry in self.origin.sample(time_ms, sample) {
            self.put(entry);
        }
    }

    fn operated(&mut self, time_ms: u64, key: OperatorKey) {
        self.put_turns();
        self.put(self.origin.operated(time_ms, key));
    }

    fn refused(&mut self, time_ms: u64, reason: Option<&str>) {
        self.put_turns();
        self.put(self.origin.refused(time_ms, reason));
    }

    fn turned(&mut self, turn: Turn) {
        if let Turn::Decided(time_ms) = turn {
            self.time_ms = self.time_ms.max(time_ms);
        }
        if turn != Turn::Moved(0) {
            self.turns.push(turn);
        }
        if self.turns.len() >= TURNS_MAX {
            self.put_turns();
        }
    }

    fn happened(&mut self, event: &SessionEvent) {
        self.put_turns();
        for entry in self.origin.event(event) {
            self.put(entry);
        }
    }

    fn state(&mut self, now: &Now<'_>) {
        let time_ms = now.time_ms;
        if self.is_due(0, time_ms, JOINTS_INTERVAL_MS) {
            self.put_turns();
            self.put(self.origin.joints(now));
        }
        if self.is_due(1, time_ms, ODOMETRY_INTERVAL_MS) {
            self.put_turns();
            self.put(self.origin.twist(now));
            self.put(self.origin.odometry(now));
            self.put(self.origin.transforms(now));
        }
        if self.is_due(2, time_ms, HANDS_INTERVAL_MS) {
            self.put_turns();
            self.put(self.origin.hands(now));
        }
    }
}

impl<O: Outlet> Drop for Teller<O> {
    fn drop(&mut self) {
        self.put_turns();
    }
}
