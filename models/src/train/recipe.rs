//! How a network can be trained.

use super::{Augmentation, Steps};
use crate::daily::Daily;

/// How to train: [`Recipe::aligned`], the default; [`Recipe::log_power`]; [`Recipe::paper`].
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// Name in the card.
    pub name: &'static str,
    /// How features become inputs.
    pub features: shared_dsp::recipe::Recipe,
    /// Widths of the hidden layers.
    pub hidden: &'static [usize],
    /// Most epochs.
    pub epochs: usize,
    /// Epochs without a better validation loss before the learning rate is halved; after
    /// `halvings` of those training ends. None: every epoch at the same rate.
    pub patience: Option<usize>,
    /// Halvings of the learning rate.
    pub halvings: usize,
    /// Windows per step.
    pub batch: usize,
    /// Learning rate at the start.
    pub learning_rate: f64,
    /// Decay of weights (AdamW).
    pub weight_decay: f64,
    /// Share of the probability that is spread over all labels.
    pub label_smoothing: f32,
    /// Share of the recordings that decide when to stop.
    pub validation_fraction: f64,
    /// Hops between training windows of one recording.
    pub stride_hops: usize,
    /// How recordings are varied.
    pub augmentation: Augmentation,
    /// Fixed steps instead of epochs; then nothing decides when to stop, and windows are varied one by one.
    pub steps: Option<Steps>,
    /// Simulated wearers whose movements are shown as `other`, a label that is added where the recordings have none:
    /// what is no gesture must have a place to go. With fixed steps only.
    pub bystanders: u32,
    /// Simulated wearers, [untaught](crate::synth::Wearer::untaught), who show those gestures that the simulator knows
    /// by name beside the people of the recordings, who are few. With fixed steps only.
    pub performers: u32,
    /// Real people whose daily movement is shown as `other`, too. With fixed steps and `bystanders` only.
    pub daily: Daily,
}

impl Recipe {
    /// The paper's: 30 epochs, batch 32, learning rate 5e-4, 20 % validation, features as they are.
    pub fn paper() -> Self {
        Self {
            name: "paper",
            features: shared_dsp::recipe::Recipe::Raw,
            hidden: &[20, 10, 5],
            epochs: 30,
            patience: None,
            halvings: 0,
            batch: 32,
            learning_rate: 5e-4,
            weight_decay: 0.0,
            label_smoothing: 0.0,
            validation_fraction: 0.2,
            stride_hops: 5,
            augmentation: Augmentation::NONE,
            steps: None,
            bystanders: 0,
            performers: 0,
            daily: Daily::None,
        }
    }

    /// For people that the model has never met: features in the hand's own frame ([`shared_dsp::aligned`]), windows
    /// varied as other hands would, and a number of steps that nobody's recordings decide.
    pub fn aligned() -> Self {
        Self {
            name: "aligned",
            features: shared_dsp::recipe::Recipe::Aligned,
            hidden: &crate::ALIGNED_MEMBER_HIDDEN,
            epochs: 0,
            batch: Steps::TRAIN.batch,
            learning_rate: Steps::TRAIN.learning_rate,
            label_smoothing: Steps::TRAIN.label_smoothing,
            validation_fraction: 0.0,
            stride_hops: 1,
            augmentation: Augmentation { copies: 10, ..Augmentation::NONE },
            steps: Some(Steps::TRAIN),
            bystanders: 100,
            performers: 40,
            daily: Daily::All,
            ..Self::paper()
        }
    }

    /// Features per axis, trained until it converges. It knows directions against the board, as the paper's does.
    pub fn log_power() -> Self {
        Self {
            name: "log-power",
            features: shared_dsp::recipe::Recipe::LogPower,
            epochs: 150,
            patience: Some(4),
            halvings: 4,
            batch: 64,
            learning_rate: 3e-3,
            weight_decay: 1e-3,
            label_smoothing: 0.05,
            validation_fraction: 0.15,
            augmentation: Augmentation::DEFAULT,
            ..Self::paper()
        }
    }
}

impl Default for Recipe {
    fn default() -> Self {
        Self::aligned()
    }
}
