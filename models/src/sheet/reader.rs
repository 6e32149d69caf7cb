//! The one reader of CSV files: from a file's bytes to rows of numbers, whichever hand's recording it is.
//!
//! A [`Format`] has a table of its columns ([`ColumnTable`]): which of a header's columns are read, and how their
//! cells are. Separators, decimal commas, lines before the header, comments, units below it and headers that come again
//! are the same for all, and so are the errors.

use std::path::Path;

use super::clock::{self, Stamp};
use super::error::RecordingError;
use super::text::{self, Separator, Text};

/// A header is looked for in this many lines: programs write about themselves first.
const HEADER_WITHIN: usize = 100;

/// What is wrong with the columns: the column from 1, or 0 for all of them, its name, and the problem.
pub(super) type Problem = (usize, String, String);

/// How a cell becomes a number; else what should stand there.
pub(super) type ReadCell = fn(&str) -> Result<f64, &'static str>;

/// Which columns of a file are read, and how.
pub(super) struct ColumnTable {
    /// The column of the times.
    pub time: Option<usize>,
    /// The columns of a row's values, in their order.
    pub values: Vec<(usize, ReadCell)>,
}

/// A format: what the files of one hand hold.
pub(super) trait Format {
    /// What else is known from a header.
    type Layout;
    /// Which columns such a file has, for people.
    const WANTED: &'static str;
    /// What can be done where recording again cannot.
    const INSTEAD: &'static str;
    /// Whether a blank line or another header may begin another recording, whose times begin anew.
    const TAKES: bool;

    /// The columns under these names; none if this is no header of such a file.
    ///
    /// # Errors
    /// If it is one, but cannot be used.
    fn columns(&self, names: &[String]) -> Result<Option<(ColumnTable, Self::Layout)>, Problem>;

    /// What is missing in a file without a header of this format; `numbers`: it begins with numbers.
    fn missing(&self, numbers: bool) -> &'static str;

    /// Whether lines of text between the samples are skipped (and counted).
    fn skips_text(&self) -> bool {
        false
    }

    /// Whether a cell below the header is the unit of its column.
    fn is_unit(&self, cell: &str) -> bool {
        is_unit_of_time(cell)
    }

    /// The error for a file that has too little in it.
    fn empty(file: &Path, what: &'static str) -> RecordingError {
        RecordingError::Empty { file: file.to_owned(), what, instead: Self::INSTEAD }
    }

    /// The error for columns that cannot be used.
    fn header_error(file: &Path, line: u64, (column, name, problem): Problem) -> RecordingError {
        RecordingError::Header { file: file.to_owned(), line, column, name, problem, wanted: Self::WANTED }
    }
}

/// Where the columns are, and where the rows begin.
pub(super) struct Head<L> {
    separator: Separator,
    /// Of all columns.
    pub names: Vec<String>,
    /// Line above the first row.
    line: u64,
    /// Every cell is `name:value`.
    pairs: bool,
    table: ColumnTable,
    /// What else the format has found out.
    pub layout: L,
}

/// A row of numbers.
pub(super) struct Row<'r> {
    /// Line, from 1.
    pub line: u64,
    /// A blank line or another header is above it.
    pub is_parted: bool,
    /// The time as in the file; of a time of day the seconds.
    pub time: Option<f64>,
    /// That is a time of day.
    pub is_of_day: bool,
    /// In the order of the column table.
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
    /// Lines of text that were skipped.
    pub skipped: usize,
    /// Times are times of day, in seconds.
    pub of_day: bool,
}

impl<'t, F: Format> Rows<'t, F> {
    /// Finds the header.
    ///
    /// # Errors
    /// [`RecordingError`], as [`Self::next_row`].
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

    /// The next row of numbers; none at the end.
    ///
    /// # Errors
    /// [`RecordingError`] with line and column, for anything that is not to be skipped.
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

    /// A header that comes again, units below the header, and text where the format skips that.
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

    /// Reads a row's values, and its time.
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

    /// The column of the times, from 0.
    pub fn time_column(&self) -> usize {
        self.head.table.time.unwrap_or_default()
    }

    /// The error for a cell that is not what it should be; `column` counts from 0.
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

    /// The error for a time that is not behind the one before it.
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

/// The first line that names a format's columns.
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
                    // Without a header this is the first row.
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

/// A cell that is a unit of times.
pub(super) fn is_unit_of_time(cell: &str) -> bool {
    matches!(cell.to_lowercase().as_str(), "s" | "ms" | "us" | "ns")
}
