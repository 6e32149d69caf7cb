//! Calibration without a laptop: a light guides the wearer through all three steps.
//!
//! ```text
//!  Ready (3 s, slow blink: hand level, fingers straight) ─▶ Neutral ─▶ Rest
//!    ─▶ Ready (3 s, fast blink: bend both fingers) ─▶ Bend ─▶ Keep (light on)
//!  a refused step goes back to its Ready; after five refusals ─▶ GiveUp (light off, old values stay)
//! ```

use crate::left::calibration::CaptureStep;

/// Time that the wearer has to take up a pose.
pub const READY_MS: u32 = 3000;
/// Number of refusals after which the calibration ends and the old calibration remains.
pub const REFUSALS: u8 = 5;

/// What the board must do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuidedAction {
    /// Do nothing.
    Wait,
    /// Begin this step, and report to [`Guided::step`] when it has ended.
    Start(CaptureStep),
    /// All three steps are complete, so the result must be stored.
    Keep,
    /// Restore the previous calibration.
    GiveUp,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Ready { next: CaptureStep, since_ms: u32 },
    Capturing(CaptureStep),
    Done,
}

/// The state of the guided calibration.
#[derive(Clone, Copy, Debug)]
pub struct Guided {
    phase: Phase,
    refusals: u8,
}

impl Guided {
    /// Begins the calibration at `now_ms`, on a clock that wraps.
    pub fn new(now_ms: u32) -> Self {
        let phase = Phase::Ready { next: CaptureStep::Neutral, since_ms: now_ms };
        Self { phase, refusals: 0 }
    }

    /// Advances the guide. `ended` is the result of the current step if it has ended (true = accepted).
    #[inline(never)]
    pub fn step(&mut self, ended: Option<bool>, now_ms: u32) -> GuidedAction {
        use CaptureStep::{Bend, Neutral, Rest};
        let start = |step| (Phase::Capturing(step), GuidedAction::Start(step));
        let ready = |next| (Phase::Ready { next, since_ms: now_ms }, GuidedAction::Wait);
        let (phase, action) = match (self.phase, ended) {
            (Phase::Ready { next, since_ms }, _) if now_ms.wrapping_sub(since_ms) >= READY_MS => start(next),
            (Phase::Capturing(step), Some(false)) => {
                self.refusals += 1;
                if self.refusals >= REFUSALS {
                    (Phase::Done, GuidedAction::GiveUp)
                } else {
                    ready(if step == Bend { Bend } else { Neutral })
                }
            }
            (Phase::Capturing(Neutral), Some(true)) => start(Rest),
            (Phase::Capturing(Rest), Some(true)) => ready(Bend),
            (Phase::Capturing(Bend), Some(true)) => (Phase::Done, GuidedAction::Keep),
            (phase, _) => (phase, GuidedAction::Wait),
        };
        self.phase = phase;
        action
    }

    /// Returns whether the light is on. Slow blink: level and straight; fast blink: bend; steady: hold still.
    pub fn light(&self, now_ms: u32) -> bool {
        match self.phase {
            Phase::Ready { next: CaptureStep::Bend, .. } => now_ms & 128 != 0,
            Phase::Ready { .. } => now_ms & 512 != 0,
            Phase::Capturing(_) => true,
            Phase::Done => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use CaptureStep::{Bend, Neutral, Rest};
    use GuidedAction::{GiveUp, Keep, Start, Wait};

    #[test]
    fn the_guide_walks_through_three_steps_and_keeps_them() {
        let start = u32::MAX - 1000;
        let at = |ms: u32| start.wrapping_add(ms);
        let mut guided = Guided::new(start);
        assert_eq!(guided.step(None, at(2990)), Wait);
        assert_eq!(guided.step(None, at(3000)), Start(Neutral));
        assert!(guided.light(at(3000)));
        assert_eq!(guided.step(None, at(3500)), Wait);
        assert_eq!(guided.step(Some(true), at(3640)), Start(Rest));
        assert_eq!(guided.step(Some(true), at(4280)), Wait);
        assert_eq!(guided.step(None, at(7270)), Wait);
        assert_eq!(guided.step(None, at(7280)), Start(Bend));
        assert_eq!(guided.step(Some(true), at(7920)), Keep);
        assert_eq!(guided.step(None, at(8000)), Wait);
        assert!(!guided.light(at(8000)));
    }

    #[test]
    fn a_refused_step_is_tried_again_and_five_refusals_end_it() {
        let mut guided = Guided::new(0);
        let mut now = 0;
        for refusal in 1..=REFUSALS {
            now += READY_MS;
            assert_eq!(guided.step(None, now), Start(Neutral));
            let after = guided.step(Some(false), now);
            assert_eq!(after, if refusal == REFUSALS { GiveUp } else { Wait });
        }
        assert_eq!(guided.step(None, now + 100_000), Wait);
    }
}
