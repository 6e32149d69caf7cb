//! `models train`: trains on recordings and writes `NAME.tflite`, `NAME.float.tflite` and `NAME.card.json`.

use std::path::PathBuf;

use clap::Args;
use models::train::{Job, held_out, train};

/// Train a network on a folder of recordings
#[derive(Args)]
pub struct Cmd {
    #[command(flatten)]
    source: super::Source,
    /// Folder in which the model is written
    #[arg(long)]
    out: PathBuf,
    /// Name of the model's files
    #[arg(long, default_value = "gestures")]
    name: String,
    /// Fraction of the recordings to hold out and test on, chosen by the seed
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    test: f64,
    /// Description of the data for the card [default: FOLDER/ABOUT.txt, as `synth` writes it]
    #[arg(long)]
    about: Option<String>,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!((0.0..=0.9).contains(&self.test), "--test takes a share between 0 and 0.9");
        let named = !self.name.is_empty() && !self.name.contains(['/', '\\']);
        anyhow::ensure!(named, "--name takes a plain file name without ending");
        let dataset = self.source.dataset()?;
        let test = held_out(&dataset, self.test, self.source.seed);
        let noted = std::fs::read_to_string(self.source.folder.join("ABOUT.txt"));
        let about = match (&self.about, noted) {
            (Some(text), _) => text.clone(),
            (None, Ok(text)) => text.trim().to_owned(),
            (None, Err(_)) => "not said; --about or FOLDER/ABOUT.txt would".to_owned(),
        };
        let job = Job {
            name: self.name.clone(),
            about,
            seed: self.source.seed,
            excluded: self.source.exclude_person.clone(),
            progress: true,
        };
        let trained = train(&dataset, &test, &*self.source.recipe(), &job)?;
        let card = &trained.card;
        println!(
            "{} windows of {} recordings, {} padded (going on as they went a period before) and {} resampled; \
             {} epochs, best {}",
            card.training.windows,
            card.data.recordings,
            card.data.padded,
            card.data.resampled,
            card.training.epochs,
            card.training.best_epoch
        );
        let show = |what: &str, scores: &models::card::Scores| {
            println!(
                "{what} per recording: float {:.2} %, int8 {:.2} % (per window {:.2} %, {:.2} %)",
                scores.float.per_recording,
                scores.int8.per_recording,
                scores.float.per_window,
                scores.int8.per_window
            );
        };
        if card.features == "aligned" {
            for (one, other) in models::labels::mirrored(&card.labels) {
                println!(
                    "{one} and {other} look the same to recipe aligned, whose features are those of the mirrored movement, \
                     too: it tells them apart by habit only. --recipe log-power knows the board's directions, if the board \
                     is worn as in the recordings; or give both one label"
                );
            }
        }
        if let Some(scores) = &card.validation {
            show("validation (chose when to stop)", scores);
        }
        if let Some(scores) = &card.test {
            show("test", scores);
        }
        for file in trained.write(&self.out)? {
            println!("{}", file.display());
        }
        let list = self.out.join(format!("{}.test.txt", self.name));
        if test.is_empty() {
            // If the test list of an earlier model remained, this model would be tested on its own training data.
            match std::fs::remove_file(&list) {
                Ok(()) => println!("removed {}: it was of the model that was here before", list.display()),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => {
                    anyhow::bail!("{}: {error}; it is of an older model, delete it", list.display())
                }
            }
        } else {
            models::recording::write_whole(&list, (test.join("\n") + "\n").as_bytes())?;
            println!("{} ({} recordings kept out of training)", list.display(), test.len());
        }
        println!("model id {}", trained.card.model_id);
        Ok(())
    }
}
