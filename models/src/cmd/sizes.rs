//! `models sizes`: measures how much accuracy a smaller network loses.

use std::str::FromStr;
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
    /// How many networks of 20 and 10 units are merged into one
    #[arg(long, value_delimiter = ',', value_name = "N,N,...", default_value = "1,2,3,4")]
    members: Vec<usize>,
    /// Networks that learn from eight merged ones: hidden widths (a board's: 60-30)
    #[arg(long, value_delimiter = ',', value_name = "N-N,...", default_value = "40-20,60-30")]
    students: Vec<Student>,
    #[command(flatten)]
    axes: super::Axes,
    #[command(flatten)]
    short: super::Short,
}

/// Hidden widths of a network that learns from a larger one.
#[derive(Clone, Copy, Debug)]
struct Student([usize; 2]);

impl FromStr for Student {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let widths: Option<Vec<usize>> = text.split('-').map(|width| width.parse().ok()).collect();
        match widths.as_deref() {
            Some([first, second]) if (1..=128).contains(first) && (1..=128).contains(second) => {
                Ok(Self([*first, *second]))
            }
            _ => Err(format!("{text:?}: two widths from 1 to 128 are needed, such as 40-20")),
        }
    }
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
                "{:<22} {:>8} {:>8} {:>10} {:>12} {:>9} {:>9} {:>7}",
                "network", "blob, B", "zeros, B", "products", "recordings", "worst", "events", "false"
            );
            let usual = self.short.aligned();
            let merged = self.members.iter().map(|&members| {
                let recipe =
                    Aligned { steps: Steps { members, ..usual.steps }, student: None, ..usual.clone() };
                ("", recipe)
            });
            let students = self
                .students
                .iter()
                .map(|student| (" student", Aligned { student: Some(student.0), ..usual.clone() }));
            for (kind, recipe) in merged.chain(students) {
                let trial = Trial { folder: &set.folder, axes, labels: &set.labels, recipe: &recipe };
                let one = |(person, seed): (&String, u64)| -> anyhow::Result<_> {
                    let model = trial.without(person, seed)?;
                    let events = trial.events_of(&model, person, Pause::USUAL, seed)?;
                    let graded = trial.grade_of(&model, person)?;
                    Ok((graded, events, NetworkSize::of(&model)?, zeros_of(&model.int8_tflite)?))
                };
                let jobs: Vec<(&String, u64)> = people
                    .iter()
                    .flat_map(|person| (1..=self.seeds).map(move |seed| (person, seed)))
                    .collect();
                let runs = jobs.into_par_iter().map(one).collect::<anyhow::Result<Vec<_>>>()?;
                // The jobs of one person are in sequence.
                let each: Vec<f64> = runs
                    .chunks(self.seeds as usize)
                    .map(|runs| Graded::mean(runs.iter().map(|run| &run.0)).int8)
                    .collect();
                let mut all = Tally::default();
                runs.iter().for_each(|run| all.add(&run.1));
                let Some((_, _, size, zeros)) = runs.last() else { continue };
                let (name, bytes, products) = (size.shape() + kind, size.blob_bytes, size.products());
                println!(
                    "{name:<22} {bytes:>8} {zeros:>8} {products:>10} {:>12.2} {:>9.2} {:>9.2} {:>7}",
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
