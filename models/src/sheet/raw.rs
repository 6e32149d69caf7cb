//! Rows in a file's own units, and how they become recordings.

mod factor;
mod table;

use std::path::Path;

pub use table::Table;

use factor::{acceleration_factor, other_factor};

use super::clock::{self, Stamp};
use super::judge;
use super::layout::{Layout, Problem, Source};
use super::text::{self, Separator};
use super::{Reading, SENSORS, Sensor, Sheet};
use crate::recording::{MAX_RATE_HZ, MIN_RATE_HZ, Recording, RecordingError, SAME_RATE};

/// A header is looked for in so many lines: programs write about themselves first.
const HEADER_WITHIN: usize = 100;
/// After a blank line and so long a pause, in ms, another recording begins.
const PAUSE_MS: f64 = 1000.0;

/// Samples from one start of recording to its end.
#[derive(Clone, Debug, Default)]
struct Take {
    first_line: u64,
    /// As in the file; then in ms.
    times: Vec<f64>,
    /// Of each sensor, as in the file.
    values: [Vec<[f64; 3]>; 3],
}

/// What a file holds, in its own units.
#[derive(Clone, Debug)]
pub(super) struct RawSheet {
    sources: [Option<Source>; 3],
    takes: Vec<Take>,
    notes: Vec<String>,
}

/// Where the columns are, and where the rows begin.
struct Head {
    separator: Separator,
    names: Vec<String>,
    /// Line above the first row.
    line: u64,
    /// Every cell is `name:value`.
    pairs: bool,
    layout: Layout,
}

fn header_error(file: &Path, line: u64, (column, name, problem): Problem) -> RecordingError {
    RecordingError::Header { file: file.to_owned(), line, column, name, problem }
}

/// The first line that names an accelerometer's columns (or a sensor's, in a file of one).
fn head(file: &Path, text: &str, reading: &Reading) -> Result<Head, RecordingError> {
    let mut cells = Vec::new();
    let mut first = None;
    let mut problem = None;
    for (line, row) in text::lines(text).filter(|(_, row)| !row.trim().is_empty()).take(HEADER_WITHIN) {
        for separator in Separator::all() {
            separator.split(row, &mut cells);
            if cells.len() < 3 {
                continue;
            }
            let pairs = text::pairs(&cells);
            let is_pairs = pairs.is_some();
            let names: Vec<String> = match &pairs {
                Some(pairs) => pairs.iter().map(|(name, _)| (*name).to_owned()).collect(),
                None => cells.iter().map(|cell| (*cell).to_owned()).collect(),
            };
            let numbers = cells.iter().all(|cell| text::number(cell).is_some());
            if first.is_none() {
                first = Some((line, names.clone(), numbers));
            }
            let layout = match &reading.columns {
                Some(columns) => Layout::given(columns, &names),
                None => Layout::of(&names, file),
            };
            match layout {
                Ok(layout) if layout.sensors.iter().any(Option::is_some) => {
                    // Without a header this is the first row.
                    let line = if is_pairs || numbers { line - 1 } else { line };
                    return Ok(Head { separator, names, line, pairs: is_pairs, layout });
                }
                Ok(_) => {}
                Err(error) => {
                    problem.get_or_insert((line, error));
                }
            }
        }
    }
    if let Some((line, error)) = problem {
        return Err(header_error(file, line, error));
    }
    let nothing = || "no columns of an accelerometer are named".to_owned();
    let (line, problem) = match first {
        None => (1, (0, String::new(), nothing())),
        Some((line, names, numbers)) => {
            let what = if numbers {
                "the file has no header; name its columns with --columns".to_owned()
            } else {
                nothing()
            };
            (line, (1, names.first().cloned().unwrap_or_default(), what))
        }
    };
    Err(header_error(file, line, problem))
}

/// Reads rows.
pub(super) fn parse(file: &Path, bytes: &[u8], reading: &Reading) -> Result<RawSheet, RecordingError> {
    let (text, foreign_line) = text::decode(bytes);
    if text.trim().is_empty() {
        return Err(RecordingError::Empty { file: file.to_owned(), what: "the file is empty" });
    }
    let head = head(file, &text, reading)?;
    let mut rows = Rows {
        file,
        head: &head,
        foreign_line,
        skips_text: reading.guess,
        cells: Vec::with_capacity(head.names.len()),
        takes: Vec::new(),
        break_before: false,
        skipped: 0,
        clock_text: false,
    };
    for (line, row) in text::lines(&text).filter(|(line, _)| *line > head.line) {
        rows.take(line, row)?;
    }
    let Rows { mut takes, skipped, clock_text, .. } = rows;
    let mut notes = head.layout.notes.clone();
    if skipped > 0 {
        notes.push(format!("{skipped} lines of text between the samples are skipped"));
    }
    if takes.is_empty() {
        return Err(RecordingError::Empty {
            file: file.to_owned(),
            what: "there are no samples below the header",
        });
    }
    // A recording of one sample: a button was touched, or a line was lost.
    if takes.len() > 1 {
        let whole = takes.len();
        takes.retain(|take| take.values.iter().flatten().count() > 0 && take.len() > 1);
        if takes.len() < whole {
            notes.push(format!("{} recordings of one sample are left out", whole - takes.len()));
        }
    }
    let mut equal = 0;
    for take in &mut takes {
        equal += take.clocked(file, &head, reading, clock_text, &mut notes)?;
    }
    if equal > 0 {
        notes.push(format!("{equal} samples had the time of the one before and were spread evenly"));
    }
    Ok(RawSheet { sources: head.layout.sensors.clone(), takes, notes })
}

struct Rows<'a> {
    file: &'a Path,
    head: &'a Head,
    foreign_line: Option<u64>,
    skips_text: bool,
    cells: Vec<&'a str>,
    takes: Vec<Take>,
    /// A blank line or another header: a recording may begin here.
    break_before: bool,
    skipped: usize,
    clock_text: bool,
}

impl<'a> Rows<'a> {
    fn take(&mut self, line: u64, row: &'a str) -> Result<(), RecordingError> {
        let (file, head) = (self.file, self.head);
        if row.trim().is_empty() {
            self.break_before = !self.takes.is_empty();
            return Ok(());
        }
        if row.trim_start().starts_with('#') {
            return Ok(());
        }
        let mut cells = std::mem::take(&mut self.cells);
        head.separator.split(row, &mut cells);
        if head.pairs {
            match text::pairs(&cells) {
                Some(pairs) => cells = pairs.into_iter().map(|(_, value)| value).collect(),
                None => cells.clear(),
            }
        }
        let result = self.cells(line, &cells);
        cells.clear();
        self.cells = cells;
        result.map_err(|error| match error {
            RecordingError::Value { .. } if self.foreign_line == Some(line) => RecordingError::Text {
                file: file.to_owned(),
                line,
                what: "there are bytes that are no text".to_owned(),
            },
            error => error,
        })
    }

    fn cells(&mut self, line: u64, cells: &[&str]) -> Result<(), RecordingError> {
        let (file, head) = (self.file, self.head);
        let is_number = |cell: &&str| text::number(cell).is_some_and(f64::is_finite);
        if cells.len() == head.names.len()
            && cells.iter().zip(&head.names).all(|(cell, name)| cell == name)
            && !cells.iter().all(is_number)
        {
            self.break_before = true;
            return Ok(());
        }
        let is_text = !cells.iter().any(is_number);
        // Below a header there may be a row of units.
        let first = self.takes.is_empty() && head.line > 0 && cells.len() == head.names.len();
        if is_text && (self.skips_text || (first && cells.iter().any(|cell| is_unit(cell)))) {
            self.skipped += usize::from(!first);
            return Ok(());
        }
        if cells.len() != head.names.len() {
            return Err(RecordingError::Row {
                file: file.to_owned(),
                line,
                column: cells.len().min(head.names.len()) + 1,
                found: cells.len(),
                expected: head.names.len(),
            });
        }
        let value_error = |column: usize, wanted| RecordingError::Value {
            file: file.to_owned(),
            line,
            column: column + 1,
            name: head.names[column].clone(),
            value: cells[column].chars().take(40).collect(),
            wanted,
        };
        let number = |column: usize| -> Result<f64, RecordingError> {
            let value = text::number(cells[column]).ok_or_else(|| value_error(column, "number"))?;
            // Rounding to float32 may overflow although the text is a finite number.
            if (value as f32).is_finite() { Ok(value) } else { Err(value_error(column, "finite number")) }
        };
        let time = match head.layout.time {
            None => None,
            Some((column, _)) => match clock::stamp(cells[column]) {
                Some(Stamp::Number(time)) if time.is_finite() => Some(time),
                Some(Stamp::Seconds(time)) => {
                    self.clock_text = true;
                    Some(time)
                }
                Some(_) => return Err(value_error(column, "finite number")),
                None => return Err(value_error(column, "number")),
            },
        };
        let before = self.takes.last().and_then(|take| take.times.last().copied());
        let begins = match (time, before) {
            (Some(time), Some(before)) if time < before && !self.break_before => {
                let column = head.layout.time.map_or(0, |(column, _)| column);
                return Err(RecordingError::Time {
                    file: file.to_owned(),
                    line,
                    column: column + 1,
                    name: head.names[column].clone(),
                    time_ms: time,
                    before_ms: before,
                });
            }
            // With times, a blank line alone begins nothing.
            (Some(time), Some(before)) => self.break_before && (time < before || self.pauses(time)),
            _ => self.break_before,
        };
        if begins || self.takes.is_empty() {
            self.takes.push(Take { first_line: line, ..Take::default() });
        }
        self.break_before = false;
        let Some(take) = self.takes.last_mut() else { return Ok(()) };
        for (source, values) in head.layout.sensors.iter().zip(&mut take.values) {
            let Some(source) = source else { continue };
            let mut sample = [0.0; 3];
            for (axis, value) in sample.iter_mut().enumerate() {
                *value = number(source.columns[axis])?;
                if let Some(plus) = source.plus {
                    *value += number(plus[axis])?;
                }
            }
            values.push(sample);
        }
        take.times.extend(time);
        Ok(())
    }

    /// Whether there is a pause before this time.
    fn pauses(&self, time: f64) -> bool {
        let Some(take) = self.takes.last() else { return false };
        let unit = match self.head.layout.time {
            _ if self.clock_text => Some(1000.0),
            Some((_, Some(unit))) => Some(unit),
            _ => clock::unit(&take.times).map(|(_, ms)| ms),
        };
        let step = take.times.last().map_or(0.0, |last| time - last);
        unit.is_some_and(|unit| step * unit > PAUSE_MS)
    }
}

/// A cell below a header that is a unit.
fn is_unit(cell: &str) -> bool {
    let cell = cell.trim_matches(['(', ')', '[', ']']);
    SENSORS.iter().any(|sensor| super::names::factor(*sensor, cell).is_some())
        || matches!(cell.to_lowercase().as_str(), "s" | "ms" | "us" | "ns")
}

impl Take {
    fn len(&self) -> usize {
        self.values.iter().map(Vec::len).max().unwrap_or_default()
    }

    /// Times in ms; how many were equal.
    fn clocked(
        &mut self,
        file: &Path,
        head: &Head,
        reading: &Reading,
        clock_text: bool,
        notes: &mut Vec<String>,
    ) -> Result<usize, RecordingError> {
        if self.len() < 2 {
            let what = "one sample is not enough to tell the sampling rate";
            return Err(RecordingError::Empty { file: file.to_owned(), what });
        }
        let Some((column, declared)) = head.layout.time else {
            let rate_hz = reading.rate_hz.ok_or_else(|| RecordingError::NoTimes { file: file.to_owned() })?;
            self.times = (0..self.len()).map(|n| n as f64 * 1000.0 / rate_hz).collect();
            return Ok(0);
        };
        let unit = match declared {
            _ if clock_text => 1000.0,
            Some(unit) => unit,
            None => match clock::unit(&self.times) {
                Some((name, unit)) => {
                    if unit != 1.0 {
                        let note = format!("times ({}) are in {name}, by the rate", head.names[column]);
                        if !notes.contains(&note) {
                            notes.push(note);
                        }
                    }
                    unit
                }
                None => 1.0,
            },
        };
        self.times.iter_mut().for_each(|time| *time *= unit);
        if let (Some(&first), Some(&last)) = (self.times.first(), self.times.last())
            && first == last
        {
            return Err(RecordingError::Time {
                file: file.to_owned(),
                line: self.first_line + 1,
                column: column + 1,
                name: head.names[column].clone(),
                time_ms: last,
                before_ms: first,
            });
        }
        let equal = clock::spread(&mut self.times);
        let rate_hz = 1000.0 / clock::typical_interval(&self.times).unwrap_or(f64::INFINITY);
        if !(MIN_RATE_HZ * (1.0 - SAME_RATE)..=MAX_RATE_HZ * (1.0 + SAME_RATE)).contains(&rate_hz) {
            return Err(RecordingError::Rate { file: file.to_owned(), rate_hz });
        }
        Ok(equal)
    }
}

/// Several files of one recording, one sensor each: the samples of all at the times of the accelerometer's, between
/// their neighbours. None where there is no accelerometer among them, or they do not overlap in time.
///
/// # Errors
/// As [`super::parse`].
pub fn merge(files: &[(&Path, Vec<u8>)], reading: &Reading) -> Result<Option<Sheet>, RecordingError> {
    let mut sheets = Vec::new();
    for (file, bytes) in files {
        sheets.push((*file, parse(file, bytes, reading)?));
    }
    let is_base = |sheet: &RawSheet| sheet.sources[0].is_some();
    let Some(base) = sheets.iter().position(|(_, sheet)| is_base(sheet)) else { return Ok(None) };
    let (file, mut base) = sheets.swap_remove(base);
    for (other, sheet) in &sheets {
        for (kind, source) in sheet.sources.iter().enumerate() {
            let Some(source) = source else { continue };
            let gravity = kind == 0;
            if !gravity && base.sources[kind].is_some() {
                continue;
            }
            for take in &mut base.takes {
                let Some(values) = sheet.takes.iter().find_map(|theirs| theirs.at(kind, &take.times)) else {
                    return Ok(None);
                };
                if gravity {
                    for (sum, part) in take.values[0].iter_mut().zip(&values) {
                        (0..3).for_each(|axis| sum[axis] += part[axis]);
                    }
                } else {
                    take.values[kind] = values;
                }
            }
            let name = other.file_name().unwrap_or_default().to_string_lossy();
            if gravity {
                base.notes.push(format!("gravity is added from {name}"));
                if let Some(base) = &mut base.sources[0] {
                    base.linear = false;
                }
            } else {
                base.notes.push(format!("{} is from {name}", SENSORS[kind]));
                base.sources[kind] = Some(source.clone());
            }
        }
    }
    base.judged(file, reading).map(Some)
}

impl Take {
    /// A sensor's samples at these times; none where its times do not cover them but for a fifth of a second.
    fn at(&self, kind: usize, times: &[f64]) -> Option<Vec<[f64; 3]>> {
        const SLACK_MS: f64 = 200.0;
        let values = &self.values[kind];
        let (first, last) = (self.times.first()?, self.times.last()?);
        if times.first()? + SLACK_MS < *first || times.last()? - SLACK_MS > *last || values.len() < 2 {
            return None;
        }
        let mut left = 0;
        let at = |&time: &f64| {
            while left + 2 < self.times.len() && self.times[left + 1] <= time {
                left += 1;
            }
            let span = self.times[left + 1] - self.times[left];
            let part = ((time - self.times[left]) / span).clamp(0.0, 1.0);
            std::array::from_fn(|axis| {
                values[left][axis] + (values[left + 1][axis] - values[left][axis]) * part
            })
        };
        Some(times.iter().map(at).collect())
    }
}

impl RawSheet {
    /// One sensor's samples in all takes, times a factor.
    fn of(&self, sensor: Sensor, factor: f64) -> Vec<[f32; 3]> {
        let values = self.takes.iter().flat_map(|take| &take.values[sensor as usize]);
        values.map(|sample| sample.map(|value| (value * factor) as f32)).collect()
    }

    /// Recordings in our units.
    pub(super) fn judged(mut self, file: &Path, reading: &Reading) -> Result<Sheet, RecordingError> {
        let refused = |problem: String| RecordingError::Units { file: file.to_owned(), problem };
        let Some(acceleration) = &self.sources[0] else {
            return Err(header_error(
                file,
                1,
                (0, String::new(), "no columns of an accelerometer are named".into()),
            ));
        };
        let nested = self.sources.iter().take_while(|source| source.is_some()).count();
        if self.sources[nested..].iter().any(Option::is_some) {
            self.notes.push("a magnetometer without a gyroscope is not used".to_owned());
        }
        let rate_hz = self
            .takes
            .first()
            .and_then(|take| clock::typical_interval(&take.times))
            .map_or(100.0, |ms| 1000.0 / ms);
        let mut notes = std::mem::take(&mut self.notes);
        let judge = |factor: f64| judge::acceleration(&self.of(Sensor::Acceleration, factor), rate_hz);
        let first = acceleration_factor(acceleration, reading, &judge, &mut notes).map_err(refused)?;
        let mut factors = [first, 1.0, 1.0];
        if let Some(source) = self.sources[1].as_ref().filter(|_| nested > 1) {
            let moved = self.of(Sensor::Acceleration, first);
            let judge = |factor| judge::turns_in_radians(&moved, &self.of(Sensor::TurnRate, factor));
            factors[1] =
                other_factor(Sensor::TurnRate, source, reading, judge, &mut notes).map_err(refused)?;
        }
        if let Some(source) = self.sources[2].as_ref().filter(|_| nested > 2) {
            let judge = |factor| judge::field_in_gauss(&self.of(Sensor::Field, factor));
            factors[2] = other_factor(Sensor::Field, source, reading, judge, &mut notes).map_err(refused)?;
        }
        let takes = self.takes.into_iter().map(|take| {
            let mut values = Vec::with_capacity(3 * nested * take.times.len());
            for n in 0..take.times.len() {
                for (samples, factor) in take.values.iter().zip(factors).take(nested) {
                    values.extend(samples[n].iter().map(|value| (value * factor) as f32));
                }
            }
            Recording::new(3 * nested, take.times, values)
        });
        Ok(Sheet { takes: takes.collect(), notes })
    }
}
