//! `models adapt`: adapts a model to one person with a few recordings.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use models::blob::ModelFiles;
use models::daily::Daily;
use models::dataset::Dataset;
use models::evaluate::people::grade;
use models::tflite::{self, Network};
use models::train::{Memory, Trained, adapt, examples_of};

/// Teach a model (recipe aligned) one more person from a few recordings of each gesture
#[derive(Args)]
pub struct Cmd {
    /// The int8 .tflite file, with its card, .float.tflite and .memory.bin in the same folder
    model: PathBuf,
    /// Folder with <label>/<person>__<n>.csv
    folder: PathBuf,
    /// Person whose recordings are used
    #[arg(long)]
    person: String,
    /// Folder for the new model
    #[arg(long)]
    out: PathBuf,
    /// Name of the new model's files [default: the model's name and the person's]
    #[arg(long)]
    name: Option<String>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        let (model, memory) = read(&self.model)?;
        let card = &model.card;
        let theirs =
            Dataset::read_where(&self.folder, Some(card.axes_needed()), |_, person| person == self.person)
                .with_context(|| format!("recordings of {:?} in {}", self.person, self.folder.display()))?;
        let mut examples = Vec::new();
        for item in &theirs.items {
            let label = card.labels.iter().position(|label| *label == item.label);
            let label = label.with_context(|| {
                format!(
                    "{}: the model does not know {:?}, only {}",
                    item.file.display(),
                    item.label,
                    card.labels.join(", ")
                )
            })?;
            examples.extend(examples_of(&item.recording).into_iter().map(|window| (window, label)));
        }
        for label in card.labels.iter().filter(|label| !theirs.labels.contains(label)) {
            println!("no {label} of {}: there the model stays as it was", self.person);
        }
        let mut adapted = adapt(&model, &memory, &examples, &self.person, &Daily::All, self.seed)?;
        adapted.card.name = self.name.unwrap_or_else(|| format!("{}-{}", card.name, self.person));
        let limit = card.scaling.limit;
        println!("{} windows of {} recordings", examples.len(), theirs.items.len());
        println!(
            "rehearsed windows of the people it knew: {:.2} % right before, {:.2} % now",
            memory.accuracy(&model.float, limit),
            memory.accuracy(&adapted.float, limit)
        );
        let (before, now) = (grade(&model, &theirs)?.accuracy(), grade(&adapted, &theirs)?.accuracy());
        println!(
            "the shown recordings themselves: {:.2} % right before, {:.2} % now (int8)",
            before.int8, now.int8
        );
        for file in adapted.write(&self.out)? {
            println!("{}", file.display());
        }
        println!("model id {}", adapted.card.model_id);
        Ok(())
    }
}

/// Reads a model with all data for adapting it.
fn read(model: &Path) -> anyhow::Result<(Trained, Memory)> {
    let files = ModelFiles::read(model)?;
    anyhow::ensure!(
        files.card.features == "aligned",
        "{}: made with the features {:?}; only models of `models train --recipe aligned` can be adapted",
        model.display(),
        files.card.features
    );
    let beside = |ending: &str| -> anyhow::Result<Vec<u8>> {
        let file = model.with_file_name(format!("{}.{ending}", files.card.name));
        std::fs::read(&file)
            .with_context(|| format!("{}: needed beside the model, copy it there", file.display()))
    };
    let (float_tflite, int8_tflite) = (beside("float.tflite")?, beside("tflite")?);
    let Network::Float(float) = tflite::read(&float_tflite)? else {
        anyhow::bail!("{}.float.tflite is not a float model; train it again", files.card.name)
    };
    let memory = Memory::parse(&beside("memory.bin")?, &files.card)?;
    Ok((Trained { card: files.card, float, float_tflite, int8_tflite, memory: None }, memory))
}
