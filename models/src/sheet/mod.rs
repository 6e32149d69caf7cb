//! CSV files as people have them: from a file's bytes to recordings in our units, of either hand.
//!
//! ```text
//! bytes ─ text ─► lines of cells ─ reader ─► rows of numbers ┬ right ─► clock ─► judge ─► m/s², deg/s, µT
//!                         column table of each hand ──┘      └ left ─► conversions of five channels
//! ```
//!
//! Columns are found by their names in any order, whatever parts them and whether decimals have a point or a comma.
//! What a name or [`Reading`] does not say is judged: the unit of times by the rate that it gives, the units of samples
//! by gravity and by how hands turn (`right/judge.rs`). A judgement is either printed (import, [`Reading::guess`]) or a
//! question in an error: nothing is taken for something else in silence.

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

/// The sensors of a recording, in the order of its axes.
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

/// Units that a user declares, by sensor: how many m/s², deg/s or µT one of them is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Units([Option<f64>; 3]);

impl Units {
    /// Nothing is declared.
    pub const NONE: Units = Units([None; 3]);

    /// The factor of a sensor, if one is declared.
    pub fn of(&self, sensor: Sensor) -> Option<f64> {
        self.0[sensor as usize]
    }
}

impl FromStr for Units {
    type Err = String;

    /// `g`, `m/s2`, `g,rad/s`, `16384/g,131/dps`: units, separated by commas; a number before a slash is counts per unit.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut units = Units::default();
        for part in text.split(',') {
            let counts =
                part.split_once('/').and_then(|(n, unit)| Some((n.trim().parse::<f64>().ok()?, unit)));
            let (per_unit, unit) = counts.unwrap_or((1.0, part));
            // Twice `gs`, of gauss and of g: acceleration comes first.
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

/// How many m/s², deg/s or µT a unit is, if it is one of this sensor's.
pub fn factor(sensor: Sensor, unit: &str) -> Option<f64> {
    names::factor(sensor, unit)
}

/// Spellings of a sensor's units.
pub fn unit_names(sensor: Sensor) -> Vec<&'static str> {
    names::units(sensor).iter().map(|(name, _)| *name).collect()
}

/// How a file is to be read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// Units that are known, whatever the file says.
    pub units: Units,
    /// Samples per second of files without times.
    pub rate_hz: Option<f64>,
    /// Names for columns.
    pub columns: Option<Columns>,
    /// What can be judged is taken, and said in the notes. Otherwise only what the file declares is, and a doubt is an
    /// error.
    pub guess: bool,
}

/// A file's recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// One for each time that recording began.
    pub takes: Vec<Recording>,
    /// What was judged, repaired or left out, in words.
    pub notes: Vec<String>,
}

/// Reads all recordings of the right hand in the bytes of a file; `file` is for the errors, and says which sensor columns x, y, z are of.
///
/// # Errors
/// [`RecordingError`], with the place and what to do.
pub fn parse(file: &Path, bytes: &[u8], reading: &Reading) -> Result<Sheet, RecordingError> {
    right::parse(file, bytes, reading)?.judged(file, reading)
}

#[cfg(test)]
mod tests;
