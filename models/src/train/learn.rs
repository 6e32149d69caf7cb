//! Turns a data set into a model: windows, scaling, training, tests and the card.

use std::collections::BTreeMap;

use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use shared_dsp::right::network::{MAX_LABELS, Model};

use super::memory::Memory;
use super::recipe::{Calibration, Learnt, Recipe, Row, Shared, Windows};
use super::split::held_out;
use super::trained::{TrainError, Trained, hex};
use crate::card::{self, Card, Data, Scaling, Scores, Training};
use crate::dataset::{Dataset, Item};
use crate::evaluate::score::{Classifier, score, scored, standardise};
use crate::{HOP, RATE_HZ, WINDOW, blob};

/// Further settings of a training.
#[derive(Clone, Debug)]
pub struct Job {
    /// Name of the model.
    pub name: String,
    /// A description of the data, for the card.
    pub about: String,
    /// The seed of all random numbers.
    pub seed: u64,
    /// People whom the user excluded, for the card.
    pub excluded: Vec<String>,
    /// Whether to draw progress bars (if stderr is a terminal).
    pub progress: bool,
}

/// Returns a progress bar, or nothing if it is not wanted.
fn bar(job: &Job, length: usize, what: &'static str) -> ProgressBar {
    if !job.progress {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:10} {bar:40} {pos}/{len} {elapsed} (left {eta})");
    let bar = ProgressBar::new(length as u64).with_message(what);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Trains on `dataset` except for the recordings named in `test`, and tests the model on those recordings.
pub fn train(
    dataset: &Dataset,
    test: &[String],
    recipe: &dyn Recipe,
    job: &Job,
) -> Result<Trained, TrainError> {
    let test_set = dataset.filtered(|item| test.contains(&item.name));
    let used = dataset.filtered(|item| !test.contains(&item.name));
    check_labels(&used)?;
    let labels = recipe.labels(used.labels.clone());
    let plan = recipe.plan();
    let validation = held_out(&used, plan.validation_fraction, job.seed);

    let windows = all_windows(&used, &labels, recipe, job);
    let beside = recipe.beside(used.axes, &labels);
    let is_validation: Vec<bool> = used.items.iter().map(|i| validation.contains(&i.name)).collect();
    let (mut learn, mut check): (Vec<Row<'_>>, Vec<Row<'_>>) = (Vec::new(), Vec::new());
    for (part, held) in windows.iter().zip(&is_validation) {
        if *held {
            check.extend(labelled(&part.own, part.label));
        } else {
            learn.extend(labelled(&part.own, part.label));
            learn.extend(labelled(&part.varied, part.label));
        }
    }
    let of_recordings = learn.len();
    learn.extend(rows(&beside.of_people));
    let remembered = learn.len();
    learn.extend(rows(&beside.of_nobody));
    let real = || windows.iter().flat_map(|part| part.own.iter().map(Vec::as_slice));
    let scaling = recipe.scaling(&learn, &mut real());

    let mut card = blank_card(&used, &labels, recipe, job, scaling)?;
    card.training.augmentation = beside.words.clone();
    card.training.windows = learn.len();
    card.data.padded = windows.iter().filter(|w| w.prepared.padded).count();
    card.data.resampled = windows.iter().filter(|w| w.prepared.resampled).count();
    card.data.test = test.to_vec();

    let inputs = |set: &[Row<'_>]| -> Vec<(Vec<f32>, usize)> {
        set.iter().map(|(window, label)| (standardise(&card, window), *label)).collect()
    };
    let (learn, check) = (inputs(&learn), inputs(&check));
    let progress = bar(job, plan.epochs, "training");
    let limit = card.scaling.limit;
    let fitted = recipe.fit(
        &Learnt { rows: &learn, check: &check, of_recordings, labels: labels.len(), limit },
        job.seed,
        &progress,
    )?;
    progress.finish_and_clear();
    card.training.epochs = fitted.epochs;
    card.training.best_epoch = fitted.best_epoch;

    let real_inputs: Vec<Vec<f32>>;
    let calibration: Vec<&[f32]> = match recipe.calibration() {
        Calibration::Real => {
            real_inputs = real().map(|window| standardise(&card, window)).collect();
            real_inputs.iter().map(Vec::as_slice).collect()
        }
        Calibration::Learnt => learn.iter().map(|(input, _)| input.as_slice()).collect(),
    };
    let people = &learn[..remembered];
    let memory = recipe.adapts().map(|_| Memory::new(people, labels.len(), limit, job.seed));
    let mut trained = Trained::of(card, fitted.layers, &calibration, memory)?;

    let blob = trained.blob()?;
    let model = Model::parse(&blob).map_err(|error| TrainError::Quantise(error.to_string()))?;
    let card = &trained.card;
    let both = |set: &Dataset| -> Option<Scores> {
        if set.items.is_empty() {
            return None;
        }
        let recordings = scored(set, &labels, &card.features);
        let float = Classifier::Float { card, layers: &trained.float };
        Some(Scores {
            float: score(&float, &recordings, &card.answers()),
            int8: score(&Classifier::Int8(model), &recordings, &card.answers()),
        })
    };
    let test_scores = both(&test_set);
    let validation_scores = both(&used.filtered(|item| validation.contains(&item.name)));
    trained.card.test = test_scores;
    trained.card.validation = validation_scores;
    Ok(trained)
}

/// Creates the card of a model before training.
fn blank_card(
    used: &Dataset,
    labels: &[String],
    recipe: &dyn Recipe,
    job: &Job,
    scaling: Scaling,
) -> Result<Card, TrainError> {
    let plan = recipe.plan();
    Ok(Card {
        format: card::FORMAT,
        name: job.name.clone(),
        about: job.about.clone(),
        model_id: String::new(),
        tflite_sha256: String::new(),
        labels: labels.to_vec(),
        axes: used.axes,
        rate_hz: RATE_HZ as u16,
        window: WINDOW as u16,
        hop: HOP as u16,
        features: blob::recipe_name(recipe.features()).to_owned(),
        scaling,
        training: Training {
            recipe: recipe.name().to_owned(),
            seed: job.seed,
            tool: format!("models {}", env!("CARGO_PKG_VERSION")),
            epochs: 0,
            best_epoch: 0,
            batch: plan.batch,
            learning_rate: plan.learning_rate,
            validation_fraction: plan.validation_fraction,
            augmentation: String::new(),
            windows: 0,
        },
        data: Data {
            sha256: data_hash(used)?,
            recordings: used.items.len(),
            minutes: used.items.iter().map(|i| i.recording.seconds()).sum::<f64>() / 60.0,
            padded: 0,
            resampled: 0,
            labels: count(used, |item| &item.label),
            people: count(used, |item| &item.person),
            excluded: job.excluded.clone(),
            test: Vec::new(),
        },
        test: None,
        validation: None,
    })
}

/// Windows with their label.
fn labelled(windows: &[Vec<f32>], label: usize) -> impl Iterator<Item = Row<'_>> {
    windows.iter().map(move |window| (window.as_slice(), label))
}

/// Like `labelled`, but for several data sets.
fn rows(sets: &[(Shared, usize)]) -> impl Iterator<Item = Row<'_>> {
    sets.iter().flat_map(|(windows, label)| labelled(windows, *label))
}

fn check_labels(used: &Dataset) -> Result<(), TrainError> {
    let problem = match used.labels.as_slice() {
        labels if labels.len() < 2 => format!(
            "{}: {} label(s) with recordings; at least 2 are needed: add FOLDER/<label>/ folders",
            used.folder.display(),
            labels.len()
        ),
        labels if labels.len() > MAX_LABELS => format!(
            "{}: {} labels; a board holds at most {}: merge or remove some",
            used.folder.display(),
            labels.len(),
            MAX_LABELS
        ),
        labels => match labels.iter().find(|label| label.contains(',') || label.is_empty()) {
            Some(label) => format!("label {label:?} is empty or has a comma; rename its folder"),
            None => return Ok(()),
        },
    };
    Err(TrainError::Labels(problem))
}

fn all_windows(used: &Dataset, labels: &[String], recipe: &dyn Recipe, job: &Job) -> Vec<Windows> {
    let progress = bar(job, used.items.len(), "features");
    let one = |(place, item): (usize, &Item)| {
        let label = labels.iter().position(|label| *label == item.label).unwrap_or_default();
        let windows = recipe.windows(item, label, place, job.seed);
        progress.inc(1);
        windows
    };
    let windows = used.items.par_iter().enumerate().map(one).collect();
    progress.finish_and_clear();
    windows
}

fn count<'a>(set: &'a Dataset, key: impl Fn(&'a Item) -> &'a String) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for item in &set.items {
        *counts.entry(key(item).clone()).or_default() += 1;
    }
    counts
}

/// Returns the SHA-256 over names and contents of the recordings in order.
/// For a recording without a file, the hash uses the recording as CSV text.
pub fn data_hash(set: &Dataset) -> Result<String, TrainError> {
    let mut hash = Sha256::new();
    for item in &set.items {
        let bytes = match item.file.as_os_str().is_empty() {
            true => item.recording.to_csv().into_bytes(),
            false => std::fs::read(&item.file)
                .map_err(|source| TrainError::Io { file: item.file.clone(), source })?,
        };
        hash.update((item.name.len() as u64).to_le_bytes());
        hash.update(item.name.as_bytes());
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(&bytes);
    }
    Ok(hex(&hash.finalize()))
}
