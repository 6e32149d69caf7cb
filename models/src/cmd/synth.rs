//! `models synth`: generates recordings of simulated wearers.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use models::synth::{Group, Take, Wearer, session, takes};
use rayon::prelude::*;

/// Which wearers.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum GroupName {
    /// Wearers for training
    Training,
    /// Wearers for tests, who are never wearers for training
    Evaluation,
}

/// Generate recordings of simulated wearers (not of real people)
#[derive(Args)]
pub struct Cmd {
    /// Folder for the recordings, which must be new or empty
    #[arg(long)]
    out: PathBuf,
    /// Seed of the wearers and of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of wearers
    #[arg(long, default_value_t = 20)]
    wearers: u32,
    /// Duration of each gesture per wearer in seconds
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Whether the wearers are for training or for tests
    #[arg(long, value_enum, default_value = "training")]
    group: GroupName,
    /// Number of wearers (the last ones) without instructions: slower and faster, with circles in any plane
    #[arg(long, value_name = "N", default_value_t = 0)]
    untaught: u32,
    /// Omit recordings in which a gesture has just begun or has nearly ended. They would teach recipe aligned to
    /// hesitate, although its decision already waits for the movement
    #[arg(long)]
    whole: bool,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!((1..=9999).contains(&self.wearers), "--wearers takes 1 to 9999");
        anyhow::ensure!(
            self.untaught <= self.wearers,
            "--untaught takes 0 to {}, all of --wearers",
            self.wearers
        );
        anyhow::ensure!((2.0..=600.0).contains(&self.seconds), "--seconds takes 2 to 600");
        let full = std::fs::read_dir(&self.out).is_ok_and(|mut entries| entries.next().is_some());
        anyhow::ensure!(!full, "{}: not empty; give a new folder with --out", self.out.display());
        let group = match self.group {
            GroupName::Training => Group::Training,
            GroupName::Evaluation => Group::Evaluation,
        };
        // The data set is created in a temporary folder and then renamed, so that an incomplete one is never visible.
        let name = self.out.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let part = self.out.with_file_name(format!("{name}.{}.part", std::process::id()));
        let mut takes = takes(self.seconds);
        takes.retain(|take| !self.whole || take.number < Take::FIRST_PART);
        for label in models::labels::PAPER {
            std::fs::create_dir_all(part.join(label))?;
        }
        let about = format!(
            "simulated wearers, not real people: models synth --group {} --seed {} --wearers {} \
             --seconds {} --untaught {}{}\n",
            match self.group {
                GroupName::Training => "training",
                GroupName::Evaluation => "evaluation",
            },
            self.seed,
            self.wearers,
            self.seconds,
            self.untaught,
            if self.whole { " --whole" } else { "" }
        );
        std::fs::write(part.join("ABOUT.txt"), about)?;
        let progress = ProgressBar::new(u64::from(self.wearers));
        let made = (1..=self.wearers).into_par_iter().try_for_each(|index| {
            let wearer = Wearer::new(group, self.seed, index);
            let wearer = if index > self.wearers - self.untaught { wearer.untaught() } else { wearer };
            for (number, take) in takes.iter().enumerate() {
                let file = format!("{}/{}__{:03}.csv", take.label, wearer.name, take.number);
                session(&wearer, number as u64, &take.script).write(&part.join(file))?;
            }
            progress.inc(1);
            Ok::<_, std::io::Error>(())
        });
        progress.finish_and_clear();
        let placed = made.and_then(|()| {
            if self.out.exists() {
                std::fs::remove_dir(&self.out)?;
            }
            std::fs::rename(&part, &self.out)
        });
        if let Err(error) = placed {
            let _ = std::fs::remove_dir_all(&part);
            anyhow::bail!("{}: {error}; check the folder and the space on the disk", self.out.display());
        }
        println!(
            "{}: {} recordings of {} simulated wearers (no real people), seed {}",
            self.out.display(),
            takes.len() * self.wearers as usize,
            self.wearers,
            self.seed
        );
        Ok(())
    }
}
