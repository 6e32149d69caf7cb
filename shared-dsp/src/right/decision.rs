//! Converts the scores of each hop to one event per performed gesture.
//!
//! ```text
//!            enough of the last hops agree, with confidence
//!   armed ────────────────────────────────────────────────▶ event, then spent
//!     ▲                                                        │
//!     └──────────── some hops in a row at rest ────────────────┘
//! ```
//! The labels `idle` and `other` are rest and never cause an event.
//! If a model has no such labels, it rests while its best score is below the required confidence.

use shared_words::is_rest;

/// Maximum number of hops on which a decision is based.
pub const MAX_HOPS: usize = 16;

/// Criteria for a performed gesture. A probability p is given as 256·p.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecisionConfig {
    /// This many of the last `of` hops, including the newest one, must have the same gesture.
    pub agree: u8,
    /// Number of most recent hops on which a decision is based, at most [`MAX_HOPS`].
    pub of: u8,
    /// Minimum mean probability of the hops that agree.
    pub min_confidence: u8,
    /// Number of consecutive hops at rest that are required between two events.
    pub rest_hops: u8,
}

impl Default for DecisionConfig {
    /// Requires 4 of 5 hops (the newest 0.4 s), a mean probability of 0.7, and 3 hops (0.24 s) of rest.
    fn default() -> Self {
        Self { agree: 4, of: 5, min_confidence: 179, rest_hops: 3 }
    }
}

impl DecisionConfig {
    /// Limits the values to their valid ranges.
    fn sound(self) -> Self {
        let of = self.of.clamp(1, MAX_HOPS as u8);
        Self { agree: self.agree.clamp(1, of), of, rest_hops: self.rest_hops.max(1), ..self }
    }
}

/// A performed gesture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GestureEvent {
    /// Index of the gesture in the model's labels.
    pub label: u8,
    /// Mean probability of the hops that agree, 0 to 255.
    pub confidence: u8,
}

/// The label and the score of one hop.
#[derive(Clone, Copy, Debug)]
struct Vote {
    label: u8,
    probability: u8,
}

/// Detects gestures in the scores of one hand.
#[derive(Clone, Debug)]
pub struct GestureDecision {
    config: DecisionConfig,
    /// Bit i is set if label i is rest.
    rest_labels: u16,
    /// The last hops; the newest is first. The first `known` entries are valid.
    hops: [Vote; MAX_HOPS],
    known: u8,
    armed: bool,
    resting: u8,
}

impl GestureDecision {
    /// Creates a decision for a model with these labels. Values of `config` outside their range are limited.
    pub fn new<'a>(labels: impl Iterator<Item = &'a str>, config: DecisionConfig) -> Self {
        let rest_labels = labels
            .take(16)
            .enumerate()
            .filter(|(_, label)| is_rest(label))
            .fold(0, |bits, (index, _)| bits | (1 << index));
        Self {
            config: config.sound(),
            rest_labels,
            hops: [Vote { label: 0, probability: 0 }; MAX_HOPS],
            known: 0,
            armed: true,
            resting: 0,
        }
    }

    /// Adds the int8 scores of a hop, one per label: (score + 128) / 256 is the probability.
    /// If scores are equal, the first label wins. Empty scores are ignored.
    pub fn step(&mut self, scores: &[i8]) -> Option<GestureEvent> {
        let (label, &best) = scores.iter().enumerate().rev().max_by_key(|(_, score)| **score)?;
        let newest = Vote { label: label as u8, probability: (i16::from(best) + 128) as u8 };
        self.hops.copy_within(0..MAX_HOPS - 1, 1);
        self.hops[0] = newest;
        self.known = (self.known + 1).min(self.config.of);

        let at_rest = if self.rest_labels == 0 {
            newest.probability < self.config.min_confidence
        } else {
            self.is_rest_label(newest.label)
        };
        self.resting = if at_rest { self.resting.saturating_add(1) } else { 0 };
        if self.resting >= self.config.rest_hops {
            self.armed = true;
        }
        if at_rest || !self.armed {
            return None;
        }

        let agreeing = self.hops.iter().take(self.known.into()).filter(|hop| hop.label == newest.label);
        let (count, sum) =
            agreeing.fold((0u8, 0u16), |(n, sum), hop| (n + 1, sum + u16::from(hop.probability)));
        let confidence = (sum / u16::from(count.max(1))) as u8;
        if count < self.config.agree || confidence < self.config.min_confidence {
            return None;
        }
        self.armed = false;
        self.known = 0;
        Some(GestureEvent { label: newest.label, confidence })
    }

    /// Forgets the last hops after a gap. The next event still requires rest.
    pub fn reset(&mut self) {
        self.known = 0;
        self.resting = 0;
    }

    /// Returns whether the label with this index means that the hand rests.
    pub fn is_rest_label(&self, label: u8) -> bool {
        label < 16 && self.rest_labels & (1 << label) != 0
    }

    /// Returns whether the next gesture can cause an event.
    pub fn is_armed(&self) -> bool {
        self.armed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const LABELS: [&str; 4] = ["idle", "circle", "other", "up-down"];

    fn decision(config: DecisionConfig) -> GestureDecision {
        GestureDecision::new(LABELS.iter().copied(), config)
    }

    fn hop(label: usize, probability: i16) -> [i8; 4] {
        let mut scores = [-128; 4];
        scores[label] = (probability - 128) as i8;
        scores
    }

    /// Returns the indices of the hops that caused an event, each with the event's label.
    fn run(decision: &mut GestureDecision, labels: &[usize]) -> Vec<(usize, u8)> {
        let step = |(index, &label): (usize, &usize)| {
            decision.step(&hop(label, 250)).map(|event| (index, event.label))
        };
        labels.iter().enumerate().filter_map(step).collect()
    }

    #[test]
    fn a_gesture_makes_one_event_as_soon_as_enough_hops_agree() {
        let mut decision = decision(DecisionConfig::default());
        assert_eq!(run(&mut decision, &[0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]), [(5, 1)]);
    }

    #[test]
    fn one_dissenting_hop_is_forgiven_and_two_are_not() {
        assert_eq!(run(&mut decision(DecisionConfig::default()), &[0, 1, 1, 3, 1, 1]), [(5, 1)]);
        assert_eq!(run(&mut decision(DecisionConfig::default()), &[0, 1, 3, 1, 3, 1, 3, 1, 1]), []);
    }

    #[test]
    fn idle_and_other_never_make_an_event_and_both_end_a_gesture() {
        assert_eq!(run(&mut decision(DecisionConfig::default()), &[0; 50]), []);
        assert_eq!(run(&mut decision(DecisionConfig::default()), &[2; 50]), []);
        for rest in [0, 2] {
            let labels = [1, 1, 1, 1, 1, rest, rest, rest, 1, 1, 1, 1];
            assert_eq!(run(&mut decision(DecisionConfig::default()), &labels), [(3, 1), (11, 1)]);
        }
        let too_short = [1, 1, 1, 1, 1, 0, 2, 1, 1, 1, 1, 3, 3, 3, 3, 3, 3];
        assert_eq!(run(&mut decision(DecisionConfig::default()), &too_short), [(3, 1)]);
    }

    #[test]
    fn doubtful_hops_make_no_event() {
        let mut decision = decision(DecisionConfig::default());
        for _ in 0..50 {
            assert_eq!(decision.step(&hop(1, 178)), None);
        }
        let event = (0..5).find_map(|_| decision.step(&hop(1, 255))).unwrap();
        assert_eq!(event.label, 1);
        assert!(event.confidence >= 179);
    }

    #[test]
    fn after_a_gap_agreement_starts_anew_and_a_spent_gesture_stays_spent() {
        let mut decision = decision(DecisionConfig::default());
        assert_eq!(run(&mut decision, &[1, 1, 1]), []);
        decision.reset();
        assert_eq!(run(&mut decision, &[1, 1, 1, 1]), [(3, 1)]);
        decision.reset();
        assert_eq!(run(&mut decision, &[1; 30]), []);
        assert!(!decision.is_armed());
    }

    #[test]
    fn a_model_without_rest_rests_while_it_is_unsure() {
        let mut decision = GestureDecision::new(["a", "b"].into_iter(), DecisionConfig::default());
        let sure = [100, -100];
        let unsure = [0, -1];
        let mut events = Vec::new();
        for scores in [[sure; 6], [unsure; 6], [sure; 6]].as_flattened() {
            events.extend(decision.step(scores));
        }
        assert_eq!(events.len(), 2);
    }

    #[test]
    fn senseless_settings_are_limited() {
        let mut decision = decision(DecisionConfig { agree: 200, of: 0, min_confidence: 0, rest_hops: 0 });
        assert_eq!(run(&mut decision, &[1, 1, 0, 3]), [(0, 1), (3, 3)]);
        assert_eq!(decision.step(&[]), None);
    }

    proptest! {
        #[test]
        fn no_events_from_rest_and_never_two_without_rest_between(
            config in (any::<u8>(), any::<u8>(), any::<u8>(), any::<u8>()),
            hops in prop::collection::vec((any::<[i8; 4]>(), prop::bool::weighted(0.02)), 0..400),
        ) {
            let config = DecisionConfig {
                agree: config.0 % 8, of: config.1 % 20, min_confidence: config.2, rest_hops: config.3 % 6,
            };
            let mut decision = decision(config);
            // Finds the longest run of hops at rest since the last event.
            let (mut run, mut longest, mut first) = (0, 0, true);
            for (scores, gap) in hops {
                if gap {
                    decision.reset();
                    run = 0;
                }
                let best = *scores.iter().max().unwrap();
                let winner = scores.iter().position(|&score| score == best).unwrap();
                let rest = winner == 0 || winner == 2;
                run = if rest { run + 1 } else { 0 };
                longest = longest.max(run);
                if let Some(event) = decision.step(&scores) {
                    prop_assert!(!rest);
                    prop_assert_eq!(usize::from(event.label), winner);
                    prop_assert!(event.confidence >= config.min_confidence);
                    prop_assert!(first || longest >= i32::from(config.rest_hops.max(1)));
                    (longest, first) = (0, false);
                }
            }
        }
    }
}
