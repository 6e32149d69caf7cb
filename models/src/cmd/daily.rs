//! `models daily`: real daily movement without gestures, for training and for tests.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, Subcommand};
use models::daily::{Daily, vectors};
use models::dataset::{Dataset, Item};
use models::evaluate::events::{AnnotatedRecording, Heard, Tally, decide, listen};
use models::evaluate::people::Trial;
use models::streams::RandomStream;
use models::train::{Aligned, Trained, adapt, examples_of, train};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use shared_dsp::right::movement::MovementConfig;
use shared_dsp::right::network::Model;

use super::people::Set;

/// Use real daily movement without gestures: train with it, or count false events in it
#[derive(Args)]
pub struct Cmd {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Write the feature vectors that every model learns
    Vectors {
        /// Folder with files named other/<person>__<n>.csv, accelerometer and gyroscope
        folder: PathBuf,
        /// The file to write
        #[arg(long)]
        out: PathBuf,
    },
    Events(Events),
    Simulated(super::daily_simulated::Cmd),
}

/// Count events in daily movement: train with half of its people, test with the other half, and vice versa
#[derive(Args)]
struct Events {
    /// Folder with files named other/<person>__<n>.csv of at least two people who make no gesture
    daily: PathBuf,
    /// Folders to train separate models on; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Also play the gestures in this folder, before and after the model has learned three of each from each person
    #[arg(long, value_name = "FOLDER[:LABEL,...]")]
    show: Option<Set>,
    /// Number of models per half, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Maximum probability of rest for an event, in 256ths; several values are compared [default: a board's]
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    max_rest: Vec<u8>,
    /// Print the name of each recording that caused an event
    #[arg(long)]
    errors: bool,
    /// Test models that have never learned daily movement
    #[arg(long)]
    untaught: bool,
    #[command(flatten)]
    short: super::Short,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        match self.verb {
            Verb::Vectors { folder, out } => {
                let bytes = vectors(&super::read(&folder, Some(6))?);
                models::recording::write_whole(&out, &bytes)?;
                println!("{}: {} bytes", out.display(), bytes.len());
                Ok(())
            }
            Verb::Events(events) => events.run(),
            Verb::Simulated(simulated) => simulated.run(),
        }
    }
}

/// The results of one model on all data, for each setting of the decision.
#[derive(Clone, Default)]
struct Outcome {
    /// Of daily movement.
    daily: Vec<Tally>,
    /// Results on the gestures in the folder.
    gestures: Vec<Tally>,
}

impl Outcome {
    fn add(&mut self, other: &Self) {
        for (mine, theirs) in [(&mut self.daily, &other.daily), (&mut self.gestures, &other.gestures)] {
            mine.resize_with(theirs.len().max(mine.len()), Tally::default);
            mine.iter_mut().zip(theirs).for_each(|(mine, theirs)| mine.add(theirs));
        }
    }
}

impl Events {
    fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        let start = Instant::now();
        let daily = Dataset::read(&self.daily, None)?;
        let people = daily.people();
        anyhow::ensure!(people.len() >= 2, "{}: only {} person(s)", self.daily.display(), people.len());
        let recipe = self.short.aligned();
        for set in &self.folders {
            let learned = Dataset::read_where(&set.folder, None, |label, _| {
                set.labels.is_empty()
                    || shared_words::is_rest(label)
                    || set.labels.iter().any(|wanted| wanted == label)
            })?;
            println!("{}: {} axes, labels {}", set.folder.display(), learned.axes, learned.labels.join(" "));
            let jobs: Vec<(usize, u64)> =
                (0..2).flat_map(|half| (1..=self.seeds).map(move |seed| (half, seed))).collect();
            let runs = jobs
                .par_iter()
                .map(|&(half, seed)| self.one(&learned, &recipe, &daily, &people, half, seed))
                .collect::<anyhow::Result<Vec<_>>>()?;
            let (mut before, mut after) = (Outcome::default(), Outcome::default());
            for (as_is, shown) in &runs {
                before.add(as_is);
                after.add(shown);
            }
            let settings = self.settings(learned.axes);
            let worst = |pick: fn(&(Outcome, Outcome)) -> &Outcome, place: usize| {
                runs.iter()
                    .filter_map(|run| pick(run).daily.get(place))
                    .map(|t| t.rest_events + t.stray_events)
                    .max()
            };
            for (place, config) in settings.iter().enumerate() {
                self.print(
                    "as it is",
                    config,
                    before.daily.get(place),
                    before.gestures.get(place),
                    worst(|r| &r.0, place),
                );
                self.print(
                    "shown",
                    config,
                    after.daily.get(place),
                    after.gestures.get(place),
                    worst(|r| &r.1, place),
                );
            }
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }

    fn print(
        &self,
        what: &str,
        config: &MovementConfig,
        daily: Option<&Tally>,
        gestures: Option<&Tally>,
        worst: Option<usize>,
    ) {
        let Some(daily) = daily else { return };
        let count = daily.rest_events + daily.stray_events;
        let (low, high) = interval(count);
        let hours = daily.rest_s / 3600.0;
        print!(
            "  {what:<9} rest below {:3}/256: {count} false events in {hours:.2} h (per hour {:.1}, 95 %: {:.1} to {:.1}), \
             most of one model {}",
            config.max_rest,
            count as f64 / hours,
            low / hours,
            high / hours,
            worst.unwrap_or(0)
        );
        if let Some(gestures) = gestures.filter(|tally| tally.performed > 0) {
            print!(
                "; of {} gestures {:.2} % exactly one right event, {} missed, {} wrong, {} several; {} in {} rests",
                gestures.performed,
                gestures.right_per_cent(),
                gestures.missed,
                gestures.wrong,
                gestures.several,
                gestures.rest_events,
                gestures.rests
            );
        }
        println!();
        if self.errors {
            daily.errors.iter().for_each(|error| println!("    {error}"));
        }
    }

    fn settings(&self, axes: usize) -> Vec<MovementConfig> {
        let usual = MovementConfig::for_axes(axes);
        match self.max_rest.as_slice() {
            [] => vec![usual],
            list => list.iter().map(|&max_rest| MovementConfig { max_rest, ..usual }).collect(),
        }
    }

    /// Trains a model on half of the people and tests it on the other half, before and after three examples.
    fn one(
        &self,
        learned: &Dataset,
        recipe: &Aligned,
        daily: &Dataset,
        people: &[String],
        half: usize,
        seed: u64,
    ) -> anyhow::Result<(Outcome, Outcome)> {
        let judges: Vec<String> = people.iter().skip(half).step_by(2).cloned().collect();
        let taught = if self.untaught { Daily::None } else { Daily::Without(judges.clone()) };
        let recipe = Aligned { daily: taught.clone(), ..recipe.clone() };
        let model = train(learned, &[], &recipe, &Trial::job(seed))?;
        let axes = model.card.axes_needed();
        let settings = self.settings(axes);
        let judge = |model: &Trained| -> anyhow::Result<Vec<Tally>> {
            let mut tallies = vec![Tally::default(); settings.len()];
            for person in &judges {
                let items: Vec<&Item> = daily.items.iter().filter(|item| item.person == *person).collect();
                tally(model, &AnnotatedRecording::joined(&items, axes, seed), &settings, &mut tallies)?;
            }
            Ok(tallies)
        };
        let mut before = Outcome { daily: judge(&model)?, gestures: Vec::new() };
        let mut after = Outcome::default();
        if let Some(set) = &self.show {
            let gestures = set.read(Some(axes))?;
            before.gestures = vec![Tally::default(); settings.len()];
            let mut shown = vec![Tally::default(); settings.len()];
            for person in gestures.people() {
                let theirs = gestures.filtered(|item| item.person == person);
                let (examples, rest) = three_of_each(&theirs, &model, seed);
                tally(
                    &model,
                    &AnnotatedRecording::joined(&rest, axes, seed),
                    &settings,
                    &mut before.gestures,
                )?;
                if let Some(memory) = model.memory.as_ref().filter(|_| !examples.is_empty()) {
                    let adapted = adapt(&model, memory, &examples, &person, &taught, seed)?;
                    tally(&adapted, &AnnotatedRecording::joined(&rest, axes, seed), &settings, &mut shown)?;
                    after.add(&Outcome { daily: judge(&adapted)?, gestures: Vec::new() });
                }
            }
            after.gestures = shown;
        }
        Ok((before, after))
    }
}

fn tally(
    model: &Trained,
    recording: &AnnotatedRecording,
    settings: &[MovementConfig],
    tallies: &mut [Tally],
) -> anyhow::Result<()> {
    let blob = model.blob()?;
    let heard: Vec<Heard> = listen(Model::parse(&blob)?, recording)?;
    for (config, tally) in settings.iter().zip(tallies) {
        tally.count(recording, &decide(&heard, &model.card.labels, *config), &model.card.labels);
    }
    Ok(())
}

/// Returns the windows of three recordings of each known gesture, chosen by the seed, and all other recordings.
fn three_of_each<'a>(
    theirs: &'a Dataset,
    model: &Trained,
    seed: u64,
) -> (Vec<(Vec<f32>, usize)>, Vec<&'a Item>) {
    let mut rng = RandomStream::ShownDaily.of(seed);
    let (mut examples, mut rest) = (Vec::new(), Vec::new());
    for label in &theirs.labels {
        let mut items: Vec<&Item> = theirs.items.iter().filter(|item| item.label == *label).collect();
        let known = model.card.labels.iter().position(|known| known == label);
        if let Some(known) = known.filter(|_| !shared_words::is_rest(label)) {
            items.shuffle(&mut rng);
            for item in items.drain(..items.len().min(3)) {
                examples.extend(examples_of(&item.recording).into_iter().map(|window| (window, known)));
            }
        }
        rest.extend(items);
    }
    (examples, rest)
}

/// Returns the 95 % confidence interval of the mean of a count (Byar's approximation for Poisson).
pub(super) fn interval(count: usize) -> (f64, f64) {
    let bound = |n: f64, z: f64| {
        if n == 0.0 { 0.0 } else { n * (1.0 - 1.0 / (9.0 * n) + z / (3.0 * n.sqrt())).powi(3) }
    };
    (bound(count as f64, -1.96).max(0.0), bound(count as f64 + 1.0, 1.96))
}

#[cfg(test)]
mod tests {
    use super::interval;

    #[test]
    fn the_interval_of_a_count_is_poissons() {
        // Exact: 0 to 3.69, 0.24 to 7.22, 4.80 to 18.39.
        for (count, low, high) in [(0, 0.0, 3.69), (2, 0.24, 7.22), (10, 4.80, 18.39)] {
            let (a, b) = interval(count);
            assert!((a - low).abs() < 0.06 && (b - high).abs() < 0.06, "{count}: {a} {b}");
        }
    }
}
