//! `models events`: joins the recordings of each held-out person and plays them through a board's right hand.

use std::time::Instant;

use clap::Args;
use indicatif::ProgressBar;
use models::evaluate::events::{Pause, Tally};
use models::evaluate::people::Trial;
use models::evaluate::study::Events;

use super::RecipeName;
use super::people::Set;

/// Hold out each person in turn, play their recordings one after another and count the gesture events
#[derive(Args)]
pub struct Cmd {
    /// Folders with files named <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(required = true, value_name = "FOLDER[:LABEL,...]")]
    folders: Vec<Set>,
    /// Number of models per person, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Recipe for the training
    #[arg(long, value_enum, default_value = "aligned")]
    recipe: RecipeName,
    #[command(flatten)]
    axes: super::Axes,
    /// Number of hours, per folder, in which simulated wearers make no gesture
    #[arg(long, default_value_t = 1.0)]
    hours: f64,
    /// Also print the results for other thresholds: maximum probability of rest, in 256ths
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    max_rest: Vec<u8>,
    /// Seconds of rest between two recordings [default: 1.4 to 2.5]
    #[arg(long, value_name = "SECONDS")]
    apart: Option<f64>,
    /// Print the name of each recording that was not understood, and the events that came instead
    #[arg(long)]
    errors: bool,
    #[command(flatten)]
    short: super::Short,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        anyhow::ensure!((0.0..=1000.0).contains(&self.hours), "--hours takes 0 to 1000");
        let is_fit = |apart: &f64| (0.1..=10.0).contains(apart);
        anyhow::ensure!(self.apart.as_ref().is_none_or(is_fit), "--apart takes 0.1 to 10");
        let pause = self.apart.map_or(Pause::USUAL, Pause::of);
        let start = Instant::now();
        let axes = self.axes.count();
        let recipe = self.short.shorten(self.recipe.0);
        for set in &self.folders {
            let (people, what) = set.people(axes)?;
            println!("{what}, recipe {}, {} seeds", recipe.name(), self.seeds);
            println!(
                "{:<8} {:>9} {:>8} {:>7} {:>6} {:>8} {:>8} {:>9} {:>7} {:>7}",
                "person",
                "performed",
                "right, %",
                "missed",
                "wrong",
                "several",
                "delay, s",
                "no gesture",
                "false",
                "stray"
            );
            let trial = Trial { folder: &set.folder, axes, labels: &set.labels, recipe: &*recipe };
            let progress = ProgressBar::new_spinner();
            let done = |what: &str| {
                progress.set_message(what.to_owned());
                progress.tick();
            };
            let aimless_s = self.hours * 3600.0;
            let events = Events::run(&trial, &people, self.seeds, aimless_s, &self.max_rest, pause, done)?;
            progress.finish_and_clear();
            for (person, tally) in events.people.iter().zip(&events.real) {
                print(person, tally);
            }
            print("all", &events.together());
            for (max_rest, real, simulated) in &events.trade {
                println!(
                    "rest below {max_rest:3}/256: {:.2} % right, {} wrong or several, {} and {} false ones in recordings of no \
                     gesture and in rest, {} of simulated wearers",
                    real.right_per_cent(),
                    real.wrong + real.several,
                    real.rest_events,
                    real.stray_events,
                    simulated.rest_events
                );
            }
            if self.hours > 0.0 {
                let simulated = &events.simulated;
                println!(
                    "simulated wearers without a gesture: {} events in {:.1} h, {:.2} per hour",
                    simulated.rest_events,
                    simulated.rest_s / 3600.0,
                    simulated.false_per_hour()
                );
            }
            if self.errors {
                for (person, tally) in events.people.iter().zip(&events.real) {
                    tally.errors.iter().for_each(|error| println!("{person} {error}"));
                }
            }
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}

fn print(person: &str, tally: &Tally) {
    println!(
        "{person:<8} {:>9} {:>8.2} {:>7} {:>6} {:>8} {:>8} {:>10} {:>7} {:>7}",
        tally.performed,
        tally.right_per_cent(),
        tally.missed,
        tally.wrong,
        tally.several,
        tally.median_delay(),
        tally.rests,
        tally.rest_events,
        tally.stray_events
    );
}
