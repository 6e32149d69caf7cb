//! `models tempo`: plays the recordings of held-out people slower and faster.

use std::time::Instant;

use clap::Args;
use models::dataset::{Dataset, Item};
use models::evaluate::people::{Accuracy, Trial};
use models::evaluate::tempo::{at_tempo, range_of, strokes_per_second};
use rayon::prelude::*;
use shared_words::is_rest;

use super::people::Set;

/// Hold out each person in turn and play their gestures slower and faster, with the matching forces
#[derive(Args)]
pub struct Cmd {
    /// Folders with files named <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Number of models per person, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Tempos, relative to the recordings
    #[arg(long, value_delimiter = ',', value_name = "F,F,...", default_value = "0.5,0.7,1,1.4,2")]
    tempo: Vec<f64>,
    #[command(flatten)]
    axes: super::Axes,
    #[command(flatten)]
    short: super::Short,
}

/// Only recordings with this number of strokes per second count.
const STROKES_HZ: std::ops::RangeInclusive<f64> = 0.5..=5.0;

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        anyhow::ensure!(
            self.tempo.iter().all(|f| (0.1..=10.0).contains(f)),
            "--tempo takes numbers from 0.1 to 10"
        );
        let start = Instant::now();
        let axes = self.axes.count();
        let recipe = self.short.aligned();
        for set in &self.folders {
            let (people, what) = set.people(axes)?;
            println!("{what}");
            println!(
                "right gestures of people never met in per cent (int8), mean and worst person of {} seeds",
                self.seeds
            );
            let trial = Trial { folder: &set.folder, axes, labels: &set.labels, recipe: &recipe };
            let all = set.read(axes)?;
            let range = range_of(all.items.iter().map(|item| &item.recording));
            // The recordings as played at each tempo.
            let played: Vec<Dataset> = self.tempo.iter().map(|factor| at(&all, *factor, range)).collect();
            let jobs: Vec<(&String, u64)> =
                people.iter().flat_map(|person| (1..=self.seeds).map(move |seed| (person, seed))).collect();
            let one = |(person, seed): &(&String, u64)| -> anyhow::Result<Vec<Option<Accuracy>>> {
                let model = trial.without(person, *seed)?;
                let judge = |set: &Dataset| {
                    let theirs = set.filtered(|item| item.person == **person);
                    let graded = (!theirs.items.is_empty()).then(|| trial.grade(&model, &theirs));
                    Ok(graded.transpose()?.map(|graded| graded.accuracy()))
                };
                played.iter().map(judge).collect()
            };
            let runs = jobs.par_iter().map(one).collect::<anyhow::Result<Vec<_>>>()?;
            for (place, (factor, set)) in self.tempo.iter().zip(&played).enumerate() {
                let of = |person: &String| -> Vec<Accuracy> {
                    let mine = jobs.iter().zip(&runs).filter(|((name, _), _)| *name == person);
                    mine.filter_map(|(_, run)| run[place]).collect()
                };
                let each: Vec<(&String, usize, Accuracy)> = people
                    .iter()
                    .map(|person| {
                        (
                            person,
                            set.items.iter().filter(|item| item.person == *person).count(),
                            Accuracy::mean(&of(person)),
                        )
                    })
                    .filter(|(_, count, _)| *count > 0)
                    .collect();
                let total: usize = each.iter().map(|(_, count, _)| count).sum();
                let right: f64 = each.iter().map(|(_, count, a)| *count as f64 * a.int8).sum::<f64>()
                    / total.max(1) as f64;
                let persons: Vec<String> = each
                    .iter()
                    .map(|(person, count, a)| format!("{person} {:.1} of {count}", a.int8))
                    .collect();
                println!("tempo {factor:<4} {right:6.2} % of {total} recordings: {}", persons.join(", "));
            }
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}

/// Returns the gestures of a data set at another tempo, omitting tempos that hands do not have.
fn at(all: &Dataset, factor: f64, range: f64) -> Dataset {
    let gestures = all.filtered(|item| !is_rest(&item.label));
    // Movements labelled `other` are left out: the strongest of them saturate the sensor.
    let items = gestures.items.par_iter().filter_map(|item| {
        let hz = strokes_per_second(&item.recording)?;
        STROKES_HZ.contains(&(hz * factor)).then(|| {
            let recording =
                if factor == 1.0 { item.recording.clone() } else { at_tempo(&item.recording, factor, range) };
            Item { recording, ..item.clone() }
        })
    });
    Dataset { items: items.collect(), ..gestures.clone() }
}
