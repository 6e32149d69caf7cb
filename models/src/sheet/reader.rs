//! The reader of all CSV files. It converts the bytes of a file to rows of numbers, for either hand.
//!
//! Each [`Format`] has a [`ColumnTable`], which lists the columns to be read and the form of their cells.
//! All formats share the code for separators, decimal commas, comments, units, repeated headers and errors.

use std::path::Path;

use super::clock::{self, Stamp};
use super::error::RecordingError;
use super::text::{self, Separator, Text};

/// The header must be within this number of lines, because some programs first write information about themselves.
const HEADER_WITHIN: usize = 100;

/// A problem with the columns: the number of the column from 1 (or 0 for all of them), its name, and a description.
pub(super) type Problem = (usize, String, String);

/// Converts a cell to a number. The error describes the expected content.
pub(super) type ReadCell = fn(&str) -> Result<f64, &'static str>;

/// The columns to be read in a file, and how their cells are written.
pub(super) struct ColumnTable {
    /// The column of the times.
    pub time: Option<usize>,
    /// The columns of a row's values, in order.
    pub values: Vec<(usize, ReadCell)>,
}

/// The format of the files of one hand.
pub(super) trait Format {
    /// Additional information from a header.
    type Layout;
    /// The columns that such a file must have, as text for users.
    const WANTED: &'static str;
    /// A remedy for users who cannot record again.
    const INSTEAD: &'static str;
    /// Whether a blank line or another header can begin another recording, whose times start again.
    const TAKES: bool;

    /// Returns the columns with these names, or `None` if this is not a header of such a file.
    ///
    /// # Errors
    /// Fails if the row is a header that cannot be used.
    fn columns(&self, names: &[String]) -> Result<Option<(ColumnTable, Self::Layout)>, Problem>;

    /// Describes the missing header; `numbers` is true if the file begins with numbers instead.
    fn missing(&self, numbers: bool) -> &'static str;

    /// Whether lines of text between samples are skipped (and counted).
    fn skips_text(&self) -> bool {
        false
    }

    /// Whether a cell below the header is the unit of its column.
    fn is_unit(&self, cell: &str) -> bool {
        is_unit_of_time(cell)
    }

    /// Returns the error for a file with too little data.
    fn empty(file: &Path, what: &'static str) -> RecordingError {
        RecordingError::Empty { file: file.to_owned(), what, instead: Self::INSTEAD }
    }

    /// Returns the error for columns that cannot be used.
    fn header_error(file: &Path, line: u64, (column, name, problem): Problem) -> RecordingError {
        RecordingError::Header { file: file.to_owned(), line, column, name, problem, wanted: Self::WANTED }
    }
}

/// The positions of the columns, and the place where the rows start.
pub(super) struct Head<L> {
    separator: Separator,
    /// Of all columns.
    pub names: Vec<String>,
    /// Number of the line above the first row.
    line: u64,
    /// Whether every cell has the form `name:value`.
    pairs: bool,
    table: ColumnTable,
    /// Additional information that the format needs.
    pub layout: L,
}

/// A row of numbers.
pub(super) struct Row<'r> {
    /// Line, from 1.
    pub line: u64,
    /// Whether a blank line or another header precedes the row.
    pub is_parted: bool,
    /// The time of the row in the file; a time of day is converted to seconds.
    pub time: Option<f64>,
    /// Whether the time is a time of day.
    pub is_of_day: bool,
    /// The values of the row in the order of the column table.
    pub values: &'r [f64],
}

/// The rows of a file.
pub(super) struct Rows<'t, F: Format> {
    file: &'t Path,
    format: &'t F,
    /// Its header.
    pub head: Head<F::Layout>,
    lines: Box<dyn Iterator<Item = (u64, &'t str)> + 't>,
    foreign_line: Option<u64>,
    cells: Vec<&'t str>,
    values: Vec<f64>,
    /// The last row's time.
    before: Option<f64>,
    /// There has been a row.
    has_begun: bool,
    is_parted: bool,
    /// Number of skipped lines of text.
    pub skipped: usize,
    /// Whether the times are times of day in seconds.
    pub of_day: bool,
}

impl<'t, F: Format> Rows<'t, F> {
    /// Finds the header.
    ///
    /// # Errors
    /// Returns a [`RecordingError`] in the same cases as [`Self::next_row`].
    pub fn of(file: &'t Path, text: &'t Text<'_>, format: &'t F) -> Result<Self, RecordingError> {
        if text.content.trim().is_empty() {
            return Err(F::empty(file, "the file is empty"));
        }
        let head = head(file, &text.content, format)?;
        let above = head.line;
        Ok(Self {
            file,
            format,
            lines: Box::new(text::lines(&text.content).filter(move |(line, _)| *line > above)),
            foreign_line: text.foreign_line,
            cells: Vec::with_capacity(head.names.len()),
            values: Vec::with_capacity(head.table.values.len()),
            head,
            before: None,
            has_begun: false,
            is_parted: false,
            skipped: 0,
            of_day: false,
        })
    }

    /// Returns the next row of numbers, or `None` at the end of the file.
    ///
    /// # Errors
    /// Returns a [`RecordingError`] with line and column for anything that must not be skipped.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, RecordingError> {
        while let Some((line, text)) = self.lines.next() {
            if text.trim().is_empty() {
                self.is_parted = self.has_begun;
                continue;
            }
            if text.trim_start().starts_with('#') {
                continue;
            }
            let mut cells = std::mem::take(&mut self.cells);
            self.head.separator.split(text, &mut cells);
            if self.head.pairs {
                match text::pairs(&cells) {
                    Some(pairs) => cells = pairs.into_iter().map(|(_, value)| value).collect(),
                    None => cells.clear(),
                }
            }
            let read = if self.is_skipped(&cells) { Ok(None) } else { self.read(line, &cells).map(Some) };
            self.cells = cells;
            let Some(time) = read.map_err(|error| match error {
                RecordingError::Value { .. } if self.foreign_line == Some(line) => RecordingError::Text {
                    file: self.file.to_owned(),
                    line,
                    what: "there are bytes that are no text".to_owned(),
                },
                error => error,
            })?
            else {
                continue;
            };
            let is_parted = std::mem::take(&mut self.is_parted);
            self.has_begun = true;
            self.before = time;
            return Ok(Some(Row { line, is_parted, time, is_of_day: self.of_day, values: &self.values }));
        }
        Ok(None)
    }

    /// Returns whether a row is skipped.
    /// Such a row is a repeated header, units below the header, or text if the format permits it.
    fn is_skipped(&mut self, cells: &[&str]) -> bool {
        let names = &self.head.names;
        let is_number = |cell: &&str| text::number(cell).is_some_and(f64::is_finite);
        if cells.len() == names.len()
            && cells.iter().zip(names).all(|(cell, name)| cell == name)
            && !cells.iter().all(is_number)
        {
            self.is_parted = true;
            return true;
        }
        if cells.iter().any(is_number) {
            return false;
        }
        let first = !self.has_begun && self.head.line > 0 && cells.len() == names.len();
        let skipped = self.format.skips_text()
            || (first
                && cells.iter().any(|cell| self.format.is_unit(cell.trim_matches(['(', ')', '[', ']']))));
        self.skipped += usize::from(skipped && !first);
        skipped
    }

    /// Parses a row's values and its time.
    fn read(&mut self, line: u64, cells: &[&str]) -> Result<Option<f64>, RecordingError> {
        let expected = self.head.names.len();
        if cells.len() != expected {
            return Err(RecordingError::Row {
                file: self.file.to_owned(),
                line,
                column: cells.len().min(expected) + 1,
                found: cells.len(),
                expected,
            });
        }
        let time = match self.head.table.time {
            None => None,
            Some(column) => match clock::stamp(cells[column]) {
                Some(Stamp::Number(time)) if time.is_finite() => Some(time),
                Some(Stamp::Seconds(time)) => {
                    self.of_day = true;
                    Some(time)
                }
                Some(_) => return Err(self.value_error(line, column, cells[column], "finite number".into())),
                None => return Err(self.value_error(line, column, cells[column], "number".into())),
            },
        };
        if let (Some(time), Some(before)) = (time, self.before)
            && time < before
            && !(F::TAKES && self.is_parted)
        {
            return Err(self.time_error(line, time, before));
        }
        self.values.clear();
        for &(column, read) in &self.head.table.values {
            match read(cells[column]) {
                Ok(value) => self.values.push(value),
                Err(wanted) => return Err(self.value_error(line, column, cells[column], wanted.into())),
            }
        }
        Ok(time)
    }

    /// The number of the time column, counted from 0.
    pub fn time_column(&self) -> usize {
        self.head.table.time.unwrap_or_default()
    }

    /// Returns the error for an invalid cell; `column` counts from 0.
    pub fn value_error(
        &self,
        line: u64,
        column: usize,
        value: &str,
        wanted: std::borrow::Cow<'static, str>,
    ) -> RecordingError {
        RecordingError::Value {
            file: self.file.to_owned(),
            line,
            column: column + 1,
            name: self.head.names[column].clone(),
            value: value.chars().take(40).collect(),
            wanted,
        }
    }

    /// Returns the error for a time that is not later than the previous time.
    pub fn time_error(&self, line: u64, time_ms: f64, before_ms: f64) -> RecordingError {
        let column = self.time_column();
        RecordingError::Time {
            file: self.file.to_owned(),
            line,
            column: column + 1,
            name: self.head.names[column].clone(),
            time_ms,
            before_ms,
        }
    }
}

/// Finds the first line that names a format's columns.
fn head<F: Format>(file: &Path, text: &str, format: &F) -> Result<Head<F::Layout>, RecordingError> {
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
            match format.columns(&names) {
                Ok(Some((table, layout))) => {
                    // Without a header, this is the first row.
                    let line = if is_pairs || numbers { line - 1 } else { line };
                    return Ok(Head { separator, names, line, pairs: is_pairs, table, layout });
                }
                Ok(None) => {}
                Err(error) => {
                    problem.get_or_insert((line, error));
                }
            }
        }
    }
    if let Some((line, error)) = problem {
        return Err(F::header_error(file, line, error));
    }
    let (line, problem) = match first {
        None => (1, (0, String::new(), format.missing(false).to_owned())),
        Some((line, names, numbers)) => {
            (line, (1, names.first().cloned().unwrap_or_default(), format.missing(numbers).to_owned()))
        }
    };
    Err(F::header_error(file, line, problem))
}

/// Returns whether a cell is a unit of time.
pub(super) fn is_unit_of_time(cell: &str) -> bool {
    matches!(cell.to_lowercase().as_str(), "s" | "ms" | "us" | "ns")
}
