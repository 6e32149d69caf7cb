//! From scores and movement, one set per hop, to one event per movement of the hand.
//!
//! ```text
//!          the hand moves            long enough, and it is over or 1.8 s old,
//!                                    and the mean of the last scores is sure of a gesture
//!   still ───────────────▶ moving ────────────────────────────────────────────▶ event, then spent
//!     ▲                      │                                                      │
//!     └──────────────────────┴───────────── some hops without movement ─────────────┘
//! ```
//! A gesture shows soon. A movement that has made no event for a while is something else, and makes one only if it
//! becomes, surely and for two seconds, a gesture; so does one that goes on after its event, if it becomes a *different*
//! gesture. The same gesture again needs rest in between. The labels `idle` and `other` never make an event.

use crate::aligned::Movement;
use crate::decision::{Event, is_rest};
use crate::mlp::MAX_LABELS;

/// Most hops that scores are averaged over.
pub const MAX_AVERAGE_HOPS: usize = 8;

/// When a movement counts as a gesture. A probability p is given as 256·p.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovementConfig {
    /// The hand moves when [`Movement::acceleration`] is above this, in m/s² …
    pub acceleration: f32,
    /// … or [`Movement::rotation`] above this, in deg/s.
    pub rotation: f32,
    /// A movement ends after so many hops in a row without movement.
    pub rest_hops: u8,
    /// Least hops from the start of a movement to its event.
    pub min_hops: u8,
    /// Least hops in which the hand did move.
    pub min_moving: u8,
    /// From so many hops on the event does not wait for the movement's end.
    pub decide_hops: u8,
    /// Hops whose scores are averaged, 1 to [`MAX_AVERAGE_HOPS`].
    pub average_hops: u8,
    /// Least mean probability.
    pub min_confidence: u8,
    /// Most mean probability of all rest labels together: which gesture it is may be open longer than that it is one.
    pub max_rest: u8,
    /// A movement without an event after so many hops is a long one.
    pub late_hops: u8,
    /// In a long movement, and after an event, a (different) gesture must be seen for so many hops in a row …
    pub change_hops: u8,
    /// … each with this mean probability.
    pub change_confidence: u8,
}

impl MovementConfig {
    /// The usual values for samples of so many axes: without a gyroscope movement is harder to tell from tremor.
    pub const fn for_axes(axes: usize) -> Self {
        let has_gyro = axes >= 6;
        Self {
            acceleration: 0.7,
            rotation: 30.0,
            rest_hops: if has_gyro { 3 } else { 5 },
            min_hops: 9,
            min_moving: if has_gyro { 8 } else { 22 },
            decide_hops: 22,
            average_hops: if has_gyro { 4 } else { 8 },
            min_confidence: 128,
            max_rest: if has_gyro { 36 } else { 26 },
            late_hops: if has_gyro { 30 } else { 60 },
            change_hops: 25,
            change_confidence: 205,
        }
    }
}

/// A movement under way.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    hops: u8,
    moving: u8,
    /// Label of its last event.
    fired: Option<u8>,
}

/// Watches scores and movement of one hand.
#[derive(Clone, Debug)]
pub struct MovementDecision {
    config: MovementConfig,
    /// Bit i: label i is rest.
    rest_labels: u16,
    /// Probabilities of the last hops, a ring; `known` of them.
    scores: [[u8; MAX_LABELS]; MAX_AVERAGE_HOPS],
    next: usize,
    known: u8,
    run: Option<Run>,
    quiet: u8,
    /// A different gesture after an event, and for how many hops it has been seen.
    change: (u8, u8),
}

impl MovementDecision {
    /// For a model with these labels. A value of `average_hops` outside its range is limited.
    pub fn new<'a>(labels: impl Iterator<Item = &'a str>, config: MovementConfig) -> Self {
        let rest = labels.take(MAX_LABELS).enumerate().filter(|(_, label)| is_rest(label));
        Self {
            config: MovementConfig {
                average_hops: config.average_hops.clamp(1, MAX_AVERAGE_HOPS as u8),
                ..config
            },
            rest_labels: rest.fold(0, |bits, (index, _)| bits | (1 << index)),
            scores: [[0; MAX_LABELS]; MAX_AVERAGE_HOPS],
            next: 0,
            known: 0,
            run: None,
            quiet: 0,
            change: (0, 0),
        }
    }

    /// Takes the int8 scores of a hop, one per label: (score + 128) / 256 is the probability. Of equal means the
    /// first label wins; no scores say nothing.
    pub fn step(&mut self, scores: &[i8], movement: Movement) -> Option<Event> {
        let config = self.config;
        let average = usize::from(config.average_hops);
        self.next = (self.next + 1) % average;
        let row = &mut self.scores[self.next];
        *row = [0; MAX_LABELS];
        for (place, score) in row.iter_mut().zip(scores) {
            *place = (i16::from(*score) + 128) as u8;
        }
        self.known = (self.known + 1).min(config.average_hops);

        let moves = movement.acceleration > config.acceleration || movement.rotation > config.rotation;
        if moves {
            self.quiet = 0;
            let run = self.run.get_or_insert_default();
            run.moving = run.moving.saturating_add(1);
        } else {
            self.quiet = self.quiet.saturating_add(1);
        }
        let mut run = self.run?;
        run.hops = run.hops.saturating_add(1);
        let ended = self.quiet >= config.rest_hops;
        let (label, confidence) = self.best(scores.len().min(MAX_LABELS))?;
        let is_gesture = self.rest_labels & (1 << label) == 0;
        let mut fires = false;
        match run.fired {
            None if run.hops <= config.late_hops => {
                self.change = (0, 0);
                fires = is_gesture
                    && confidence >= config.min_confidence
                    && self.rest(scores.len().min(MAX_LABELS)) <= config.max_rest
                    && run.hops >= config.min_hops
                    && run.moving >= config.min_moving
                    && (ended || run.hops >= config.decide_hops);
            }
            fired if is_gesture && fired != Some(label) && confidence >= config.change_confidence => {
                let (last, count) = self.change;
                self.change = (label, if label == last { count.saturating_add(1) } else { 1 });
                fires = self.change.1 >= config.change_hops;
            }
            _ => self.change = (0, 0),
        }
        if fires {
            run.fired = Some(label);
            self.change = (0, 0);
        }
        self.run = (!ended).then_some(run);
        fires.then_some(Event { label, confidence })
    }

    /// Forgets the last hops, after a gap. A movement that had its event before the gap gets no second one: rest is
    /// still needed.
    pub fn reset(&mut self) {
        self.known = 0;
        self.quiet = 0;
        self.change = (0, 0);
        self.run = self.run.map(|run| Run { fired: run.fired, ..Run::default() });
    }

    /// Whether a movement is under way.
    pub fn is_moving(&self) -> bool {
        self.run.is_some()
    }

    /// The label with the largest mean, and the mean.
    fn best(&self, labels: usize) -> Option<(u8, u8)> {
        let (label, sum) =
            (0..labels).map(|label| (label as u8, self.sum(label))).rev().max_by_key(|(_, sum)| *sum)?;
        Some((label, self.mean(sum)))
    }

    /// Mean probability of all rest labels together.
    fn rest(&self, labels: usize) -> u8 {
        let rest = (0..labels).filter(|label| self.rest_labels & (1 << label) != 0);
        self.mean(rest.map(|label| self.sum(label)).sum())
    }

    /// A label's probabilities of the last hops, added.
    fn sum(&self, label: usize) -> u16 {
        let average = usize::from(self.config.average_hops);
        let hops = (0..usize::from(self.known)).map(|back| (self.next + average - back) % average);
        hops.map(|hop| u16::from(self.scores[hop][label])).sum()
    }

    fn mean(&self, sum: u16) -> u8 {
        (sum / u16::from(self.known.max(1))).min(255) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const LABELS: [&str; 4] = ["idle", "circle", "other", "up-down"];
    const STILL: Movement = Movement { acceleration: 0.2, rotation: 2.0 };
    const MOVING: Movement = Movement { acceleration: 3.0, rotation: 100.0 };

    fn decision() -> MovementDecision {
        MovementDecision::new(LABELS.iter().copied(), MovementConfig::for_axes(9))
    }

    fn scores(label: usize, probability: i16) -> [i8; 4] {
        let mut scores = [-128; 4];
        scores[label] = (probability - 128) as i8;
        scores
    }

    /// Runs pieces of (hops, label, probability, movement); gives the hops that made an event, with its label.
    fn run(decision: &mut MovementDecision, pieces: &[(usize, usize, i16, Movement)]) -> Vec<(usize, u8)> {
        let hops = pieces
            .iter()
            .flat_map(|&(count, label, p, movement)| (0..count).map(move |_| (label, p, movement)));
        let step = |(index, (label, p, movement)): (usize, _)| {
            decision.step(&scores(label, p), movement).map(|event| (index, event.label))
        };
        hops.enumerate().filter_map(step).collect()
    }

    #[test]
    fn a_short_movement_makes_its_event_when_it_ends() {
        let pieces = [(10, 0, 250, STILL), (12, 1, 250, MOVING), (20, 1, 250, STILL)];
        assert_eq!(run(&mut decision(), &pieces), [(24, 1)], "three hops after the last movement");
    }

    #[test]
    fn a_long_movement_makes_one_event_before_its_end_and_no_second() {
        let pieces = [(10, 0, 250, STILL), (300, 1, 250, MOVING), (20, 0, 250, STILL)];
        assert_eq!(run(&mut decision(), &pieces), [(31, 1)], "22 hops");
    }

    #[test]
    fn what_looks_like_a_gesture_late_in_a_movement_must_be_sure_for_two_seconds() {
        // With the 31st hop it is late; the mean passes 205 with the fourth hop of the gesture.
        let pieces = [(31, 2, 250, MOVING), (27, 1, 250, MOVING), (20, 2, 250, MOVING), (9, 1, 250, STILL)];
        assert_eq!(run(&mut decision(), &pieces[..2]), []);
        assert_eq!(
            run(&mut decision(), &[(31, 2, 250, MOVING), (20, 1, 250, MOVING), pieces[2], pieces[3]]),
            []
        );
        assert_eq!(run(&mut decision(), &[(31, 2, 250, MOVING), (60, 1, 250, MOVING)]), [(58, 1)]);
        assert_eq!(
            run(&mut decision(), &[(31, 2, 250, MOVING), (60, 1, 200, MOVING)]),
            [],
            "not sure enough"
        );
    }

    #[test]
    fn sure_scores_without_movement_make_no_event() {
        assert_eq!(run(&mut decision(), &[(1000, 1, 255, STILL)]), []);
    }

    #[test]
    fn a_twitch_makes_no_event() {
        let pieces = [(10, 0, 250, STILL), (7, 1, 250, MOVING), (30, 1, 250, STILL)];
        assert_eq!(run(&mut decision(), &pieces), []);
    }

    #[test]
    fn movement_that_is_idle_other_or_unsure_makes_no_event() {
        for (label, probability) in [(0, 255), (2, 255), (1, 127)] {
            assert_eq!(
                run(&mut decision(), &[(500, label, probability, MOVING)]),
                [],
                "{label} at {probability}"
            );
        }
        assert_eq!(run(&mut decision(), &[(500, 1, 128, MOVING)]), [(21, 1)]);
    }

    #[test]
    fn a_movement_that_may_well_be_none_makes_no_event() {
        let config = MovementConfig { min_confidence: 110, max_rest: 70, ..MovementConfig::for_axes(9) };
        // Probabilities of idle, circle, other and up-down of 256.
        for (shares, event) in [
            ([0, 120, 66, 70], true),
            ([0, 140, 76, 40], false),
            ([40, 140, 40, 36], false),
            ([0, 109, 0, 108], false),
        ] {
            let mut decision = MovementDecision::new(LABELS.iter().copied(), config);
            let scores = shares.map(|share: i16| (share - 128) as i8);
            let fired = (0..60).any(|_| decision.step(&scores, MOVING).is_some());
            assert_eq!(fired, event, "{shares:?}");
        }
    }

    #[test]
    fn a_different_gesture_without_rest_needs_two_sure_seconds() {
        // Four hops until the mean passes 205.
        let pieces = [(40, 1, 250, MOVING), (27, 3, 250, MOVING), (40, 1, 250, MOVING)];
        assert_eq!(run(&mut decision(), &pieces), [(21, 1)]);
        let pieces = [(40, 1, 250, MOVING), (60, 3, 250, MOVING)];
        assert_eq!(run(&mut decision(), &pieces), [(21, 1), (67, 3)]);
    }

    #[test]
    fn the_same_gesture_again_needs_rest() {
        let gesture = (25, 1, 250, MOVING);
        let pause = |hops| (hops, 0, 250, STILL);
        assert_eq!(run(&mut decision(), &[gesture, pause(2), gesture]), [(21, 1)]);
        assert_eq!(run(&mut decision(), &[gesture, pause(3), gesture]), [(21, 1), (49, 1)]);
    }

    #[test]
    fn after_a_gap_a_spent_movement_stays_spent_until_rest() {
        let mut decision = decision();
        assert_eq!(run(&mut decision, &[(30, 1, 250, MOVING)]), [(21, 1)]);
        decision.reset();
        assert_eq!(
            run(&mut decision, &[(60, 1, 250, MOVING), (3, 0, 250, STILL), (30, 1, 250, MOVING)]),
            [(84, 1)]
        );
        decision.reset();
    }

    #[test]
    fn no_scores_and_no_numbers_are_no_gesture() {
        let bad = Movement { acceleration: f32::NAN, rotation: f32::NAN };
        let (mut empty, mut numberless) = (decision(), decision());
        for _ in 0..100 {
            assert_eq!(empty.step(&[], MOVING), None);
            assert_eq!(numberless.step(&scores(1, 255), bad), None);
        }
    }
}
