//! Plays a right hand from recordings of its IMU.

use std::ops::Range;
use std::path::{Path, PathBuf};

use models::blob::ModelFiles;
use models::card::Card;
use models::recording::{Recording, RecordingError};
use models::sheet::Reading;
use shared_board::Identity;
use shared_board::hand::ValueHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_dsp::right::{ModelMismatch, RightHand};
use shared_proto::message::{Board as BoardKind, LABELS_MAX};

use super::Board;
use super::virtual_board::{PERIOD_MS, VirtualRight, no_store};
use host_core::observe::Sample;

/// The values of one count in m/s², deg/s and µT, which equal those of the right board in record mode.
const COUNT: [f32; 3] = [0.000_732 * 9.806_65, 0.07, 0.014];

const BUNDLED: &[u8] = include_bytes!("../../../../../models/bundled/right-aligned.tflite");
const BUNDLED_CARD: &[u8] = include_bytes!("../../../../../models/bundled/right-aligned.card.json");

/// A model with its card, ready to run.
#[derive(Clone, Debug)]
pub struct ModelFile {
    blob: Vec<u8>,
    card: Card,
}

/// The reason why a model or its recordings cannot be used, with a remedy in the text.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// The model or its card cannot be read, or they do not match.
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
    /// The blob is not complete.
    #[error("{name}: {problem}")]
    Damaged {
        /// The model.
        name: String,
        /// Why.
        problem: String,
    },
    /// The labels do not fit in their frame.
    #[error(
        "{name}: its labels are {length} bytes long with their commas, the wire takes {LABELS_MAX}; shorten them"
    )]
    Labels {
        /// The model.
        name: String,
        /// The combined length of the labels.
        length: usize,
    },
    /// A recording cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A recording has fewer axes than the model needs.
    #[error(
        "{file}, line 1, column {column}: the recording has {recording} axes, the model needs {model}; \
         give a model of {recording} axes with --model, or a recording of {model} axes"
    )]
    Axes {
        /// The recording.
        file: PathBuf,
        /// The first missing column, counted from 1.
        column: usize,
        /// Number of axes in the recording.
        recording: usize,
        /// Number of axes that the model needs.
        model: usize,
    },
}

impl ModelFile {
    /// Reads an int8 `.tflite` file and its card.
    ///
    /// # Errors
    /// Returns [`ModelFileError`] if one of the files is missing or damaged, or they do not match.
    pub fn read(file: &Path) -> Result<Self, ModelFileError> {
        let (blob, card) = models::blob::read(file)?;
        Ok(ModelFile { blob, card })
    }

    /// Returns the bundled model: 9 axes, with the paper's labels and `other`.
    /// The model was trained on simulated wearers only.
    ///
    /// # Errors
    /// Returns [`ModelFileError`] if the compiled-in files do not match.
    pub fn bundled() -> Result<Self, ModelFileError> {
        let name = Path::new("right-aligned.tflite");
        let card = Card::parse(Path::new("right-aligned.card.json"), BUNDLED_CARD)
            .map_err(models::blob::ModelError::from)?;
        let files = ModelFiles::new(name, BUNDLED, card)?;
        match files.blob() {
            Ok(blob) => Ok(ModelFile { blob, card: files.card }),
            Err(problem) => Err(ModelFileError::Damaged { name: name.display().to_string(), problem }),
        }
    }

    /// Returns the blob that boards run, which was checked against its card.
    pub fn blob(&self) -> &[u8] {
        &self.blob
    }

    /// Values per sample.
    pub fn axes(&self) -> usize {
        self.card.axes
    }

    /// Returns the axes of the model, and the number of axes that a recording must have.
    pub fn axes_of_recordings(&self) -> (usize, usize) {
        (self.card.axes, self.card.axes_needed())
    }

    /// Names of the outputs in order.
    pub fn labels(&self) -> &[String] {
        &self.card.labels
    }

    /// Returns the name of the model.
    pub fn name(&self) -> &str {
        &self.card.name
    }

    /// Returns a description of the training data. The description mentions simulated data.
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

/// Reads recordings, converts each to 100 Hz, and joins them without pauses into one recording of `axes` axes.
/// The notes are those of all recordings. The start time is that of the first recording.
///
/// If a recording has more than `axes` axes, only the first ones are used, as in `models eval`.
/// At least `needed` axes must exist. Missing axes have the value 0.
///
/// # Errors
/// Returns [`ModelFileError`] if a recording cannot be read or has too few axes. All recordings are checked first.
pub fn join(
    files: &[PathBuf],
    (axes, needed): (usize, usize),
    reading: &Reading,
) -> Result<Joined, ModelFileError> {
    let mut values = Vec::new();
    let mut notes = Vec::new();
    let mut silences = Vec::new();
    let mut start_ms = None;
    for file in files {
        let recording = Recording::read_as(file, reading)?;
        if recording.axes() < needed {
            return Err(ModelFileError::Axes {
                file: file.clone(),
                column: recording.axes() + 2,
                recording: recording.axes(),
                model: needed,
            });
        }
        notes.extend(recording.notes().iter().map(|note| format!("{}: {note}", file.display())));
        start_ms = start_ms.or(recording.time_ms().first().copied());
        let found = silences_of(&recording, values.len() / axes);
        if let Some(longest) = found.iter().max_by_key(|slots| slots.len()) {
            let seconds = |samples: usize| samples as f64 * PERIOD_MS as f64 / 1000.0;
            notes.push(format!(
                "{}: {} without samples, the longest of {:.1} s from {:.1} s on: the hand is silent there",
                file.display(),
                if found.len() == 1 { "a time".to_owned() } else { format!("{} times", found.len()) },
                seconds(longest.len()),
                seconds(longest.start - values.len() / axes),
            ));
        }
        silences.extend(found);
        let used = recording.axes().min(axes);
        for sample in recording.resampled().samples() {
            values.extend_from_slice(&sample[..used]);
            values.extend(std::iter::repeat_n(0.0, axes - used));
        }
    }
    let count = (values.len() / axes) as u64;
    let time_ms = (0..count).map(|n| (n * PERIOD_MS) as f64).collect();
    Ok(Joined {
        recording: Recording::new(axes, time_ms, values),
        silences,
        notes,
        start_ms: start_ms.unwrap_or_default(),
    })
}

/// A pause of at least this many intervals and this duration means that the sensor delivers no data.
/// Shorter pauses, such as a few samples lost by a radio, are bridged.
const SILENT_INTERVALS: f64 = 3.0;
const SILENT_MS: f64 = 50.0;

/// Returns the samples in pauses of a recording, counted at 100 Hz after `before` other samples.
fn silences_of(recording: &Recording, before: usize) -> Vec<Range<usize>> {
    let times = recording.time_ms();
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let usual_ms = steps.get(steps.len() / 2).copied().unwrap_or_default();
    let slot = |ms: f64| (ms - times[0]) / PERIOD_MS as f64;
    let pauses = recording.holes((SILENT_INTERVALS * usual_ms).max(SILENT_MS)).into_iter().map(|(at, _)| {
        let from = slot(times[at]).floor() as usize + 1;
        before + from..before + from.max(slot(times[at + 1]).ceil() as usize)
    });
    pauses.filter(|slots| !slots.is_empty()).collect()
}

/// Several recordings joined into one.
#[derive(Clone, Debug)]
pub struct Joined {
    /// At 100 Hz, from time 0.
    pub recording: Recording,
    /// Ranges of samples that are missing because the sensor delivered no data.
    pub silences: Vec<Range<usize>>,
    /// Notes about everything that was inferred, repaired or omitted while reading.
    pub notes: Vec<String>,
    /// The time of the first sample in the first file, in ms.
    pub start_ms: f64,
}

/// The board's code for any number of axes.
trait AnyAxes: Send {
    /// Processes the sample taken at `time_ms`, which has the axes of the model.
    fn sample(&mut self, values: &[f32], time_ms: u64, wire: &mut Vec<u8>);
    /// Reports that there is no sample at this time.
    fn nothing(&mut self);
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);
}

impl<const A: usize> AnyAxes for VirtualRight<ValueHand<'_, A>> {
    fn sample(&mut self, values: &[f32], time_ms: u64, wire: &mut Vec<u8>) {
        if let Ok(values) = values.try_into() {
            VirtualRight::sample(self, values, time_ms, wire);
        }
    }

    fn nothing(&mut self) {
        VirtualRight::nothing(self);
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        VirtualRight::receive(self, bytes, now_ms, wire, no_store);
    }
}

/// Plays a recording like the Nano 33 BLE Sense.
pub struct RightBoard<'m> {
    recording: Recording,
    /// Ranges of missing samples, in order.
    silences: Vec<Range<usize>>,
    next: usize,
    board: Box<dyn AnyAxes + 'm>,
    /// Samples with a lower index were taken before the last call of `step`.
    before: usize,
}

impl<'m> RightBoard<'m> {
    /// Creates a board that starts at time 0 with a recording at 100 Hz.
    ///
    /// # Errors
    /// Returns [`ModelFileError`] if the model cannot run here or the recording has other axes.
    pub fn new(recording: Recording, model: &'m ModelFile, boot_id: u32) -> Result<Self, ModelFileError> {
        let name = || model.name().to_owned();
        let parsed = model.model()?;
        let length = parsed.info().label_text.len();
        if length > LABELS_MAX {
            return Err(ModelFileError::Labels { name: name(), length });
        }
        let unfit = |source| ModelFileError::Unfit { name: name(), source };
        let axes = parsed.info().axes;
        if axes != recording.axes() {
            return Err(unfit(ModelMismatch::Axes { model: axes, hand: recording.axes() }));
        }
        let identity = Identity {
            board: BoardKind::RightReplay,
            firmware: env!("CARGO_PKG_VERSION"),
            boot_id,
            sample_hz: parsed.info().sample_hz,
        };
        let board = match axes {
            3 => any_axes::<3>(identity, parsed),
            6 => any_axes::<6>(identity, parsed),
            _ => any_axes::<9>(identity, parsed),
        };
        Ok(RightBoard { recording, silences: Vec::new(), next: 0, board: board.map_err(unfit)?, before: 0 })
    }
}

impl RightBoard<'_> {
    /// Removes these samples, as if the sensor had delivered no data. They therefore cause no state.
    #[must_use]
    pub fn silent_in(self, silences: Vec<Range<usize>>) -> Self {
        RightBoard { silences, ..self }
    }

    fn is_silent(&self, sample: usize) -> bool {
        let behind = self.silences.partition_point(|slots| slots.end <= sample);
        self.silences.get(behind).is_some_and(|slots| slots.start <= sample)
    }
}

fn any_axes<'m, const A: usize>(
    identity: Identity,
    model: Model<'m>,
) -> Result<Box<dyn AnyAxes + 'm>, ModelMismatch> {
    let hand = RightHand::<A>::new(model, DecisionConfig::default())?;
    Ok(Box::new(VirtualRight::start(identity, ValueHand::new(hand, COUNT))))
}

impl Board for RightBoard<'_> {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        self.before = self.next;
        while self.next as u64 * PERIOD_MS <= now_ms
            && let Some(sample) = self.recording.samples().nth(self.next)
        {
            if self.is_silent(self.next) {
                self.board.nothing();
            } else {
                self.board.sample(sample, self.next as u64 * PERIOD_MS, wire);
            }
            self.next += 1;
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        if !self.ended() {
            self.board.receive(bytes, now_ms, wire);
        }
    }

    fn sample(&self) -> Option<Sample<'_>> {
        let newest =
            self.next.checked_sub(1).filter(|newest| *newest >= self.before && !self.is_silent(*newest))?;
        self.recording.samples().nth(newest).map(|values| Sample::Right { values })
    }

    fn ended(&self) -> bool {
        self.next >= self.recording.len()
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
        let joined = join(&[file.clone(), file.clone()], (3, 3), &Reading::default()).unwrap().recording;
        assert_eq!(joined.axes(), 3);
        assert!(joined.samples().all(|sample| sample == [1.0, 2.0, 3.0]));
        assert_eq!(joined.len(), 4);
        // A model that reads no magnetometer accepts recordings without one.
        let six = folder.path().join("six.csv");
        std::fs::write(&six, "time,ax,ay,az,gx,gy,gz\n5000,1,2,9,4,5,6\n5010,1,2,9,4,5,6\n").unwrap();
        let joined = join(std::slice::from_ref(&six), (9, 6), &Reading::default()).unwrap();
        assert_eq!((joined.start_ms, joined.recording.axes()), (5000.0, 9));
        assert!(
            joined.recording.samples().all(|sample| sample == [1.0, 2.0, 9.0, 4.0, 5.0, 6.0, 0.0, 0.0, 0.0])
        );
        assert!(join(&[six], (9, 9), &Reading::default()).is_err());
    }

    /// Writes a recording of a still hand with nine axes at these times.
    fn still(folder: &Path, times: impl Iterator<Item = u32>) -> PathBuf {
        let file = folder.join("still.csv");
        let rows = times.map(|t| format!("{t},0.01,0.02,9.8,0.1,0.2,0.3,20,1,40\n"));
        let header = "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\n".to_owned();
        std::fs::write(&file, header + &rows.collect::<String>()).unwrap();
        file
    }

    #[test]
    fn a_hole_in_a_recording_is_a_hand_that_is_silent_and_starts_over() {
        use shared_proto::frame::{BOARD_FRAME_MAX, Decoder};
        use shared_proto::message::{BoardMessage, health};
        let folder = tempfile::tempdir().unwrap();
        // A radio loses three samples at 1 s, and there is a gap of 60 s at 3 s.
        let times =
            (0..600).filter(|n| !(100..103).contains(n)).map(|n| n * 10 + if n < 300 { 0 } else { 60_000 });
        let file = still(folder.path(), times);
        let Joined { recording, silences, notes, .. } = join(&[file], (9, 9), &Reading::default()).unwrap();
        assert_eq!(silences, vec![300..6300]);
        assert!(
            notes.iter().any(|note| note.contains("the longest of 60.0 s from 3.0 s on: the hand is silent")),
            "{notes:?}"
        );
        let model = ModelFile::bundled().unwrap();
        let mut board = RightBoard::new(recording, &model, 1).unwrap().silent_in(silences);
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        let mut states = Vec::new();
        for now_ms in 0..66_000 {
            let mut wire = Vec::new();
            board.step(now_ms, &mut wire);
            if now_ms == 30_000 {
                assert!(board.sample().is_none());
            }
            for byte in wire {
                if let Some(BoardMessage::Right(state)) = decoder.push_board(byte) {
                    states.push((now_ms, state.health & health::GAP != 0));
                }
            }
        }
        let within = |from: u64, to: u64| states.iter().filter(move |(at, _)| (from..to).contains(at));
        assert_eq!(within(3_000, 63_000).count(), 0, "silence");
        assert!(within(2_000, 3_000).all(|(_, gap)| !gap) && within(900, 1_500).count() > 5, "bridged");
        // A window needs two seconds of samples, and until then the hand has no effect.
        assert!(within(63_000, 64_900).all(|(_, gap)| *gap) && within(63_000, 64_900).count() > 20);
        assert!(within(65_100, 66_000).all(|(_, gap)| !gap));
    }
}
