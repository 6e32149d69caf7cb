//! The card is a JSON file beside a model. It describes the model, its training data and its accuracy.
//!
//! `NAME.tflite` (int8) and `NAME.float.tflite` share the card `NAME.card.json`. The README lists its fields.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::labels::OTHER;

/// Version of the card's format.
pub const FORMAT: u32 = 1;

/// The description of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Card {
    /// [`FORMAT`].
    pub format: u32,
    /// The model's name, which is its file name without the extension.
    pub name: String,
    /// A description of the training data. It says whether the data is simulated.
    pub about: String,
    /// CRC-32 of the blob in hexadecimal, which is the id that a board reports.
    pub model_id: String,
    /// SHA-256 of the int8 file.
    pub tflite_sha256: String,
    /// Names of the outputs in the order of the network.
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
    /// The conversion of features to the inputs of the network.
    pub scaling: Scaling,
    /// The training of the model.
    pub training: Training,
    /// The training data of the model.
    pub data: Data,
    /// Results for the recordings that were not used in training. `data.test` lists them.
    pub test: Option<Scores>,
    /// Results for the validation recordings.
    /// The results are optimistic, because these recordings determined when training stopped.
    pub validation: Option<Scores>,
}

/// Standardisation of features: input = (feature − mean) / deviation, limited to ±`limit`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaling {
    /// One value per feature, axis by axis.
    pub mean: Vec<f32>,
    /// Per feature, never 0.
    pub deviation: Vec<f32>,
    /// Largest input, in deviations.
    pub limit: f32,
}

/// The training of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// The training recipe: `aligned`, `log-power` (formerly `default`) or `paper`.
    pub recipe: String,
    /// The seed from which all random numbers were derived.
    pub seed: u64,
    /// Version of this tool.
    pub tool: String,
    /// Number of epochs that the training ran.
    pub epochs: usize,
    /// The epoch whose weights were kept.
    pub best_epoch: usize,
    /// Windows per step.
    pub batch: usize,
    /// Largest learning rate.
    pub learning_rate: f64,
    /// Fraction of the recordings that determine when training stops.
    pub validation_fraction: f64,
    /// A description of how training recordings were varied.
    pub augmentation: String,
    /// Number of training windows, including windows of varied recordings.
    pub windows: usize,
}

/// The training data of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Data {
    /// SHA-256 over names and contents of the recordings used. Recordings held out for the test are not included.
    pub sha256: String,
    /// Number of recordings used.
    pub recordings: usize,
    /// Their total length.
    pub minutes: f64,
    /// Number of recordings shorter than a window, which were extended periodically.
    pub padded: usize,
    /// Number of recordings that were resampled to `rate_hz`.
    pub resampled: usize,
    /// Recordings per label.
    pub labels: BTreeMap<String, usize>,
    /// Number of recordings of each person, or only a total if there are many people.
    pub people: BTreeMap<String, usize>,
    /// People whom --exclude-person left out.
    pub excluded: Vec<String>,
    /// Names of the recordings held out for the test.
    pub test: Vec<String>,
}

/// Results of the float and the int8 network for the same recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// float32.
    pub float: Score,
    /// The int8 network, which boards run.
    pub int8: Score,
}

/// The scores of a network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Correctly classified windows in per cent (stride 1 s).
    pub per_window: f64,
    /// Correctly classified recordings in per cent.
    /// A recording has the label with the highest mean probability over its windows.
    pub per_recording: f64,
    /// Confusion matrix of recordings: `confusion[true label][given label]`.
    pub confusion: Vec<Vec<usize>>,
    /// Correctly classified recordings of each person in per cent.
    pub per_person: BTreeMap<String, f64>,
}

/// The reason why a card cannot be used. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum CardError {
    /// The file cannot be read.
    #[error("{file}: {source}; the card must lie beside the model: copy both files")]
    Io {
        /// The card's file.
        file: PathBuf,
        /// The system's error message.
        source: std::io::Error,
    },
    /// The file does not contain the expected JSON.
    #[error("{file}: {what}; copy the card again or train the model again")]
    Format {
        /// The card's file.
        file: PathBuf,
        /// What is wrong.
        what: String,
    },
}

impl Card {
    /// Returns the path of a model's card: `NAME.card.json` for `NAME.tflite` or `NAME.float.tflite`.
    pub fn path(model: &Path) -> PathBuf {
        let name = model.file_name().unwrap_or_default().to_string_lossy();
        let stem = name.strip_suffix(".tflite").unwrap_or(&name);
        let stem = stem.strip_suffix(".float").unwrap_or(stem);
        model.with_file_name(format!("{stem}.card.json"))
    }

    /// Returns for each label whether a recording can have it.
    /// `other` is impossible if the training data had no recordings of it.
    /// The model then knows `other` only from simulated wearers, so that boards can reject movements.
    pub fn answers(&self) -> Vec<bool> {
        let known = &self.data.labels;
        let one = |label: &String| known.is_empty() || label != OTHER || known.contains_key(label);
        self.labels.iter().map(one).collect()
    }

    /// Number of axes that a recording must have. Recipe `aligned` uses only accelerometer and gyroscope.
    pub fn axes_needed(&self) -> usize {
        if self.features == "aligned" { self.axes.min(6) } else { self.axes }
    }

    /// Reads the card of a model.
    pub fn read(model: &Path) -> Result<Self, CardError> {
        let file = Self::path(model);
        match std::fs::read(&file) {
            Ok(bytes) => Self::parse(&file, &bytes),
            Err(source) => Err(CardError::Io { file, source }),
        }
    }

    /// Parses the JSON text of a card; `file` is used only in errors.
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
        // An unknown recipe is refused later, with an error that contains its name.
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

    /// Returns the card as JSON text with one field per line.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}
