//! Splits a file into lines of cells. It supports the formats of many programs and countries.

use std::borrow::Cow;

/// The separator between two cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    /// The separator is one character, and empty cells count as cells.
    Char(char),
    /// The separator is any number of blanks and tabs.
    Blanks,
}

/// Separators in the order in which they are tried.
/// Tabs and semicolons are unambiguous, but a comma may be a decimal sign, and a blank may be part of a name.
const SEPARATORS: [Separator; 5] = [
    Separator::Char('\t'),
    Separator::Char(';'),
    Separator::Char(','),
    Separator::Char('|'),
    Separator::Blanks,
];

impl Separator {
    pub(super) fn all() -> impl Iterator<Item = Separator> {
        SEPARATORS.into_iter()
    }

    /// Returns the cells of a line, without surrounding blanks and quotes.
    pub(super) fn split<'a>(self, line: &'a str, cells: &mut Vec<&'a str>) {
        cells.clear();
        match self {
            Separator::Blanks => cells.extend(line.split_whitespace().map(unquoted)),
            Separator::Char(separator) if !line.contains('"') => {
                cells.extend(line.split(separator).map(str::trim));
            }
            Separator::Char(separator) => {
                let (mut from, mut quoted) = (0, false);
                for (at, c) in line.char_indices() {
                    if c == '"' {
                        quoted = !quoted;
                    } else if c == separator && !quoted {
                        cells.push(unquoted(&line[from..at]));
                        from = at + c.len_utf8();
                    }
                }
                cells.push(unquoted(&line[from..]));
            }
        }
        // A separator at the end of every line does not add a cell.
        if cells.len() > 1 && cells.last().is_some_and(|cell| cell.is_empty()) {
            cells.pop();
        }
    }
}

fn unquoted(cell: &str) -> &str {
    let cell = cell.trim();
    let inner = cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"'));
    inner.unwrap_or(cell).trim()
}

/// The text of a file.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Text<'b> {
    pub content: Cow<'b, str>,
    /// The first line that is not UTF-8 (from 1). The reader treats it as Latin-1, which is permitted only in a header.
    pub foreign_line: Option<u64>,
}

/// A file's bytes as text.
pub(super) fn decode(bytes: &[u8]) -> Text<'_> {
    let whole = |content: Cow<'static, str>| Text { content, foreign_line: None };
    if let Some(rest) = bytes.strip_prefix(b"\xff\xfe") {
        return whole(utf16(rest, u16::from_le_bytes).into());
    }
    if let Some(rest) = bytes.strip_prefix(b"\xfe\xff") {
        return whole(utf16(rest, u16::from_be_bytes).into());
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Text { content: text.into(), foreign_line: None },
        Err(error) => {
            let before = &bytes[..error.valid_up_to()];
            let line = before.iter().filter(|&&byte| byte == b'\n').count() as u64 + 1;
            let content = bytes.iter().map(|&byte| char::from(byte)).collect::<String>();
            Text { content: content.into(), foreign_line: Some(line) }
        }
    }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units = bytes.as_chunks::<2>().0.iter().map(|&pair| unit(pair));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

/// Returns lines and their numbers (from 1). Line ends may be those of Unix, Windows or old Macs.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (u64, &str)> {
    let old_mac = !text.contains('\n');
    let end = if old_mac { '\r' } else { '\n' };
    (1..).zip(text.split(end).map(|line| line.trim_end_matches('\r')))
}

/// Parses a number with a decimal point or a decimal comma.
pub(super) fn number(cell: &str) -> Option<f64> {
    match cell.parse() {
        Ok(number) => Some(number),
        Err(_) if cell.matches(',').count() == 1 && !cell.contains('.') => {
            cell.replace(',', ".").parse().ok()
        }
        Err(_) => None,
    }
}

/// Parses cells of the form `name:value` (Arduino's serial plotter), if all cells have this form.
pub(super) fn pairs<'a>(cells: &[&'a str]) -> Option<Vec<(&'a str, &'a str)>> {
    let pair = |cell: &&'a str| {
        let (name, value) = cell.rsplit_once(':').or_else(|| cell.rsplit_once('='))?;
        let named = name.trim_start().starts_with(|c: char| c.is_alphabetic());
        (named && number(value.trim()).is_some()).then(|| (name.trim(), value.trim()))
    };
    cells.iter().map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(separator: Separator, line: &str) -> Vec<&str> {
        let mut cells = Vec::new();
        separator.split(line, &mut cells);
        cells
    }

    #[test]
    fn cells_lose_quotes_and_blanks_and_a_separator_at_the_end_is_none() {
        assert_eq!(split(Separator::Char(','), " 1, \"a,b\" ,3,"), ["1", "a,b", "3"]);
        assert_eq!(split(Separator::Char(','), "1,,3"), ["1", "", "3"]);
        assert_eq!(split(Separator::Blanks, "  1 \t 2  3 "), ["1", "2", "3"]);
    }

    #[test]
    fn every_way_to_write_text_is_read() {
        let utf16: Vec<u8> = "a;µ\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        let text = |content: &'static str, foreign_line| Text { content: content.into(), foreign_line };
        assert_eq!(decode(&[&b"\xff\xfe"[..], &utf16].concat()), text("a;µ\n", None));
        assert_eq!(decode(b"\xef\xbb\xbfx"), text("x", None));
        assert_eq!(decode(b"x\nm/s\xb2"), text("x\nm/s²", Some(2)));
        assert_eq!(lines("a\r\nb\n").collect::<Vec<_>>(), [(1, "a"), (2, "b"), (3, "")]);
        assert_eq!(lines("a\rb").collect::<Vec<_>>(), [(1, "a"), (2, "b")]);
    }

    #[test]
    fn numbers_may_have_a_comma_but_no_thousands() {
        assert_eq!(number("-0,25"), Some(-0.25));
        assert_eq!(number("1e-3"), Some(0.001));
        assert_eq!((number("1.234,5"), number("1,2,3"), number("x")), (None, None, None));
    }

    #[test]
    fn the_serial_plotters_pairs_are_all_pairs_or_none() {
        assert_eq!(pairs(&["aX:0.1", "aY:-2"]), Some(vec![("aX", "0.1"), ("aY", "-2")]));
        assert_eq!(pairs(&["aX:0.1", "2"]), None);
        assert_eq!(pairs(&["12:30:01", "1:2"]), None);
    }
}
