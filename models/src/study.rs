//! A whole comparison on one folder: every person held out in turn, a random fifth, and a few examples shown, for
//! several seeds. `models people` prints its rows, `models report` draws them: the same figures from the same code.

use rayon::prelude::*;

use crate::events::Tally;
use crate::people::{Accuracy, Graded, Shown, Trial, TrialError};

/// Everything that was tried with one recipe.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Name of the recipe.
    pub recipe: &'static str,
    /// The people, sorted.
    pub people: Vec<String>,
    /// Per person, per seed: models that have never met them.
    pub strangers: Vec<Vec<Graded>>,
    /// Per seed: a random fifth of the recordings, same people.
    pub random: Vec<Graded>,
    /// Per person, per seed, per number of examples. Empty with a recipe that cannot adapt.
    pub shown: Vec<Vec<Vec<Shown>>>,
}

/// A row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What was tested on.
    pub what: String,
    /// Right recordings in per cent, mean over the seeds.
    pub accuracy: Accuracy,
}

impl Study {
    /// Runs it with the seeds 1 to `seeds` and, for a recipe that can adapt, the numbers of examples `counts`, to which 0
    /// is added. `done` is called after each part.
    pub fn run(
        trial: &Trial<'_>,
        people: &[String],
        seeds: u64,
        counts: &[usize],
        done: impl Fn(&str) + Sync,
    ) -> Result<Self, TrialError> {
        let seeds = || (1..=seeds).into_par_iter();
        let mut strangers = Vec::new();
        for person in people {
            let one = |seed| trial.stranger(person, seed);
            strangers.push(seeds().map(one).collect::<Result<Vec<_>, _>>()?);
            done(&format!("{}: {person}, never met", trial.recipe.name));
        }
        let random = seeds().map(|seed| trial.random_split(seed)).collect::<Result<Vec<_>, _>>()?;
        done(&format!("{}: random fifth", trial.recipe.name));
        let mut shown = Vec::new();
        if trial.recipe.steps.is_some() && !counts.is_empty() {
            let mut counts = counts.to_vec();
            counts.push(0);
            counts.sort_unstable();
            counts.dedup();
            for person in people {
                let one = |seed| trial.shown(person, &counts, seed);
                shown.push(seeds().map(one).collect::<Result<Vec<_>, _>>()?);
                done(&format!("{}: {person}, examples shown", trial.recipe.name));
            }
        }
        Ok(Self { recipe: trial.recipe.name, people: people.to_vec(), strangers, random, shown })
    }

    /// Numbers of examples that were shown, 0 first.
    pub fn counts(&self) -> Vec<usize> {
        let first = self.shown.first().and_then(|seeds| seeds.first());
        first.map_or_else(Vec::new, |runs| runs.iter().map(|run| run.examples).collect())
    }

    /// For a number of examples (by its place): per person the runs of all seeds.
    pub fn shown_at(&self, place: usize) -> Vec<Vec<&Shown>> {
        self.shown.iter().map(|seeds| seeds.iter().map(|runs| &runs[place]).collect()).collect()
    }

    /// The table.
    pub fn rows(&self) -> Vec<Row> {
        let mut rows = Vec::new();
        let mut row = |what: String, accuracy| rows.push(Row { what, accuracy });
        let of_people: Vec<Accuracy> = self.strangers.iter().map(Graded::mean).collect();
        for (person, accuracy) in self.people.iter().zip(&of_people) {
            row(format!("{person}, never met"), *accuracy);
        }
        row("never met: mean".to_owned(), Accuracy::mean(&of_people));
        row("never met: worst".to_owned(), Accuracy::worst(&of_people));
        row("random fifth, same people".to_owned(), Graded::mean(&self.random));
        for (place, count) in self.counts().into_iter().enumerate() {
            let runs = self.shown_at(place);
            let mean = |pick: fn(&Shown) -> &Graded| -> Vec<Accuracy> {
                runs.iter().map(|runs| Graded::mean(runs.iter().map(|shown| pick(shown)))).collect()
            };
            let new = mean(|shown| &shown.new);
            row(format!("{count} shown per class: mean"), Accuracy::mean(&new));
            row(format!("{count} shown per class: worst"), Accuracy::worst(&new));
            row(format!("{count} shown, the others"), Accuracy::mean(&mean(|shown| &shown.old)));
        }
        rows
    }
}

/// Largest difference between float and int8 in a row, in points.
pub fn widest_gap(rows: &[Row]) -> f64 {
    rows.iter().map(|row| (row.accuracy.float - row.accuracy.int8).abs()).fold(0.0, f64::max)
}

/// What came of streams of people held out.
#[derive(Clone, Debug, PartialEq)]
pub struct Events {
    /// The people, sorted.
    pub people: Vec<String>,
    /// Per person, all seeds together: their recordings, joined.
    pub real: Vec<Tally>,
    /// Simulated wearers who make no gesture, for all models together.
    pub simulated: Tally,
}

impl Events {
    /// Plays every person's recordings to models that have never met them, with the seeds 1 to `seeds`, and `aimless_s`
    /// seconds of simulated wearers, shared out among the models of the first seed.
    pub fn run(
        trial: &Trial<'_>,
        people: &[String],
        seeds: u64,
        aimless_s: f64,
        done: impl Fn(&str) + Sync,
    ) -> Result<Self, TrialError> {
        let mut all = Self { people: people.to_vec(), real: Vec::new(), simulated: Tally::default() };
        for (index, person) in people.iter().enumerate() {
            let each_s = |seed: u64| if seed == 1 { aimless_s / people.len() as f64 } else { 0.0 };
            // Other simulated wearers for every model.
            let crowd = 1000 * (1 + index as u64);
            let runs: Vec<_> = (1..=seeds)
                .into_par_iter()
                .map(|seed| trial.events(person, each_s(seed), seed, crowd + seed))
                .collect::<Result<_, _>>()?;
            let mut real = Tally::default();
            for (of_person, of_simulated) in &runs {
                real.add(of_person);
                all.simulated.add(of_simulated);
            }
            all.real.push(real);
            done(&format!("{person}, never met"));
        }
        Ok(all)
    }

    /// All people together.
    pub fn together(&self) -> Tally {
        let mut sum = Tally::default();
        self.real.iter().for_each(|tally| sum.add(tally));
        sum
    }
}
