//! `models eval`: tests a model on a folder. The last line of output is the accuracy per recording.

use std::path::PathBuf;

use clap::Args;
use models::blob::ModelFiles;
use models::evaluate::score::{Classifier, score, scored};
use models::tflite::Network;
use shared_dsp::right::network::Model;

/// Test a model on a folder of recordings
#[derive(Args)]
pub struct Cmd {
    /// A .tflite file, float or int8, with its card in the same folder
    model: PathBuf,
    /// Folder with files named <label>/<person>__<n>.csv
    folder: PathBuf,
    /// Test only the recordings listed in this file, one <label>/<file> per line (as `train` writes it)
    #[arg(long, value_name = "FILE")]
    only: Option<PathBuf>,
    /// Test only this person's recordings (repeatable)
    #[arg(long, value_name = "PERSON")]
    person: Vec<String>,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        let files = ModelFiles::read(&self.model)?;
        let card = &files.card;
        println!("{}: {} ({})", self.model.display(), card.name, card.about);
        let mut dataset = super::read(&self.folder, Some(card.axes_needed()))?;
        if let Some(list) = &self.only {
            let text = std::fs::read_to_string(list)
                .map_err(|error| anyhow::anyhow!("{}: {error}; check the path", list.display()))?;
            let names: Vec<&str> = text.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
            for name in &names {
                let known = dataset.items.iter().any(|item| item.name == *name);
                anyhow::ensure!(known, "{}: {name} is not in {}", list.display(), self.folder.display());
            }
            dataset = dataset.filtered(|item| names.contains(&item.name.as_str()));
        }
        if !self.person.is_empty() {
            dataset = dataset.filtered(|item| self.person.contains(&item.person));
        }
        anyhow::ensure!(
            !dataset.items.is_empty(),
            "no recordings are left to score; check --only and --person"
        );
        for label in dataset.labels.iter().filter(|label| !card.labels.contains(label)) {
            println!("the model does not know {label:?}: its recordings count as wrong");
        }
        let recordings = scored(&dataset, &card.labels, &card.features);
        let padded = recordings.iter().filter(|recording| recording.padded).count();
        println!(
            "{padded} recordings shorter than the window were padded (going on as they went a period before)"
        );
        let answers = card.answers();
        let result = match &files.network {
            Network::Float(layers) => score(&Classifier::Float { card, layers }, &recordings, &answers),
            Network::Int8(_) => {
                let blob = files.blob().map_err(anyhow::Error::msg)?;
                score(&Classifier::Int8(Model::parse(&blob)?), &recordings, &answers)
            }
        };
        super::print_score(&result, &card.labels);
        println!("{:.2}", result.per_recording);
        Ok(())
    }
}
