//! A model for tests that send one to a board.

use std::path::{Path, PathBuf};

use models::blob::{ModelFiles, model_id};
use models::card::Card;

/// Renames one label of the bundled model, which changes its blob and its id. Returns the new file and the id.
pub fn renamed_model(folder: &Path) -> (PathBuf, String) {
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/bundled/right-aligned.tflite");
    let bytes = std::fs::read(&bundled).unwrap();
    let mut card = Card::read(&bundled).unwrap();
    let place = card.labels.iter().position(|label| label == "circle").unwrap();
    card.labels[place] = "wave".to_owned();
    let files = ModelFiles { network: models::tflite::read(&bytes).unwrap(), card: card.clone() };
    card.model_id = model_id(&files.blob().unwrap());
    let file = folder.join("mine.tflite");
    std::fs::write(&file, bytes).unwrap();
    std::fs::write(folder.join("mine.card.json"), card.to_json()).unwrap();
    (file, card.model_id)
}
