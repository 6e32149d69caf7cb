//! `models card`: updates the model id in a card after a change of the blob's format.

use std::path::PathBuf;

use clap::Args;
use models::blob;
use models::card::Card;
use models::recording::write_whole;
use models::tflite::{self, Network};
use models::train::sha256;

/// Update the model id in a model's card (needed when a new version changes the blob's format)
#[derive(Args)]
pub struct Cmd {
    /// The int8 .tflite file, with its card in the same folder
    model: PathBuf,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        let bytes = std::fs::read(&self.model)
            .map_err(|error| anyhow::anyhow!("{}: {error}; check the path", self.model.display()))?;
        let mut card = Card::read(&self.model)?;
        anyhow::ensure!(
            sha256(&bytes) == card.tflite_sha256,
            "{}: this is not the file that its card was written for; put the two together that belong together",
            self.model.display()
        );
        let network =
            tflite::read(&bytes).map_err(|error| anyhow::anyhow!("{}: {error}", self.model.display()))?;
        let Network::Int8(layers) = network else {
            anyhow::bail!("{}: this is the float model; give the int8 .tflite", self.model.display());
        };
        let before = card.model_id.clone();
        card.model_id = blob::model_id(&blob::build(&card, &layers).map_err(anyhow::Error::msg)?);
        write_whole(&Card::path(&self.model), card.to_json().as_bytes())?;
        println!("model id {before} -> {}", card.model_id);
        Ok(())
    }
}
