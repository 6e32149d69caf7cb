//! Converts a model's files to the blob that boards and bridge run.
//!
//! The blob depends only on the `.tflite` file and the card, and its CRC-32 is the model id on the wire.

use std::path::{Path, PathBuf};

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::crc32;
use shared_dsp::right::network::{BlobSpec, DenseSpec, build_blob};

use crate::card::{Card, CardError};
use crate::tflite::{self, Network, TfliteError};

/// The reason why a blob cannot be built. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error("{file}: {source}; check the path")]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error message.
        source: std::io::Error,
    },
    /// The card cannot be used.
    #[error(transparent)]
    Card(#[from] CardError),
    /// The TFLite file cannot be used.
    #[error("{file}: {source}")]
    Tflite {
        /// The file.
        file: PathBuf,
        /// Description of the problem that the file has.
        source: TfliteError,
    },
    /// The model and the card are each valid, but they do not match or are not suitable.
    #[error("{file}: {what}")]
    Mismatch {
        /// The model's file.
        file: PathBuf,
        /// The mismatch and a remedy.
        what: String,
    },
}

/// The files of a model. They have been read, and they match each other.
#[derive(Clone, Debug)]
pub struct ModelFiles {
    /// The card.
    pub card: Card,
    /// The network.
    pub network: Network,
}

impl ModelFiles {
    /// Reads a `.tflite` file (float or int8) and its card.
    pub fn read(model: &Path) -> Result<Self, ModelError> {
        let bytes =
            std::fs::read(model).map_err(|source| ModelError::Io { file: model.to_owned(), source })?;
        Self::new(model, &bytes, Card::read(model)?)
    }

    /// Like [`Self::read`], but reads from memory; `model` is used only in errors.
    pub fn new(model: &Path, bytes: &[u8], card: Card) -> Result<Self, ModelError> {
        let file = || model.to_owned();
        let network = tflite::read(bytes).map_err(|source| ModelError::Tflite { file: file(), source })?;
        let (inputs, outputs) = (network.inputs(), network.outputs());
        let features = card.scaling.mean.len();
        if inputs != features || outputs != card.labels.len() {
            let what = format!(
                "the network is {inputs} to {outputs}, its card says {} axes ({} features) and {} \
                 labels; put the card beside it that was written with it",
                card.axes,
                features,
                card.labels.len()
            );
            return Err(ModelError::Mismatch { file: file(), what });
        }
        let files = Self { card, network };
        if let Network::Int8(layers) = &files.network {
            let blob =
                build(&files.card, layers).map_err(|what| ModelError::Mismatch { file: file(), what })?;
            let id = model_id(&blob);
            if id != files.card.model_id {
                let what = format!(
                    "the model's id is {id}, its card says {}; put the card beside it that was \
                     written with it; after an update of this program, renew it: models card MODEL",
                    files.card.model_id
                );
                return Err(ModelError::Mismatch { file: file(), what });
            }
        }
        Ok(files)
    }

    /// Returns the blob of an int8 model. Float models have no blob.
    pub fn blob(&self) -> Result<Vec<u8>, String> {
        match &self.network {
            Network::Int8(layers) => build(&self.card, layers),
            Network::Float(_) => Err("this is the float model; give the int8 .tflite".to_owned()),
        }
    }
}

/// Reads an int8 model from disk, and returns its blob and its card.
///
/// ```no_run
/// let (blob, card) = models::blob::read(std::path::Path::new("right-aligned.tflite"))?;
/// # Ok::<(), models::blob::ModelError>(())
/// ```
pub fn read(model: &Path) -> Result<(Vec<u8>, Card), ModelError> {
    let files = ModelFiles::read(model)?;
    match files.blob() {
        Ok(blob) => Ok((blob, files.card)),
        Err(what) => Err(ModelError::Mismatch { file: model.to_owned(), what }),
    }
}

/// Returns the id of a blob in the form that cards use.
pub fn model_id(blob: &[u8]) -> String {
    format!("{:08x}", crc32(blob))
}

/// Returns the feature recipe that has this name in a card.
pub fn recipe(name: &str) -> Option<FeatureKind> {
    match name {
        "raw" => Some(FeatureKind::Raw),
        "log-power" => Some(FeatureKind::LogPower),
        "aligned" => Some(FeatureKind::Aligned),
        _ => None,
    }
}

/// Returns the name of a feature recipe in cards.
pub fn recipe_name(recipe: FeatureKind) -> &'static str {
    match recipe {
        FeatureKind::Raw => "raw",
        FeatureKind::LogPower => "log-power",
        FeatureKind::Aligned => "aligned",
    }
}

/// Builds the blob. If something does not match, the error describes it.
pub fn build(card: &Card, layers: &[DenseSpec]) -> Result<Vec<u8>, String> {
    let recipe = recipe(&card.features)
        .ok_or_else(|| format!("features {:?} are not known here; update this program", card.features))?;
    let Some(first) = layers.first() else { return Err("there are no layers".to_owned()) };
    let scaling = card.scaling.mean.iter().zip(&card.scaling.deviation);
    let scaling = scaling
        .map(|(mean, deviation)| {
            let a = 1.0 / (f64::from(*deviation) * f64::from(first.input_scale));
            let b = f64::from(first.input_zero_point) - f64::from(*mean) * a;
            (a as f32, b as f32)
        })
        .collect();
    let spec = BlobSpec {
        recipe,
        axes: card.axes,
        sample_hz: card.rate_hz,
        window: card.window,
        hop: card.hop,
        labels: card.labels.clone(),
        scaling,
        layers: layers.to_vec(),
    };
    build_blob(&spec).map_err(|error| error.to_string())
}
