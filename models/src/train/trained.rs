//! A trained model with its files.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::memory::Memory;
use super::quantise;
use crate::blob;
use crate::card::Card;
use crate::recording::write_whole;
use crate::tflite::{self, FloatLayer, Network};

/// The reason why a data set cannot be learned. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// There are fewer than two labels or too many, or the model's file cannot store a label.
    #[error("{0}")]
    Labels(String),
    /// A recording could not be read again, or a file could not be written.
    #[error("{file}: {source}; check the folder and the space on the disk")]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The training library failed.
    #[cfg(feature = "train")]
    #[error("training failed: {0}")]
    Candle(#[from] candle_core::Error),
    /// The trained weights cannot be quantised.
    #[error("the trained network cannot be quantised: {0}; try another --seed")]
    Quantise(String),
}

/// A trained model whose files are not yet written.
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
    /// The rows that `models adapt` needs about the training people. Only the recipe `aligned` has such rows.
    pub memory: Option<Memory>,
}

impl Trained {
    /// Creates the files of a trained network, and puts their checksums into the card.
    /// The inputs in `calibration` determine the int8 scales.
    pub(super) fn of(
        mut card: Card,
        float: Vec<FloatLayer>,
        calibration: &[&[f32]],
        memory: Option<Memory>,
    ) -> Result<Self, TrainError> {
        let int8 = quantise::quantise(&float, calibration, card.scaling.limit);
        let blob = blob::build(&card, &int8).map_err(TrainError::Quantise)?;
        card.model_id = blob::model_id(&blob);
        let int8_tflite = tflite::write(&Network::Int8(int8));
        card.tflite_sha256 = sha256(&int8_tflite);
        let float_tflite = tflite::write(&Network::Float(float.clone()));
        Ok(Self { card, float, float_tflite, int8_tflite, memory })
    }

    /// The blob that boards and bridge run.
    ///
    /// # Errors
    /// Fails if the weights cannot be converted to a blob.
    pub fn blob(&self) -> Result<Vec<u8>, TrainError> {
        match tflite::read(&self.int8_tflite) {
            Ok(Network::Int8(layers)) => blob::build(&self.card, &layers).map_err(TrainError::Quantise),
            _ => Err(TrainError::Quantise("the int8 file cannot be read back".to_owned())),
        }
    }

    /// Writes `NAME.tflite`, `NAME.float.tflite`, and `NAME.memory.bin` if there is one.
    /// The card `NAME.card.json` comes last.
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

/// Returns the SHA-256 of some bytes in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
