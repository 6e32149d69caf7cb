//! A recording of the right hand. This module reads, checks and resamples recordings, and writes CSV files.
//!
//! The output format is Edge Impulse's: a header `timestamp` or `timestamp_ms`, then `accX,accY,accZ` (m/s²).
//! Optional columns are `gyrX,gyrY,gyrZ` (deg/s) and `magX,magY,magZ` (µT); times are in ms.
//! [`crate::sheet`] lists the other formats that can be read.
//! Nothing is dropped or repaired silently: [`Recording::notes`] lists all repairs.
//! Unusable data causes an error with the file, the line, the column and a remedy.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use crate::RATE_HZ;
pub use crate::sheet::RecordingError;
use crate::sheet::{self, Reading, Sheet};

/// Column names in the order of a sample's axes.
pub const AXIS_NAMES: [&str; 9] = ["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ", "magX", "magY", "magZ"];

/// Minimum sampling rate in Hz.
pub const MIN_RATE_HZ: f64 = 25.0;
/// Maximum sampling rate in Hz.
pub const MAX_RATE_HZ: f64 = 500.0;

/// Maximum length of a recording, because its pauses are also resampled to the models' rate.
const LONGEST_H: f64 = 24.0;

/// A rate that differs by at most this fraction counts as equal, and its samples are used unchanged.
pub(crate) const SAME_RATE: f64 = 0.01;

/// Samples of 3, 6 or 9 axes, and their times.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    axes: usize,
    time_ms: Vec<f64>,
    values: Vec<f32>,
    notes: Vec<String>,
}

impl Recording {
    /// Creates a recording from its parts: `values` contains `axes` values for each entry of `time_ms`.
    ///
    /// # Panics
    /// Panics if `axes` is not 3, 6 or 9, or if the lengths do not match.
    /// Callers use constants, so no panic occurs.
    pub fn new(axes: usize, time_ms: Vec<f64>, values: Vec<f32>) -> Self {
        assert!(matches!(axes, 3 | 6 | 9), "3, 6 or 9 axes");
        assert_eq!(values.len(), time_ms.len() * axes, "one value per axis and time");
        Self { axes, time_ms, values, notes: Vec::new() }
    }

    /// Reads a CSV file.
    pub fn read(file: &Path) -> Result<Self, RecordingError> {
        Self::read_as(file, &Reading::default())
    }

    /// Reads a CSV file with the rules of [`Reading`].
    ///
    /// # Errors
    /// As [`Self::parse_as`].
    pub fn read_as(file: &Path, reading: &Reading) -> Result<Self, RecordingError> {
        let bytes =
            std::fs::read(file).map_err(|source| RecordingError::Io { file: file.to_owned(), source })?;
        Self::parse_as(file, &bytes, reading)
    }

    /// Parses the bytes of a CSV file; `file` is used only in errors.
    /// Undeclared units must be ours; if they differ, the file is refused.
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        Self::parse_as(file, bytes, &Reading::default())
    }

    /// Like [`Self::parse`], with the rules of [`Reading`].
    ///
    /// # Errors
    /// Returns a [`RecordingError`], for example if the file contains several recordings.
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

    /// Descriptions of everything that was inferred, repaired or omitted while reading.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Number of axes per sample: 3 (accelerometer), 6 (with gyroscope) or 9 (with magnetometer).
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time_ms.len()
    }

    /// Whether there are no samples. A recording from a file always contains samples.
    pub fn is_empty(&self) -> bool {
        self.time_ms.is_empty()
    }

    /// Time of each sample in milliseconds.
    pub fn time_ms(&self) -> &[f64] {
        &self.time_ms
    }

    /// The samples in order. Each has `axes()` values in m/s², deg/s and µT.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        self.values.chunks_exact(self.axes)
    }

    /// Mean sampling rate in Hz; 0 for fewer than two samples.
    pub fn rate_hz(&self) -> f64 {
        match (self.time_ms.first(), self.time_ms.last()) {
            (Some(first), Some(last)) if last > first => (self.len() - 1) as f64 * 1000.0 / (last - first),
            _ => 0.0,
        }
    }

    /// Length in seconds; every sample counts for one interval.
    pub fn seconds(&self) -> f64 {
        let rate_hz = self.rate_hz();
        if rate_hz > 0.0 { self.len() as f64 / rate_hz } else { 0.0 }
    }

    /// Number of gaps, which are intervals longer than 2.5 mean intervals.
    pub fn gaps(&self) -> usize {
        let limit_ms = 2.5 * 1000.0 / self.rate_hz();
        self.time_ms.windows(2).filter(|pair| pair[1] - pair[0] > limit_ms).count()
    }

    /// Pauses longer than `limit_ms`: the index of the sample before each pause, and the duration of the pause.
    pub fn holes(&self, limit_ms: f64) -> Vec<(usize, f64)> {
        let steps = self.time_ms.windows(2).map(|pair| pair[1] - pair[0]).enumerate();
        steps.filter(|(_, step)| *step > limit_ms).collect()
    }

    /// Returns the recording with only its first `axes` axes.
    ///
    /// # Panics
    /// Panics if the recording has fewer axes, or `axes` is not 3, 6 or 9.
    pub fn with_axes(&self, axes: usize) -> Self {
        assert!(axes <= self.axes, "{axes} axes of {}", self.axes);
        let values = self.samples().flat_map(|sample| sample[..axes].iter().copied()).collect();
        Self::new(axes, self.time_ms.clone(), values)
    }

    /// Returns `len` samples from index `start` on, or as many as exist.
    pub fn slice(&self, start: usize, len: usize) -> Self {
        let start = start.min(self.len());
        let end = (start + len).min(self.len());
        let values = self.values[start * self.axes..end * self.axes].to_vec();
        Self::new(self.axes, self.time_ms[start..end].to_vec(), values)
    }

    /// Returns the recording at the models' rate of [`RATE_HZ`], evenly spaced from time 0.
    ///
    /// If the rate is within 1 % and there are no gaps, the samples are used unchanged.
    /// Otherwise, each new sample is interpolated linearly between its neighbours in time.
    /// To avoid aliasing, a recording at a much higher rate is first averaged over one new interval.
    /// This applies above 1.5 times the models' rate.
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
        // The small tolerance preserves a last sample that rounding would place just after the end.
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

    /// Replaces each sample with the mean of all samples that are at most half of `span_ms` away.
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

    /// Returns the CSV text with the header `timestamp_ms,…`.
    /// Accelerations have 4 decimals and all other values have 2, as in recordings of real boards.
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

    /// Like [`Self::to_csv`], but with the header that Edge Impulse expects, which our own tools also read.
    pub fn to_edge_impulse_csv(&self) -> String {
        self.to_csv().replacen("timestamp_ms", "timestamp", 1)
    }

    /// Writes the CSV file completely or not at all.
    pub fn write(&self, file: &Path) -> std::io::Result<()> {
        write_whole(file, self.to_csv().as_bytes())
    }
}

/// Writes a file under a temporary name and then renames it, so that a partial file is never visible.
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
