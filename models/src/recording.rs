//! One recording of the right hand: reading, checking, resampling and writing its CSV file.
//!
//! The format that is written is Edge Impulse's: a header `timestamp` or `timestamp_ms`, then `accX,accY,accZ`
//! (m/s²), optionally `gyrX,gyrY,gyrZ` (deg/s), optionally `magX,magY,magZ` (µT); times in ms. What is read besides,
//! [`crate::sheet`] says. Nothing is dropped or repaired silently: what was mended is in [`Recording::notes`], and what
//! cannot be used is an error that names the file, the line and the column and says what to do.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use crate::RATE_HZ;
pub use crate::sheet::RecordingError;
use crate::sheet::{self, Reading, Sheet};

/// Column names in the order of a sample's axes.
pub const AXIS_NAMES: [&str; 9] = ["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ", "magX", "magY", "magZ"];

/// Slowest sampling rate that is accepted, in Hz.
pub const MIN_RATE_HZ: f64 = 25.0;
/// Fastest sampling rate that is accepted, in Hz.
pub const MAX_RATE_HZ: f64 = 500.0;

/// Longer than this no recording is: what is read is brought to the models' rate, pauses and all.
const LONGEST_H: f64 = 24.0;

/// A rate this near to the wanted one counts as the wanted one: samples are used as they are.
pub(crate) const SAME_RATE: f64 = 0.01;

/// Samples of 3, 6 or 9 axes with their times.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    axes: usize,
    time_ms: Vec<f64>,
    values: Vec<f32>,
    notes: Vec<String>,
}

impl Recording {
    /// A recording from its parts: `values` holds `axes` values per entry of `time_ms`.
    ///
    /// # Panics
    /// If `axes` is not 3, 6 or 9 or the lengths do not match: these are the caller's constants.
    pub fn new(axes: usize, time_ms: Vec<f64>, values: Vec<f32>) -> Self {
        assert!(matches!(axes, 3 | 6 | 9), "3, 6 or 9 axes");
        assert_eq!(values.len(), time_ms.len() * axes, "one value per axis and time");
        Self { axes, time_ms, values, notes: Vec::new() }
    }

    /// Reads a CSV file.
    pub fn read(file: &Path) -> Result<Self, RecordingError> {
        Self::read_as(file, &Reading::default())
    }

    /// Reads a CSV file as [`Reading`] says.
    ///
    /// # Errors
    /// As [`Self::parse_as`].
    pub fn read_as(file: &Path, reading: &Reading) -> Result<Self, RecordingError> {
        let bytes =
            std::fs::read(file).map_err(|source| RecordingError::Io { file: file.to_owned(), source })?;
        Self::parse_as(file, &bytes, reading)
    }

    /// Reads the bytes of a CSV file; `file` is only for the errors. Units that the file does not declare are ours, or
    /// it is refused.
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        Self::parse_as(file, bytes, &Reading::default())
    }

    /// The same of a file that is read as [`Reading`] says.
    ///
    /// # Errors
    /// [`RecordingError`], also where the file holds several recordings.
    pub fn parse_as(file: &Path, bytes: &[u8], reading: &Reading) -> Result<Self, RecordingError> {
        let Sheet { mut takes, notes } = sheet::parse(file, bytes, reading)?;
        match takes.pop() {
            Some(recording) if takes.is_empty() => {
                let times = recording.time_ms();
                let hours = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first) / 3.6e6;
                if hours > LONGEST_H {
                    return Err(RecordingError::Long { file: file.to_owned(), hours });
                }
                Ok(Self { notes, ..recording })
            }
            _ => Err(RecordingError::Takes { file: file.to_owned(), takes: takes.len() + 1 }),
        }
    }

    /// What was judged, repaired or left out when it was read, in words.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Axes per sample: 3 (accelerometer), 6 (and gyroscope) or 9 (and magnetometer).
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time_ms.len()
    }

    /// Whether there are no samples (never so for a recording that was read).
    pub fn is_empty(&self) -> bool {
        self.time_ms.is_empty()
    }

    /// Time of each sample in ms.
    pub fn time_ms(&self) -> &[f64] {
        &self.time_ms
    }

    /// The samples in order, `axes()` values each: m/s², deg/s, µT.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        self.values.chunks_exact(self.axes)
    }

    /// Mean sampling rate in Hz; 0 with fewer than two samples.
    pub fn rate_hz(&self) -> f64 {
        match (self.time_ms.first(), self.time_ms.last()) {
            (Some(first), Some(last)) if last > first => (self.len() - 1) as f64 * 1000.0 / (last - first),
            _ => 0.0,
        }
    }

    /// Length in seconds: every sample stands for one interval.
    pub fn seconds(&self) -> f64 {
        let rate_hz = self.rate_hz();
        if rate_hz > 0.0 { self.len() as f64 / rate_hz } else { 0.0 }
    }

    /// Intervals longer than 2.5 mean intervals: places where samples were lost.
    pub fn gaps(&self) -> usize {
        let limit_ms = 2.5 * 1000.0 / self.rate_hz();
        self.time_ms.windows(2).filter(|pair| pair[1] - pair[0] > limit_ms).count()
    }

    /// Pauses longer than `limit_ms`: the sample before each, and how long it is.
    pub fn holes(&self, limit_ms: f64) -> Vec<(usize, f64)> {
        let steps = self.time_ms.windows(2).map(|pair| pair[1] - pair[0]).enumerate();
        steps.filter(|(_, step)| *step > limit_ms).collect()
    }

    /// The first `axes` axes only.
    ///
    /// # Panics
    /// If the recording has fewer axes, or `axes` is not 3, 6 or 9.
    pub fn with_axes(&self, axes: usize) -> Self {
        assert!(axes <= self.axes, "{axes} axes of {}", self.axes);
        let values = self.samples().flat_map(|sample| sample[..axes].iter().copied()).collect();
        Self::new(axes, self.time_ms.clone(), values)
    }

    /// The samples from `start` on, `len` of them or as many as there are.
    pub fn slice(&self, start: usize, len: usize) -> Self {
        let start = start.min(self.len());
        let end = (start + len).min(self.len());
        let values = self.values[start * self.axes..end * self.axes].to_vec();
        Self::new(self.axes, self.time_ms[start..end].to_vec(), values)
    }

    /// The recording at the models' rate of [`RATE_HZ`], evenly spaced from time 0.
    ///
    /// A rate within 1 % of it and without gaps is taken sample for sample. Otherwise each new
    /// sample is interpolated linearly between its neighbours in time; a recording more than half
    /// as fast again is first averaged over one new interval, so that what lies above the new
    /// Nyquist frequency does not fold back.
    pub fn resampled(&self) -> Self {
        let interval_ms = 1000.0 / RATE_HZ;
        if (self.rate_hz() / RATE_HZ - 1.0).abs() <= SAME_RATE && self.gaps() == 0 {
            let time_ms = (0..self.len()).map(|n| n as f64 * interval_ms).collect();
            return Self::new(self.axes, time_ms, self.values.clone());
        }
        let smooth = self.rate_hz() > 1.5 * RATE_HZ;
        let source = if smooth { self.averaged_over(interval_ms) } else { self.values.clone() };
        let start_ms = self.time_ms[0];
        let last_ms = self.time_ms[self.len() - 1];
        // The small allowance keeps a last sample that rounding would put just past the end.
        let count = ((last_ms - start_ms) / interval_ms + 1e-6).floor() as usize + 1;
        let mut values = Vec::with_capacity(count * self.axes);
        let mut left = 0;
        for n in 0..count {
            let at_ms = start_ms + n as f64 * interval_ms;
            while left + 2 < self.len() && self.time_ms[left + 1] <= at_ms {
                left += 1;
            }
            let span_ms = self.time_ms[left + 1] - self.time_ms[left];
            let part = ((at_ms - self.time_ms[left]) / span_ms).clamp(0.0, 1.0) as f32;
            for axis in 0..self.axes {
                let a = source[left * self.axes + axis];
                let b = source[(left + 1) * self.axes + axis];
                values.push(a + (b - a) * part);
            }
        }
        let time_ms = (0..count).map(|n| n as f64 * interval_ms).collect();
        Self::new(self.axes, time_ms, values)
    }

    /// Each sample replaced by the mean of those less than half of `span_ms` away.
    fn averaged_over(&self, span_ms: f64) -> Vec<f32> {
        let mut values = Vec::with_capacity(self.values.len());
        let (mut from, mut to) = (0, 0);
        for &at_ms in &self.time_ms {
            while self.time_ms[from] < at_ms - span_ms / 2.0 {
                from += 1;
            }
            while to < self.len() && self.time_ms[to] < at_ms + span_ms / 2.0 {
                to += 1;
            }
            for axis in 0..self.axes {
                let sum: f64 = (from..to).map(|n| f64::from(self.values[n * self.axes + axis])).sum();
                values.push((sum / (to - from) as f64) as f32);
            }
        }
        values
    }

    /// The CSV text: header `timestamp_ms,…`, acceleration with 4 decimals, the rest with 2, as
    /// the recordings of real boards have them.
    pub fn to_csv(&self) -> String {
        let mut text = String::with_capacity(self.len() * self.axes * 9);
        text.push_str("timestamp_ms");
        for name in &AXIS_NAMES[..self.axes] {
            text.push(',');
            text.push_str(name);
        }
        text.push('\n');
        for (time_ms, sample) in self.time_ms.iter().zip(self.samples()) {
            let _ = write!(text, "{time_ms}");
            for (axis, value) in sample.iter().enumerate() {
                let decimals = if axis < 3 { 4 } else { 2 };
                let _ = write!(text, ",{value:.decimals$}");
            }
            text.push('\n');
        }
        text
    }

    /// Writes the CSV file whole or not at all.
    pub fn write(&self, file: &Path) -> std::io::Result<()> {
        write_whole(file, self.to_csv().as_bytes())
    }
}

/// Writes a file under a temporary name and renames it, so that no reader ever sees half of it.
pub fn write_whole(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = file.with_file_name(name);
    let written = std::fs::File::create(&part).and_then(|mut out| {
        out.write_all(bytes)?;
        out.sync_all()
    });
    let renamed = written.and_then(|()| std::fs::rename(&part, file));
    if renamed.is_err() {
        let _ = std::fs::remove_file(&part);
    }
    renamed
}
