//! The model that is bundled with this project. It was trained on simulated wearers only.
//! The paper's recordings of its seven gestures are not public.
//! The card states this, and every place that shows the model must also state it.

use std::path::Path;

use crate::blob::{ModelError, ModelFiles};
use crate::card::Card;

/// `right-aligned.tflite`.
pub const TFLITE: &[u8] = include_bytes!("../bundled/right-aligned.tflite");
/// `right-aligned.card.json`.
pub const CARD: &[u8] = include_bytes!("../bundled/right-aligned.card.json");
/// The file `right-aligned.float.tflite`, which `adapt` needs to add one more person.
#[cfg(feature = "adapt")]
pub const FLOAT: &[u8] = include_bytes!("../bundled/right-aligned.float.tflite");
/// The file `right-aligned.memory.bin`, which `adapt` also needs.
#[cfg(feature = "adapt")]
pub const MEMORY: &[u8] = include_bytes!("../bundled/right-aligned.memory.bin");

/// The bundled model and its card.
pub fn files() -> Result<ModelFiles, ModelError> {
    let file = Path::new("right-aligned.tflite");
    ModelFiles::new(file, TFLITE, Card::parse(&Card::path(file), CARD)?)
}

/// Returns the blob of the bundled model, which boards and bridge run.
pub fn blob() -> Result<Vec<u8>, ModelError> {
    files()?.blob().map_err(|what| ModelError::Mismatch { file: "right-aligned.tflite".into(), what })
}
