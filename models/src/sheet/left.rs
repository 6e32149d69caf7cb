//! Reads rows of the left hand's recordings, which contain conversions of its five channels.

use std::path::{Path, PathBuf};

use super::error::RecordingError;
use super::reader::{ColumnTable, Format, Problem, ReadCell, Rows};
use super::text;

/// The channels' names, in the order of a sample's values.
pub(crate) const CHANNEL_NAMES: [&str; 5] = ["x", "y", "z", "index", "middle"];

/// Maximum value of a 12-bit converter.
const CONVERSION_MAX: f64 = 4095.0;
/// Number of conversions that a board adds up. A mean is therefore a multiple of one over this number.
const PARTS: f64 = shared_dsp::left::OVERSAMPLING as f64;
/// Maximum time between two samples. A clock that jumps further is unusable.
const LONGEST_MS: f64 = 1e12;

struct Left;

impl Format for Left {
    /// The channels' columns.
    type Layout = [usize; 5];
    const WANTED: &'static str = "the header must be timestamp_ms,x,y,z,index,middle";
    const INSTEAD: &'static str = "leave --left out";
    const TAKES: bool = false;

    fn columns(&self, names: &[String]) -> Result<Option<(ColumnTable, [usize; 5])>, Problem> {
        let channel = |name: &String| CHANNEL_NAMES.iter().position(|known| known == name);
        let is_time = |name: &String| matches!(name.as_str(), "timestamp_ms" | "timestamp");
        // A row with a time column is a header, even if it is the header of a right hand.
        if names.iter().filter_map(channel).count() < 2 && !names.iter().any(is_time) {
            return Ok(None);
        }
        let (mut time, mut channels) = (None, [None; 5]);
        for (at, name) in names.iter().enumerate() {
            let known = match channel(name) {
                Some(channel) => &mut channels[channel],
                None if is_time(name) => &mut time,
                None => return Err((at + 1, name.clone(), "a left hand has no such column".to_owned())),
            };
            if known.replace(at).is_some() {
                return Err((at + 1, name.clone(), "this column is there twice".to_owned()));
            }
        }
        let missing = |name: &str| (names.len() + 1, name.to_owned(), "the column is missing".to_owned());
        let time = time.ok_or_else(|| missing("timestamp_ms"))?;
        let mut columns = [0; 5];
        for ((column, found), name) in columns.iter_mut().zip(channels).zip(CHANNEL_NAMES) {
            *column = found.ok_or_else(|| missing(name))?;
        }
        let values = columns.map(|column| (column, conversion as ReadCell)).to_vec();
        Ok(Some((ColumnTable { time: Some(time), values }, columns)))
    }

    fn missing(&self, numbers: bool) -> &'static str {
        if numbers { "the file has no header" } else { "no channels of a left hand are named" }
    }
}

/// Parses a conversion: an integer, or a multiple of an eighth, such as the mean of eight conversions.
fn conversion(cell: &str) -> Result<f64, &'static str> {
    let plain = cell.bytes().all(|byte| byte.is_ascii_digit() || matches!(byte, b'.' | b','));
    let count = text::number(cell).filter(|_| plain);
    count
        .filter(|count| *count <= CONVERSION_MAX && (count * PARTS).fract() == 0.0)
        .ok_or("whole number from 0 to 1023, nor one with eighths, as raw conversions are")
}

/// A sample in the units of the file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeftRow {
    line: u64,
    /// Time since the first sample in ms.
    pub time_ms: f64,
    /// Of each channel.
    pub conversions: [f64; 5],
}

/// At least two samples from a file, sorted by time.
#[derive(Clone, Debug)]
pub(crate) struct LeftSheet {
    file: PathBuf,
    /// The numbers of the time column and of the channels' columns.
    columns: (usize, [usize; 5]),
    /// Time of the first sample in the file, in ms.
    pub start_ms: f64,
    /// The samples.
    pub rows: Vec<LeftRow>,
}

impl LeftSheet {
    /// Parses the bytes of a file; `file` is used only in errors.
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        let text = text::decode(bytes);
        let mut reader = Rows::of(file, &text, &Left)?;
        let columns = (reader.time_column(), reader.head.layout);
        let mut rows: Vec<LeftRow> = Vec::new();
        let (mut start_ms, mut before) = (0.0, f64::NEG_INFINITY);
        while let Some(row) = reader.next_row()? {
            let (line, time) = (row.line, row.time.unwrap_or_default());
            let to_ms = if row.is_of_day { 1000.0 } else { 1.0 };
            let Ok(&conversions) = <&[f64; 5]>::try_from(row.values) else { continue };
            // From the third sample on, a millisecond clock may repeat a time.
            if time == before && rows.len() < 2 {
                return Err(reader.time_error(line, time, before));
            }
            before = time;
            let time_ms = to_ms * time;
            if rows.is_empty() {
                start_ms = time_ms;
            }
            let time_ms = time_ms - start_ms;
            if !(0.0..=LONGEST_MS).contains(&time_ms) {
                return Err(reader.value_error(
                    line,
                    columns.0,
                    &time.to_string(),
                    "time of this recording".into(),
                ));
            }
            rows.push(LeftRow { line, time_ms, conversions });
        }
        match rows.len() {
            0 => Err(Left::empty(file, "there are no samples below the header")),
            1 => Err(Left::empty(file, "one sample is not enough to tell the sampling rate")),
            _ => Ok(Self { file: file.to_owned(), columns, start_ms, rows }),
        }
    }

    /// Returns the error for a row in which a conversion exceeds the converter's range.
    pub fn too_large(&self, row: &LeftRow, channel: usize, largest: f64) -> RecordingError {
        RecordingError::Value {
            file: self.file.clone(),
            line: row.line,
            column: self.columns.1[channel] + 1,
            name: CHANNEL_NAMES[channel].to_owned(),
            value: row.conversions[channel].to_string(),
            wanted: format!("whole number from 0 to {largest}, nor one with eighths, as raw conversions are")
                .into(),
        }
    }

    /// Returns the error for a sampling rate that cannot be converted to the board's.
    pub fn wrong_rate(&self, interval_ms: f64, (slowest_hz, fastest_hz): (f64, f64)) -> RecordingError {
        RecordingError::Rate {
            file: self.file.clone(),
            column: self.columns.0 + 1,
            rate_hz: 1000.0 / interval_ms,
            slowest_hz,
            fastest_hz,
        }
    }
}
