//! A model with all files that are needed to adapt it to one more person.

use std::path::{Path, PathBuf};

use super::adapt::{adapt, examples_of};
use super::memory::{Memory, MemoryError};
use super::trained::{TrainError, Trained};
use crate::blob::{ModelError, ModelFiles};
use crate::bundled;
use crate::daily::Daily;
use crate::dataset::Dataset;
use crate::tflite::{self, Network};

/// See the module.
#[derive(Clone, Debug)]
pub struct Adaptable {
    /// The model.
    pub model: Trained,
    /// What the model remembers of the people whom it knows.
    pub memory: Memory,
}

/// The reason why a model cannot be adapted to one more person. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum AdaptError {
    /// The model's file or its card cannot be used.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The model was trained with another recipe.
    #[error(
        "{file}: made with the features {features:?}; only models of `models train --recipe aligned` can be adapted"
    )]
    Recipe {
        /// The model's file.
        file: PathBuf,
        /// Its features.
        features: String,
    },
    /// A file that must be beside the model is missing.
    #[error("{file}: {source}; needed beside the model, copy it there")]
    Beside {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The float network cannot be used.
    #[error("{file}: {what}; train the model again")]
    Float {
        /// The file.
        file: PathBuf,
        /// The problem with the network.
        what: String,
    },
    /// The memory file cannot be used.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// A recording has a label that the model does not know.
    #[error("{file}: the model does not know {label:?}, only {known}")]
    Label {
        /// The recording.
        file: PathBuf,
        /// Its label.
        label: String,
        /// The model's labels.
        known: String,
    },
    /// The adapted model cannot be created or written.
    #[error(transparent)]
    Train(#[from] TrainError),
}

impl Adaptable {
    /// Reads the files of a model. The float network and the memory must be in the same folder.
    ///
    /// # Errors
    /// Returns an [`AdaptError`] if a file is missing, damaged or unsuitable.
    pub fn read(model: &Path) -> Result<Self, AdaptError> {
        let files = ModelFiles::read(model)?;
        let beside = |ending: &str| -> Result<(PathBuf, Vec<u8>), AdaptError> {
            let file = model.with_file_name(format!("{}.{ending}", files.card.name));
            match std::fs::read(&file) {
                Ok(bytes) => Ok((file, bytes)),
                Err(source) => Err(AdaptError::Beside { file, source }),
            }
        };
        check_recipe(model, &files)?;
        let [int8, float, memory] = [beside("tflite")?, beside("float.tflite")?, beside("memory.bin")?];
        Self::of(files, int8.1, &float.0, float.1, &memory.1)
    }

    /// The bundled model.
    ///
    /// # Errors
    /// Returns an [`AdaptError`] if the files that were compiled into the program do not match.
    pub fn bundled() -> Result<Self, AdaptError> {
        let files = bundled::files()?;
        let file = Path::new("right-aligned.tflite");
        check_recipe(file, &files)?;
        Self::of(files, bundled::TFLITE.to_vec(), file, bundled::FLOAT.to_vec(), bundled::MEMORY)
    }

    fn of(
        files: ModelFiles,
        int8_tflite: Vec<u8>,
        float_file: &Path,
        float_tflite: Vec<u8>,
        memory: &[u8],
    ) -> Result<Self, AdaptError> {
        let file = || float_file.to_owned();
        let float = match tflite::read(&float_tflite) {
            Ok(Network::Float(float)) => float,
            Ok(Network::Int8(_)) => {
                return Err(AdaptError::Float { file: file(), what: "this is no float model".to_owned() });
            }
            Err(error) => return Err(AdaptError::Float { file: file(), what: error.to_string() }),
        };
        let memory = Memory::parse(memory, &files.card)?;
        Ok(Self {
            model: Trained { card: files.card, float, float_tflite, int8_tflite, memory: None },
            memory,
        })
    }

    /// Returns the model after it has learned these recordings of one person; `name` is the name of the new model.
    ///
    /// # Errors
    /// Returns an [`AdaptError`] if the model does not know a label, or if no model can be created.
    pub fn adapted(
        &self,
        recordings: &Dataset,
        person: &str,
        name: String,
        seed: u64,
    ) -> Result<Trained, AdaptError> {
        let card = &self.model.card;
        let mut examples = Vec::new();
        for item in &recordings.items {
            let Some(label) = card.labels.iter().position(|label| *label == item.label) else {
                return Err(AdaptError::Label {
                    file: item.file.clone(),
                    label: item.label.clone(),
                    known: card.labels.join(", "),
                });
            };
            examples.extend(examples_of(&item.recording).into_iter().map(|window| (window, label)));
        }
        let mut adapted = adapt(&self.model, &self.memory, &examples, person, &Daily::All, seed)?;
        adapted.card.name = name;
        Ok(adapted)
    }
}

fn check_recipe(model: &Path, files: &ModelFiles) -> Result<(), AdaptError> {
    if files.card.features == "aligned" {
        return Ok(());
    }
    Err(AdaptError::Recipe { file: model.to_owned(), features: files.card.features.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundled_model_can_be_taught_and_a_model_without_its_memory_says_what_is_missing() {
        let bundled = Adaptable::bundled().unwrap();
        assert_eq!(bundled.model.card.model_id, bundled::files().unwrap().card.model_id);
        let folder = tempfile::tempdir().unwrap();
        let [model, _, card] = bundled.model.write(folder.path()).unwrap();
        let error = Adaptable::read(&model).unwrap_err().to_string();
        assert!(error.contains("right-aligned.memory.bin") && error.contains("copy it there"), "{error}");
        std::fs::write(folder.path().join("right-aligned.memory.bin"), bundled::MEMORY).unwrap();
        assert_eq!(Adaptable::read(&model).unwrap().memory, bundled.memory);
        let text = std::fs::read_to_string(&card).unwrap();
        std::fs::write(&card, text.replace("\"aligned\",\n", "\"log-power\",\n")).unwrap();
        assert!(Adaptable::read(&model).is_err());
    }
}
