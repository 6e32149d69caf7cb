//! The state of one hand: its connection, and how long it has been neutral.

use super::NEUTRAL_SAMPLES;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    pub(super) awaited: bool,
    pub(super) connected: bool,
    pub(super) live: bool,
    /// Earliest possible time of the newest valid sample on the host's clock.
    pub(super) sample_ms: u64,
    /// Samples before this time do not count as neutral, because an event has reset neutral since then.
    pub(super) reset_ms: u64,
    pub(super) neutral: Option<Neutral>,
}

/// A sequence of consecutive neutral samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neutral {
    /// Latest possible time of the first sample on the host's clock.
    pub(super) first_ms: u64,
    /// Earliest possible time of the newest sample on the host's clock.
    pub(super) newest_ms: u64,
    pub(super) samples: u32,
}

impl Neutral {
    /// Returns whether the samples prove neutral for `long_ms` at `time_ms`.
    pub(super) fn held(&self, long_ms: u64, time_ms: u64) -> bool {
        self.samples >= NEUTRAL_SAMPLES
            && self.newest_ms.min(time_ms).saturating_sub(self.first_ms) >= long_ms
    }
}

impl Watch {
    pub(super) fn lose(&mut self, now_ms: u64) {
        self.live = false;
        self.reset(now_ms);
    }

    /// Resets neutral. Only later samples then count as neutral.
    pub(super) fn reset(&mut self, now_ms: u64) {
        self.reset_ms = now_ms;
        self.neutral = None;
    }

    pub(super) fn refresh(&mut self, age_ms: u64, neutral: bool, now_ms: u64) {
        let sample_ms = now_ms.saturating_sub(age_ms);
        self.live = true;
        // Ages vary slightly, but the time of a hand's samples never decreases.
        self.sample_ms = self.sample_ms.max(sample_ms);
        if !neutral {
            self.neutral = None;
        } else if let Some(neutral) = &mut self.neutral {
            neutral.newest_ms = neutral.newest_ms.max(sample_ms);
            neutral.samples = neutral.samples.saturating_add(1);
        } else if sample_ms >= self.reset_ms {
            self.neutral = Some(Neutral { first_ms: now_ms, newest_ms: sample_ms, samples: 1 });
        }
    }
}
