//! The commands of the program, and the parts that they share.

pub mod adapt;
pub mod card;
pub mod daily;
pub mod daily_simulated;
pub mod eval;
pub mod events;
pub mod import;
pub mod infer;
pub mod people;
pub mod report;
pub mod simulated;
pub mod sizes;
pub mod splits;
pub mod synth;
pub mod tempo;
pub mod train;

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use models::card::Score;
use models::dataset::Dataset;
use models::train::{ALIGNED, Aligned, Recipe, recipes};

/// The training recipe: one of [`recipes::ALL`].
#[derive(Clone, Copy, Debug)]
pub struct RecipeName(pub &'static dyn Recipe);

impl ValueEnum for RecipeName {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<RecipeName>> =
            LazyLock::new(|| recipes::ALL.iter().map(|recipe| RecipeName(*recipe)).collect());
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()).help(self.0.about()))
    }
}

/// Options that shorten the training and make the result worse.
#[derive(Args)]
pub struct Short {
    /// Number of training steps of recipe aligned, for quick experiments [default: that of the recipe]
    #[arg(long, value_name = "N")]
    steps: Option<usize>,
}

impl Short {
    /// Returns the recipe with the requested number of steps.
    pub fn shorten(&self, recipe: &dyn Recipe) -> Box<dyn Recipe> {
        recipe.shortened(self.steps)
    }

    /// Returns recipe aligned with the requested number of steps. The caller can change its settings.
    pub fn aligned(&self) -> Aligned {
        ALIGNED.with_steps(self.steps)
    }
}

/// The number of axes used in each sample.
#[derive(Args)]
pub struct Axes {
    /// Use only the first 3, 6 or 9 axes [default: all axes common to the recordings]
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(["3", "6", "9"]))]
    axes: Option<String>,
}

impl Axes {
    /// Returns the requested number, or `None` for all axes common to the recordings.
    pub fn count(&self) -> Option<usize> {
        self.axes.as_deref().and_then(|text| text.parse().ok())
    }
}

/// The recordings, and the options for training.
#[derive(Args)]
pub struct Source {
    /// Folder with files named <label>/<person>__<n>.csv
    pub folder: PathBuf,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Recipe for the training
    #[arg(long, value_enum, default_value = "aligned")]
    recipe: RecipeName,
    #[command(flatten)]
    short: Short,
    #[command(flatten)]
    axes: Axes,
    /// Exclude all recordings of this person (repeatable)
    #[arg(long, value_name = "PERSON")]
    pub exclude_person: Vec<String>,
}

impl Source {
    pub fn recipe(&self) -> Box<dyn Recipe> {
        self.short.shorten(self.recipe.0)
    }

    /// Returns the recordings. Those of excluded people are not even opened.
    pub fn dataset(&self) -> anyhow::Result<Dataset> {
        let axes = self.axes.count();
        let people = Dataset::people_of(&self.folder)?;
        for person in &self.exclude_person {
            anyhow::ensure!(
                people.contains(person),
                "{}: nobody is called {person:?}; the people are {}",
                self.folder.display(),
                people.join(", ")
            );
        }
        read_where(&self.folder, axes, |person| {
            !self.exclude_person.iter().any(|left_out| left_out == person)
        })
    }
}

/// Reads a folder and prints its contents, including unused files.
pub fn read(folder: &Path, axes: Option<usize>) -> anyhow::Result<Dataset> {
    read_where(folder, axes, |_| true)
}

/// Like [`read`], but only for selected people.
fn read_where(folder: &Path, axes: Option<usize>, person: impl Fn(&str) -> bool) -> anyhow::Result<Dataset> {
    let dataset = Dataset::read_where(folder, axes, |_, name| person(name))?;
    println!(
        "{}: {} recordings, {:.1} min, {} axes, labels {}, people {}",
        folder.display(),
        dataset.items.len(),
        dataset.items.iter().map(|item| item.recording.seconds()).sum::<f64>() / 60.0,
        dataset.axes,
        dataset.labels.join(" "),
        match dataset.people() {
            people if people.len() > 12 => people.len().to_string(),
            people => people.join(" "),
        }
    );
    if dataset.narrowed > 0 {
        println!("{} recordings have more axes, which are not used", dataset.narrowed);
    }
    for file in &dataset.ignored {
        println!("not a recording, left out: {}", file.display());
    }
    let folders: std::collections::BTreeSet<&str> =
        dataset.items.iter().filter_map(|item| item.name.split('/').next()).collect();
    for folder in folders.into_iter().filter(|folder| models::labels::is_no_gesture(folder)) {
        println!("{folder} is taken to be no gesture (other); rename the folder if it is one");
    }
    let noted: Vec<_> = dataset.items.iter().filter(|item| !item.recording.notes().is_empty()).collect();
    for item in noted.iter().take(3) {
        println!("{}: {}", item.name, item.recording.notes().join("; "));
    }
    if noted.len() > 3 {
        println!("and the like of {} more recordings", noted.len() - 3);
    }
    let gaps = dataset.items.iter().filter(|item| item.recording.gaps() > 0).count();
    if gaps > 0 {
        println!("{gaps} recordings have gaps in time, which are bridged by straight lines");
    }
    Ok(dataset)
}

/// Prints a score: windows, confusion of recordings, people, and finally the accuracy per recording.
pub fn print_score(score: &Score, labels: &[String]) {
    println!("per window (stride 1 s): {:.2} %", score.per_window);
    let width = labels.iter().map(String::len).max().unwrap_or(0).max(5);
    println!("recordings by true label (rows) and given label (columns):");
    println!("{:width$} {}", "", labels.iter().map(|l| format!("{l:>width$}")).collect::<Vec<_>>().join(" "));
    for (label, row) in labels.iter().zip(&score.confusion) {
        println!(
            "{label:width$} {}",
            row.iter().map(|n| format!("{n:>width$}")).collect::<Vec<_>>().join(" ")
        );
    }
    if score.per_person.len() <= 12 {
        for (person, right) in &score.per_person {
            println!("person {person}: {right:.2} %");
        }
    } else if let Some((person, right)) = score.per_person.iter().min_by(|a, b| a.1.total_cmp(b.1)) {
        println!("{} people, worst {person}: {right:.2} %", score.per_person.len());
    }
    println!("accuracy per recording: {:.2} %", score.per_recording);
}
