//! Recipes that use features per axis and train in epochs. `paper` and `log-power` are two configurations of this type.

use indicatif::ProgressBar;
use shared_dsp::right::kind::FeatureKind;

use crate::card::Scaling;
use crate::dataset::Item;
use crate::streams::RandomStream;
use crate::train::TrainError;
use crate::train::augment::Augmentation;
use crate::train::epochs::{self, Epochs};
use crate::train::recipe::{Beside, Calibration, Fitted, Learnt, Plan, Recipe, Row, Windows, scaling};
use crate::windows::{features, prepare};

/// Settings of such a recipe.
#[derive(Clone, Debug, PartialEq)]
pub struct PerAxis {
    /// The recipe's name on the command line and in cards.
    pub name: &'static str,
    /// In one sentence.
    pub about: &'static str,
    /// The conversion of features to network inputs.
    pub features: FeatureKind,
    /// Fraction of the recordings held out for early stopping.
    pub validation_fraction: f64,
    /// Number of hops between the starts of two training windows of a recording.
    pub stride_hops: usize,
    /// The variation of recordings.
    pub augmentation: Augmentation,
    /// The training of the network.
    pub epochs: Epochs,
}

impl Recipe for PerAxis {
    fn name(&self) -> &'static str {
        self.name
    }

    fn about(&self) -> &'static str {
        self.about
    }

    fn features(&self) -> FeatureKind {
        self.features
    }

    fn plan(&self) -> Plan {
        let Epochs { batch, learning_rate, most, .. } = self.epochs;
        Plan { batch, learning_rate, validation_fraction: self.validation_fraction, epochs: most }
    }

    fn windows(&self, item: &Item, label: usize, place: usize, seed: u64) -> Windows {
        let (ready, prepared) = prepare(&item.recording);
        let own = features(&ready, self.features, self.stride_hops);
        let varied = (0..self.augmentation.copies)
            .flat_map(|copy| {
                let mut rng = RandomStream::Copy { recording: place, copy }.of(seed);
                let (varied, _) = prepare(&self.augmentation.vary(&ready, &mut rng));
                features(&varied, self.features, self.stride_hops)
            })
            .collect();
        Windows { label, own, varied, prepared }
    }

    fn beside(&self, _: usize, _: &[String]) -> Beside {
        Beside { words: self.augmentation.to_string(), ..Beside::default() }
    }

    fn scaling(&self, learnt: &[Row<'_>], _: &mut dyn Iterator<Item = &[f32]>) -> Scaling {
        // The noise of a feature that hardly varies must not be amplified.
        let divisor = |mean: f64, deviation: f64| deviation.max(1e-3 * mean.abs()).max(1e-6);
        scaling(learnt, divisor, &mut learnt.iter().map(|(window, _)| *window), 3.0..=10.0)
    }

    fn fit(&self, learnt: &Learnt<'_>, seed: u64, progress: &ProgressBar) -> Result<Fitted, TrainError> {
        Ok(epochs::fit(learnt, &self.epochs, seed, progress)?)
    }

    fn calibration(&self) -> Calibration {
        Calibration::Learnt
    }

    fn shortened(&self, _: Option<usize>) -> Box<dyn Recipe> {
        Box::new(self.clone())
    }

    fn for_simulated(&self) -> Box<dyn Recipe> {
        let copies = self.augmentation.copies.min(3);
        let augmentation = Augmentation { copies, ..self.augmentation.clone() };
        Box::new(Self { augmentation, ..self.clone() })
    }
}
