//! Recordings of the right hand: reads rows in a file's own units and converts them to recordings.

mod factor;
mod judge;
mod layout;
pub(super) mod names;
mod table;

use std::path::Path;

pub use layout::Columns;
pub use table::Table;

use factor::{acceleration_factor, other_factor};
use layout::{Layout, Source};

use super::reader::{ColumnTable, Format, Problem, ReadCell, Rows, is_unit_of_time};
use super::{Reading, SENSORS, Sensor, Sheet, clock, text};
use crate::recording::{MAX_RATE_HZ, MIN_RATE_HZ, Recording, RecordingError, SAME_RATE};

/// A blank line begins another recording if the pause is longer than this, in ms.
const PAUSE_MS: f64 = 1000.0;

/// Samples that belong to one recording in a file.
#[derive(Clone, Debug, Default)]
struct Take {
    first_line: u64,
    /// Times in the file's unit, which are later converted to ms.
    times: Vec<f64>,
    /// Values of each sensor in the units of the file.
    values: [Vec<[f64; 3]>; 3],
}

/// The contents of a file in its own units.
#[derive(Clone, Debug)]
pub(super) struct RawSheet {
    sources: [Option<Source>; 3],
    takes: Vec<Take>,
    notes: Vec<String>,
}

/// The format of right-hand recordings, together with the user's options.
struct Right<'r> {
    file: &'r Path,
    reading: &'r Reading,
}

impl Format for Right<'_> {
    type Layout = Layout;
    const WANTED: &'static str = "a recording has the columns timestamp (or timestamp_ms),accX,accY,accZ\
         [,gyrX,gyrY,gyrZ[,magX,magY,magZ]] or others that `models import --columns` names";
    const INSTEAD: &'static str = "delete the file";
    const TAKES: bool = true;

    fn columns(&self, names: &[String]) -> Result<Option<(ColumnTable, Layout)>, Problem> {
        let layout = match &self.reading.columns {
            Some(columns) => Layout::given(columns, names),
            None => Layout::of(names, self.file),
        }?;
        let of = |source: &Source| source.columns.into_iter().chain(source.plus.into_iter().flatten());
        let values = layout.sensors.iter().flatten().flat_map(of).map(|column| (column, sample as ReadCell));
        let table = ColumnTable { time: layout.time.map(|(column, _)| column), values: values.collect() };
        Ok(layout.sensors.iter().any(Option::is_some).then_some((table, layout)))
    }

    fn missing(&self, numbers: bool) -> &'static str {
        if numbers {
            "the file has no header; name its columns with --columns"
        } else {
            "no columns of an accelerometer are named"
        }
    }

    fn skips_text(&self) -> bool {
        self.reading.guess
    }

    fn is_unit(&self, cell: &str) -> bool {
        SENSORS.iter().any(|sensor| names::factor(*sensor, cell).is_some()) || is_unit_of_time(cell)
    }
}

/// Parses a sensor's value. Rounding to float32 may overflow although the text is a finite number.
fn sample(cell: &str) -> Result<f64, &'static str> {
    let value = text::number(cell).ok_or("number")?;
    if (value as f32).is_finite() { Ok(value) } else { Err("finite number") }
}

/// Reads rows.
pub(super) fn parse(file: &Path, bytes: &[u8], reading: &Reading) -> Result<RawSheet, RecordingError> {
    let text = text::decode(bytes);
    let format = Right { file, reading };
    let mut rows = Rows::of(file, &text, &format)?;
    let layout = rows.head.layout.clone();
    let mut takes: Vec<Take> = Vec::new();
    while let Some(row) = rows.next_row()? {
        let begins = match (row.time, takes.last()) {
            (_, None) => true,
            // If a file has times, a blank line alone does not begin a recording.
            (Some(time), Some(take)) if take.times.last().is_some_and(|before| time >= *before) => {
                row.is_parted && take.pauses(time, unit(&layout, row.is_of_day))
            }
            _ => row.is_parted,
        };
        if begins {
            takes.push(Take { first_line: row.line, ..Take::default() });
        }
        let Some(take) = takes.last_mut() else { continue };
        take.push(&layout, row.values);
        take.times.extend(row.time);
    }
    let mut notes = layout.notes.clone();
    if rows.skipped > 0 {
        notes.push(format!("{} lines of text between the samples are skipped", rows.skipped));
    }
    if takes.is_empty() {
        return Err(Right::empty(file, "there are no samples below the header"));
    }
    // A recording of one sample is an accident: someone pressed a button or a line was lost.
    if takes.len() > 1 {
        let whole = takes.len();
        takes.retain(|take| take.values.iter().flatten().count() > 0 && take.len() > 1);
        if takes.len() < whole {
            notes.push(format!("{} recordings of one sample are left out", whole - takes.len()));
        }
    }
    let mut equal = 0;
    for take in &mut takes {
        equal += take.clocked(file, &rows, reading, &mut notes)?;
    }
    if equal > 0 {
        notes.push(format!("{equal} samples had the time of the one before and were spread evenly"));
    }
    Ok(RawSheet { sources: layout.sensors, takes, notes })
}

/// Returns the length of the file's time unit in milliseconds, if the file declares a unit.
fn unit(layout: &Layout, of_day: bool) -> Option<f64> {
    if of_day { Some(1000.0) } else { layout.time.and_then(|(_, unit)| unit) }
}

impl Take {
    fn len(&self) -> usize {
        self.values.iter().map(Vec::len).max().unwrap_or_default()
    }

    /// Adds a row's values, sensor by sensor.
    fn push(&mut self, layout: &Layout, values: &[f64]) {
        let (mut threes, _) = values.as_chunks::<3>();
        for (source, samples) in layout.sensors.iter().zip(&mut self.values) {
            let Some(source) = source else { continue };
            let Some((&sample, rest)) = threes.split_first() else { return };
            threes = rest;
            let mut sample = sample;
            if source.plus.is_some()
                && let Some((plus, rest)) = threes.split_first()
            {
                (0..3).for_each(|axis| sample[axis] += plus[axis]);
                threes = rest;
            }
            samples.push(sample);
        }
    }

    /// Returns whether there is a pause before this time; `unit` is the declared unit, if any.
    fn pauses(&self, time: f64, unit: Option<f64>) -> bool {
        let unit = unit.or_else(|| clock::unit(&self.times).map(|(_, ms)| ms));
        let step = self.times.last().map_or(0.0, |last| time - last);
        unit.is_some_and(|unit| step * unit > PAUSE_MS)
    }

    /// Converts times to ms, and counts equal times.
    fn clocked(
        &mut self,
        file: &Path,
        rows: &Rows<'_, Right<'_>>,
        reading: &Reading,
        notes: &mut Vec<String>,
    ) -> Result<usize, RecordingError> {
        if self.len() < 2 {
            return Err(Right::empty(file, "one sample is not enough to tell the sampling rate"));
        }
        let head = &rows.head;
        let Some((column, _)) = head.layout.time else {
            let rate_hz = reading.rate_hz.ok_or_else(|| RecordingError::NoTimes { file: file.to_owned() })?;
            self.times = (0..self.len()).map(|n| n as f64 * 1000.0 / rate_hz).collect();
            return Ok(0);
        };
        let unit = match unit(&head.layout, rows.of_day) {
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
            return Err(rows.time_error(self.first_line + 1, last, first));
        }
        let equal = clock::spread(&mut self.times);
        let rate_hz = 1000.0 / clock::typical_interval(&self.times).unwrap_or(f64::INFINITY);
        if !(MIN_RATE_HZ * (1.0 - SAME_RATE)..=MAX_RATE_HZ * (1.0 + SAME_RATE)).contains(&rate_hz) {
            return Err(RecordingError::Rate {
                file: file.to_owned(),
                column: column + 1,
                rate_hz,
                slowest_hz: MIN_RATE_HZ,
                fastest_hz: MAX_RATE_HZ,
            });
        }
        Ok(equal)
    }
}

/// Merges several files of one recording, each with one sensor. Values are interpolated at the accelerometer's times.
/// The result is `None` if there is no accelerometer, or if the files do not overlap in time.
///
/// # Errors
/// The errors are the same as those of [`super::parse`].
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
    /// Returns a sensor's samples, interpolated at these times.
    /// Returns `None` if the sensor's own times do not cover these times to within 0.2 s.
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
    /// Returns the samples of one sensor in all recordings, multiplied by a factor.
    fn of(&self, sensor: Sensor, factor: f64) -> Vec<[f32; 3]> {
        let values = self.takes.iter().flat_map(|take| &take.values[sensor as usize]);
        values.map(|sample| sample.map(|value| (value * factor) as f32)).collect()
    }

    /// Recordings in our units.
    pub(super) fn judged(mut self, file: &Path, reading: &Reading) -> Result<Sheet, RecordingError> {
        let refused = |problem: String| RecordingError::Units { file: file.to_owned(), problem };
        let Some(acceleration) = &self.sources[0] else {
            let nothing = "no columns of an accelerometer are named".to_owned();
            return Err(Right::header_error(file, 1, (0, String::new(), nothing)));
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
