//! `models people`: holds out each person in turn. It also tests random splits and models that were shown examples.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use clap::Args;
use indicatif::ProgressBar;
use models::dataset::Dataset;
use models::evaluate::people::Trial;
use models::evaluate::study::{Study, widest_gap};
use models::train::{ALIGNED, PAPER, Recipe};

use super::RecipeName;

/// Hold out each person in turn and test models trained without this person
#[derive(Args)]
pub struct Cmd {
    /// Folders with files named <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Number of models per row, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Recipes to compare (repeatable) [default: paper and aligned]
    #[arg(long, value_enum)]
    recipe: Vec<RecipeName>,
    #[command(flatten)]
    axes: super::Axes,
    /// Also adapt models to each person with this many examples of 2 s per class (recipe aligned)
    #[arg(long, value_delimiter = ',', value_name = "N,N,...", default_value = "1,3,10")]
    examples: Vec<usize>,
    #[command(flatten)]
    short: super::Short,
}

/// A folder and the labels to use; an empty list means all labels.
#[derive(Clone, Debug)]
pub struct Set {
    pub folder: PathBuf,
    pub labels: Vec<String>,
}

impl FromStr for Set {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let whole = PathBuf::from(text);
        Ok(match text.rsplit_once(':') {
            Some((folder, labels)) if !whole.exists() => Self {
                folder: folder.into(),
                labels: labels.split(',').map(models::labels::canonical).collect(),
            },
            _ => Self { folder: whole, labels: Vec::new() },
        })
    }
}

impl Set {
    /// Reads the selected part of the folder.
    pub fn read(&self, axes: Option<usize>) -> anyhow::Result<Dataset> {
        Ok(Dataset::read_where(&self.folder, axes, |label, _| {
            self.labels.is_empty() || self.labels.iter().any(|wanted| wanted == label)
        })?)
    }

    /// Returns the folder's people (at least two), and a line of text that describes them.
    pub fn people(&self, axes: Option<usize>) -> anyhow::Result<(Vec<String>, String)> {
        let known = self.read(axes)?;
        let people = known.people();
        anyhow::ensure!(
            people.len() >= 2,
            "{}: recordings of {} person(s); at least 2 are needed to hold one out",
            self.folder.display(),
            people.len()
        );
        let what = format!(
            "{}: {} recordings, labels {}, {} axes",
            self.folder.display(),
            known.items.len(),
            known.labels.join(" "),
            known.axes
        );
        Ok((people, what))
    }
}

/// Returns the recipes to compare: those named by the user, or the paper's and the best.
pub fn recipes(names: &[RecipeName], short: &super::Short) -> Vec<Box<dyn Recipe>> {
    let usual = [RecipeName(&PAPER), RecipeName(&ALIGNED)];
    let names = if names.is_empty() { &usual } else { names };
    names.iter().map(|name| short.shorten(name.0)).collect()
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        let start = Instant::now();
        let axes = self.axes.count();
        let mut all = Vec::new();
        for set in &self.folders {
            let (people, what) = set.people(axes)?;
            println!("{what}");
            println!("right recordings in per cent, mean of {} seeds", self.seeds);
            println!("{:<9} {:<28} {:>8} {:>8}", "recipe", "tested on", "float", "int8");
            for recipe in recipes(&self.recipe, &self.short) {
                let trial = Trial { folder: &set.folder, axes, labels: &set.labels, recipe: &*recipe };
                let progress = ProgressBar::new_spinner();
                let done = |what: &str| {
                    progress.set_message(what.to_owned());
                    progress.tick();
                };
                let study = Study::run(&trial, &people, self.seeds, &self.examples, done)?;
                progress.finish_and_clear();
                let rows = study.rows();
                for row in &rows {
                    let a = row.accuracy;
                    println!("{:<9} {:<28} {:>8.2} {:>8.2}", recipe.name(), row.what, a.float, a.int8);
                }
                if recipe.adapts().is_some() {
                    all.extend(rows);
                }
            }
        }
        if !all.is_empty() {
            println!(
                "largest difference of int8 and float in a row of recipe aligned: {:.2} points",
                widest_gap(&all)
            );
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}
