//! Recordings of the left hand: raw converter counts, as the Nano reads them.
//!
//! CSV with the header `timestamp_ms,x,y,z,index,middle` (or `timestamp`): plain 10-bit conversions, 0 to
//! 1023, at 100 Hz. Nothing is repaired silently: what cannot be used is an error that names the file,
//! the line and the column and says what to do.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Names of the five lines, in the order of the columns.
pub const LINE_NAMES: [&str; 5] = ["x", "y", "z", "index", "middle"];

/// Largest conversion.
pub const COUNT_MAX: u16 = 1023;

/// The board samples every 10 ms; a recording must be this near to that on average.
const INTERVAL_MS: std::ops::RangeInclusive<f64> = 9.0..=11.0;

/// Samples of all five lines with their times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AdcRecording {
    /// Time and conversions (x, y, z, index, middle) of each sample.
    pub samples: Vec<(u64, [u16; 5])>,
}

/// Why a recording cannot be used; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum AdcError {
    /// The file cannot be opened or read.
    #[error("{file}: {source}; check the path and that the file may be read")]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Nothing in the file, or a header without samples.
    #[error("{file}: {what}; record it again or leave --left out")]
    Empty {
        /// The file.
        file: PathBuf,
        /// What is missing.
        what: &'static str,
    },
    /// One line or value is wrong.
    #[error("{file}, line {line}, column {column} ({name}): {problem}")]
    Bad {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Column, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The sampling rate is not the board's.
    #[error(
        "{file}, column 1: one sample every {interval_ms:.2} ms, but the left hand is sampled every 10 ms; \
         times must be in milliseconds, at 100 Hz"
    )]
    Rate {
        /// The file.
        file: PathBuf,
        /// Mean interval.
        interval_ms: f64,
    },
}

impl AdcRecording {
    /// Reads a CSV file.
    ///
    /// # Errors
    /// [`AdcError`] for anything but a whole recording.
    pub fn read(file: &Path) -> Result<Self, AdcError> {
        let bytes = std::fs::read(file).map_err(|source| AdcError::Io { file: file.to_owned(), source })?;
        Self::parse(file, &bytes)
    }

    /// Reads the bytes of a CSV file; `file` is only for the errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, AdcError> {
        let bad = |line: u64, column: usize, name: &str, problem: String| AdcError::Bad {
            file: file.to_owned(),
            line,
            column,
            name: name.to_owned(),
            problem,
        };
        let empty = |what| AdcError::Empty { file: file.to_owned(), what };
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(bytes);
        let text = |error: csv::Error| {
            let line = error.position().map_or(1, csv::Position::line);
            bad(line, 1, "text", format!("{error}; save it as plain CSV text in UTF-8"))
        };

        let mut row = csv::StringRecord::new();
        if !reader.read_record(&mut row).map_err(text)? {
            return Err(empty("the file is empty"));
        }
        check_header(&row).map_err(|(column, name, problem)| bad(1, column, &name, problem))?;

        let mut samples: Vec<(u64, [u16; 5])> = Vec::new();
        let mut first_ms = 0.0;
        let mut before_ms = f64::NEG_INFINITY;
        while reader.read_record(&mut row).map_err(text)? {
            let line = row.position().map_or(0, csv::Position::line);
            if row.len() != 6 {
                let problem = format!(
                    "the row has {} values, the header 6; the file may be cut off or damaged here: \
                     delete the line or record it again",
                    row.len()
                );
                return Err(bad(line, row.len().min(6) + 1, "row", problem));
            }
            let time_ms: f64 = row[0].parse().ok().filter(|t: &f64| t.is_finite()).ok_or_else(|| {
                bad(
                    line,
                    1,
                    "timestamp_ms",
                    format!("{:?} is not a number; correct it or delete the line", &row[0]),
                )
            })?;
            if time_ms <= before_ms {
                let problem = format!(
                    "time {time_ms} ms follows {before_ms} ms; times must rise: sort the rows, or split \
                     the file where a second recording starts"
                );
                return Err(bad(line, 1, "timestamp_ms", problem));
            }
            if samples.is_empty() {
                first_ms = time_ms;
            }
            before_ms = time_ms;
            let mut counts = [0; 5];
            for (i, count) in counts.iter_mut().enumerate() {
                let value = &row[i + 1];
                *count = value.parse().ok().filter(|c| *c <= COUNT_MAX).ok_or_else(|| {
                    let problem = format!(
                        "{value:?} is not a whole number from 0 to {COUNT_MAX}; \
                         raw 10-bit conversions are needed: correct it or delete the line"
                    );
                    bad(line, i + 2, LINE_NAMES[i], problem)
                })?;
            }
            samples.push(((time_ms - first_ms).round() as u64, counts));
        }
        let Some(last) = samples.last() else {
            return Err(empty("there are no samples below the header"));
        };
        if samples.len() < 2 {
            return Err(empty("one sample is not enough to tell the sampling rate"));
        }
        let interval_ms = last.0 as f64 / (samples.len() - 1) as f64;
        if !INTERVAL_MS.contains(&interval_ms) {
            return Err(AdcError::Rate { file: file.to_owned(), interval_ms });
        }
        Ok(AdcRecording { samples })
    }

    /// The CSV text.
    pub fn to_csv(&self) -> String {
        let mut text = String::from("timestamp_ms,x,y,z,index,middle\n");
        for (time_ms, [x, y, z, index, middle]) in &self.samples {
            let _ = writeln!(text, "{time_ms},{x},{y},{z},{index},{middle}");
        }
        text
    }
}

/// Column, its name and what is wrong with it.
fn check_header(row: &csv::StringRecord) -> Result<(), (usize, String, String)> {
    const WANTED: &str = "the header must be timestamp_ms,x,y,z,index,middle";
    let names = ["timestamp_ms"].into_iter().chain(LINE_NAMES);
    for (i, wanted) in names.enumerate() {
        match row.get(i) {
            Some(name) if name == wanted || (i == 0 && name == "timestamp") => {}
            Some(name) => return Err((i + 1, name.to_owned(), format!("expected {wanted}; {WANTED}"))),
            None => return Err((i + 1, wanted.to_owned(), format!("the column is missing; {WANTED}"))),
        }
    }
    match row.get(6) {
        Some(name) => Err((7, name.to_owned(), format!("one column too many; {WANTED}"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "timestamp_ms,x,y,z,index,middle\n";

    fn parse(text: &str) -> Result<AdcRecording, String> {
        AdcRecording::parse(Path::new("left.csv"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn what_is_written_reads_back() {
        let samples = vec![(0, [512, 500, 614, 704, 700]), (10, [0, 1023, 1, 2, 3])];
        let recording = AdcRecording { samples };
        assert_eq!(parse(&recording.to_csv()), Ok(recording));
    }

    #[test]
    fn edge_impulse_time_and_windows_line_ends_are_taken() {
        let text = "timestamp,x,y,z,index,middle\r\n100,1,2,3,4,5\r\n110.0,1,2,3,4,5\r\n";
        assert_eq!(parse(text).unwrap().samples[1], (10, [1, 2, 3, 4, 5]));
    }

    #[test]
    fn each_fault_names_file_line_and_column() {
        let row = |text: &str| parse(&format!("{HEADER}0,1,2,3,4,5\n{text}")).unwrap_err();
        for (error, place) in [
            (parse("").unwrap_err(), "left.csv: the file is empty"),
            (parse(HEADER).unwrap_err(), "left.csv: there are no samples"),
            (parse("time,x,y,z,index,middle\n").unwrap_err(), "line 1, column 1 (time)"),
            (parse("timestamp_ms,x,y,z,index\n").unwrap_err(), "line 1, column 6 (middle)"),
            (parse("timestamp_ms,x,y,z,index,middle,a\n").unwrap_err(), "line 1, column 7 (a)"),
            (row("10,1,2,3"), "line 3, column 5 (row)"),
            (row("10,1,2,3,4,5,6"), "line 3, column 7 (row)"),
            (row("10,1,2,x,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,1024,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,-1,4,5"), "line 3, column 4 (z)"),
            (row("NaN,1,2,3,4,5"), "line 3, column 1 (timestamp_ms)"),
            (row("0,1,2,3,4,5"), "line 3, column 1 (timestamp_ms)"),
            (row("20,1,2,3,4,5"), "every 20.00 ms"),
        ] {
            assert!(error.contains(place), "{error}");
            assert!(error.contains("left.csv"), "{error}");
        }
        let missing = AdcRecording::read(Path::new("no/such.csv")).unwrap_err().to_string();
        assert!(missing.contains("no/such.csv"), "{missing}");
    }
}
