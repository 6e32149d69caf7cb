//! The files of a wearer. The recordings are `FOLDER/NAME/recordings/<label>/NAME__<n>.csv`.
//! The model is `FOLDER/NAME/NAME.tflite` with its accompanying files.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use host_core::intent::is_rest;
use host_links::showing::{Shown, TIMES};
use models::blob::ModelFiles;
use models::dataset::Dataset;
use models::recording::write_whole;
use models::train::Adaptable;

use super::{Offer, Settings, offer_to_show};

/// Seconds that a wearer needs for one recording, including the time to get ready.
const TAKE_S: usize = 5;

/// The wearer's files, and the model to start from.
pub struct Kept {
    /// A wearer who gave no name gets one when the first recording is saved.
    settings: Settings,
    /// The base model, which is read only once.
    base: Option<Result<Adaptable, String>>,
}

impl Kept {
    /// Creates the value. Nothing is read yet.
    pub fn new(settings: Settings) -> Self {
        Kept { settings, base: None }
    }

    fn base(&mut self) -> Result<&Adaptable, String> {
        let model = &self.settings.model;
        let read = || match model {
            Some(file) => Adaptable::read(file).map_err(|error| error.to_string()),
            None => Adaptable::bundled().map_err(|error| error.to_string()),
        };
        self.base.get_or_insert_with(read).as_ref().map_err(Clone::clone)
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.settings.folder.join(name)
    }

    /// Returns the actions that are possible for the wearer if the board runs this model.
    pub(super) fn offer(&mut self, model_id: u32, labels: &[String]) -> Offer {
        let base = match self.base() {
            Ok(base) => base,
            Err(why) => return Offer::Cannot(format!("no gestures can be shown: {why}")),
        };
        let (card, started_from) = (&base.model.card, &base.model.card.name);
        if card.labels != labels {
            return Offer::Cannot(format!(
                "no gestures can be shown: the board's model {model_id:08x} names {}, and {started_from} names {}; start \
                 with --model FILE.tflite, the model that the board runs, with its card, .float.tflite and .memory.bin beside it",
                labels.join(", "),
                card.labels.join(", ")
            ));
        }
        let gestures: Vec<String> = labels.iter().filter(|label| !is_rest(label)).cloned().collect();
        let seconds = TAKE_S * TIMES * gestures.len();
        let Some(name) = self.settings.name.clone() else {
            let text = offer_to_show(None, &gestures, seconds);
            return Offer::Show { labels: gestures, text };
        };
        let file = self.folder(&name).join(format!("{name}.tflite"));
        if !file.exists() {
            let text = offer_to_show(Some(&name), &gestures, seconds);
            return Offer::Show { labels: gestures, text };
        }
        let kept = ModelFiles::read(&file).map_err(|error| error.to_string());
        let kept = kept.and_then(|files| files.blob().map(|blob| (files.card, blob)));
        match kept {
            Err(why) => {
                let text = format!(
                    "the model of {name} cannot be used ({why}): show each gesture {TIMES} times again"
                );
                Offer::Show { labels: gestures, text }
            }
            Ok((card, _)) if card.labels != labels => {
                let text = format!(
                    "the model of {name} names other gestures than the board's: show each of {} {TIMES} times",
                    gestures.join(", ")
                );
                Offer::Show { labels: gestures, text }
            }
            Ok((card, _)) if card.model_id == format!("{model_id:08x}") => {
                let text = format!(
                    "the board knows {name} (model {model_id:08x}); where gestures are missed, show each {TIMES} times more"
                );
                Offer::Show { labels: gestures, text }
            }
            Ok((card, blob)) => {
                let text = format!(
                    "the board runs model {model_id:08x}, not that of {name} ({}), which is kept in {}",
                    card.model_id,
                    file.display()
                );
                Offer::Send { blob, text }
            }
        }
    }

    /// Saves the recordings and trains with all recordings of this wearer.
    /// Returns the model, or the reason why there is none.
    pub(super) fn learn(&mut self, shown: &Shown) -> Result<Vec<u8>, String> {
        let name = match &self.settings.name {
            Some(name) => name.clone(),
            None => self.new_guest()?,
        };
        let recordings = self.folder(&name).join("recordings");
        for (label, recording) in shown {
            let file = next_file(&recordings.join(label), &name).map_err(|error| {
                format!(
                    "{}: nothing can be kept ({error}); is there room, and may you?",
                    recordings.display()
                )
            })?;
            write_whole(&file, recording.to_edge_impulse_csv().as_bytes()).map_err(|error| {
                let _ = std::fs::remove_file(&file);
                format!("{}: {error}; is there room, and may you?", file.display())
            })?;
        }
        let base = self.base()?;
        let axes = base.model.card.axes_needed();
        let theirs = Dataset::read_where(&recordings, Some(axes), |_, person| person == name)
            .map_err(|error| error.to_string())?;
        let adapted = base.adapted(&theirs, &name, name.clone(), 1).map_err(|error| error.to_string())?;
        adapted.write(&self.folder(&name)).map_err(|error| error.to_string())?;
        adapted.blob().map_err(|error| error.to_string())
    }

    /// A wearer who gave no name gets a generated name and an unused folder.
    fn new_guest(&mut self) -> Result<String, String> {
        let name = (1..u32::MAX).map(|n| format!("guest-{n}")).find(|name| !self.folder(name).exists());
        let name = name.ok_or("no free name for a guest; give one with --wearer")?;
        self.settings.name = Some(name.clone());
        Ok(name)
    }
}

/// Reserves the first free number among a person's recordings.
/// The function creates an empty file, so that no other program uses the number.
///
/// # Errors
/// Fails if the folder or the file cannot be created.
pub fn next_file(folder: &Path, person: &str) -> std::io::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    for n in 1..u32::MAX {
        let file = folder.join(format!("{person}__{n}.csv"));
        match std::fs::File::create_new(&file) {
            Ok(_) => return Ok(file),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(std::io::Error::other("no free file name"))
}
