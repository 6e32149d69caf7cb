//! `models sizes`: measures how much accuracy a smaller network loses.

use std::time::Instant;

use clap::Args;
use models::evaluate::events::{Pause, Tally};
use models::evaluate::people::{Graded, Trial};
use models::report::NetworkSize;
use models::tflite::{Network, read};
use models::train::{Aligned, Steps};
use rayon::prelude::*;

use super::people::Set;

/// Hold out each person in turn, with networks of several sizes: flash, work and accuracy of each
#[derive(Args)]
pub struct Cmd {
    /// Folders with files named <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... tries only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Number of models per person, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// How many networks of 20 and 10 units are merged into one (a board's: 4)
    #[arg(long, value_delimiter = ',', value_name = "N,N,...", default_value = "1,2,3,4")]
    members: Vec<usize>,
    #[command(flatten)]
    axes: super::Axes,
    #[command(flatten)]
    short: super::Short,
}

/// Number of weights of an int8 network that are 0, which still need flash and multiplications.
fn zeros_of(tflite: &[u8]) -> anyhow::Result<usize> {
    let Network::Int8(layers) = read(tflite)? else { anyhow::bail!("this is no int8 network") };
    let weights = layers.iter().flat_map(|layer| layer.weights.iter().flatten());
    Ok(weights.filter(|weight| **weight == 0).count())
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        anyhow::ensure!(
            !self.members.is_empty() && self.members.iter().all(|count| (1..=8).contains(count)),
            "--members takes numbers from 1 to 8"
        );
        let start = Instant::now();
        let axes = self.axes.count();
        for set in &self.folders {
            let (people, what) = set.people(axes)?;
            println!("{what}, {} seeds, int8", self.seeds);
            println!(
                "{:<18} {:>8} {:>8} {:>10} {:>12} {:>9} {:>9} {:>7}",
                "network", "blob, B", "zeros, B", "products", "recordings", "worst", "events", "false"
            );
            for &members in &self.members {
                let usual = self.short.aligned();
                let recipe = Aligned { steps: Steps { members, ..usual.steps }, ..usual };
                let trial = Trial { folder: &set.folder, axes, labels: &set.labels, recipe: &recipe };
                let (mut each, mut all) = (Vec::new(), Tally::default());
                let (mut size, mut zeros) = (NetworkSize::default(), 0);
                for person in &people {
                    let one = |seed: u64| -> anyhow::Result<_> {
                        let model = trial.without(person, seed)?;
                        let events = trial.events_of(&model, person, Pause::USUAL, seed)?;
                        let graded = trial.grade_of(&model, person)?;
                        Ok((graded, events, NetworkSize::of(&model)?, zeros_of(&model.int8_tflite)?))
                    };
                    let runs = (1..=self.seeds)
                        .into_par_iter()
                        .map(one)
                        .collect::<anyhow::Result<Vec<(Graded, Tally, NetworkSize, usize)>>>()?;
                    each.push(Graded::mean(runs.iter().map(|run| &run.0)).int8);
                    for (_, tally, of_model, none) in runs {
                        all.add(&tally);
                        (size, zeros) = (of_model, none);
                    }
                }
                let (name, bytes, products) = (size.shape(), size.blob_bytes, size.products());
                println!(
                    "{name:<18} {bytes:>8} {zeros:>8} {products:>10} {:>12.2} {:>9.2} {:>9.2} {:>7}",
                    each.iter().sum::<f64>() / each.len().max(1) as f64,
                    each.iter().copied().fold(f64::INFINITY, f64::min),
                    all.right_per_cent(),
                    format!("{}/{}", all.rest_events, all.rests)
                );
            }
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}
