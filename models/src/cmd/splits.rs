//! `models splits`: trains and tests on several random splits by recording. This shows how uncertain one figure is.

use clap::Args;
use models::train::{Job, held_out, train};
use rayon::prelude::*;

/// Train on random splits by recording and print the accuracy of each and the mean
#[derive(Args)]
pub struct Cmd {
    #[command(flatten)]
    source: super::Source,
    /// Number of splits; split k has the seed SEED + k − 1
    #[arg(long, default_value_t = 5)]
    splits: u64,
    /// Fraction of the recordings that is held out for the test
    #[arg(long, default_value_t = 0.2)]
    test: f64,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.splits > 0, "--splits takes a number above 0");
        anyhow::ensure!((0.01..=0.9).contains(&self.test), "--test takes a share between 0.01 and 0.9");
        let dataset = self.source.dataset()?;
        let recipe = self.source.recipe();
        let one = |seed: u64| -> anyhow::Result<_> {
            let test = held_out(&dataset, self.test, seed);
            let job = Job {
                name: "split".to_owned(),
                about: String::new(),
                seed,
                excluded: self.source.exclude_person.clone(),
                progress: self.splits == 1,
            };
            let card = train(&dataset, &test, &*recipe, &job)?.card;
            let scores =
                card.test.ok_or_else(|| anyhow::anyhow!("no recordings to test on; raise --test"))?;
            eprintln!("seed {seed}: {} epochs", card.training.epochs);
            Ok((scores.float.per_recording, scores.int8.per_recording, scores.int8.per_window))
        };
        let seeds: Vec<u64> = (0..self.splits).map(|k| self.source.seed + k).collect();
        let results: Vec<_> = seeds.par_iter().map(|&seed| one(seed)).collect::<anyhow::Result<_>>()?;
        println!("accuracy per recording in per cent, {} recipe", recipe.name());
        println!("{:>6} {:>8} {:>8} {:>14}", "seed", "float", "int8", "int8 windows");
        for (seed, (float, int8, windows)) in seeds.iter().zip(&results) {
            println!("{seed:>6} {float:>8.2} {int8:>8.2} {windows:>14.2}");
        }
        let mean =
            |pick: fn(&(f64, f64, f64)) -> f64| results.iter().map(pick).sum::<f64>() / results.len() as f64;
        println!("{:>6} {:>8.2} {:>8.2} {:>14.2}", "mean", mean(|r| r.0), mean(|r| r.1), mean(|r| r.2));
        Ok(())
    }
}
