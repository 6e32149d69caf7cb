//! The card: the JSON beside a model that says what it is, where it comes from and what it can do.
//!
//! `NAME.tflite` (int8) and `NAME.float.tflite` share `NAME.card.json`. The README lists the fields.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::labels::OTHER;

/// Version of the card's format.
pub const FORMAT: u32 = 1;

/// What is known about a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Card {
    /// [`FORMAT`].
    pub format: u32,
    /// The model's name: its file's without ending.
    pub name: String,
    /// What the training data is, in words; simulated data says so here.
    pub about: String,
    /// CRC-32 of the blob in hexadecimal: the id that a board reports.
    pub model_id: String,
    /// SHA-256 of the int8 file.
    pub tflite_sha256: String,
    /// Names of the outputs in order.
    pub labels: Vec<String>,
    /// Values per sample: 3, 6 or 9.
    pub axes: usize,
    /// Samples per second.
    pub rate_hz: u16,
    /// Samples per window.
    pub window: u16,
    /// Samples per hop.
    pub hop: u16,
    /// The kind of features: `raw`, `log-power` or `aligned` (`shared_dsp::right::kind`).
    pub features: String,
    /// How features become inputs of the network.
    pub scaling: Scaling,
    /// How it was trained.
    pub training: Training,
    /// What it was trained on.
    pub data: Data,
    /// Scores on recordings that took no part in the training; which ones, is in `data.test`.
    pub test: Option<Scores>,
    /// Scores on the training's own validation recordings (they chose when to stop: optimistic).
    pub validation: Option<Scores>,
}

/// Standardisation: input = (feature − mean) / deviation, limited to ±`limit`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaling {
    /// Per feature, axis after axis.
    pub mean: Vec<f32>,
    /// Per feature, never 0.
    pub deviation: Vec<f32>,
    /// Largest input, in deviations.
    pub limit: f32,
}

/// How a model was trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// `aligned`, `log-power` (once called `default`) or `paper`.
    pub recipe: String,
    /// Everything random follows from it.
    pub seed: u64,
    /// Version of this tool.
    pub tool: String,
    /// Epochs run, and the one whose weights were kept.
    pub epochs: usize,
    /// The epoch whose weights were kept.
    pub best_epoch: usize,
    /// Windows per step.
    pub batch: usize,
    /// Largest learning rate.
    pub learning_rate: f64,
    /// Share of the recordings that decide when to stop.
    pub validation_fraction: f64,
    /// What was varied in the training recordings, in words.
    pub augmentation: String,
    /// Training windows, varied ones included.
    pub windows: usize,
}

/// What a model was trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Data {
    /// SHA-256 over names and contents of the recordings used, those held out for the test not.
    pub sha256: String,
    /// Number of recordings used.
    pub recordings: usize,
    /// Their total length.
    pub minutes: f64,
    /// Recordings shorter than a window, which were padded, going on as they went a period before.
    pub padded: usize,
    /// Recordings that were resampled to `rate_hz`.
    pub resampled: usize,
    /// Recordings per label.
    pub labels: BTreeMap<String, usize>,
    /// Recordings per person; if there are many people, only their number.
    pub people: BTreeMap<String, usize>,
    /// People left out with --exclude-person.
    pub excluded: Vec<String>,
    /// Names of the recordings held out for the test.
    pub test: Vec<String>,
}

/// Scores of the float and the int8 network on the same recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// float32.
    pub float: Score,
    /// int8, as boards run it.
    pub int8: Score,
}

/// The scores of a network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Right windows in per cent (stride 1 s).
    pub per_window: f64,
    /// Recordings recognised correctly, in per cent (largest mean probability of their windows).
    pub per_recording: f64,
    /// Recordings: `confusion[true label][given label]`.
    pub confusion: Vec<Vec<usize>>,
    /// Right recordings per person in per cent.
    pub per_person: BTreeMap<String, f64>,
}

/// Why a card cannot be used; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum CardError {
    /// The file cannot be read.
    #[error("{file}: {source}; the card must lie beside the model: copy both files")]
    Io {
        /// The card's file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not the JSON that is expected.
    #[error("{file}: {what}; copy the card again or train the model again")]
    Format {
        /// The card's file.
        file: PathBuf,
        /// What is wrong.
        what: String,
    },
}

impl Card {
    /// Where the card of a model lies: `NAME.card.json` beside `NAME.tflite` or `NAME.float.tflite`.
    pub fn path(model: &Path) -> PathBuf {
        let name = model.file_name().unwrap_or_default().to_string_lossy();
        let stem = name.strip_suffix(".tflite").unwrap_or(&name);
        let stem = stem.strip_suffix(".float").unwrap_or(stem);
        model.with_file_name(format!("{stem}.card.json"))
    }

    /// Of each label, whether it can be what a recording shows. `other` cannot where no recording of it was there to
    /// learn from: the model knows it from simulated wearers, so that boards can tell that something is no gesture.
    pub fn answers(&self) -> Vec<bool> {
        let known = &self.data.labels;
        let one = |label: &String| known.is_empty() || label != OTHER || known.contains_key(label);
        self.labels.iter().map(one).collect()
    }

    /// Axes that a recording must have: recipe `aligned` makes its features of accelerometer and gyroscope alone.
    pub fn axes_needed(&self) -> usize {
        if self.features == "aligned" { self.axes.min(6) } else { self.axes }
    }

    /// Reads the card beside a model.
    pub fn read(model: &Path) -> Result<Self, CardError> {
        let file = Self::path(model);
        match std::fs::read(&file) {
            Ok(bytes) => Self::parse(&file, &bytes),
            Err(source) => Err(CardError::Io { file, source }),
        }
    }

    /// Reads a card from JSON; `file` is only for the errors.
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, CardError> {
        let error = |what: String| CardError::Format { file: file.to_owned(), what };
        let card: Self = serde_json::from_slice(bytes).map_err(|e| error(e.to_string()))?;
        if card.format != FORMAT {
            return Err(error(format!("format {}, this tool reads {FORMAT}", card.format)));
        }
        if let Some(twice) = (1..card.labels.len()).find(|at| card.labels[..*at].contains(&card.labels[*at]))
        {
            return Err(error(format!("the label {:?} is there twice", card.labels[twice])));
        }
        // A recipe that is not known here is refused later, by name.
        let inputs = crate::blob::recipe(&card.features)
            .map_or(card.scaling.mean.len(), |recipe| recipe.feature_count(card.axes));
        if !matches!(card.axes, 3 | 6 | 9)
            || card.scaling.mean.len() != inputs
            || card.scaling.deviation.len() != inputs
        {
            return Err(error(format!(
                "{} axes with {} means and {} deviations",
                card.axes,
                card.scaling.mean.len(),
                card.scaling.deviation.len()
            )));
        }
        let numbers = card.scaling.mean.iter().chain(&card.scaling.deviation);
        if !numbers.chain([&card.scaling.limit]).all(|v| v.is_finite())
            || !card.scaling.deviation.iter().all(|d| *d > 0.0)
            || card.scaling.limit <= 0.0
        {
            return Err(error("a scaling value is out of range".to_owned()));
        }
        Ok(card)
    }

    /// The card as JSON text, one field per line.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}
