//! Daily movement of real people without gestures, which every model learns as `other`.
//!
//! `daily/watch-daily.bin` contains no recordings, only int8 features of recipe `aligned`.
//! The features were computed from the watches of twelve people who sat, stood up, walked, turned and sat down.
//! `models daily vectors` generates the file, and `daily/ABOUT.txt` contains the source and its licence.
//! Without this training, a model easily mistakes getting up from a chair for a circle.
//!
//! The file starts with `BIMANDAY`, the number of people as u8, and their names.
//! Each name follows its length as u8.
//! Then there are three tables.
//! The first table has features without a gyroscope, and the third table has features with a gyroscope.
//! The second has features of the slow window ([`shared_dsp::right::slow`]).
//! A table starts with its numbers of rows and columns as u32.
//! For each column, it then has an offset and a unit as f32 (little-endian).
//! Each row has the number of its person as u8, and a signed byte for each column.
//! The value of a feature is this byte times the unit, plus the offset.

use std::sync::OnceLock;

use crate::dataset::Dataset;
use crate::recording::Recording;
use crate::windows::{aligned_features, prepare, slowed};
use crate::{HOP, WINDOW};

/// The source of the vectors. Their licence requires that a model's card names the source.
pub const SOURCE: &str = "features of daily movement without a gesture, as other, from: Dataset of inertial measurements of \
     smartphones and smartwatches for human activity recognition, M. Matey-Sanz, S. Casteleyn, C. Granell, Data in Brief \
     2023, 109809, doi 10.5281/zenodo.8398688, CC BY 4.0 (changed: smartwatches of 12 people, features only)";

/// The vectors that are bundled with this crate.
const BYTES: &[u8] = include_bytes!("../daily/watch-daily.bin");
const MAGIC: &[u8; 8] = b"BIMANDAY";
/// Number of samples between the starts of two windows, and of two slow windows.
const STRIDE: usize = 6 * HOP;
const SLOW_STRIDE: usize = 12 * HOP;

/// The people whose daily movement a model learns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Daily {
    /// Nobody's.
    None,
    /// Everybody's.
    #[default]
    All,
    /// Selects all people except these, on whom the model will be tested.
    Without(Vec<String>),
}

impl Daily {
    /// Returns the feature vectors for samples of this many axes, one per window.
    /// If there is no gyroscope, the slow windows are included.
    pub fn rows(&self, axes: usize) -> Vec<Vec<f32>> {
        let knows = |name: &String| match self {
            Self::None => false,
            Self::All => true,
            Self::Without(left_out) => !left_out.contains(name),
        };
        let vectors = bundled();
        let known: Vec<bool> = vectors.people.iter().map(knows).collect();
        let tables = if axes < 6 { &vectors.tables[..2] } else { &vectors.tables[2..] };
        let rows = tables.iter().flat_map(Table::rows);
        rows.filter(|(person, _)| known.get(*person) == Some(&true)).map(|(_, row)| row).collect()
    }
}

/// Returns the names of the people whose movement is bundled with this crate.
pub fn people() -> &'static [String] {
    &bundled().people
}

fn bundled() -> &'static Vectors {
    static VECTORS: OnceLock<Vectors> = OnceLock::new();
    // A test below checks that the file is valid.
    VECTORS.get_or_init(|| Vectors::parse(BYTES).unwrap_or_default())
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Vectors {
    people: Vec<String>,
    tables: Vec<Table>,
}

/// Rows of features in int8.
#[derive(Clone, Debug, PartialEq)]
struct Table {
    middle: Vec<f32>,
    unit: Vec<f32>,
    /// Person and values.
    rows: Vec<(u8, Vec<i8>)>,
}

impl Table {
    fn new(rows: &[(u8, Vec<f32>)]) -> Self {
        let width = rows.first().map_or(0, |(_, row)| row.len());
        let range = |column: usize| {
            let values = rows.iter().map(|(_, row)| row[column]);
            values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            })
        };
        let ranges: Vec<(f32, f32)> = (0..width).map(range).collect();
        let middle: Vec<f32> = ranges.iter().map(|(low, high)| 0.5 * (low + high)).collect();
        let unit: Vec<f32> = ranges.iter().map(|(low, high)| ((high - low) / 254.0).max(1e-6)).collect();
        let byte = |column: usize, value: f32| {
            ((value - middle[column]) / unit[column]).round().clamp(-127.0, 127.0) as i8
        };
        let row =
            |row: &Vec<f32>| row.iter().enumerate().map(|(column, value)| byte(column, *value)).collect();
        let rows = rows.iter().map(|(person, values)| (*person, row(values))).collect();
        Self { middle, unit, rows }
    }

    fn rows(&self) -> impl Iterator<Item = (usize, Vec<f32>)> {
        self.rows.iter().map(|(person, row)| {
            let value =
                |(column, byte): (usize, &i8)| self.middle[column] + self.unit[column] * f32::from(*byte);
            (usize::from(*person), row.iter().enumerate().map(value).collect())
        })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend((self.rows.len() as u32).to_le_bytes());
        bytes.extend((self.middle.len() as u32).to_le_bytes());
        for (middle, unit) in self.middle.iter().zip(&self.unit) {
            bytes.extend(middle.to_le_bytes());
            bytes.extend(unit.to_le_bytes());
        }
        for (person, row) in &self.rows {
            bytes.push(*person);
            bytes.extend(row.iter().map(|value| *value as u8));
        }
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        let rows = u32::from_le_bytes(*take(bytes)?) as usize;
        let width = u32::from_le_bytes(*take(bytes)?) as usize;
        let (mut middle, mut unit) = (Vec::new(), Vec::new());
        for _ in 0..width {
            middle.push(f32::from_le_bytes(*take(bytes)?));
            unit.push(f32::from_le_bytes(*take(bytes)?));
        }
        let (table, rest) = bytes.split_at_checked(rows.checked_mul(width.checked_add(1)?)?)?;
        *bytes = rest;
        let row = |row: &[u8]| Some((*row.first()?, row[1..].iter().map(|value| *value as i8).collect()));
        let rows = table.chunks_exact(width + 1).map(row).collect::<Option<_>>()?;
        Some(Self { middle, unit, rows })
    }
}

fn take<'a, const N: usize>(bytes: &mut &'a [u8]) -> Option<&'a [u8; N]> {
    let (first, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(first)
}

impl Vectors {
    fn parse(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(MAGIC)?;
        let [count] = *take(&mut rest)?;
        let mut people = Vec::new();
        for _ in 0..count {
            let [length] = *take(&mut rest)?;
            let (name, after) = rest.split_at_checked(length.into())?;
            rest = after;
            people.push(String::from_utf8(name.to_vec()).ok()?);
        }
        let tables = (0..3).map(|_| Table::read(&mut rest)).collect::<Option<_>>()?;
        rest.is_empty().then_some(Self { people, tables })
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.push(self.people.len() as u8);
        for name in &self.people {
            bytes.push(name.len() as u8);
            bytes.extend(name.bytes());
        }
        self.tables.iter().for_each(|table| table.write(&mut bytes));
        bytes
    }
}

/// Returns a file of vectors. They are computed from recordings of people who make no gesture.
/// The recordings must contain a gyroscope.
pub fn vectors(recordings: &Dataset) -> Vec<u8> {
    let people = recordings.people();
    let windows = |recording: &Recording, stride: usize| -> Vec<Vec<f32>> {
        let starts = (0..=recording.len().saturating_sub(WINDOW)).step_by(stride);
        let window = |start| recording.slice(start, WINDOW).samples().flatten().copied().collect();
        starts.map(window).collect()
    };
    let mut rows = [const { Vec::new() }; 3];
    for item in &recordings.items {
        let person = people.iter().position(|name| *name == item.person).unwrap_or_default() as u8;
        let six = item.recording.with_axes(6);
        let (three, _) = prepare(&six.with_axes(3));
        let slow = slowed(&three);
        let mut add = |table: usize, axes: usize, recording: &Recording, stride: usize| {
            let features =
                windows(recording, stride).into_iter().map(|window| aligned_features(axes, &window));
            rows[table].extend(features.map(|features| (person, features)));
        };
        add(0, 3, &three, STRIDE);
        if slow.len() >= WINDOW {
            add(1, 3, &slow, SLOW_STRIDE / 2);
        }
        add(2, 6, &prepare(&six).0, STRIDE);
    }
    Vectors { people, tables: rows.iter().map(|rows| Table::new(rows)).collect() }.to_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vectors_that_come_with_the_crate_are_whole_and_small() {
        let vectors = Vectors::parse(BYTES).expect("a whole file");
        assert_eq!(vectors.people.len(), 12);
        assert!(BYTES.len() <= 500_000, "{} bytes", BYTES.len());
        assert_eq!(vectors.to_bytes(), BYTES);
        for axes in [3, 6, 9] {
            let rows = Daily::All.rows(axes);
            assert!(rows.len() >= 1000, "{} rows for {axes} axes", rows.len());
            assert!(rows.iter().all(|row| row.len() == shared_dsp::right::aligned::feature_count(axes)));
            assert!(rows.iter().flatten().all(|value| value.is_finite()));
        }
    }

    #[test]
    fn people_left_out_are_left_out() {
        let [all, none] = [Daily::All, Daily::None].map(|daily| daily.rows(6).len());
        let (even, odd): (Vec<_>, Vec<_>) =
            people().iter().cloned().enumerate().partition(|(n, _)| n % 2 == 0);
        let without = |people: &[(usize, String)]| {
            Daily::Without(people.iter().map(|(_, name)| name.clone()).collect()).rows(6).len()
        };
        assert_eq!(none, 0);
        assert_eq!(without(&even) + without(&odd), all);
        assert!(without(&even) > all / 3 && without(&odd) > all / 3);
    }

    #[test]
    fn a_cut_or_strange_file_is_none() {
        for length in [0, 7, 8, 20, 200, BYTES.len() - 1] {
            assert_eq!(Vectors::parse(&BYTES[..length]), None, "{length}");
        }
        assert_eq!(Vectors::parse(&[BYTES, b"x"].concat()), None);
    }

    #[test]
    fn a_table_gives_its_rows_back_to_a_unit() {
        let rows: Vec<(u8, Vec<f32>)> =
            (0u8..50).map(|n| (n % 3, vec![f32::from(n), -0.01 * f32::from(n), 7.0])).collect();
        let table = Table::new(&rows);
        for ((person, row), (back_person, back)) in rows.iter().zip(table.rows()) {
            assert_eq!(usize::from(*person), back_person);
            for (column, (a, b)) in row.iter().zip(&back).enumerate() {
                assert!((a - b).abs() <= 0.51 * table.unit[column], "{a} {b}");
            }
        }
    }
}
