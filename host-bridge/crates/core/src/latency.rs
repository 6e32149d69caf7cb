//! Measures the robot's reaction time to a hand, in virtual or real time.

use serde::Serialize;

/// Delays of one kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Delays {
    waiting_since_ms: Option<u64>,
    seen_ms: Vec<u64>,
}

/// Figures of [`Delays`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DelaySummary {
    /// How many.
    pub count: usize,
    /// The median. For an even number of delays, it is the upper of the two middle values.
    pub median_ms: Option<u64>,
    /// The longest.
    pub worst_ms: Option<u64>,
}

impl Delays {
    /// Records an action of the hand at this time. The next motion is its response.
    pub fn begin(&mut self, at_ms: u64) {
        self.waiting_since_ms = Some(at_ms);
    }

    /// Records that no motion will follow.
    pub fn cancel(&mut self) {
        self.waiting_since_ms = None;
    }

    /// Records a motion at this time.
    pub fn moved(&mut self, at_ms: u64) {
        if let Some(since_ms) = self.waiting_since_ms.take() {
            self.seen_ms.push(at_ms.saturating_sub(since_ms));
        }
    }

    /// Count, median and worst.
    pub fn summary(&self) -> DelaySummary {
        let mut sorted = self.seen_ms.clone();
        sorted.sort_unstable();
        DelaySummary {
            count: sorted.len(),
            median_ms: sorted.get(sorted.len() / 2).copied(),
            worst_ms: sorted.last().copied(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_first_motion_after_a_cause_counts() {
        let mut delays = Delays::default();
        delays.moved(5);
        for (cause, motion) in [(10, 40), (100, 110), (200, 220)] {
            delays.begin(cause);
            delays.moved(motion);
            delays.moved(motion + 500);
        }
        delays.begin(300);
        delays.cancel();
        delays.moved(301);
        let summary = delays.summary();
        assert_eq!(summary, DelaySummary { count: 3, median_ms: Some(20), worst_ms: Some(30) });
    }
}
