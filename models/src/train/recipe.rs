//! The trait `Recipe`, which describes a method for training a model from recordings.

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

/// The features (or inputs) of a window, and the window's label.
pub type Row<'a> = (&'a [f32], usize);

/// Features of windows that several trainings use.
pub type Shared = Arc<Vec<Vec<f32>>>;

/// A method for training a model. It selects and varies windows, trains a network, and converts it to int8.
/// [`train`](super::train) calls these functions in order.
pub trait Recipe: fmt::Debug + Send + Sync {
    /// The recipe's name on the command line and in cards.
    fn name(&self) -> &'static str;

    /// A description of the recipe in one sentence, for users.
    fn about(&self) -> &'static str;

    /// The features that models of this recipe read.
    fn features(&self) -> FeatureKind;

    /// The description of the training for the card.
    fn plan(&self) -> Plan;

    /// The labels of the model in order, given the labels of the recordings.
    fn labels(&self, of_recordings: Vec<String>) -> Vec<String> {
        of_recordings
    }

    /// Returns the windows of a recording and of its varied copies.
    /// `place` is the index of the recording in its data set. Together with the seed, it determines the random values.
    fn windows(&self, item: &Item, label: usize, place: usize, seed: u64) -> Windows;

    /// Returns additional training windows for this number of axes and these labels.
    fn beside(&self, axes: usize, labels: &[String]) -> Beside;

    /// Returns the conversion of features to inputs. `real` contains the windows of the unvaried recordings.
    fn scaling(&self, learnt: &[Row<'_>], real: &mut dyn Iterator<Item = &[f32]>) -> Scaling;

    /// Fits a network.
    ///
    /// # Errors
    /// Fails if the training library fails.
    fn fit(&self, learnt: &Learnt<'_>, seed: u64, progress: &ProgressBar) -> Result<Fitted, TrainError>;

    /// Selects the inputs that determine the scales of int8.
    fn calibration(&self) -> Calibration;

    /// Returns the daily movement for adaptation, if the recipe's models can be adapted.
    /// In this case, a [`Memory`](super::Memory) of the training people is stored.
    fn adapts(&self) -> Option<&Daily> {
        None
    }

    /// Returns the recipe with this number of steps (if it has steps), for quick experiments.
    fn shortened(&self, steps: Option<usize>) -> Box<dyn Recipe>;

    /// Returns the recipe for simulated wearers only. Their `idle` recordings already contain movement without gestures.
    fn for_simulated(&self) -> Box<dyn Recipe>;
}

/// A card's description of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Windows per step.
    pub batch: usize,
    /// Learning rate at the start, or its maximum.
    pub learning_rate: f64,
    /// Fraction of the recordings that determine when training stops.
    pub validation_fraction: f64,
    /// Maximum number of epochs, for the progress bar; 0 if the recipe has no epochs.
    pub epochs: usize,
}

/// The windows of one recording that are used for training.
#[derive(Clone, Debug)]
pub struct Windows {
    /// Place of its label.
    pub label: usize,
    /// Features of the unvaried recording.
    pub own: Vec<Vec<f32>>,
    /// Features of varied copies of the recording.
    pub varied: Vec<Vec<f32>>,
    /// The recording as it was prepared for training.
    pub prepared: Prepared,
}

/// Additional training windows, each with the index of its label.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Windows that are also stored in the memory for adaptation.
    pub of_people: Vec<(Shared, usize)>,
    /// Windows that are not stored in the memory.
    pub of_nobody: Vec<(Shared, usize)>,
    /// A description of these windows and of the variation, for the card.
    pub words: String,
}

/// The windows with which a network is trained.
#[derive(Clone, Copy, Debug)]
pub struct Learnt<'a> {
    /// Inputs, each with the index of its label.
    pub rows: &'a [(Vec<f32>, usize)],
    /// Inputs of recordings that determine when training stops; the list may be empty.
    pub check: &'a [(Vec<f32>, usize)],
    /// Number of inputs that come from the recordings, including varied copies.
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
    /// The epoch whose weights the network kept.
    pub best_epoch: usize,
}

/// The inputs that determine the scales of int8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calibration {
    /// All inputs that were used in training.
    Learnt,
    /// Inputs that come from the unvaried recordings.
    Real,
}

/// Computes the mean and the divisor of each feature over the training windows.
/// Also computes a limit, within `limits`, that 99.9 % of the inputs in `real` do not exceed.
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
