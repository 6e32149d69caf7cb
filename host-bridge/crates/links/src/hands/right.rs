//! The right hand from recordings of its IMU.

use std::path::{Path, PathBuf};

use models::blob::ModelFiles;
use models::card::Card;
use models::recording::{Recording, RecordingError};
use shared_dsp::decision::DecisionConfig;
use shared_dsp::mlp::{self, Model};
use shared_dsp::right::{ModelMismatch, RightHand, RightOutput};
use shared_proto::message::{
    Board as BoardKind, BoardMessage, Hello, LABELS_MAX, ModelInfo, PROTOCOL_MAJOR, PROTOCOL_MINOR,
    RightState,
};

use super::{Board, Port};
use host_core::observe::Sample;

/// A sample every so often: recordings are brought to 100 Hz first.
const SAMPLE_INTERVAL_MS: u64 = 10;

const BUNDLED: &[u8] = include_bytes!("../../../../../models/bundled/right-9axis.tflite");
const BUNDLED_CARD: &[u8] = include_bytes!("../../../../../models/bundled/right-9axis.card.json");

/// A model with its card, ready to run.
#[derive(Clone, Debug)]
pub struct ModelFile {
    blob: Vec<u8>,
    card: Card,
}

/// Why a model or the recordings for it cannot be used; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// Model or card cannot be read, or do not belong together.
    #[error(transparent)]
    Model(#[from] models::blob::ModelError),
    /// This program cannot run the model.
    #[error("{name}: {source}; train it again with this version's `models train`")]
    Unfit {
        /// The model.
        name: String,
        /// Why.
        source: ModelMismatch,
    },
    /// The blob is not whole.
    #[error("{name}: {problem}")]
    Damaged {
        /// The model.
        name: String,
        /// Why.
        problem: String,
    },
    /// The labels do not fit the frame that names them.
    #[error(
        "{name}: its labels are {length} bytes long with their commas, the wire takes {LABELS_MAX}; shorten them"
    )]
    Labels {
        /// The model.
        name: String,
        /// How long they are.
        length: usize,
    },
    /// A recording cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A recording has fewer axes than the model.
    #[error(
        "{file}, line 1, column {column}: the recording has {recording} axes, the model needs {model}; \
         give a model of {recording} axes with --model, or a recording of {model} axes"
    )]
    Axes {
        /// The recording.
        file: PathBuf,
        /// First column that is missing, from 1.
        column: usize,
        /// Axes of the recording.
        recording: usize,
        /// Axes of the model.
        model: usize,
    },
}

impl ModelFile {
    /// Reads an int8 `.tflite` and the card beside it.
    ///
    /// # Errors
    /// [`ModelFileError`] if they are missing, damaged, or not of each other.
    pub fn read(file: &Path) -> Result<Self, ModelFileError> {
        let (blob, card) = models::blob::read(file)?;
        Ok(ModelFile { blob, card })
    }

    /// The bundled model: 9 axes, the paper's labels and `other`, trained on simulated wearers only.
    ///
    /// # Errors
    /// [`ModelFileError`] if the files that were compiled in do not belong together.
    pub fn bundled() -> Result<Self, ModelFileError> {
        let name = Path::new("right-9axis.tflite");
        let card = Card::parse(Path::new("right-9axis.card.json"), BUNDLED_CARD)
            .map_err(models::blob::ModelError::from)?;
        let files = ModelFiles::new(name, BUNDLED, card)?;
        match files.blob() {
            Ok(blob) => Ok(ModelFile { blob, card: files.card }),
            Err(problem) => Err(ModelFileError::Damaged { name: name.display().to_string(), problem }),
        }
    }

    /// What boards run, checked against its card.
    pub fn blob(&self) -> &[u8] {
        &self.blob
    }

    /// Values per sample.
    pub fn axes(&self) -> usize {
        self.card.axes
    }

    /// Names of the outputs in order.
    pub fn labels(&self) -> &[String] {
        &self.card.labels
    }

    /// What the model is called.
    pub fn name(&self) -> &str {
        &self.card.name
    }

    /// What the model was trained on, in words; simulated data says so here.
    pub fn about(&self) -> &str {
        &self.card.about
    }

    fn model(&self) -> Result<Model<'_>, ModelFileError> {
        Model::parse(&self.blob).map_err(|error| ModelFileError::Damaged {
            name: self.card.name.clone(),
            problem: error.to_string(),
        })
    }
}

/// Reads recordings, brings each to 100 Hz, and joins them into one stream without a pause.
///
/// Of recordings with more axes than `axes`, the first ones are used, as in `models eval`.
///
/// # Errors
/// [`ModelFileError`] if one cannot be read, or has fewer axes than the model. All are checked first.
pub fn join(files: &[PathBuf], axes: usize) -> Result<Recording, ModelFileError> {
    let mut values = Vec::new();
    for file in files {
        let recording = Recording::read(file)?;
        if recording.axes() < axes {
            return Err(ModelFileError::Axes {
                file: file.clone(),
                column: recording.axes() + 2,
                recording: recording.axes(),
                model: axes,
            });
        }
        for sample in recording.resampled().with_axes(axes).samples() {
            values.extend_from_slice(sample);
        }
    }
    let count = (values.len() / axes) as u64;
    let time_ms = (0..count).map(|n| (n * SAMPLE_INTERVAL_MS) as f64).collect();
    Ok(Recording::new(axes, time_ms, values))
}

/// The hand's code for each number of axes.
#[expect(clippy::large_enum_variant, reason = "one of them exists, for a whole session")]
enum AnyHand<'m> {
    Three(RightHand<'m, 3>),
    Six(RightHand<'m, 6>),
    Nine(RightHand<'m, 9>),
}

impl<'m> AnyHand<'m> {
    fn new(model: Model<'m>) -> Result<Self, ModelMismatch> {
        let config = DecisionConfig::default();
        Ok(match model.info().axes {
            3 => AnyHand::Three(RightHand::new(model, config)?),
            6 => AnyHand::Six(RightHand::new(model, config)?),
            _ => AnyHand::Nine(RightHand::new(model, config)?),
        })
    }

    fn push(&mut self, sample: &[f32], time_ms: u32) -> Option<RightOutput> {
        // The recording has the model's axes: `RightBoard::new` has seen to that.
        match self {
            AnyHand::Three(hand) => hand.push(sample.try_into().ok()?, time_ms).copied(),
            AnyHand::Six(hand) => hand.push(sample.try_into().ok()?, time_ms).copied(),
            AnyHand::Nine(hand) => hand.push(sample.try_into().ok()?, time_ms).copied(),
        }
    }
}

/// Plays a recording as the Nano 33 BLE Sense would.
pub struct RightBoard<'m> {
    recording: Recording,
    next: usize,
    model: Model<'m>,
    hand: AnyHand<'m>,
    port: Port,
    boot_id: u32,
    sequence: u16,
    said_hello: bool,
    /// Samples before this one were taken before the last step.
    before: usize,
}

impl<'m> RightBoard<'m> {
    /// A board that starts at time 0 with a recording at 100 Hz.
    ///
    /// # Errors
    /// [`ModelFileError`] if the model cannot run here or the recording has other axes.
    pub fn new(recording: Recording, model: &'m ModelFile, boot_id: u32) -> Result<Self, ModelFileError> {
        let name = || model.name().to_owned();
        let parsed = model.model()?;
        let length = parsed.info().label_text.len();
        if length > LABELS_MAX {
            return Err(ModelFileError::Labels { name: name(), length });
        }
        let unfit = |source| ModelFileError::Unfit { name: name(), source };
        if parsed.info().axes != recording.axes() {
            return Err(unfit(ModelMismatch::Axes { model: parsed.info().axes, hand: recording.axes() }));
        }
        Ok(RightBoard {
            recording,
            next: 0,
            model: parsed,
            hand: AnyHand::new(parsed).map_err(unfit)?,
            port: Port::default(),
            boot_id,
            sequence: 0,
            said_hello: false,
            before: 0,
        })
    }

    fn hello(&mut self, wire: &mut Vec<u8>) {
        let info = *self.model.info();
        let hello = Hello {
            major: PROTOCOL_MAJOR,
            minor: PROTOCOL_MINOR,
            board: BoardKind::RightReplay,
            firmware: env!("CARGO_PKG_VERSION"),
            boot_id: self.boot_id,
            model_id: info.model_id,
            sample_hz: info.sample_hz,
        };
        self.port.send(&BoardMessage::Hello(hello), wire);
        self.port.send(&BoardMessage::ModelInfo(model_info_on_the_wire(&info)), wire);
    }

    fn send(&mut self, output: &RightOutput, wire: &mut Vec<u8>) {
        let scores = output.score_bytes();
        let count = if output.full { output.scores().len() } else { 0 };
        let state = RightState {
            sequence: self.sequence,
            board_time_ms: output.window_end_ms,
            events: output.events,
            label: output.label,
            confidence: output.confidence,
            event_window_end_ms: output.event_window_end_ms,
            scores: &scores[..count],
            health: 0,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.port.send(&BoardMessage::Right(state), wire);
    }
}

impl Board for RightBoard<'_> {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        if !self.said_hello && !self.ended() {
            self.said_hello = true;
            self.hello(wire);
        }
        self.before = self.next;
        while !self.ended() && self.next as u64 * SAMPLE_INTERVAL_MS <= now_ms {
            // The board's wrapping clock.
            let time_ms = (self.next as u64 * SAMPLE_INTERVAL_MS) as u32;
            let sample = self.recording.samples().nth(self.next);
            self.next += 1;
            if let Some(output) = sample.and_then(|sample| self.hand.push(sample, time_ms)) {
                self.send(&output, wire);
            }
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        if self.port.is_asked_for_hello(bytes, now_ms, wire) && !self.ended() {
            self.hello(wire);
        }
    }

    fn sample(&self) -> Option<Sample<'_>> {
        let newest = self.next.checked_sub(1).filter(|newest| *newest >= self.before)?;
        self.recording.samples().nth(newest).map(|values| Sample::Right { values })
    }

    fn ended(&self) -> bool {
        self.next >= self.recording.len()
    }
}

/// What the wire says of a model.
pub fn model_info_on_the_wire<'a>(info: &mlp::ModelInfo<'a>) -> ModelInfo<'a> {
    ModelInfo {
        model_id: info.model_id,
        recipe: info.recipe.id(),
        axes: info.axes as u8,
        sample_hz: info.sample_hz,
        window: info.window,
        labels: info.label_text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_of_three_axes_takes_the_first_three_of_a_nine_axis_recording() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("nine.csv");
        let header = "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\n";
        std::fs::write(&file, format!("{header}0,1,2,3,4,5,6,7,8,9\n10,1,2,3,4,5,6,7,8,9\n")).unwrap();
        let joined = join(&[file.clone(), file], 3).unwrap();
        assert_eq!(joined.axes(), 3);
        assert!(joined.samples().all(|sample| sample == [1.0, 2.0, 3.0]));
        assert_eq!(joined.len(), 4);
    }
}
