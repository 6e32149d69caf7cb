//! Converts the scores of each hop and the hand's movement to one event per movement.
//!
//! ```text
//!          the hand moves            long enough, and it is over or 1.8 s old,
//!                                    and the mean of the last scores is sure of a gesture
//!   still ───────────────▶ moving ────────────────────────────────────────────▶ event, then spent
//!     ▲                      │                                                      │
//!     └──────────────────────┴───────────── some hops without movement ─────────────┘
//! ```
//! A gesture is normally recognised early. If a movement has had no event for a while, it is probably something else.
//! Such a movement causes an event only if it becomes a gesture with high confidence for two seconds.
//! The same applies to a movement that continues after its event and becomes a *different* gesture.
//! The same gesture can be repeated only after rest. The labels `idle` and `other` never cause an event.
//!
//! If there are scores of a slow window ([`crate::right::slow`]), they can also cause an event in a long movement.
//! These scores must show a gesture for long enough. A slow left-right, for example, may not fit in the normal window.
//! People who move slowly also pause for longer, so such an event requires twice as much rest.
//! Only the normal window can detect a change to a different gesture.

use crate::right::aligned::Movement;
use crate::right::decision::GestureEvent;
use crate::right::network::MAX_LABELS;
use shared_words::is_rest;

/// Maximum number of hops over which scores are averaged.
pub const MAX_AVERAGE_HOPS: usize = 8;

/// Criteria for a movement to count as a gesture. A probability p is given as 256·p.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovementConfig {
    /// The hand moves if [`Movement::acceleration`] is above this value in m/s², or `rotation` is exceeded.
    pub acceleration: f32,
    /// The hand moves if [`Movement::rotation`] is above this value in deg/s, or `acceleration` is exceeded.
    pub rotation: f32,
    /// A movement ends after this many consecutive hops without movement.
    pub rest_hops: u8,
    /// Minimum number of hops between the start of a movement and its event.
    pub min_hops: u8,
    /// Minimum number of hops in which the hand must have moved.
    pub min_moving: u8,
    /// After this many hops, an event no longer waits for the end of the movement.
    pub decide_hops: u8,
    /// Number of hops over which scores are averaged, 1 to [`MAX_AVERAGE_HOPS`].
    pub average_hops: u8,
    /// Minimum mean probability.
    pub min_confidence: u8,
    /// Maximum mean probability of all rest labels together.
    /// It is often certain that the hand makes a gesture before it is certain which gesture it makes.
    pub max_rest: u8,
    /// A movement is long if it has had no event after this many hops.
    pub late_hops: u8,
    /// In a long movement, a gesture must persist for this number of consecutive hops.
    /// After an event, the same applies to a different gesture.
    pub change_hops: u8,
    /// Minimum mean probability in each of these `change_hops` hops.
    pub change_confidence: u8,
    /// After this number of hops without an event, a movement may be a slow gesture in the slow window.
    pub slow_after_hops: u8,
    /// A slow gesture must persist for this number of consecutive normal hops.
    pub slow_hops: u8,
    /// Minimum mean probability of a slow gesture over the last [`MAX_AVERAGE_HOPS`] hops of the slow window.
    pub slow_confidence: u8,
}

impl MovementConfig {
    /// Default values for this number of axes. Without a gyroscope, tremor is harder to distinguish from movement.
    pub const fn for_axes(axes: usize) -> Self {
        let has_gyro = axes >= 6;
        Self {
            acceleration: 0.7,
            rotation: 30.0,
            rest_hops: if has_gyro { 3 } else { 5 },
            min_hops: 9,
            // With 8 hops, reaching for something would more often count as a gesture. With 14, gestures of one second are lost.
            min_moving: if has_gyro { 12 } else { 22 },
            decide_hops: 22,
            average_hops: if has_gyro { 4 } else { 8 },
            // The README of `models` lists the false events that these values cause.
            // `models events --max-rest` measures the number of false events.
            min_confidence: 128,
            max_rest: if has_gyro { 77 } else { 26 },
            late_hops: if has_gyro { 30 } else { 60 },
            change_hops: 25,
            change_confidence: 205,
            slow_after_hops: 50,
            slow_hops: 40,
            slow_confidence: 150,
        }
    }
}

/// The current movement.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    hops: u8,
    moving: u8,
    /// Label of the last event in this movement.
    fired: Option<u8>,
    /// Whether the event of this movement came from the slow window.
    slow: bool,
}

/// A gesture that persists over consecutive hops.
#[derive(Clone, Copy, Debug, Default)]
struct Streak {
    label: u8,
    hops: u8,
}

impl Streak {
    /// Adds the gesture of one hop. Returns the number of consecutive hops with this gesture.
    fn see(&mut self, seen: Option<GestureEvent>) -> u8 {
        *self = match seen {
            Some(GestureEvent { label, .. }) if label == self.label => {
                Self { label, hops: self.hops.saturating_add(1) }
            }
            Some(GestureEvent { label, .. }) => Self { label, hops: 1 },
            None => Self::default(),
        };
        self.hops
    }
}

/// A ring buffer of the last probabilities.
#[derive(Clone, Debug)]
struct Average {
    rows: [[u8; MAX_LABELS]; MAX_AVERAGE_HOPS],
    next: u8,
    /// Number of valid rows, and the maximum number of rows.
    known: u8,
    most: u8,
}

impl Average {
    fn new(most: u8) -> Self {
        let most = most.clamp(1, MAX_AVERAGE_HOPS as u8);
        Self { rows: [[0; MAX_LABELS]; MAX_AVERAGE_HOPS], next: 0, known: 0, most }
    }

    fn push(&mut self, scores: &[i8]) {
        let row = &mut self.rows[usize::from(self.next)];
        *row = [0; MAX_LABELS];
        for (place, score) in row.iter_mut().zip(scores) {
            *place = (i16::from(*score) + 128) as u8;
        }
        self.next = (self.next + 1) % self.most;
        self.known = (self.known + 1).min(self.most);
    }

    fn clear(&mut self) {
        (self.next, self.known) = (0, 0);
    }

    /// Returns the label with the highest mean, and this mean, or `None` if there are no scores.
    fn best(&self, labels: usize) -> Option<GestureEvent> {
        if self.known == 0 {
            return None;
        }
        // Iterates backwards, because `max` returns the last of equal sums.
        let sums = (0..labels).rev().map(|label| (label as u8, self.sum(label)));
        let (label, sum) = sums.max_by_key(|(_, sum)| *sum)?;
        Some(GestureEvent { label, confidence: self.mean(sum) })
    }

    /// Mean of the summed probabilities of a set of labels (bit i = label i).
    fn together(&self, labels: u16) -> u8 {
        let sums = (0..MAX_LABELS).filter(|label| labels & (1 << label) != 0).map(|label| self.sum(label));
        self.mean(sums.sum())
    }

    /// Sum of a label's probabilities.
    fn sum(&self, label: usize) -> u16 {
        // Until the ring buffer is full, only its first rows are valid.
        self.rows[..usize::from(self.known)].iter().map(|row| u16::from(row[label])).sum()
    }

    fn mean(&self, sum: u16) -> u8 {
        (sum / u16::from(self.known.max(1))).min(255) as u8
    }
}

/// Detects gestures in the scores and movement of one hand.
#[derive(Clone, Debug)]
pub struct MovementDecision {
    config: MovementConfig,
    /// Bit i is set if label i is rest.
    rest_labels: u16,
    scores: Average,
    slow_scores: Average,
    run: Option<Run>,
    quiet: u8,
    /// State of a gesture that begins late in a movement, or that differs from the movement's event.
    change: Streak,
    /// State of a gesture in the slow window.
    slow: Streak,
}

impl MovementDecision {
    /// Creates a decision for a model with these labels. An invalid `average_hops` is limited.
    pub fn new<'a>(labels: impl Iterator<Item = &'a str>, config: MovementConfig) -> Self {
        let rest = labels.take(MAX_LABELS).enumerate().filter(|(_, label)| is_rest(label));
        Self {
            config,
            rest_labels: rest.fold(0, |bits, (index, _)| bits | (1 << index)),
            scores: Average::new(config.average_hops),
            slow_scores: Average::new(MAX_AVERAGE_HOPS as u8),
            run: None,
            quiet: 0,
            change: Streak::default(),
            slow: Streak::default(),
        }
    }

    /// Adds the int8 scores of a hop, one per label, and those of the slow window if they are new.
    /// A probability is (score + 128) / 256. If means are equal, the first label wins. Empty scores are ignored.
    #[inline(never)]
    pub fn step(&mut self, scores: &[i8], slow: Option<&[i8]>, movement: Movement) -> Option<GestureEvent> {
        let config = self.config;
        self.scores.push(scores);
        if let Some(slow) = slow {
            self.slow_scores.push(slow);
        }

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
        let quiet = self.quiet;
        let is_over = |run: Run| quiet >= config.rest_hops.saturating_mul(1 + u8::from(run.slow));
        let ended = is_over(run);

        let labels = scores.len().min(MAX_LABELS);
        let gesture = |scores: &Average, least: u8| {
            let best = scores.best(labels)?;
            (self.rest_labels & (1 << best.label) == 0 && best.confidence >= least).then_some(best)
        };
        let is_new = run.fired.is_none();
        let mut event = None;
        if is_new && run.hops <= config.late_hops {
            self.change = Streak::default();
            if run.hops >= config.min_hops
                && run.moving >= config.min_moving
                && (ended || run.hops >= config.decide_hops)
                && self.scores.together(self.rest_labels) <= config.max_rest
            {
                event = gesture(&self.scores, config.min_confidence);
            }
        } else {
            let seen = gesture(&self.scores, config.change_confidence);
            let seen = seen.filter(|seen| run.fired != Some(seen.label));
            if self.change.see(seen) >= config.change_hops {
                event = seen;
            }
        }
        let mut slow = None;
        if is_new && run.hops > config.slow_after_hops {
            slow = gesture(&self.slow_scores, config.slow_confidence);
        }
        if self.slow.see(slow) >= config.slow_hops && slow.is_some() && event.is_none() {
            event = slow;
            run.slow = true;
        }
        if let Some(event) = event {
            run.fired = Some(event.label);
            self.change = Streak::default();
        }
        self.run = (!is_over(run)).then_some(run);
        if self.run.is_none() {
            self.slow = Streak::default();
        }
        event
    }

    /// Forgets the last hops after a gap.
    /// If the movement had an event before the gap, the next event still requires rest.
    pub fn reset(&mut self) {
        self.scores.clear();
        self.slow_scores.clear();
        self.quiet = 0;
        self.change = Streak::default();
        self.slow = Streak::default();
        self.run = self.run.map(|run| Run { hops: 0, moving: 0, ..run });
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

    /// Plays pieces of (hops, label, probability, movement). Returns the hops that caused an event, with the event's label.
    fn run(decision: &mut MovementDecision, pieces: &[(usize, usize, i16, Movement)]) -> Vec<(usize, u8)> {
        let hops = pieces
            .iter()
            .flat_map(|&(count, label, p, movement)| (0..count).map(move |_| (label, p, movement)));
        let step = |(index, (label, p, movement)): (usize, _)| {
            decision.step(&scores(label, p), None, movement).map(|event| (index, event.label))
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
        // From the 31st hop on, the movement is late. In the fourth hop of the gesture, the mean exceeds 205.
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
        // Probabilities (of 256) of the labels idle, circle, other and up-down.
        for (shares, event) in [
            ([0, 120, 66, 70], true),
            ([0, 140, 76, 40], false),
            ([40, 140, 40, 36], false),
            ([0, 109, 0, 108], false),
        ] {
            let mut decision = MovementDecision::new(LABELS.iter().copied(), config);
            let scores = shares.map(|share: i16| (share - 128) as i8);
            let fired = (0..60).any(|_| decision.step(&scores, None, MOVING).is_some());
            assert_eq!(fired, event, "{shares:?}");
        }
    }

    #[test]
    fn a_different_gesture_without_rest_needs_two_sure_seconds() {
        // The mean exceeds 205 after four hops.
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

    /// Plays pieces of (hops, probability of label 1 in the slow window, movement). The normal window always shows `other`.
    fn run_slow(decision: &mut MovementDecision, pieces: &[(usize, i16, Movement)]) -> Vec<(usize, u8)> {
        let hops = pieces.iter().flat_map(|&(count, p, movement)| (0..count).map(move |_| (p, movement)));
        let step = |(index, (p, movement)): (usize, _)| {
            let slow = scores(1, p);
            // One hop of the slow window takes two normal hops.
            let slow = (index % 2 == 1).then_some(slow.as_slice());
            decision.step(&scores(2, 250), slow, movement).map(|event| (index, event.label))
        };
        hops.enumerate().filter_map(step).collect()
    }

    #[test]
    fn what_only_the_slow_window_sees_makes_an_event_after_seven_seconds() {
        assert_eq!(run_slow(&mut decision(), &[(300, 150, MOVING)]), [(89, 1)], "50 hops and 40");
        assert_eq!(run_slow(&mut decision(), &[(300, 149, MOVING)]), []);
        assert_eq!(run_slow(&mut decision(), &[(86, 250, MOVING), (300, 250, STILL)]), []);
        // In a mean over eight hops, a single uncertain hop has no effect, but a longer uncertainty does.
        let doubt = |hops| [(80, 250, MOVING), (hops, 0, MOVING), (40, 250, MOVING)];
        assert_eq!(run_slow(&mut decision(), &doubt(2)), [(89, 1)]);
        assert_eq!(run_slow(&mut decision(), &doubt(12)), []);
    }

    #[test]
    fn the_slow_window_adds_nothing_to_a_movement_that_had_its_event() {
        let mut decision = decision();
        let slow = scores(3, 250);
        let mut step = |hop: usize| decision.step(&scores(1, 250), Some(&slow), MOVING).map(|_| hop);
        assert_eq!((0..300).filter_map(&mut step).collect::<Vec<_>>(), [21]);
    }

    #[test]
    fn after_a_slow_gesture_it_takes_twice_the_rest_to_begin_anew() {
        let gesture = (100, 250, MOVING);
        let pause = |hops| (hops, 250, STILL);
        assert_eq!(run_slow(&mut decision(), &[gesture, pause(5), gesture]), [(89, 1)]);
        assert_eq!(run_slow(&mut decision(), &[gesture, pause(6), gesture]), [(89, 1), (195, 1)]);
        // The same holds if the event occurs at the end of the movement.
        let gesture = (87, 250, MOVING);
        assert_eq!(run_slow(&mut decision(), &[gesture, pause(5), (100, 250, MOVING)]), [(89, 1)]);
    }

    #[test]
    fn after_a_gap_the_slow_window_counts_anew() {
        let mut decision = decision();
        assert_eq!(run_slow(&mut decision, &[(89, 250, MOVING)]), []);
        decision.reset();
        assert_eq!(run_slow(&mut decision, &[(100, 250, MOVING)]), [(89, 1)]);
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
            assert_eq!(empty.step(&[], None, MOVING), None);
            assert_eq!(numberless.step(&scores(1, 255), None, bad), None);
        }
    }
}
