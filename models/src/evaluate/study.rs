//! A complete comparison on one folder for several seeds.
//! The study holds out each person, and then a random 20 % of the recordings.
//! It also tests models that have been shown a few examples.
//! `models people` prints its results, and `models report` draws the same figures.

use std::collections::BTreeMap;

use rayon::prelude::*;
use shared_dsp::right::movement::MovementConfig;

use crate::evaluate::events::{Pause, Tally};
use crate::evaluate::people::{Accuracy, Graded, Shown, Trial, TrialError};

/// All results of one recipe.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Name of the recipe.
    pub recipe: &'static str,
    /// The people, sorted.
    pub people: Vec<String>,
    /// Results by person and seed. Each result is for a model that was trained without that person.
    pub strangers: Vec<Vec<Graded>>,
    /// Results for a random 20 % of the same people's recordings, by seed.
    pub random: Vec<Graded>,
    /// Results by person, seed and number of examples. The list is empty if the recipe cannot adapt.
    pub shown: Vec<Vec<Vec<Shown>>>,
}

/// A row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What was tested.
    pub what: String,
    /// Mean percentage of correctly classified recordings, over all seeds.
    pub accuracy: Accuracy,
}

impl Study {
    /// Runs the comparison with the seeds 1 to `seeds`.
    /// A recipe that can adapt is also tested after each number of examples in `counts`,
    /// and without examples.
    /// `done` is called after each part.
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
            done(&format!("{}: {person}, never met", trial.recipe.name()));
        }
        let random = seeds().map(|seed| trial.random_split(seed)).collect::<Result<Vec<_>, _>>()?;
        done(&format!("{}: random fifth", trial.recipe.name()));
        let mut shown = Vec::new();
        if trial.recipe.adapts().is_some() && !counts.is_empty() {
            let mut counts = counts.to_vec();
            counts.push(0);
            counts.sort_unstable();
            counts.dedup();
            for person in people {
                let one = |seed| trial.shown(person, &counts, seed);
                shown.push(seeds().map(one).collect::<Result<Vec<_>, _>>()?);
                done(&format!("{}: {person}, examples shown", trial.recipe.name()));
            }
        }
        Ok(Self { recipe: trial.recipe.name(), people: people.to_vec(), strangers, random, shown })
    }

    /// Numbers of shown examples, starting with 0.
    pub fn counts(&self) -> Vec<usize> {
        let first = self.shown.first().and_then(|seeds| seeds.first());
        first.map_or_else(Vec::new, |runs| runs.iter().map(|run| run.examples).collect())
    }

    /// Results of all seeds by person, for the number of examples at this index of the list.
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

    /// Returns recordings of unknown people that most models misclassify. The errors with the highest certainty come first.
    pub fn doubts(&self) -> Vec<Doubt> {
        let mut doubts: BTreeMap<&str, Doubt> = BTreeMap::new();
        for runs in &self.strangers {
            for (run, answer) in
                runs.iter().flat_map(|run| run.answers.iter().map(move |answer| (run, answer)))
            {
                let doubt = doubts.entry(&answer.recording).or_insert_with(|| Doubt {
                    recording: answer.recording.clone(),
                    models: runs.len(),
                    given: BTreeMap::new(),
                });
                if !answer.right {
                    let given = doubt.given.entry(run.labels[answer.label].clone()).or_default();
                    given.push(answer.probability);
                }
            }
        }
        let mut doubts: Vec<Doubt> =
            doubts.into_values().filter(|doubt| 2 * doubt.wrong() > doubt.models).collect();
        doubts.sort_by(|a, b| b.sureness().total_cmp(&a.sureness()));
        doubts
    }
}

/// A recording that models misclassify, whose label may be wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Doubt {
    /// Name of the recording in the data set.
    pub recording: String,
    /// Number of models that classified the recording.
    pub models: usize,
    /// Incorrect answers, and the probability of each.
    pub given: BTreeMap<String, Vec<f32>>,
}

impl Doubt {
    /// Number of models that gave an incorrect answer.
    pub fn wrong(&self) -> usize {
        self.given.values().map(Vec::len).sum()
    }

    /// Mean probability of incorrect answers over all models; a correct answer counts as 0.
    pub fn sureness(&self) -> f32 {
        self.given.values().flatten().sum::<f32>() / self.models.max(1) as f32
    }
}

/// Largest difference between float and int8 in a row, in percentage points.
pub fn widest_gap(rows: &[Row]) -> f64 {
    rows.iter().map(|row| (row.accuracy.float - row.accuracy.int8).abs()).fold(0.0, f64::max)
}

/// Events in the recordings of held-out people, joined for each person.
#[derive(Clone, Debug, PartialEq)]
pub struct Events {
    /// The people, sorted.
    pub people: Vec<String>,
    /// Results for the joined recordings of each person, over all seeds.
    pub real: Vec<Tally>,
    /// Results for simulated wearers who make no gesture, over all models.
    pub simulated: Tally,
    /// Results for other thresholds (maximum probability of rest, in 256ths), for all people and for simulated wearers.
    pub trade: Vec<(u8, Tally, Tally)>,
}

impl Events {
    /// Plays every person's recordings with models that were trained without this person.
    /// It trains these models once for each random seed from 1 to `seeds`.
    /// The models of the first seed also share `aimless_s` seconds of simulated wearers.
    pub fn run(
        trial: &Trial<'_>,
        people: &[String],
        seeds: u64,
        aimless_s: f64,
        max_rest: &[u8],
        pause: Pause,
        done: impl Fn(&str) + Sync,
    ) -> Result<Self, TrialError> {
        let trade = max_rest.iter().map(|&max_rest| (max_rest, Tally::default(), Tally::default())).collect();
        let mut all = Self { people: people.to_vec(), real: Vec::new(), simulated: Tally::default(), trade };
        let axes = trial.axes()?;
        // The board's own threshold comes first.
        let tried: Vec<u8> = std::iter::once(MovementConfig::for_axes(axes).max_rest)
            .chain(max_rest.iter().copied())
            .collect();
        for (index, person) in people.iter().enumerate() {
            let each_s = |seed: u64| if seed == 1 { aimless_s / people.len() as f64 } else { 0.0 };
            // Each model gets different simulated wearers.
            let crowd = 1000 * (1 + index as u64);
            let runs: Vec<_> = (1..=seeds)
                .into_par_iter()
                .map(|seed| trial.events(person, each_s(seed), seed, crowd + seed, &tried, pause))
                .collect::<Result<_, _>>()?;
            let mut real = Tally::default();
            for run in &runs {
                let Some(((of_person, of_simulated), others)) = run.split_first() else { continue };
                real.add(of_person);
                all.simulated.add(of_simulated);
                for ((_, people, simulated), (of_person, of_simulated)) in all.trade.iter_mut().zip(others) {
                    people.add(of_person);
                    simulated.add(of_simulated);
                }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::card::Scores;
    use crate::evaluate::people::Answer;

    /// Creates a run from answers. Each answer has the recording, the given label, the probability and its correctness.
    fn run(answers: &[(&str, usize, f32, bool)]) -> Graded {
        let answer = |&(recording, label, probability, right): &(&str, usize, f32, bool)| Answer {
            recording: recording.to_owned(),
            label,
            probability,
            right,
        };
        Graded {
            labels: ["circle", "other", "wave"].map(String::from).to_vec(),
            scores: Scores::default(),
            answers: answers.iter().map(answer).collect(),
        }
    }

    #[test]
    fn a_recording_is_doubted_when_most_models_take_it_for_something_else() {
        let strangers = vec![
            vec![
                run(&[("wave/a__1.csv", 2, 0.9, true), ("other/a__1.csv", 2, 0.6, false)]),
                run(&[("wave/a__1.csv", 0, 0.9, false), ("other/a__1.csv", 0, 0.3, false)]),
            ],
            vec![run(&[("circle/b__1.csv", 1, 0.8, false)]), run(&[("circle/b__1.csv", 1, 0.6, false)])],
        ];
        let study = Study {
            recipe: "aligned",
            people: vec!["a".to_owned(), "b".to_owned()],
            strangers,
            random: Vec::new(),
            shown: Vec::new(),
        };
        let doubts = study.doubts();
        let names: Vec<&str> = doubts.iter().map(|doubt| doubt.recording.as_str()).collect();
        assert_eq!(
            names,
            ["circle/b__1.csv", "other/a__1.csv"],
            "half of the models is not most; the surest first"
        );
        assert_eq!((doubts[0].wrong(), doubts[0].models), (2, 2));
        assert!((doubts[0].sureness() - 0.7).abs() < 1e-6);
        assert_eq!(doubts[1].given.keys().collect::<Vec<_>>(), ["circle", "wave"]);
    }
}
