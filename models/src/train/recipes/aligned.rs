//! Recipe `aligned`, for people who are not in the training data.
//!
//! The recipe uses features in the hand's own frame ([`shared_dsp::right::aligned`]).
//! Windows are varied to simulate other hands.
//! The recipe adds simulated wearers and real daily movement to the recordings, and trains for a fixed number of steps.

use std::sync::Arc;

use indicatif::ProgressBar;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::MAX_LABELS;

use crate::card::Scaling;
use crate::daily::{self, Daily};
use crate::dataset::Item;
use crate::labels::OTHER;
use crate::streams::RandomStream;
use crate::train::TrainError;
use crate::train::fit::Steps;
use crate::train::recipe::{Beside, Calibration, Fitted, Learnt, Plan, Recipe, Row, Windows, scaling};
use crate::train::simulated::{aimless, performed};
use crate::train::steps;
use crate::train::vary::{self, Kind, vary};
use crate::windows::{aligned_features, cut, prepare};

/// Number of times that each window of daily movement is learned, beside ten copies of each window of a recording.
const DAILY_WEIGHT: usize = 8;

/// The recipe's settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Aligned {
    /// The training of the networks.
    pub steps: Steps,
    /// Number of varied copies of each window of a recording.
    pub copies: usize,
    /// Number of simulated wearers whose movements are training examples of `other`.
    /// If the recordings do not have the label `other`, it is added, so that the model can reject movements.
    pub bystanders: u32,
    /// Number of [untaught](crate::synth::Wearer::untaught) simulated wearers who make gestures that the simulator knows.
    /// Simulated people supplement the few people of the recordings.
    pub performers: u32,
    /// Real people whose daily movement also provides examples of `other`.
    /// The daily movement is used only together with `bystanders`.
    pub daily: Daily,
    /// Hidden widths of the network that learns the probabilities of the merged one, and which boards run.
    /// `None` keeps the merged network itself.
    pub student: Option<[usize; 2]>,
}

/// The recipe with its default parameters.
pub const ALIGNED: Aligned = Aligned {
    steps: Steps::TRAIN,
    copies: 10,
    bystanders: 100,
    performers: 40,
    daily: Daily::All,
    student: Some(crate::ALIGNED_HIDDEN),
};

impl Aligned {
    /// Limits the number of steps and the number of simulated wearers. `None` changes nothing.
    pub fn with_steps(&self, count: Option<usize>) -> Self {
        let Some(count) = count else { return self.clone() };
        let Self { mut steps, bystanders, performers, .. } = *self;
        let fewer = |wearers: u32| wearers.min((wearers as usize * count).div_ceil(steps.count) as u32);
        let (bystanders, performers) = (fewer(bystanders), fewer(performers));
        (steps.count, steps.most) = (count, count);
        steps.rounded = steps.rounded.min(count);
        Self { steps, bystanders, performers, ..self.clone() }
    }
}

impl Recipe for Aligned {
    fn name(&self) -> &'static str {
        "aligned"
    }

    fn about(&self) -> &'static str {
        "Features in the hand's own frame, for people it has never met"
    }

    fn features(&self) -> FeatureKind {
        FeatureKind::Aligned
    }

    fn plan(&self) -> Plan {
        let Steps { batch, learning_rate, .. } = self.steps;
        Plan { batch, learning_rate, validation_fraction: 0.0, epochs: 0 }
    }

    fn labels(&self, mut of_recordings: Vec<String>) -> Vec<String> {
        let has_place = of_recordings.iter().any(|label| label == OTHER);
        if self.bystanders > 0 && of_recordings.len() < MAX_LABELS && !has_place {
            of_recordings.push(OTHER.to_owned());
            crate::labels::sort(&mut of_recordings);
        }
        of_recordings
    }

    fn windows(&self, item: &Item, label: usize, place: usize, seed: u64) -> Windows {
        let (ready, prepared) = prepare(&item.recording);
        let (axes, kind) = (ready.axes(), Kind::of(&item.label));
        let mut rng = RandomStream::Recording(place).of(seed);
        let (mut own, mut varied) = (Vec::new(), Vec::new());
        for window in cut(&ready) {
            own.push(aligned_features(axes, &window));
            for _ in 0..self.copies {
                varied.push(aligned_features(axes, &vary(&window, axes, kind, &mut rng)));
            }
        }
        Windows { label, own, varied, prepared }
    }

    fn beside(&self, axes: usize, labels: &[String]) -> Beside {
        let mut beside = Beside::default();
        // With the label `idle`, the bystanders would teach the model that slow movement is rest.
        let no_gesture = labels.iter().position(|label| label == OTHER).filter(|_| self.bystanders > 0);
        let (mut bystanders, mut everyday) = (0, 0);
        if let Some(label) = no_gesture {
            let windows = aimless(axes, self.bystanders);
            bystanders = windows.len();
            beside.of_people.push((windows, label));
            // For adaptation, these windows come from the crate and not from the model's memory.
            let daily = Arc::new(self.daily.rows(axes));
            everyday = daily.len();
            beside.of_nobody.extend((0..DAILY_WEIGHT).map(|_| (Arc::clone(&daily), label)));
        }
        let performed = performed(axes, self.performers, labels);
        let shown: usize = performed.iter().map(|(windows, _)| windows.len()).sum();
        beside.of_nobody.extend(performed);
        beside.words = format!(
            "{} copies of each window: {}; {bystanders} windows of {} simulated wearers \
             who make no gesture and {shown} of {} who make those that the simulator knows; {everyday} {}",
            self.copies,
            vary::WORDS,
            self.bystanders,
            self.performers,
            daily::SOURCE
        );
        beside
    }

    fn scaling(&self, learnt: &[Row<'_>], real: &mut dyn Iterator<Item = &[f32]>) -> Scaling {
        // The addition prevents the amplification of noise in features that hardly vary.
        scaling(learnt, |_, deviation| deviation + 0.1, real, 1.0..=20.0)
    }

    fn fit(&self, learnt: &Learnt<'_>, seed: u64, _: &ProgressBar) -> Result<Fitted, TrainError> {
        let Learnt { rows, labels, limit, of_recordings, .. } = *learnt;
        let plan = self.steps.following(of_recordings);
        let member = crate::ALIGNED_MEMBER_HIDDEN;
        let layers = steps::fit(rows, labels, &member, &plan, limit, seed, self.student);
        let epochs = (plan.count * plan.batch).div_ceil(rows.len().max(1));
        Ok(Fitted { layers, epochs, best_epoch: epochs })
    }

    /// Varied windows are more extreme than real windows, so they would waste a part of the int8 range.
    fn calibration(&self) -> Calibration {
        Calibration::Real
    }

    fn adapts(&self) -> Option<&Daily> {
        Some(&self.daily)
    }

    fn shortened(&self, steps: Option<usize>) -> Box<dyn Recipe> {
        Box::new(self.with_steps(steps))
    }

    fn for_simulated(&self) -> Box<dyn Recipe> {
        let copies = self.copies.min(3);
        // The figures of `models simulated` were measured with the minimum number of steps.
        let steps = Steps { most: self.steps.count, ..self.steps };
        Box::new(Self {
            steps,
            copies,
            bystanders: 0,
            performers: 0,
            daily: Daily::None,
            student: self.student,
        })
    }
}
