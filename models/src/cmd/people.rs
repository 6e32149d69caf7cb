//! `models people`: each person held out in turn, random splits, and a few examples shown.

use std::path::PathBuf;

use clap::Args;
use models::dataset::Dataset;
use models::people::{Accuracy, Shown, Trial};
use rayon::prelude::*;

use super::RecipeName;

/// Hold out each person in turn and print how models do that have never met them
#[derive(Args)]
pub struct Cmd {
    /// Folder with <label>/<person>__<n>.csv
    folder: PathBuf,
    /// Models per row, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Recipes to compare (repeatable) [default: paper and aligned]
    #[arg(long, value_enum)]
    recipe: Vec<RecipeName>,
    /// Use only these labels (repeatable) [default: all]
    #[arg(long, value_name = "LABEL")]
    label: Vec<String>,
    /// Use only the first 3, 6 or 9 axes [default: all that every recording has]
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(["3", "6", "9"]))]
    axes: Option<String>,
    /// Also adapt to each person with so many examples of 2 s per class (recipe aligned)
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    examples: Vec<usize>,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        let people = Dataset::people_of(&self.folder)?;
        let labels: Vec<String> = self.label.iter().map(|label| models::labels::canonical(label)).collect();
        let axes = self.axes.as_deref().and_then(|text| text.parse().ok());
        let known = Dataset::read_where(&self.folder, axes, |label, _| {
            labels.is_empty() || labels.iter().any(|l| l == label)
        })?;
        let people: Vec<String> =
            people.into_iter().filter(|person| known.people().contains(person)).collect();
        anyhow::ensure!(
            people.len() >= 2,
            "{}: recordings of {} person(s); at least 2 are needed to hold one out",
            self.folder.display(),
            people.len()
        );
        println!(
            "{}: {} recordings, labels {}, {} axes",
            self.folder.display(),
            known.items.len(),
            known.labels.join(" "),
            known.axes
        );
        drop(known);
        println!("right recordings in per cent, mean of {} seeds", self.seeds);
        println!("{:<8} {:<28} {:>8} {:>8}", "recipe", "tested on", "float", "int8");
        let names = match self.recipe.as_slice() {
            [] => vec![RecipeName::Paper, RecipeName::Aligned],
            names => names.to_vec(),
        };
        for name in names {
            let recipe = name.recipe();
            let trial = Trial { folder: &self.folder, axes, labels: &labels, recipe: &recipe };
            let row = |what: &str, a: Accuracy| {
                println!("{:<8} {what:<28} {:>8.2} {:>8.2}", recipe.name, a.float, a.int8)
            };
            let seeds = || (1..=self.seeds).into_par_iter();
            let strangers = people.iter().map(|person| {
                let all = seeds().map(|seed| trial.stranger(person, seed)).collect::<Result<Vec<_>, _>>()?;
                row(&format!("{person}, never met"), Accuracy::mean(&all));
                Ok(Accuracy::mean(&all))
            });
            summary(&row, "never met", &strangers.collect::<anyhow::Result<Vec<_>>>()?);
            let splits = seeds().map(|seed| trial.random_split(seed)).collect::<Result<Vec<_>, _>>()?;
            row("random fifth, same people", Accuracy::mean(&splits));
            if self.examples.is_empty() || recipe.steps.is_none() {
                continue;
            }
            let mut counts = self.examples.clone();
            counts.insert(0, 0);
            let mut of_person: Vec<Vec<Vec<Shown>>> = Vec::new();
            for person in &people {
                of_person
                    .push(seeds().map(|seed| trial.shown(person, &counts, seed)).collect::<Result<_, _>>()?);
            }
            for (index, count) in counts.iter().enumerate() {
                let mean = |runs: &Vec<Vec<Shown>>, pick: fn(&Shown) -> Accuracy| {
                    Accuracy::mean(&runs.iter().map(|run| pick(&run[index])).collect::<Vec<_>>())
                };
                let new: Vec<_> = of_person.iter().map(|runs| mean(runs, |shown| shown.new)).collect();
                let old: Vec<_> = of_person.iter().map(|runs| mean(runs, |shown| shown.old)).collect();
                summary(&row, &format!("{count} shown per class"), &new);
                row(&format!("{count} shown, the others"), Accuracy::mean(&old));
            }
        }
        Ok(())
    }
}

/// Mean and worst of several people.
fn summary(row: &impl Fn(&str, Accuracy), what: &str, people: &[Accuracy]) {
    row(&format!("{what}: mean"), Accuracy::mean(people));
    let worst = |pick: fn(&Accuracy) -> f64| people.iter().map(pick).fold(f64::INFINITY, f64::min);
    row(&format!("{what}: worst"), Accuracy { float: worst(|a| a.float), int8: worst(|a| a.int8) });
}
