//! Tests a network per window, per recording (by the highest mean probability of its windows) and per person.

use std::collections::BTreeMap;

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::Model;

use crate::card::{Card, Score};
use crate::dataset::Dataset;
use crate::tflite::{FloatLayer, infer_float};
use crate::windows::{features_every, prepare};
use crate::{RATE_HZ, blob};

/// Number of samples between two tested windows, which is 1 s.
pub const STRIDE: usize = RATE_HZ as usize;

/// A network that assigns a label to each window of features.
pub enum Classifier<'a> {
    /// The float network with the scaling from the card.
    Float {
        /// Its card.
        card: &'a Card,
        /// Its layers.
        layers: &'a [FloatLayer],
    },
    /// The int8 network, which boards run.
    Int8(Model<'a>),
}

/// Converts transformed features to the inputs of the float network.
pub fn standardise(card: &Card, features: &[f32]) -> Vec<f32> {
    let scaling = &card.scaling;
    let pairs = scaling.mean.iter().zip(&scaling.deviation);
    features
        .iter()
        .zip(pairs)
        .map(|(value, (mean, deviation))| {
            let input = (value - mean) / deviation;
            // NaN becomes the lower limit, as in the int8 network.
            if input.is_nan() { -scaling.limit } else { input.clamp(-scaling.limit, scaling.limit) }
        })
        .collect()
}

impl Classifier<'_> {
    /// Returns the probability of each label, or nothing if the number of features differs from the model's.
    ///
    /// The int8 network takes raw features and applies the recipe itself.
    pub fn probabilities(&self, raw: &[f32], transformed: &[f32]) -> Vec<f32> {
        match self {
            Self::Float { card, layers } => infer_float(layers, &standardise(card, transformed)),
            Self::Int8(model) => {
                let mut scores = vec![0i8; model.info().label_count];
                match model.classify_features(raw, &mut scores) {
                    Ok(()) => scores.iter().map(|score| (f32::from(*score) + 128.0) / 256.0).collect(),
                    Err(_) => Vec::new(),
                }
            }
        }
    }
}

/// Returns the index of the largest permitted value, or of the first one if several are equal.
fn best(values: &[f32], answers: &[bool]) -> usize {
    let mut best = None;
    for (index, value) in values.iter().enumerate().filter(|(index, _)| answers[*index]) {
        if best.is_none_or(|best: usize| *value > values[best]) {
            best = Some(index);
        }
    }
    best.unwrap_or_default()
}

/// A recording's windows at stride 1 s.
#[derive(Clone, Debug)]
pub struct Scored {
    /// Index of the correct label in the model's labels, or `None` if the model does not know it.
    pub truth: Option<usize>,
    /// Who made it.
    pub person: String,
    /// Raw features of each window.
    pub raw: Vec<Vec<f32>>,
    /// The features after the transformation of the card's recipe.
    pub transformed: Vec<Vec<f32>>,
    /// Whether the recording was shorter than a window.
    pub padded: bool,
}

/// Computes the data for testing models with these labels and this recipe.
pub fn scored(dataset: &Dataset, labels: &[String], features: &str) -> Vec<Scored> {
    let recipe = blob::recipe(features).unwrap_or(FeatureKind::Raw);
    let one = |item: &crate::dataset::Item| {
        let (ready, prepared) = prepare(&item.recording);
        let measured = if recipe == FeatureKind::Aligned { FeatureKind::Aligned } else { FeatureKind::Raw };
        let raw = features_every(&ready, measured, STRIDE);
        let transformed = raw
            .iter()
            .map(|window| {
                let values = window.iter().enumerate();
                values.map(|(n, &value)| recipe.transform(n, value)).collect()
            })
            .collect();
        Scored {
            truth: labels.iter().position(|label| *label == item.label),
            person: item.person.clone(),
            raw,
            transformed,
            padded: prepared.padded,
        }
    };
    dataset.items.iter().map(one).collect()
}

/// What a classifier returned for one recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Index of the label with the highest mean probability.
    pub label: usize,
    /// That probability.
    pub probability: f32,
    /// Number of windows, and number of correctly classified windows.
    pub windows: (usize, usize),
}

/// Classifies a recording; `answers` are the labels that the classifier may give ([`Card::answers`]).
pub fn given(classifier: &Classifier<'_>, recording: &Scored, answers: &[bool]) -> Given {
    let mut sum = vec![0.0f32; answers.len()];
    let mut right = 0;
    for (raw, transformed) in recording.raw.iter().zip(&recording.transformed) {
        let probabilities = classifier.probabilities(raw, transformed);
        right +=
            usize::from(!probabilities.is_empty() && Some(best(&probabilities, answers)) == recording.truth);
        for (sum, probability) in sum.iter_mut().zip(&probabilities) {
            *sum += probability;
        }
    }
    let label = best(&sum, answers);
    let windows = recording.raw.len();
    let probability = sum.get(label).copied().unwrap_or_default() / windows.max(1) as f32;
    Given { label, probability, windows: (windows, right) }
}

/// Tests a classifier. A recording whose label the model does not know counts as incorrect.
/// A recording without an answer does not appear in the confusion matrix.
pub fn score(classifier: &Classifier<'_>, recordings: &[Scored], answers: &[bool]) -> Score {
    let given: Vec<Given> =
        recordings.iter().map(|recording| given(classifier, recording, answers)).collect();
    summary(recordings, &given, answers.len())
}

/// Computes the scores from a classifier's results for all recordings.
pub fn summary(recordings: &[Scored], given: &[Given], labels: usize) -> Score {
    let mut confusion = vec![vec![0; labels]; labels];
    let mut people: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    let (mut windows, mut right_windows, mut right) = (0, 0, 0);
    for (recording, given) in recordings.iter().zip(given) {
        windows += given.windows.0;
        right_windows += given.windows.1;
        let is_right = recording.truth == Some(given.label);
        if let Some(cell) = recording.truth.and_then(|truth| confusion.get_mut(truth)?.get_mut(given.label)) {
            *cell += 1;
        }
        right += usize::from(is_right);
        let person = people.entry(recording.person.clone()).or_default();
        person.0 += usize::from(is_right);
        person.1 += 1;
    }
    let per_cent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
    Score {
        per_window: per_cent(right_windows, windows),
        per_recording: per_cent(right, recordings.len()),
        confusion,
        per_person: people.into_iter().map(|(name, (r, n))| (name, per_cent(r, n))).collect(),
    }
}
