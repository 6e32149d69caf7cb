//! What a recipe is: one method of making a model from recordings.

use std::fmt;
use std::ops::RangeInclusive;
use std::sync::Arc;

use indicatif::ProgressBar;
use shared_dsp::right::kind::FeatureKind;

use super::TrainError;
use crate::card::Scaling;
use crate::daily::Daily;
use crate::dataset::Item;
use crate::tflite::FloatLayer;
use crate::windows::Prepared;

/// A window's features or inputs, and its label.
pub type Row<'a> = (&'a [f32], usize);

/// Features of windows that several trainings use.
pub type Shared = Arc<Vec<Vec<f32>>>;

/// One way to make a model: which windows are learnt and how they are varied, how a network is fitted to them, and what its
/// int8 is made by. [`train`](super::train) calls these in their order.
pub trait Recipe: fmt::Debug + Send + Sync {
    /// On the command line and in cards.
    fn name(&self) -> &'static str;

    /// A description in one sentence, for those who choose.
    fn about(&self) -> &'static str;

    /// Which features models of it read.
    fn features(&self) -> FeatureKind;

    /// The card's description of the training.
    fn plan(&self) -> Plan;

    /// Labels of the model, in order, where the recordings have these.
    fn labels(&self, of_recordings: Vec<String>) -> Vec<String> {
        of_recordings
    }

    /// The windows of a recording and of its varied copies. `place` is that of the recording in its data set: what is random
    /// follows from it and the seed.
    fn windows(&self, item: &Item, label: usize, place: usize, seed: u64) -> Windows;

    /// What is learnt besides the recordings, for samples of this many axes and a model of these labels.
    fn beside(&self, axes: usize, labels: &[String]) -> Beside;

    /// How features become inputs of the network. `real` are the windows of the recordings as they are.
    fn scaling(&self, learnt: &[Row<'_>], real: &mut dyn Iterator<Item = &[f32]>) -> Scaling;

    /// Fits a network.
    ///
    /// # Errors
    /// If the library that does it fails.
    fn fit(&self, learnt: &Learnt<'_>, seed: u64, progress: &ProgressBar) -> Result<Fitted, TrainError>;

    /// Which inputs decide the scales of int8.
    fn calibration(&self) -> Calibration;

    /// If models of it can learn another person, whose daily movement stays no gesture then: a
    /// [`Memory`](super::Memory) of its people is kept.
    fn adapts(&self) -> Option<&Daily> {
        None
    }

    /// The same in this many steps, if it has steps: to try things out.
    fn shortened(&self, steps: Option<usize>) -> Box<dyn Recipe>;

    /// The same for recordings of simulated wearers alone, which contain movement without a gesture themselves, as `idle`.
    fn for_simulated(&self) -> Box<dyn Recipe>;
}

/// A card's description of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Windows per step.
    pub batch: usize,
    /// Learning rate at the start, or the largest.
    pub learning_rate: f64,
    /// Share of the recordings that decide when to stop.
    pub validation_fraction: f64,
    /// Maximum number of epochs, for the progress bar; 0 if there are none.
    pub epochs: usize,
}

/// The windows of one recording, ready to learn from.
#[derive(Clone, Debug)]
pub struct Windows {
    /// Place of its label.
    pub label: usize,
    /// Features of the recording as it is.
    pub own: Vec<Vec<f32>>,
    /// Features of its varied copies.
    pub varied: Vec<Vec<f32>>,
    /// How it was prepared.
    pub prepared: Prepared,
}

/// What is learnt beside the recordings: windows with the place of their label.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// A model that can be adapted remembers these, as it does the recordings.
    pub of_people: Vec<(Shared, usize)>,
    /// Windows that it does not remember.
    pub of_nobody: Vec<(Shared, usize)>,
    /// A description of all this and of the recordings' variation, for the card.
    pub words: String,
}

/// The windows that a network is fitted to.
#[derive(Clone, Copy, Debug)]
pub struct Learnt<'a> {
    /// Inputs with the place of their label.
    pub rows: &'a [(Vec<f32>, usize)],
    /// Inputs of recordings that decide when to stop; may be empty.
    pub check: &'a [(Vec<f32>, usize)],
    /// How many of them are of the recordings, varied copies included.
    pub of_recordings: usize,
    /// Number of labels.
    pub labels: usize,
    /// The largest input.
    pub limit: f32,
}

/// A fitted network.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its layers.
    pub layers: Vec<FloatLayer>,
    /// Epochs run.
    pub epochs: usize,
    /// The one whose weights were kept.
    pub best_epoch: usize,
}

/// Inputs that decide the scales of int8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calibration {
    /// All inputs that were learnt.
    Learnt,
    /// Inputs of the recordings as they are.
    Real,
}

/// Mean and divisor per feature over the training windows, and a limit, within `limits`, that 999 of 1000 inputs of
/// the windows `real` keep.
pub fn scaling(
    learn: &[Row<'_>],
    divisor: impl Fn(f64, f64) -> f64,
    real: &mut dyn Iterator<Item = &[f32]>,
    limits: RangeInclusive<f32>,
) -> Scaling {
    let inputs = learn.first().map_or(0, |(window, _)| window.len());
    let count = learn.len().max(1) as f64;
    let (mut mean, mut deviation) = (Vec::new(), Vec::new());
    for feature in 0..inputs {
        let values = || learn.iter().map(|(window, _)| f64::from(window[feature]));
        let centre = values().sum::<f64>() / count;
        let variance = values().map(|v| (v - centre).powi(2)).sum::<f64>() / count;
        mean.push(centre as f32);
        deviation.push(divisor(centre, variance.sqrt()) as f32);
    }
    let mut sizes = Vec::new();
    for window in real {
        sizes.extend(window.iter().enumerate().map(|(n, v)| ((v - mean[n]) / deviation[n]).abs()));
    }
    let at = (sizes.len() as f64 * 0.999) as usize;
    let limit = match sizes.len() {
        0 => 4.0,
        count => {
            let at = at.min(count - 1);
            sizes.select_nth_unstable_by(at, f32::total_cmp).1.clamp(*limits.start(), *limits.end())
        }
    };
    Scaling { mean, deviation, limit }
}
