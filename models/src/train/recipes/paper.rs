//! The paper's recipe, which does not scale features.

use shared_dsp::right::kind::FeatureKind;

use super::PerAxis;
use crate::train::augment::Augmentation;
use crate::train::epochs::Epochs;

/// The paper uses 30 epochs, batch size 32, learning rate 5e-4 and 20 % of the data for validation.
pub const PAPER: PerAxis = PerAxis {
    name: "paper",
    about: "The paper's: 30 epochs, batch 32, learning rate 5e-4, 20 % validation",
    features: FeatureKind::Raw,
    validation_fraction: 0.2,
    stride_hops: 5,
    augmentation: Augmentation::NONE,
    epochs: Epochs {
        hidden: &[20, 10, 5],
        most: 30,
        patience: None,
        halvings: 0,
        batch: 32,
        learning_rate: 5e-4,
        weight_decay: 0.0,
        label_smoothing: 0.0,
    },
};
