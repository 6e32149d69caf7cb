//! Reads samples from other file formats that have named columns.

use std::path::Path;

use super::layout::Layout;
use super::{RawSheet, Right, Take};
use crate::recording::{Recording, RecordingError};
use crate::sheet::reader::Format;
use crate::sheet::{Reading, SENSORS, Sensor, Sheet};

/// Samples at a constant rate under named columns, from a file that is not CSV.
#[derive(Clone, Debug)]
pub struct Table {
    layout: Layout,
    values: [Vec<[f64; 3]>; 3],
}

impl Table {
    /// Finds the columns; `file` is used only in errors.
    ///
    /// # Errors
    /// [`RecordingError::Header`].
    pub fn new(file: &Path, names: Vec<String>, reading: &Reading) -> Result<Self, RecordingError> {
        let layout = match &reading.columns {
            Some(columns) => Layout::given(columns, &names),
            None => Layout::of(&names, file),
        };
        let layout = layout.map_err(|problem| Right::header_error(file, 1, problem))?;
        if layout.sensors[0].is_none() {
            let text = format!("no columns of an accelerometer are named, there are {}", names.join(", "));
            return Err(Right::header_error(file, 1, (0, String::new(), text)));
        }
        Ok(Self { layout, values: Default::default() })
    }

    /// The columns that are used, and the sensor of each.
    pub fn columns(&self) -> impl Iterator<Item = (usize, Sensor)> {
        self.layout.sensors.iter().zip(SENSORS).flat_map(|(source, sensor)| {
            let source = source.iter();
            source.flat_map(move |source| {
                source
                    .columns
                    .into_iter()
                    .chain(source.plus.into_iter().flatten())
                    .map(move |column| (column, sensor))
            })
        })
    }

    /// Sets the sensors whose samples are in our units according to the file.
    pub fn declare(&mut self, declared: [bool; 3]) {
        for (source, declared) in self.layout.sensors.iter_mut().zip(declared) {
            if let (Some(source), true) = (source, declared) {
                source.factor = Some(1.0);
            }
        }
    }

    /// Adds one sample, which has a value in every column. Short rows are ignored.
    pub fn push(&mut self, row: &[f64]) {
        for (source, values) in self.layout.sensors.iter().zip(&mut self.values) {
            let Some(source) = source else { continue };
            let value = |axis: usize| {
                let plus = source.plus.and_then(|plus| row.get(plus[axis]));
                Some(row.get(source.columns[axis])? + plus.unwrap_or(&0.0))
            };
            if let (Some(x), Some(y), Some(z)) = (value(0), value(1), value(2)) {
                values.push([x, y, z]);
            }
        }
    }

    /// Returns the recording and its notes.
    ///
    /// # Errors
    /// [`RecordingError::Units`].
    pub fn finish(
        self,
        file: &Path,
        interval_ms: f64,
        reading: &Reading,
    ) -> Result<(Recording, Vec<String>), RecordingError> {
        let times = (0..self.values[0].len()).map(|n| n as f64 * interval_ms).collect();
        let take = Take { first_line: 1, times, values: self.values };
        let sheet = RawSheet { sources: self.layout.sensors, takes: vec![take], notes: self.layout.notes };
        let Sheet { mut takes, notes } = sheet.judged(file, reading)?;
        match takes.pop() {
            Some(recording) => Ok((recording, notes)),
            None => Err(Right::empty(file, "there are no samples")),
        }
    }
}
