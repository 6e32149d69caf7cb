//! Evaluates recipes on unknown people: each person of a folder is held out in turn.
//!
//! A fold reads only the files of the other people. The files of the held-out person are opened after training.
//! These files therefore cannot influence training, scaling, stopping or quantisation.

use std::path::{Path, PathBuf};

use rand::seq::SliceRandom;
use rayon::prelude::*;
use shared_dsp::right::ModelMismatch;
use shared_dsp::right::movement::MovementConfig;
use shared_dsp::right::network::Model;
use shared_words::is_rest;

use crate::card::Scores;
use crate::dataset::{Dataset, DatasetError, Item};
use crate::evaluate::events::{AnnotatedRecording, Pause, Tally, decide, listen, play};
use crate::evaluate::score::{Classifier, Given, given, scored, summary};
use crate::recording::Recording;
use crate::streams;
use crate::synth::{Take, Wearer, session, takes};
use crate::train::{Job, Recipe, TrainError, Trained, adapt, examples_of, held_out, train};

/// What is tried.
#[derive(Clone, Debug)]
pub struct Trial<'a> {
    /// Folder with `<label>/<person>__<n>.csv`.
    pub folder: &'a Path,
    /// Number of axes to use; `None` means all axes common to the recordings.
    pub axes: Option<usize>,
    /// The labels to test; empty means all labels.
    /// Models also learn from the other people's recordings without gestures (`idle`, `other`).
    pub labels: &'a [String],
    /// The recipes that train the models.
    pub recipe: &'a dyn Recipe,
}

/// The reason why a trial cannot run. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The folder cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A model cannot be trained.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A trained model cannot be parsed, which is a bug of this program.
    #[error("the trained model is damaged: {0}")]
    Model(#[from] shared_dsp::right::network::ModelError),
    /// A trained model cannot run on its own recordings, which is a bug of this program.
    #[error("the trained model does not run: {0}")]
    Mismatch(#[from] ModelMismatch),
}

/// Percentages of correctly classified recordings, for float and int8.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accuracy {
    /// Score of the float network.
    pub float: f64,
    /// Score of the int8 network, which boards run.
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

    /// Returns the smaller value, separately for float and int8.
    pub fn worst(all: &[Self]) -> Self {
        let least = |pick: fn(&Self) -> f64| all.iter().map(pick).fold(f64::INFINITY, f64::min);
        Self { float: least(|a| a.float), int8: least(|a| a.int8) }
    }
}

/// A model's results on recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Graded {
    /// Labels of the rows and columns of the confusion matrices.
    pub labels: Vec<String>,
    /// Confusion matrices of the float and the int8 network.
    pub scores: Scores,
    /// The int8 network's answer for each recording.
    pub answers: Vec<Answer>,
}

/// The int8 network's answer for one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Name of the recording in its data set.
    pub recording: String,
    /// Index in [`Graded::labels`].
    pub label: usize,
    /// The network's probability for this answer, 0 to 1.
    pub probability: f32,
    /// Whether it was right.
    pub right: bool,
}

impl Graded {
    /// Right recordings.
    pub fn accuracy(&self) -> Accuracy {
        Accuracy { float: self.scores.float.per_recording, int8: self.scores.int8.per_recording }
    }

    /// Returns the mean accuracy of several results.
    pub fn mean<'a>(all: impl IntoIterator<Item = &'a Self>) -> Accuracy {
        Accuracy::mean(&all.into_iter().map(Self::accuracy).collect::<Vec<_>>())
    }
}

/// Results of a model after a person has shown it some examples per class.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Number of examples per class; 0 is the original model.
    pub examples: usize,
    /// Results on this person's recordings that were never used as examples.
    pub new: Graded,
    /// Results on other people's recordings that were not used for training.
    pub old: Graded,
}

impl Trial<'_> {
    /// Returns the settings for the training of a model that is only tested.
    pub fn job(seed: u64) -> Job {
        Job { name: "trial".to_owned(), about: String::new(), seed, excluded: Vec::new(), progress: false }
    }

    /// Axes that are used.
    pub fn axes(&self) -> Result<usize, TrialError> {
        Ok(self.read_with_rest(self.axes, |_| true)?.axes)
    }

    fn uses(&self, label: &str) -> bool {
        self.labels.is_empty() || self.labels.iter().any(|used| used == label)
    }

    /// Recordings to test with.
    fn read(&self, axes: usize, person: impl Fn(&str) -> bool) -> Result<Dataset, DatasetError> {
        Dataset::read_where(self.folder, Some(axes), |label, name| self.uses(label) && person(name))
    }

    /// Reads recordings for learning and for joining.
    /// Recordings without gestures are included, whatever labels are tested.
    fn read_with_rest(
        &self,
        axes: Option<usize>,
        person: impl Fn(&str) -> bool,
    ) -> Result<Dataset, DatasetError> {
        let wanted = |label: &str| self.uses(label) || is_rest(label);
        Dataset::read_where(self.folder, axes, |label, name| wanted(label) && person(name))
    }

    /// Tests a model on recordings of the tested labels, and permits only these labels as answers.
    pub fn grade(&self, model: &Trained, recordings: &Dataset) -> Result<Graded, TrialError> {
        let mut answers = model.card.answers();
        answers.iter_mut().zip(&model.card.labels).for_each(|(answer, label)| *answer &= self.uses(label));
        graded(model, recordings, &answers)
    }

    /// Trains a model without the recordings of `person`.
    pub fn without(&self, person: &str, seed: u64) -> Result<Trained, TrialError> {
        let others = self.read_with_rest(self.axes, |name| name != person)?;
        Ok(train(&others, &[], self.recipe, &Self::job(seed))?)
    }

    /// Tests a model trained without `person` on all recordings of `person`.
    pub fn stranger(&self, person: &str, seed: u64) -> Result<Graded, TrialError> {
        self.grade_of(&self.without(person, seed)?, person)
    }

    /// Tests a model on all recordings of `person`.
    pub fn grade_of(&self, model: &Trained, person: &str) -> Result<Graded, TrialError> {
        self.grade(model, &self.read(model.card.axes, |name| name == person)?)
    }

    /// Counts the events that a model and a board's thresholds detect in all recordings of `person`.
    /// The recordings are joined to a single recording.
    pub fn events_of(
        &self,
        model: &Trained,
        person: &str,
        pause: Pause,
        seed: u64,
    ) -> Result<Tally, TrialError> {
        let axes = model.card.axes;
        let theirs = self.read_with_rest(Some(axes), |name| name == person)?;
        let items: Vec<&Item> = theirs.items.iter().collect();
        let joined = AnnotatedRecording::joined_by(&items, axes, pause, seed);
        let blob = model.blob()?;
        let mut tally = Tally::default();
        tally.count(&joined, &play(Model::parse(&blob)?, &joined)?, &model.card.labels);
        Ok(tally)
    }

    /// Tests a model on a random 20 % of the recordings, which were held out of training.
    pub fn random_split(&self, seed: u64) -> Result<Graded, TrialError> {
        let all = self.read_with_rest(self.axes, |_| true)?;
        let test = held_out(&all, 0.2, seed);
        let model = train(&all, &test, self.recipe, &Self::job(seed))?;
        self.grade(&model, &all.filtered(|item| test.contains(&item.name) && self.uses(&item.label)))
    }

    /// Trains a model on a fraction `share` of the other people's recordings.
    /// Tests this model on the recordings of `person`.
    /// For each label, the seed determines which recordings are used.
    pub fn stranger_after(&self, person: &str, share: f64, seed: u64) -> Result<Graded, TrialError> {
        let others = self.read_with_rest(self.axes, |name| name != person)?;
        let dropped = held_out(&others, 1.0 - share, seed);
        self.grade_of(&train(&others, &dropped, self.recipe, &Self::job(seed))?, person)
    }

    /// Counts the events of a model that has learned nothing from `person`.
    /// There is one result for each [`MovementConfig::max_rest`].
    /// The model hears all recordings of `person`, including those without a gesture, joined with this pause.
    /// The model also hears simulated wearers of the `crowd` who make no gesture for `aimless_s` seconds.
    pub fn events(
        &self,
        person: &str,
        aimless_s: f64,
        seed: u64,
        crowd: u64,
        max_rest: &[u8],
        pause: Pause,
    ) -> Result<Vec<(Tally, Tally)>, TrialError> {
        let model = self.without(person, seed)?;
        let theirs = self.read_with_rest(Some(model.card.axes), |name| name == person)?;
        let blob = model.blob()?;
        let network = Model::parse(&blob)?;
        let (axes, labels) = (model.card.axes, &model.card.labels);
        let count = |recording: &AnnotatedRecording, tallies: &mut [Tally]| -> Result<(), TrialError> {
            if model.card.features != "aligned" {
                let events = play(network, recording)?;
                tallies.iter_mut().for_each(|tally| tally.count(recording, &events, labels));
                return Ok(());
            }
            let heard = listen(network, recording)?;
            for (tally, &max_rest) in tallies.iter_mut().zip(max_rest) {
                let config = MovementConfig { max_rest, ..MovementConfig::for_axes(axes) };
                tally.count(recording, &decide(&heard, labels, config), labels);
            }
            Ok(())
        };
        let mut real = vec![Tally::default(); max_rest.len()];
        let items: Vec<&Item> = theirs.items.iter().collect();
        count(&AnnotatedRecording::joined_by(&items, axes, pause, seed), &mut real)?;
        let mut simulated = vec![Tally::default(); max_rest.len()];
        // Each wearer is simulated for ten minutes of movement.
        const EACH_S: f64 = 600.0;
        for index in 0..(aimless_s / EACH_S).ceil() as u32 {
            let left_s = aimless_s - f64::from(index) * EACH_S;
            count(
                &AnnotatedRecording::aimless(crowd, index + 1, left_s.min(EACH_S)).with_axes(axes),
                &mut simulated,
            )?;
        }
        Ok(real.into_iter().zip(simulated).collect())
    }

    /// Trains a model on 80 % of the other people's recordings.
    /// The model is then adapted with `counts` examples per class of `person`.
    /// Each example lasts 2 s and is from a different recording.
    pub fn shown(&self, person: &str, counts: &[usize], seed: u64) -> Result<Vec<Shown>, TrialError> {
        let others = self.read_with_rest(self.axes, |name| name != person)?;
        let kept = held_out(&others, 0.2, seed);
        let model = train(&others, &kept, self.recipe, &Self::job(seed))?;
        let old = others.filtered(|item| kept.contains(&item.name) && self.uses(&item.label));
        let theirs = self.read(model.card.axes, |name| name == person)?;
        let most = counts.iter().copied().max().unwrap_or(0);
        // The seed determines the order within each class. At most half of the recordings may be examples; the others are tested.
        let mut rng = streams::RandomStream::Shown.of(seed);
        let mut shown: Vec<Vec<(Vec<f32>, usize)>> = Vec::new();
        let mut tested = Vec::new();
        for label in &theirs.labels {
            let Some(index) = model.card.labels.iter().position(|known| known == label) else { continue };
            let mut items: Vec<_> = theirs.items.iter().filter(|item| item.label == *label).collect();
            items.shuffle(&mut rng);
            let (first, rest) = items.split_at(most.min(items.len() / 2));
            tested.extend(rest.iter().map(|item| item.name.clone()));
            let cut = |item: &&Item| {
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
            let adapted = match (&model.memory, self.recipe.adapts()) {
                (Some(memory), Some(daily)) if !set.is_empty() => {
                    Some(adapt(&model, memory, &set, person, daily, seed)?)
                }
                _ => None,
            };
            let model = adapted.as_ref().unwrap_or(&model);
            rows.push(Shown { examples, new: self.grade(model, &test)?, old: self.grade(model, &old)? });
        }
        Ok(rows)
    }
}

/// Trains a model on `wearers` simulated wearers with these labels and axes. It then tests the model on real recordings.
pub fn from_simulated(
    recipe: &dyn Recipe,
    wearers: u32,
    labels: &[String],
    real: &Dataset,
    seed: u64,
) -> Result<Graded, TrialError> {
    let simulated = simulated(wearers, labels, real.axes, seed);
    // Simulated wearers vary more than copies of one recording do.
    let model = train(&simulated, &[], &*recipe.for_simulated(), &Trial::job(seed))?;
    grade(&model, real)
}

/// Simulates wearers and returns their recordings as a data set without files.
/// The wearers are [untaught](Wearer::untaught), like the people who made the real recordings.
fn simulated(wearers: u32, wanted: &[String], axes: usize, seed: u64) -> Dataset {
    const SECONDS: f64 = 6.0;
    // Start and length in samples of two short recordings, which are taken from each gesture.
    const SHORT: [(usize, usize); 2] = [(150, 105), (300, 130)];
    let of_wearer = |index: u32| {
        let wearer = Wearer::training(seed, index).untaught();
        let takes = takes(SECONDS).into_iter().filter(|take| wanted.iter().any(|label| label == take.label));
        let item = |number: u64, take: &Take, recording: Recording| Item {
            file: PathBuf::new(),
            name: format!("{}/{}__{number:03}.csv", take.label, wearer.name),
            label: take.label.to_owned(),
            person: wearer.name.clone(),
            recording,
        };
        let items = |(number, take): (usize, Take)| {
            let whole = session(&wearer, number as u64, &take.script).with_axes(axes);
            let mut items = Vec::new();
            if take.label != "idle" {
                // Real recordings are often shorter than a window, and the padding changes their features.
                for ((from, len), number) in SHORT.into_iter().zip(500..) {
                    items.push(item(number, &take, whole.slice(from, len)));
                }
            }
            items.push(item(take.number, &take, whole));
            items
        };
        takes.enumerate().flat_map(items).collect::<Vec<_>>()
    };
    let mut items: Vec<Item> = (1..=wearers).into_par_iter().flat_map_iter(of_wearer).collect();
    items.sort_by(|a, b| a.name.cmp(&b.name));
    let mut labels: Vec<String> = wanted.to_vec();
    crate::labels::sort(&mut labels);
    Dataset { folder: PathBuf::new(), items, labels, axes, ignored: Vec::new(), narrowed: 0 }
}

/// A model's results on recordings.
pub fn grade(model: &Trained, recordings: &Dataset) -> Result<Graded, TrialError> {
    graded(model, recordings, &model.card.answers())
}

/// Tests a model on recordings; `answers` are the labels that the model may give.
fn graded(model: &Trained, recordings: &Dataset, answers: &[bool]) -> Result<Graded, TrialError> {
    let card = &model.card;
    let scored = scored(recordings, &card.labels, &card.features);
    let blob = model.blob()?;
    let run = |classifier: Classifier<'_>| -> Vec<Given> {
        scored.iter().map(|recording| given(&classifier, recording, answers)).collect()
    };
    let float = run(Classifier::Float { card, layers: &model.float });
    let int8 = run(Classifier::Int8(Model::parse(&blob)?));
    let answered = recordings.items.iter().zip(&scored).zip(&int8).map(|((item, scored), given)| Answer {
        recording: item.name.clone(),
        label: given.label,
        probability: given.probability,
        right: scored.truth == Some(given.label),
    });
    Ok(Graded {
        answers: answered.collect(),
        scores: Scores {
            float: summary(&scored, &float, answers.len()),
            int8: summary(&scored, &int8, answers.len()),
        },
        labels: card.labels.clone(),
    })
}
