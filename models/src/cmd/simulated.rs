//! `models simulated`: compares simulated wearers with real people.

use std::time::Instant;

use clap::Args;
use models::evaluate::people::{Accuracy, Graded, from_simulated};
use rayon::prelude::*;

use super::RecipeName;
use super::people::Set;

/// Train on simulated wearers only and test on real recordings whose labels the simulator supports
#[derive(Args)]
pub struct Cmd {
    /// Folders with files named <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Number of models per row, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Recipe for the training
    #[arg(long, value_enum, default_value = "aligned")]
    recipe: RecipeName,
    /// Labels of the models: LABEL,LABEL,... [default: the four of real recordings, then the paper's seven]
    #[arg(long, value_delimiter = ',')]
    labels: Vec<String>,
    #[command(flatten)]
    axes: super::Axes,
    /// Simulated wearers to train on
    #[arg(long, default_value_t = 40)]
    wearers: u32,
}

/// Labels of the simulator for which real recordings exist.
const REAL: [&str; 4] = ["idle", "up-down", "left-right", "circle"];

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0 && self.wearers > 0, "--seeds and --wearers take a number above 0");
        let start = Instant::now();
        let axes = self.axes.count();
        let known: Vec<Vec<String>> = match self.labels.as_slice() {
            [] => [REAL.as_slice(), &models::labels::PAPER]
                .map(|labels| labels.iter().map(|label| (*label).to_owned()).collect())
                .into(),
            labels => vec![labels.iter().map(|label| models::labels::canonical(label)).collect()],
        };
        println!("trained on {} simulated wearers only; right real recordings in per cent", self.wearers);
        for labels in &known {
            println!("models that know {}", labels.join(" "));
            for set in &self.folders {
                let all = set.read(axes)?;
                let real = all.filtered(|item| labels.contains(&item.label));
                if real.items.is_empty() {
                    println!("{}: none of these labels", set.folder.display());
                    continue;
                }
                let runs: Vec<Graded> = (1..=self.seeds)
                    .into_par_iter()
                    .map(|seed| from_simulated(self.recipe.0, self.wearers, labels, &real, seed))
                    .collect::<Result<_, _>>()?;
                let accuracy: Accuracy = Graded::mean(&runs);
                println!(
                    "{}, {} axes, {} recordings of {}: float {:.2}, int8 {:.2}",
                    set.folder.display(),
                    real.axes,
                    real.items.len(),
                    real.labels.join(" "),
                    accuracy.float,
                    accuracy.int8
                );
                let labels = &runs[0].labels;
                for (truth, label) in
                    labels.iter().enumerate().filter(|(_, label)| real.labels.contains(label))
                {
                    let sum = |given: usize| {
                        runs.iter().map(|run| run.scores.int8.confusion[truth][given]).sum::<usize>()
                    };
                    let given: Vec<String> = (0..labels.len())
                        .filter(|given| sum(*given) > 0)
                        .map(|given| format!("{} {}", labels[given], sum(given)))
                        .collect();
                    println!("  {label} taken for: {}", given.join(", "));
                }
            }
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}
