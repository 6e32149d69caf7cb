//! How a recipe does with people it has never met: each person of a folder held out in turn.
//!
//! A fold reads the files of the other people only; those of the held-out person are opened after the model is
//! finished, to score it. So nothing of theirs can reach training, scaling, stopping or quantisation.

use std::path::Path;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use shared_dsp::mlp::Model;

use crate::card::Score;
use crate::dataset::{Dataset, DatasetError};
use crate::score::{Classifier, score, scored};
use crate::train::{Job, Recipe, TrainError, Trained, adapt, examples_of, held_out, train};

/// What is tried.
#[derive(Clone, Debug)]
pub struct Trial<'a> {
    /// Folder with `<label>/<person>__<n>.csv`.
    pub folder: &'a Path,
    /// Axes used; none: as many as all recordings have.
    pub axes: Option<usize>,
    /// Labels used; empty: all.
    pub labels: &'a [String],
    /// How models are trained.
    pub recipe: &'a Recipe,
}

/// Why a trial cannot be run; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The folder cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A model cannot be trained.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A trained model does not parse: a mistake of ours.
    #[error("the trained model is damaged: {0}")]
    Model(#[from] shared_dsp::mlp::ModelError),
}

/// Right recordings in per cent, float and int8.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accuracy {
    /// Of the float network.
    pub float: f64,
    /// Of the int8 network, as boards run it.
    pub int8: f64,
}

impl Accuracy {
    /// Mean of several.
    pub fn mean(all: &[Self]) -> Self {
        let count = all.len().max(1) as f64;
        Self {
            float: all.iter().map(|a| a.float).sum::<f64>() / count,
            int8: all.iter().map(|a| a.int8).sum::<f64>() / count,
        }
    }
}

/// A person's accuracy with so many examples per class shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// Examples per class; 0: the model as it was.
    pub examples: usize,
    /// On recordings of the person that are never shown, however many are.
    pub new: Accuracy,
    /// On recordings of the others that took no part in anything.
    pub old: Accuracy,
}

impl Trial<'_> {
    fn job(seed: u64) -> Job {
        Job { name: "trial".to_owned(), about: String::new(), seed, excluded: Vec::new(), progress: false }
    }

    fn read(&self, axes: Option<usize>, person: impl Fn(&str) -> bool) -> Result<Dataset, DatasetError> {
        let wanted = |label: &str| self.labels.is_empty() || self.labels.iter().any(|l| l == label);
        Dataset::read_where(self.folder, axes, |label, name| wanted(label) && person(name))
    }

    /// A model that has never met `person`.
    pub fn without(&self, person: &str, seed: u64) -> Result<Trained, TrialError> {
        let others = self.read(self.axes, |name| name != person)?;
        Ok(train(&others, &[], self.recipe, &Self::job(seed))?)
    }

    /// How a model that has never met `person` does on all their recordings.
    pub fn stranger(&self, person: &str, seed: u64) -> Result<Accuracy, TrialError> {
        let model = self.without(person, seed)?;
        let theirs = self.read(Some(model.card.axes), |name| name == person)?;
        accuracy(&model, &theirs)
    }

    /// How a model does on a fifth of the recordings, chosen by the seed and kept out of training.
    pub fn random_split(&self, seed: u64) -> Result<Accuracy, TrialError> {
        let all = self.read(self.axes, |_| true)?;
        let test = held_out(&all, 0.2, seed);
        let model = train(&all, &test, self.recipe, &Self::job(seed))?;
        accuracy(&model, &all.filtered(|item| test.contains(&item.name)))
    }

    /// How a model does that knows four fifths of the others' recordings and is shown `counts` examples of 2 s per
    /// class of `person`, each cut from another recording.
    pub fn shown(&self, person: &str, counts: &[usize], seed: u64) -> Result<Vec<Shown>, TrialError> {
        let others = self.read(self.axes, |name| name != person)?;
        let kept = held_out(&others, 0.2, seed);
        let model = train(&others, &kept, self.recipe, &Self::job(seed))?;
        let old = others.filtered(|item| kept.contains(&item.name));
        let theirs = self.read(Some(model.card.axes), |name| name == person)?;
        let most = counts.iter().copied().max().unwrap_or(0);
        // Per class, in an order by the seed: first what may be shown (at most half), then what is tested.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1 << 44);
        let mut shown: Vec<Vec<(Vec<f32>, usize)>> = Vec::new();
        let mut tested = Vec::new();
        for label in &theirs.labels {
            let Some(index) = model.card.labels.iter().position(|known| known == label) else { continue };
            let mut items: Vec<_> = theirs.items.iter().filter(|item| item.label == *label).collect();
            items.shuffle(&mut rng);
            let (first, rest) = items.split_at(most.min(items.len() / 2));
            tested.extend(rest.iter().map(|item| item.name.clone()));
            let cut = |item: &&crate::dataset::Item| {
                let mut windows = examples_of(&item.recording);
                windows.shuffle(&mut rng);
                windows.pop().map(|window| (window, index))
            };
            shown.push(first.iter().filter_map(cut).collect());
        }
        let test = theirs.filtered(|item| tested.contains(&item.name));
        let mut rows = Vec::new();
        for &examples in counts {
            let set: Vec<_> =
                shown.iter().flat_map(|of_label| of_label.iter().take(examples).cloned()).collect();
            let adapted = match &model.memory {
                Some(memory) if !set.is_empty() => Some(adapt(&model, memory, &set, person, seed)?),
                _ => None,
            };
            let model = adapted.as_ref().unwrap_or(&model);
            rows.push(Shown { examples, new: accuracy(model, &test)?, old: accuracy(model, &old)? });
        }
        Ok(rows)
    }
}

/// Float and int8 accuracy of a model on recordings.
pub fn accuracy(model: &Trained, recordings: &Dataset) -> Result<Accuracy, TrialError> {
    let (card, labels) = (&model.card, model.card.labels.len());
    let recordings = scored(recordings, &card.labels, &card.features);
    let blob = model.blob()?;
    let right = |score: Score| score.per_recording;
    Ok(Accuracy {
        float: right(score(&Classifier::Float { card, layers: &model.float }, &recordings, labels)),
        int8: right(score(&Classifier::Int8(Model::parse(&blob)?), &recordings, labels)),
    })
}
