//! `models report`: writes one HTML page about a folder and the models' results.

use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use models::evaluate::events::Pause;
use models::evaluate::people::{Trial, TrialError};
use models::evaluate::study::{Events, Study};
use models::recording::write_whole;
use models::report::{Facts, NetworkSize, Report, html};
use rayon::prelude::*;
use shared_dsp::right::network::Model;

use super::RecipeName;
use super::people::{Set, recipes};

/// Write one self-contained HTML page about a folder and the results of models trained without these people
#[derive(Args)]
pub struct Cmd {
    /// Folder with <label>/<person>__<n>.csv; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(value_name = "FOLDER[:LABEL,...]")]
    set: Set,
    /// The HTML file to write
    #[arg(long, default_value = "report.html")]
    out: PathBuf,
    /// Number of models per figure, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Recipes to compare (repeatable); events are those of the last one [default: paper and aligned]
    #[arg(long, value_enum)]
    recipe: Vec<RecipeName>,
    #[command(flatten)]
    axes: super::Axes,
    /// Adapt models to each person with this many examples of 2 s per class (recipe aligned)
    #[arg(long, value_delimiter = ',', value_name = "N,N,...", default_value = "1,3,10")]
    examples: Vec<usize>,
    /// Number of hours in which simulated wearers make no gesture
    #[arg(long, default_value_t = 1.0)]
    hours: f64,
    #[command(flatten)]
    short: super::Short,
}

/// Fractions of the other people's recordings in the learning curves.
const SHARES: [f64; 4] = [0.1, 0.25, 0.5, 1.0];

/// Maximum probabilities of rest for an event, in 256ths, in the comparison of thresholds.
const TRIED: [u8; 6] = [13, 26, 36, 50, 77, 102];

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0, "--seeds takes a number above 0");
        anyhow::ensure!((0.0..=1000.0).contains(&self.hours), "--hours takes 0 to 1000");
        let axes = self.axes.count();
        let (people, what) = self.set.people(axes)?;
        println!("{what}");
        let progress = ProgressBar::new_spinner();
        let done = |what: &str| {
            progress.set_message(what.to_owned());
            progress.tick();
        };
        let (mut studies, mut networks, mut learning, mut events) =
            (Vec::new(), Vec::new(), Vec::new(), None);
        for recipe in recipes(&self.recipe, &self.short) {
            let trial = Trial { folder: &self.set.folder, axes, labels: &self.set.labels, recipe: &*recipe };
            studies.push(Study::run(&trial, &people, self.seeds, &self.examples, done)?);
            let model = trial.without(&people[0], 1)?;
            Model::parse(&model.blob()?)?;
            networks.push(NetworkSize::of(&model)?);
            for person in &people {
                let point = |share: &f64| -> Result<(f64, f64), TrialError> {
                    Ok((*share, trial.stranger_after(person, *share, 1)?.accuracy().int8))
                };
                let points = SHARES.par_iter().map(point).collect::<Result<Vec<_>, _>>()?;
                learning.push((format!("{}: {person}", recipe.name()), points));
            }
            events = Some(Events::run(
                &trial,
                &people,
                self.seeds,
                self.hours * 3600.0,
                &TRIED,
                Pause::USUAL,
                done,
            )?);
        }
        progress.finish_and_clear();
        let report = Report {
            title: format!("Gestures in {}", self.set.folder.display()),
            seeds: self.seeds,
            facts: Facts::of(&self.set.read(axes)?),
            studies,
            networks,
            events,
            learning,
        };
        if let Some(folder) = self.out.parent() {
            std::fs::create_dir_all(folder)?;
        }
        write_whole(&self.out, html(&report).as_bytes())
            .map_err(|error| anyhow::anyhow!("{}: {error}; check --out", self.out.display()))?;
        println!("{}", self.out.display());
        Ok(())
    }
}
