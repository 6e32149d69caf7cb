//! How long the hands must be neutral before a stop may be released.

use super::{Safety, State};

impl Safety {
    /// Sets that the right hand also sends the left hand's states.
    /// To release a stop, the hand must have rested and been level for a second before it draws.
    pub fn one_handed(&mut self) {
        self.one_handed = true;
    }

    /// Returns whether all connected hands are live.
    /// In addition, the left hand must have been neutral for a second at `time_ms`.
    /// Without a left hand, the right hand must have rested instead.
    pub(super) fn neutral_long_enough_at(&self, time_ms: u64) -> bool {
        let all_live = (self.left.connected || self.right.connected)
            && !self.refused
            && !self.awaits_a_hand()
            && self.connected_hands_live();
        let neutral = if self.left.connected && !self.one_handed {
            self.left.neutral.is_some_and(|neutral| neutral.held(self.times.release_neutral_ms, time_ms))
        } else {
            self.right_rested
        };
        all_live && neutral
    }

    pub(super) fn note_rest_during_stop(&mut self) {
        if self.state == State::Stopped
            && let Some(neutral) = self.right.neutral
            && neutral.held(self.times.release_neutral_ms, self.now_ms)
            && (!self.one_handed || self.left_is_level())
        {
            self.right_rested = true;
        }
    }

    fn left_is_level(&self) -> bool {
        self.left.neutral.is_some_and(|neutral| neutral.held(self.times.release_neutral_ms, self.now_ms))
    }
}
