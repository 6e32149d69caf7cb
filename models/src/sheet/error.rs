//! Errors that explain why a recording cannot be used.

use std::borrow::Cow;
use std::path::PathBuf;

/// The reason why a recording of either hand cannot be used. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be opened or read.
    #[error("{file}: {source}; check the path and that the file may be read")]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error message.
        source: std::io::Error,
    },
    /// The file is empty, or contains a header without samples.
    #[error("{file}: {what}; record it again or {instead}")]
    Empty {
        /// The file.
        file: PathBuf,
        /// The missing part.
        what: &'static str,
        /// An alternative that the user has.
        instead: &'static str,
    },
    /// The columns of a recording were not found.
    #[error("{file}, line {line}{}: {problem}; {wanted}", column_name(*.column, .name))]
    Header {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Number of the column, from 1; 0 if the problem concerns no particular column.
        column: usize,
        /// Its name.
        name: String,
        /// The problem with the column.
        problem: String,
        /// The columns that such a file must have.
        wanted: &'static str,
    },
    /// No column holds times.
    #[error(
        "{file}: there is no column of times; if the rate is known, say it with --rate, for example `models import --rate 119`"
    )]
    NoTimes {
        /// The file.
        file: PathBuf,
    },
    /// Samples do not have the required or declared units.
    #[error("{file}: {problem}")]
    Units {
        /// The file.
        file: PathBuf,
        /// The units that the samples appear to have, and a remedy.
        problem: String,
    },
    /// The file contains several recordings.
    #[error(
        "{file}: the file holds {takes} recordings, one after the other; `models import` makes a file of each"
    )]
    Takes {
        /// The file.
        file: PathBuf,
        /// How many.
        takes: usize,
    },
    /// The times of the file are days apart.
    #[error(
        "{file}: the recording is {hours:.0} h long, so its clock has jumped; correct the times, or let `models import` \
         part it at its pauses"
    )]
    Long {
        /// The file.
        file: PathBuf,
        /// Time from the first to the last sample in hours.
        hours: f64,
    },
    /// A row has too few or too many values.
    #[error(
        "{file}, line {line}, column {column}: the row has {found} values, the header {expected}; \
         the file may be cut off or damaged here: delete the line or record it again"
    )]
    Row {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Number of the first missing or superfluous column, from 1.
        column: usize,
        /// Values in the row.
        found: usize,
        /// Values in the header.
        expected: usize,
    },
    /// A value is invalid in its column.
    #[error(
        "{file}, line {line}, column {column} ({name}): {value:?} is not a {wanted}; \
         correct the value or delete the line"
    )]
    Value {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Column, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// The actual content.
        value: String,
        /// The expected content.
        wanted: Cow<'static, str>,
    },
    /// The time of a row is not later than the time of the previous row.
    #[error(
        "{file}, line {line}, column {column} ({name}): time {time_ms} ms follows {before_ms} ms; \
         times must rise: sort the rows, or split the file where a second recording starts"
    )]
    Time {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Column, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// The time in this row, in milliseconds.
        time_ms: f64,
        /// The time in the previous row, in milliseconds.
        before_ms: f64,
    },
    /// The sampling rate is out of range, or cannot be determined.
    #[error(
        "{file}, column {column}: the sampling rate is {rate_hz:.1} Hz, but {slowest_hz} to {fastest_hz} Hz are needed; \
         times must be in milliseconds"
    )]
    Rate {
        /// The file.
        file: PathBuf,
        /// The time column, from 1.
        column: usize,
        /// The measured rate, in Hz.
        rate_hz: f64,
        /// Minimum permitted rate in Hz.
        slowest_hz: f64,
        /// The fastest.
        fastest_hz: f64,
    },
    /// The file cannot be parsed as CSV at all.
    #[error("{file}, line {line}: {what}; save it as plain CSV text in UTF-8")]
    Text {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        what: String,
    },
}

/// Formats the column as `, column 3 ("accZ")`, as far as it is known.
fn column_name(column: usize, name: &str) -> String {
    match (column, name) {
        (0, "") => String::new(),
        (0, name) => format!(" ({name:?})"),
        (column, name) => format!(", column {column} ({name:?})"),
    }
}
