//! `models adapt`: teaches a model one more person from a few recordings.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use models::dataset::Dataset;
use models::evaluate::people::grade;
use models::train::Adaptable;

/// Teach a model (recipe aligned) one more person from a few recordings of each gesture
#[derive(Args)]
pub struct Cmd {
    /// The int8 .tflite file, with its card, .float.tflite and .memory.bin in the same folder
    model: PathBuf,
    /// Folder with files named <label>/<person>__<n>.csv
    folder: PathBuf,
    /// Person to whom the model is adapted, with this person's recordings
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
        let base = Adaptable::read(&self.model)?;
        let card = &base.model.card;
        let theirs =
            Dataset::read_where(&self.folder, Some(card.axes_needed()), |_, person| person == self.person)
                .with_context(|| format!("recordings of {:?} in {}", self.person, self.folder.display()))?;
        for label in card.labels.iter().filter(|label| !theirs.labels.contains(label)) {
            println!("no {label} of {}: there the model stays as it was", self.person);
        }
        let name = self.name.unwrap_or_else(|| format!("{}-{}", card.name, self.person));
        let adapted = base.adapted(&theirs, &self.person, name, self.seed)?;
        let limit = card.scaling.limit;
        let windows_of = |card: &models::card::Card| card.data.people.get(&self.person).copied();
        let windows = windows_of(&adapted.card).unwrap_or(0) - windows_of(card).unwrap_or(0);
        println!("{windows} windows of {} recordings", theirs.items.len());
        println!(
            "rehearsed windows of the people it knew: {:.2} % right before, {:.2} % now",
            base.memory.accuracy(&base.model.float, limit),
            base.memory.accuracy(&adapted.float, limit)
        );
        let (before, now) = (grade(&base.model, &theirs)?.accuracy(), grade(&adapted, &theirs)?.accuracy());
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
