//! Detects gestures that were nearly recognised, for the light.
//! The laptop applies the same rule to the scores that it receives, and names the gesture.

use shared_dsp::right::network::MAX_LABELS;
use shared_words::is_rest;

/// Number of hops for averaging scores.
const AVERAGE_HOPS: usize = 4;
/// Minimum sum of a gesture's probabilities (of 256) over these hops: a mean of 0.4. An event requires a mean of one half.
const NEARLY: u16 = 410;
/// A rise ends when no gesture is above this sum, which is a mean of 0.25. Then the next rise may begin.
const OVER: u16 = 256;

/// Watches the scores of a right board.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Almost {
    /// Bit i is set if label i is a gesture.
    gestures: u16,
    /// Ring buffer of the last probabilities.
    rows: [[u8; MAX_LABELS]; AVERAGE_HOPS],
    next: usize,
    rise: Rise,
}

#[derive(Clone, Copy, Debug)]
enum Rise {
    /// No gesture is near.
    None,
    /// The largest sum so far.
    Nearest(u16),
    /// The board has detected the gesture, or the light has shown it.
    Told,
}

impl Almost {
    /// Creates the state for a model with these labels, which are separated by commas.
    pub fn new(labels: &str) -> Self {
        let labels = labels.split(',').take(MAX_LABELS).enumerate();
        let gestures = labels.filter(|(_, label)| !is_rest(label)).fold(0, |bits, (n, _)| bits | (1 << n));
        Self { gestures, rows: [[0; MAX_LABELS]; AVERAGE_HOPS], next: 0, rise: Rise::None }
    }

    /// Adds the scores of a hop, and whether the board detected a gesture in it.
    /// Returns true once if a gesture was nearly recognised.
    pub fn see(&mut self, scores: &[i8], is_gesture: bool) -> bool {
        if let Some(row) = self.rows.get_mut(self.next) {
            *row = [0; MAX_LABELS];
            row.iter_mut().zip(scores).for_each(|(place, score)| *place = (i16::from(*score) + 128) as u8);
        }
        self.next = (self.next + 1) % AVERAGE_HOPS;
        let near = self.nearest();
        let (rise, told) = match self.rise {
            _ if is_gesture => (Rise::Told, false),
            Rise::Nearest(_) if near < OVER => (Rise::None, true),
            _ if near < OVER => (Rise::None, false),
            Rise::Nearest(best) if near > best => (Rise::Nearest(near), false),
            // The scores fall, so the movement has ended. The board would have reported the gesture by now.
            Rise::Nearest(best) if near < best / 2 => (Rise::Told, true),
            Rise::None if near >= NEARLY => (Rise::Nearest(near), false),
            rise => (rise, false),
        };
        self.rise = rise;
        told
    }

    /// Forgets the scores after a gap.
    pub fn reset(&mut self) {
        self.rows = [[0; MAX_LABELS]; AVERAGE_HOPS];
        self.rise = Rise::None;
    }

    /// Returns the largest sum of a gesture's probabilities.
    fn nearest(&self) -> u16 {
        let sum = |label: usize| self.rows.iter().map(|row| u16::from(row[label])).sum();
        (0..MAX_LABELS).filter(|label| self.gestures & (1 << label) != 0).map(sum).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Returns the hops with a report, for these probabilities (of 256) of the only gesture.
    /// If `fires` is given, the board detects a gesture in that hop.
    fn told(circle: &[i16], fires: Option<usize>) -> Vec<usize> {
        let mut almost = Almost::new("idle,circle,other");
        let hops = circle.iter().enumerate();
        let see = |(hop, p): (usize, &i16)| {
            let scores = [127 - *p, *p - 128, -128].map(|score| score.clamp(-128, 127) as i8);
            almost.see(&scores, fires == Some(hop)).then_some(hop)
        };
        hops.filter_map(see).collect()
    }

    #[test]
    fn scores_that_rise_and_fall_without_an_event_are_told_once() {
        // The mean of 160, 0, 0, 0 is below a quarter, and that of 160, 160, 0, 0 is not below half of 160.
        assert_eq!(told(&[[0; 6], [160; 6], [0; 6]].concat(), None), [14]);
        // A gesture at 0.35 is far, and so is a rest at any probability.
        assert_eq!(told(&[[0; 20], [90; 20], [0; 20]].concat(), None), []);
    }

    #[test]
    fn a_gesture_that_the_board_saw_is_not_almost_one() {
        assert_eq!(told(&[[0; 6], [230; 6], [128; 6], [0; 6]].concat(), Some(14)), []);
    }

    #[test]
    fn each_attempt_is_told_of_after_the_scores_have_come_down() {
        let attempt = [[0; 8], [140; 8], [0; 8]].concat();
        assert_eq!(told(&[attempt.clone(), attempt].concat(), None).len(), 2);
        let trembling = [[140; 6], [77; 6], [140; 6], [77; 6], [0; 6]].concat();
        assert_eq!(told(&trembling, None).len(), 1);
    }

    #[test]
    fn after_a_gap_the_scores_before_it_do_not_count() {
        let mut almost = Almost::new("idle,circle");
        for _ in 0..6 {
            assert!(!almost.see(&[-90, 32], false));
        }
        almost.reset();
        for _ in 0..6 {
            assert!(!almost.see(&[127, -128], false));
        }
    }
}
