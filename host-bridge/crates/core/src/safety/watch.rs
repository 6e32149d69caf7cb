//! What is known of one hand: whether it is there, and since when it is neutral.

use super::NEUTRAL_SAMPLES;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    pub(super) awaited: bool,
    pub(super) connected: bool,
    pub(super) live: bool,
    /// Host time of the newest valid sample, at the earliest.
    pub(super) sample_ms: u64,
    /// Samples taken before this time do not count as neutral: something happened then that resets it.
    pub(super) reset_ms: u64,
    pub(super) neutral: Option<Neutral>,
}

/// Neutral samples in a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neutral {
    /// Host time of the first one, at the latest.
    pub(super) first_ms: u64,
    /// Host time of the newest one, at the earliest.
    pub(super) newest_ms: u64,
    pub(super) samples: u32,
}

impl Neutral {
    /// Has neutral been held for `long_ms` at `time_ms`, as far as samples show?
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

    /// What was neutral before now must be neutral again.
    pub(super) fn reset(&mut self, now_ms: u64) {
        self.reset_ms = now_ms;
        self.neutral = None;
    }

    pub(super) fn refresh(&mut self, age_ms: u64, neutral: bool, now_ms: u64) {
        let sample_ms = now_ms.saturating_sub(age_ms);
        self.live = true;
        // Ages jitter, but the time of a hand's samples never runs back.
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
