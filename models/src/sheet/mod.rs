//! Reads CSV files of various programs and converts their bytes to recordings of either hand in our units.
//!
//! ```text
//! bytes ─ text ─► lines of cells ─ reader ─► rows of numbers ┬ right ─► clock ─► judge ─► m/s², deg/s, µT
//!                         column table of each hand ──┘      └ left ─► conversions of five channels
//! ```
//!
//! Columns are found by their names in any order, with any separator and decimal sign.
//! Anything that neither a name nor [`Reading`] declares is inferred.
//! The resulting rate determines the unit of times. Gravity and rotation determine the units of samples (`right/judge.rs`).
//! An inference is either printed (import, [`Reading::guess`]), or an error asks the user about it.

mod clock;
mod error;
pub(crate) mod left;
mod reader;
mod right;
mod text;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

pub use error::RecordingError;
pub use right::{Columns, Table, merge};

use crate::recording::Recording;
use right::names;

/// The sensors of a recording in the order of its axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Accelerometer, in m/s².
    Acceleration,
    /// Gyroscope, in deg/s.
    TurnRate,
    /// Magnetometer, in µT.
    Field,
}

/// All of them.
pub const SENSORS: [Sensor; 3] = [Sensor::Acceleration, Sensor::TurnRate, Sensor::Field];

impl fmt::Display for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Sensor::Acceleration => "the accelerometer",
            Sensor::TurnRate => "the gyroscope",
            Sensor::Field => "the magnetometer",
        })
    }
}

/// Units that a user declared: the number of m/s², deg/s or µT per unit of each sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Units([Option<f64>; 3]);

impl Units {
    /// Nothing is declared.
    pub const NONE: Units = Units([None; 3]);

    /// Returns the factor of a sensor, if the user declared a factor.
    pub fn of(&self, sensor: Sensor) -> Option<f64> {
        self.0[sensor as usize]
    }
}

impl FromStr for Units {
    type Err = String;

    /// Parses units separated by commas, such as `g`, `m/s2`, `g,rad/s` or `16384/g,131/dps` (counts per unit).
    fn from_str(text: &str) -> Result<Self, String> {
        let mut units = Units::default();
        for part in text.split(',') {
            let counts =
                part.split_once('/').and_then(|(n, unit)| Some((n.trim().parse::<f64>().ok()?, unit)));
            let (per_unit, unit) = counts.unwrap_or((1.0, part));
            // `gs` is a spelling of both gauss and g, and the acceleration has priority.
            let found = SENSORS.into_iter().find_map(|sensor| Some((sensor, names::factor(sensor, unit)?)));
            let Some((sensor, factor)) = found.filter(|_| per_unit.is_finite() && per_unit > 0.0) else {
                return Err(format!(
                    "{part:?} is no unit that is known; give g, mg or m/s2, rad/s or deg/s, uT or gauss, or counts as in 16384/g"
                ));
            };
            if units.0[sensor as usize].replace(factor / per_unit).is_some() {
                return Err(format!("{part:?}: a second unit of {sensor}"));
            }
        }
        Ok(units)
    }
}

/// Returns the number of m/s², deg/s or µT in a unit, if the unit belongs to this sensor.
pub fn factor(sensor: Sensor, unit: &str) -> Option<f64> {
    names::factor(sensor, unit)
}

/// Spellings of a sensor's units.
pub fn unit_names(sensor: Sensor) -> Vec<&'static str> {
    names::units(sensor).iter().map(|(name, _)| *name).collect()
}

/// The options for reading a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// Units declared by the user, which override the file.
    pub units: Units,
    /// Number of samples per second in files without times.
    pub rate_hz: Option<f64>,
    /// Names for columns.
    pub columns: Option<Columns>,
    /// Whether the reader accepts inferences and reports them in the notes.
    /// Otherwise, the reader accepts only declared properties, and any doubt is an error.
    pub guess: bool,
}

/// A file's recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// The recordings in the file, which may contain several.
    pub takes: Vec<Recording>,
    /// Descriptions of everything that was inferred, repaired or omitted.
    pub notes: Vec<String>,
}

/// Parses all right-hand recordings in the bytes of a file.
/// `file` is used in errors, and its name identifies the sensor of columns x, y, z.
///
/// # Errors
/// Returns a [`RecordingError`] that contains the place and a remedy.
pub fn parse(file: &Path, bytes: &[u8], reading: &Reading) -> Result<Sheet, RecordingError> {
    right::parse(file, bytes, reading)?.judged(file, reading)
}

#[cfg(test)]
mod tests;
