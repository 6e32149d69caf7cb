//! Recipe `log-power`: features per axis with logarithmic powers, trained until convergence.
//! Like the paper's recipe, this recipe uses the axes of the board.
//! It can therefore distinguish gestures that mirror each other.

use shared_dsp::right::kind::FeatureKind;

use super::{PAPER, PerAxis};
use crate::train::augment::Augmentation;
use crate::train::epochs::Epochs;

/// Training ends when four halvings of the learning rate bring no improvement.
pub const LOG_POWER: PerAxis = PerAxis {
    name: "log-power",
    about: "Features per axis with log powers, until it converges; it knows directions in the room, and wants the board \
            worn as it was in the recordings",
    features: FeatureKind::LogPower,
    validation_fraction: 0.15,
    augmentation: Augmentation::DEFAULT,
    epochs: Epochs {
        most: 150,
        patience: Some(4),
        halvings: 4,
        batch: 64,
        learning_rate: 3e-3,
        weight_decay: 1e-3,
        label_smoothing: 0.05,
        ..PAPER.epochs
    },
    ..PAPER
};
