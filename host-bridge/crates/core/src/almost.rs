//! Detects gestures that were nearly recognised, so that wearers can learn how to draw them.
//!
//! The board decides, and sends its scores with every hop.
//! If the score of a gesture rises and falls without an event,
//! this module reports the gesture and its best score.
//! The report has no other effect.

use std::collections::VecDeque;

use crate::intent::is_rest;

/// Number of hops for averaging scores, as on boards with six or more axes.
const AVERAGE_HOPS: usize = 4;
/// Minimum mean probability for a report. The board itself requires a mean of one half.
const NEARLY: f32 = 0.4;
/// A rise ends when no gesture is above this value. Then the next rise may begin.
const OVER: f32 = 0.25;

/// Watches the right hand's scores.
#[derive(Clone, Debug, Default)]
pub(crate) struct Almost {
    last: VecDeque<Vec<f32>>,
    rise: Rise,
}

#[derive(Clone, Copy, Debug, Default)]
enum Rise {
    /// No gesture is near.
    #[default]
    None,
    /// The best gesture so far: label and mean probability.
    Nearest(usize, f32),
    /// The gesture has been reported, by the board or by this module.
    Told,
}

impl Almost {
    /// Adds the scores of a hop, one per label, and whether the board detected a gesture in it.
    /// Returns the label and its best mean probability once, if a gesture was nearly recognised.
    pub(crate) fn see(
        &mut self,
        labels: &[String],
        scores: &[f32],
        is_gesture: bool,
    ) -> Option<(usize, f32)> {
        if scores.is_empty() || scores.len() != labels.len() {
            *self = Self::default();
            return None;
        }
        if self.last.front().is_some_and(|row| row.len() != scores.len()) {
            *self = Self::default();
        }
        self.last.push_back(scores.to_vec());
        if self.last.len() > AVERAGE_HOPS {
            self.last.pop_front();
        }
        let (label, mean) = self.nearest(labels)?;
        self.rise = match self.rise {
            _ if is_gesture => Rise::Told,
            _ if mean < OVER => match std::mem::take(&mut self.rise) {
                Rise::Nearest(label, best) => return Some((label, best)),
                Rise::None | Rise::Told => Rise::None,
            },
            Rise::Nearest(_, best) if mean > best => Rise::Nearest(label, mean),
            // The scores fall, so the movement has ended. The board would have reported the gesture by now.
            Rise::Nearest(label, best) if mean < best / 2.0 => {
                self.rise = Rise::Told;
                return Some((label, best));
            }
            Rise::None if mean >= NEARLY => Rise::Nearest(label, mean),
            rise => rise,
        };
        None
    }

    /// Returns the gesture that is near now and its best probability, if this rise has not been reported yet.
    pub(crate) fn near(&self) -> Option<(usize, f32)> {
        match self.rise {
            Rise::Nearest(label, best) => Some((label, best)),
            Rise::None | Rise::Told => None,
        }
    }

    /// Returns the gesture with the largest mean probability.
    fn nearest(&self, labels: &[String]) -> Option<(usize, f32)> {
        let mean =
            |label: usize| self.last.iter().map(|row| row[label]).sum::<f32>() / self.last.len() as f32;
        let gestures = (0..labels.len()).filter(|label| !is_rest(&labels[*label]));
        gestures.map(|label| (label, mean(label))).max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Vec<String> {
        ["idle", "circle", "wave", "other"].map(str::to_owned).to_vec()
    }

    /// Returns the reports for these probabilities of `circle`.
    /// If `fires` is given, the board detects a gesture in that hop.
    fn told(circle: &[f32], fires: Option<usize>) -> Vec<(usize, f32)> {
        let mut almost = Almost::default();
        let hops = circle.iter().enumerate();
        hops.filter_map(|(hop, p)| almost.see(&labels(), &[1.0 - p, *p, 0.0, 0.0], fires == Some(hop)))
            .collect()
    }

    #[test]
    fn scores_that_rise_and_fall_without_an_event_are_told_once_with_their_best() {
        let rise = [[0.0; 6], [0.6; 6], [0.45; 6], [0.0; 6]].concat();
        let told = told(&rise, None);
        assert_eq!(told.len(), 1, "{told:?}");
        assert_eq!(told[0].0, 1);
        assert!((told[0].1 - 0.6).abs() < 1e-6, "{told:?}");
    }

    #[test]
    fn a_gesture_that_the_board_saw_is_not_almost_one() {
        let rise = [[0.0; 6], [0.9; 6], [0.5; 6], [0.0; 6]].concat();
        assert_eq!(told(&rise, Some(14)), []);
    }

    #[test]
    fn a_gesture_is_near_from_its_rise_until_it_was_told_of() {
        let mut almost = Almost::default();
        let circle = [[0.0; 6], [0.6; 6], [0.0; 6]].concat();
        let near: Vec<Option<f32>> = circle
            .iter()
            .map(|p| {
                almost.see(&labels(), &[1.0 - p, *p, 0.0, 0.0], false);
                almost.near().map(|(_, best)| best)
            })
            .collect();
        // The mean of four hops exceeds 0.4 at the third hop with 0.6.
        assert_eq!(near.iter().position(Option::is_some), Some(8), "{near:?}");
        assert!((near[11].unwrap() - 0.6).abs() < 1e-6, "{near:?}");
        assert_eq!(near.last(), Some(&None));
    }

    #[test]
    fn a_hand_at_rest_or_far_from_any_gesture_is_left_alone() {
        assert_eq!(told(&[[0.0; 20], [0.35; 20], [0.0; 20]].concat(), None), []);
    }

    #[test]
    fn each_attempt_is_told_of_after_the_scores_have_come_down() {
        let attempt = [[0.0; 8], [0.55; 8], [0.0; 8]].concat();
        assert_eq!(told(&[attempt.clone(), attempt].concat(), None).len(), 2);
        // Rising and falling between two levels counts as one attempt.
        let trembling = [[0.55; 6], [0.3; 6], [0.55; 6], [0.3; 6], [0.0; 6]].concat();
        assert_eq!(told(&trembling, None).len(), 1);
    }

    #[test]
    fn scores_of_another_model_begin_anew() {
        let mut almost = Almost::default();
        (0..6).for_each(|_| assert_eq!(almost.see(&labels(), &[0.4, 0.6, 0.0, 0.0], false), None));
        let fewer = labels()[..2].to_vec();
        (0..6).for_each(|_| assert_eq!(almost.see(&fewer, &[1.0, 0.0], false), None));
        assert_eq!(almost.see(&fewer, &[], false), None);
    }
}
