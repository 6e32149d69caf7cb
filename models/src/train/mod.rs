//! Learning a network from a data set: windows, scaling, fitting, quantising, scoring, the card.
//!
//! Everything random follows from the seed and from places in sorted lists, never from the order in
//! which threads finish: the same seed gives the same files on one machine with any number of
//! threads.

mod aligned;
mod augment;
mod fit;
mod net;
mod quantise;
mod recipe;
mod split;
mod steps;
mod vary;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use shared_dsp::mlp::{MAX_LABELS, Model};

use crate::card::{self, Card, Data, Scaling, Scores, Training};
use crate::daily::Daily;
use crate::dataset::{Dataset, Item};
use crate::recording::write_whole;
use crate::score::{Classifier, score, scored, standardise};
use crate::tflite::{self, FloatLayer, Network};
use crate::windows::{features, prepare};
use crate::{HOP, RATE_HZ, WINDOW, blob};

pub use aligned::{Memory, MemoryError};
pub use augment::Augmentation;
pub use recipe::Recipe;
pub use split::held_out;
pub use steps::Steps;

/// What makes no gesture, yet is not at rest.
const OTHER: &str = "other";
/// How often each window of daily movement is learnt, beside ten copies of each window of a recording.
const DAILY_WEIGHT: usize = 8;

/// What else a training needs to know.
#[derive(Clone, Debug)]
pub struct Job {
    /// Name of the model.
    pub name: String,
    /// What the data is, for the card.
    pub about: String,
    /// Everything random follows from it.
    pub seed: u64,
    /// People who were left out, for the card.
    pub excluded: Vec<String>,
    /// Whether to draw progress bars (where stderr is a terminal).
    pub progress: bool,
}

/// Why a data set cannot be learned; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Fewer than two or too many labels, or a label that cannot be stored.
    #[error("{0}")]
    Labels(String),
    /// A file could not be read again or written.
    #[error("{file}: {source}; check the folder and the space on the disk")]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The library that fits networks failed.
    #[error("training failed: {0}")]
    Candle(#[from] candle_core::Error),
    /// The trained numbers cannot be quantised.
    #[error("the trained network cannot be quantised: {0}; try another --seed")]
    Quantise(String),
}

/// A trained model, not yet written.
#[derive(Clone, Debug)]
pub struct Trained {
    /// Its card.
    pub card: Card,
    /// The float network.
    pub float: Vec<FloatLayer>,
    /// Bytes of the float file.
    pub float_tflite: Vec<u8>,
    /// Bytes of the int8 file.
    pub int8_tflite: Vec<u8>,
    /// What [`adapt`] needs of the people it was trained on; only with the recipe `aligned`.
    pub memory: Option<Memory>,
}

/// Teaches a model one more person from a few windows of them, [`WINDOW`] samples one after the other, with their
/// labels. Everything else stays: labels, scaling, and by rehearsal what it knows of the others; and what `daily` shows
/// stays no gesture: without it, getting up from a chair becomes a circle once three circles have been shown.
///
/// # Errors
/// If the library that fits networks fails, or the result cannot be quantised.
pub fn adapt(
    model: &Trained,
    memory: &Memory,
    examples: &[(Vec<f32>, usize)],
    person: &str,
    daily: &Daily,
    seed: u64,
) -> Result<Trained, TrainError> {
    // Beside 4,096 rows of what the model remembers, a quarter is enough; all of it makes the model doubt what is shown.
    let daily: Vec<Vec<f32>> = daily.rows(model.card.axes).into_iter().step_by(4).collect();
    let adapted = aligned::adapt(&model.card, &model.float, memory, examples, &daily, seed)?;
    let mut card = Card {
        about: format!("{}; adapted to {person} with {} windows", model.card.about, examples.len()),
        test: None,
        validation: None,
        ..model.card.clone()
    };
    *card.data.people.entry(person.to_owned()).or_default() += examples.len();
    let int8 = aligned::int8(&adapted.layers, &adapted.rows, card.scaling.limit);
    let blob = blob::build(&card, &int8).map_err(TrainError::Quantise)?;
    card.model_id = blob::model_id(&blob);
    let int8_tflite = tflite::write(&Network::Int8(int8));
    card.tflite_sha256 = sha256(&int8_tflite);
    let float_tflite = tflite::write(&Network::Float(adapted.layers.clone()));
    Ok(Trained { card, float: adapted.layers, float_tflite, int8_tflite, memory: Some(memory.clone()) })
}

/// The windows of a recording that [`adapt`] learns from: one each second.
pub fn examples_of(recording: &crate::recording::Recording) -> Vec<Vec<f32>> {
    aligned::cut(&prepare(recording).0)
}

impl Trained {
    /// The blob that boards and bridge run.
    ///
    /// # Errors
    /// If the numbers cannot be put into one.
    pub fn blob(&self) -> Result<Vec<u8>, TrainError> {
        match tflite::read(&self.int8_tflite) {
            Ok(Network::Int8(layers)) => blob::build(&self.card, &layers).map_err(TrainError::Quantise),
            _ => Err(TrainError::Quantise("the int8 file cannot be read back".to_owned())),
        }
    }

    /// Writes `NAME.tflite`, `NAME.float.tflite` and `NAME.card.json`, the card last, and `NAME.memory.bin` if there is one.
    pub fn write(&self, folder: &Path) -> Result<[PathBuf; 3], TrainError> {
        let files = ["tflite", "float.tflite", "card.json"]
            .map(|ending| folder.join(format!("{}.{ending}", self.card.name)));
        let json = self.card.to_json();
        std::fs::create_dir_all(folder)
            .map_err(|source| TrainError::Io { file: folder.to_owned(), source })?;
        let contents = [&self.int8_tflite, &self.float_tflite, json.as_bytes()];
        for (file, bytes) in files.iter().zip(contents) {
            write_whole(file, bytes).map_err(|source| TrainError::Io { file: file.clone(), source })?;
        }
        if let Some(memory) = &self.memory {
            let file = folder.join(format!("{}.memory.bin", self.card.name));
            write_whole(&file, &memory.to_bytes()).map_err(|source| TrainError::Io { file, source })?;
        }
        Ok(files)
    }
}

/// The windows of one recording, ready to learn from.
struct Windows {
    label: usize,
    /// Features of the recording as it is.
    own: Vec<Vec<f32>>,
    /// Features of its varied copies.
    varied: Vec<Vec<f32>>,
    padded: bool,
    resampled: bool,
}

/// A progress bar, or nothing where it is not wanted.
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

/// Trains on `dataset` without the recordings named in `test`, and scores on those.
pub fn train(dataset: &Dataset, test: &[String], recipe: &Recipe, job: &Job) -> Result<Trained, TrainError> {
    let test_set = dataset.filtered(|item| test.contains(&item.name));
    let used = dataset.filtered(|item| !test.contains(&item.name));
    check_labels(&used)?;
    let mut labels = used.labels.clone();
    if recipe.bystanders > 0 && labels.len() < MAX_LABELS && !labels.iter().any(|label| label == OTHER) {
        labels.push(OTHER.to_owned());
        crate::labels::sort(&mut labels);
    }
    let validation = held_out(&used, recipe.validation_fraction, job.seed);

    let windows = all_windows(&used, &labels, recipe, job);
    let is_validation: Vec<bool> = used.items.iter().map(|i| validation.contains(&i.name)).collect();
    let mut learn: Vec<(&[f32], usize)> = Vec::new();
    let mut check: Vec<(&[f32], usize)> = Vec::new();
    for (part, held) in windows.iter().zip(&is_validation) {
        let own = part.own.iter().map(|w| (w.as_slice(), part.label));
        if *held {
            check.extend(own);
        } else {
            learn.extend(own);
            learn.extend(part.varied.iter().map(|w| (w.as_slice(), part.label)));
        }
    }
    if check.is_empty() && recipe.steps.is_none() {
        // Too few recordings to spare any: the training windows themselves decide when to stop.
        check.clone_from(&learn);
    }
    // As `idle` they would teach that whoever moves slowly rests.
    let no_gesture = labels.iter().position(|label| label == OTHER);
    let bystanders = match (recipe.bystanders, no_gesture) {
        (1.., Some(label)) => Some((aligned::aimless(used.axes, recipe.bystanders), label)),
        _ => None,
    };
    if let Some((windows, label)) = &bystanders {
        learn.extend(windows.iter().map(|window| (window.as_slice(), *label)));
    }
    let daily = match &bystanders {
        Some((_, label)) => (recipe.daily.rows(used.axes), *label),
        None => (Vec::new(), 0),
    };
    // What a model remembers of people is what people did.
    let remembered = learn.len();
    // Adapting has them from the crate, not from the model's memory.
    for _ in 0..DAILY_WEIGHT {
        learn.extend(daily.0.iter().map(|window| (window.as_slice(), daily.1)));
    }
    let performed = aligned::performed(used.axes, recipe.performers, &labels);
    for (windows, label) in &performed {
        learn.extend(windows.iter().map(|window| (window.as_slice(), *label)));
    }
    let real = || windows.iter().flat_map(|part| part.own.iter().map(Vec::as_slice));
    let scaling = match recipe.steps {
        Some(_) => scaling(&learn, aligned::divisor, real(), 1.0..=20.0),
        None => scaling(&learn, divisor, learn.iter().map(|(window, _)| *window), 3.0..=10.0),
    };

    let mut card = Card {
        format: card::FORMAT,
        name: job.name.clone(),
        about: job.about.clone(),
        model_id: String::new(),
        tflite_sha256: String::new(),
        labels: labels.clone(),
        axes: used.axes,
        rate_hz: RATE_HZ as u16,
        window: WINDOW as u16,
        hop: HOP as u16,
        features: blob::recipe_name(recipe.features).to_owned(),
        scaling,
        training: Training {
            recipe: recipe.name.to_owned(),
            seed: job.seed,
            tool: format!("models {}", env!("CARGO_PKG_VERSION")),
            epochs: 0,
            best_epoch: 0,
            batch: recipe.batch,
            learning_rate: recipe.learning_rate,
            validation_fraction: recipe.validation_fraction,
            augmentation: match recipe.steps {
                Some(_) => {
                    let copies = recipe.augmentation.copies;
                    let aimless = bystanders.as_ref().map_or(0, |(windows, _)| windows.len());
                    let shown: usize = performed.iter().map(|(windows, _)| windows.len()).sum();
                    let words = vary::WORDS;
                    format!(
                        "{copies} copies of each window: {words}; {aimless} windows of {} simulated wearers \
                         who make no gesture and {shown} of {} who make those that the simulator knows; {} {}",
                        recipe.bystanders,
                        recipe.performers,
                        daily.0.len(),
                        crate::daily::SOURCE
                    )
                }
                None => recipe.augmentation.to_string(),
            },
            windows: learn.len(),
        },
        data: Data {
            sha256: data_hash(&used)?,
            recordings: used.items.len(),
            minutes: used.items.iter().map(|i| i.recording.seconds()).sum::<f64>() / 60.0,
            padded: windows.iter().filter(|w| w.padded).count(),
            resampled: windows.iter().filter(|w| w.resampled).count(),
            labels: count(&used, |item| &item.label),
            people: count(&used, |item| &item.person),
            excluded: job.excluded.clone(),
            test: test.to_vec(),
        },
        test: None,
        validation: None,
    };

    let inputs = |set: &[(&[f32], usize)]| -> Vec<(Vec<f32>, usize)> {
        set.iter().map(|(window, label)| (standardise(&card, window), *label)).collect()
    };
    let (learn, check) = (inputs(&learn), inputs(&check));
    let progress = bar(job, recipe.epochs, "training");
    let fitted = match &recipe.steps {
        Some(plan) => {
            let start = steps::Start::Widths(recipe.hidden);
            let layers = steps::fit(&learn, labels.len(), &start, plan, card.scaling.limit, job.seed)?;
            let epochs = (plan.count * plan.batch).div_ceil(learn.len().max(1));
            fit::Fitted { layers, epochs, best_epoch: epochs }
        }
        None => fit::fit(&learn, &check, labels.len(), recipe, job.seed, &progress)?,
    };
    progress.finish_and_clear();
    card.training.epochs = fitted.epochs;
    card.training.best_epoch = fitted.best_epoch;

    let real_inputs: Vec<Vec<f32>>;
    let calibration: Vec<&[f32]> = match recipe.steps {
        // Varied windows go further than real ones do: their rare extremes would cost every value a part of its
        // int8 range.
        Some(_) => {
            real_inputs = real().map(|window| standardise(&card, window)).collect();
            real_inputs.iter().map(Vec::as_slice).collect()
        }
        None => learn.iter().map(|(input, _)| input.as_slice()).collect(),
    };
    let int8 = quantise::quantise(&fitted.layers, &calibration, card.scaling.limit);
    let blob = blob::build(&card, &int8).map_err(TrainError::Quantise)?;
    card.model_id = blob::model_id(&blob);
    let model = Model::parse(&blob).map_err(|error| TrainError::Quantise(error.to_string()))?;
    let int8_tflite = tflite::write(&Network::Int8(int8));
    let float_tflite = tflite::write(&Network::Float(fitted.layers.clone()));
    card.tflite_sha256 = sha256(&int8_tflite);

    let both = |set: &Dataset| -> Option<Scores> {
        if set.items.is_empty() {
            return None;
        }
        let recordings = scored(set, &labels, &card.features);
        let float = Classifier::Float { card: &card, layers: &fitted.layers };
        Some(Scores {
            float: score(&float, &recordings, &card.answers()),
            int8: score(&Classifier::Int8(model), &recordings, &card.answers()),
        })
    };
    let test_scores = both(&test_set);
    let validation_scores = both(&used.filtered(|item| validation.contains(&item.name)));
    card.test = test_scores;
    card.validation = validation_scores;
    let memory =
        recipe.steps.map(|_| Memory::new(&learn[..remembered], labels.len(), card.scaling.limit, job.seed));
    Ok(Trained { card, float: fitted.layers, float_tflite, int8_tflite, memory })
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

fn all_windows(used: &Dataset, labels: &[String], recipe: &Recipe, job: &Job) -> Vec<Windows> {
    let progress = bar(job, used.items.len(), "features");
    let one = |(index, item): (usize, &Item)| {
        let label = labels.iter().position(|label| *label == item.label).unwrap_or_default();
        if recipe.steps.is_some() {
            let mut rng = ChaCha8Rng::seed_from_u64(job.seed);
            rng.set_stream(1 + index as u64);
            progress.inc(1);
            return aligned::windows(item, label, recipe.augmentation.copies, &rng);
        }
        let (ready, prepared) = prepare(&item.recording);
        let own = features(&ready, recipe.features, recipe.stride_hops);
        let varied = (0..recipe.augmentation.copies)
            .flat_map(|copy| {
                // A number of its own for every copy of every recording.
                let mut rng = ChaCha8Rng::seed_from_u64(job.seed);
                rng.set_stream(1 + (index * 1000 + copy) as u64);
                let (varied, _) = prepare(&recipe.augmentation.vary(&ready, &mut rng));
                features(&varied, recipe.features, recipe.stride_hops)
            })
            .collect();
        progress.inc(1);
        Windows { label, own, varied, padded: prepared.padded, resampled: prepared.resampled }
    };
    let windows = used.items.par_iter().enumerate().map(one).collect();
    progress.finish_and_clear();
    windows
}

/// Mean and divisor per feature over the training windows, and a limit, within `limits`, that 999 of 1000 inputs of
/// the windows `real` keep.
fn scaling<'a>(
    learn: &[(&[f32], usize)],
    divisor: impl Fn(f64, f64) -> f64,
    real: impl Iterator<Item = &'a [f32]>,
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

/// What a feature is divided by. One that hardly varies must not become an amplifier of noise.
fn divisor(mean: f64, deviation: f64) -> f64 {
    deviation.max(1e-3 * mean.abs()).max(1e-6)
}

fn count<'a>(set: &'a Dataset, key: impl Fn(&'a Item) -> &'a String) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for item in &set.items {
        *counts.entry(key(item).clone()).or_default() += 1;
    }
    counts
}

/// SHA-256 over the names and contents of the recordings, in order; of one without a file, what its file would hold.
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

/// SHA-256 of some bytes, in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
