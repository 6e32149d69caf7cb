//! Writes a pose, or how the right hand's board is worn, to a user's TOML file, and preserves everything else.

use std::fmt::Write as _;
use std::ops::Range;

use toml::de::{DeTable, DeValue};

use crate::one_handed::OneHanded;

/// Number of decimals. It corresponds to about a micrometre at the tip of an arm.
const DIGITS: usize = 6;

/// The values cannot be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TaughtError {
    /// The text is no TOML.
    #[error("line {line}: {what}")]
    Text {
        /// Line, from 1.
        line: usize,
        /// The parser's error message.
        what: String,
    },
    /// The pose exists, but it is not given by joint angles.
    #[error("pose '{0}' is there already, given by its place; take it out, or choose another name")]
    ByPlace(String),
    /// The section exists, but it is not written as a section.
    #[error(
        "write one_handed as a section [one_handed], one key per line, so that the axes can be added to it"
    )]
    NoSection,
}

/// Returns the text with this pose. An existing pose gets new angles, and a new pose is appended.
///
/// # Errors
/// Returns [`TaughtError`]. The file's text is unchanged in this case.
pub fn with_pose(text: &str, name: &str, joints_rad: &[f64]) -> Result<String, TaughtError> {
    let mut angles = String::from("[");
    for (i, angle) in joints_rad.iter().enumerate() {
        let _ = write!(angles, "{}{angle:.DIGITS$}", if i == 0 { "" } else { ", " });
    }
    angles.push(']');
    let mut new = text.to_owned();
    match place(text, name)? {
        Some(span) => new.replace_range(span, &angles),
        None => {
            if !new.is_empty() && !new.ends_with('\n') {
                new.push('\n');
            }
            let gap = if new.is_empty() { "" } else { "\n" };
            let _ = write!(new, "{gap}[[pose]]\nname = {}\njoints_rad = {angles}\n", quoted(name));
        }
    }
    Ok(new)
}

/// Returns the text with these axes and this neutral pose under `[one_handed]`.
/// Known keys get new values. The choice of the mode remains unchanged.
///
/// # Errors
/// Returns [`TaughtError`]. The file's text is unchanged in this case.
pub fn with_worn(text: &str, worn: &OneHanded) -> Result<String, TaughtError> {
    // The data consists only of strings and numbers, so this cannot fail.
    let Ok(toml::Value::Table(mut values)) = toml::Value::try_from(worn) else { return Ok(text.to_owned()) };
    values.remove("on");
    let table = parsed(text)?;
    let known = match table.get_ref().get("one_handed").map(|value| value.get_ref()) {
        Some(DeValue::Table(known)) => Some(known),
        _ => None,
    };
    let mut spans = Vec::new();
    let mut lines = String::new();
    for (key, value) in &values {
        match known.and_then(|known| known.get(key.as_str())) {
            Some(old) => spans.push((old.span(), value.to_string())),
            None => {
                let _ = writeln!(lines, "{key} = {value}");
            }
        }
    }
    let mut new = text.to_owned();
    // The last one comes first, so that the positions before it remain valid.
    spans.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
    for (span, value) in spans {
        new.replace_range(span, &value);
    }
    if known.is_none() {
        let gap = if new.is_empty() || new.ends_with("\n\n") { "" } else { "\n" };
        let end = if new.is_empty() || new.ends_with('\n') { "" } else { "\n" };
        let _ = write!(new, "{end}{gap}[one_handed]\n{lines}");
    } else if !lines.is_empty() {
        let is_header = |line: &str| line.split('#').next().is_some_and(|line| line.trim() == "[one_handed]");
        let mut end = 0;
        let header = new.split_inclusive('\n').find(|line| {
            end += line.len();
            is_header(line)
        });
        let header = header.ok_or(TaughtError::NoSection)?;
        let gap = if header.ends_with('\n') { "" } else { "\n" };
        new.insert_str(end, &format!("{gap}{lines}"));
    }
    Ok(new)
}

/// Returns the name as a TOML string.
fn quoted(name: &str) -> String {
    toml::Value::String(name.to_owned()).to_string()
}

fn parsed(text: &str) -> Result<toml::Spanned<DeTable<'_>>, TaughtError> {
    DeTable::parse(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let line = text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        TaughtError::Text { line, what: error.message().trim().replace('\n', "; ") }
    })
}

/// Finds the pose with this name, and returns the position of its angles in the text.
fn place(text: &str, name: &str) -> Result<Option<Range<usize>>, TaughtError> {
    let table = parsed(text)?;
    let Some(DeValue::Array(poses)) = table.get_ref().get("pose").map(|value| value.get_ref()) else {
        return Ok(None);
    };
    for pose in poses.iter() {
        let DeValue::Table(pose) = pose.get_ref() else { continue };
        let is_it =
            matches!(pose.get("name").map(|n| n.get_ref()), Some(DeValue::String(known)) if known == name);
        if is_it {
            let angles = pose.get("joints_rad").ok_or_else(|| TaughtError::ByPlace(name.to_owned()))?;
            return Ok(Some(angles.span()));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_pose_comes_last_and_a_known_one_gets_new_angles_and_nothing_else_changes() {
        let text = "title = \"mine\" # a comment\n\n[[pose]]\nname = \"a \\\"b\\\"\"\njoints_rad = [ 1.0,\n  2.0 ] # old\n";
        let new = with_pose(text, "shelf", &[0.5, -1.25]).unwrap();
        assert_eq!(new, format!("{text}\n[[pose]]\nname = \"shelf\"\njoints_rad = [0.500000, -1.250000]\n"));
        let again = with_pose(&new, "a \"b\"", &[3.0]).unwrap();
        assert_eq!(again, new.replace("[ 1.0,\n  2.0 ]", "[3.000000]"));
        let first = with_pose("", "she said \"here\"", &[0.0]).unwrap();
        assert!(place(&first, "she said \"here\"").unwrap().is_some(), "{first}");
    }

    #[test]
    fn the_axes_of_a_worn_board_replace_known_keys_and_nothing_else_changes() {
        use crate::config::Config;
        use crate::one_handed::Axis;
        let worn =
            OneHanded { forward: Axis::MinusY, left: Axis::PlusX, neutral_roll_mrad: -12, ..OneHanded::OFF };
        let read = |text: &str| Config::parse(text).unwrap().one_handed;
        let first = with_worn("", &worn).unwrap();
        assert!(first.starts_with("[one_handed]\n") && read(&first) == worn, "{first}");
        let text = "# mine\n[speed]\nstart = 0.2\n\n[one_handed] # of the right hand\nup = '+y' # the old one\non = true\nleft = '+z'\nforward = '+x'\n\n[ports]\nright = 'ble'\n";
        let new = with_worn(text, &worn).unwrap();
        assert_eq!(read(&new), OneHanded { on: true, ..worn });
        let (kept, added) = new.split_once("neutral_pitch_mrad = 0\nneutral_roll_mrad = -12\n").unwrap();
        let kept = format!("{kept}{added}");
        let expected = text.replace("'+y' #", "\"+z\" #").replace("'+z'\n", "\"+x\"\n");
        assert_eq!(kept, expected.replace("'+x'", "\"-y\""));
        assert_eq!(with_worn(&new, &worn).unwrap(), new, "again");
        assert_eq!(read(&with_worn("[one_handed]", &worn).unwrap()), worn);
        assert_eq!(with_worn("one_handed.on = true\n", &worn), Err(TaughtError::NoSection));
        assert!(matches!(with_worn("a = ", &worn), Err(TaughtError::Text { line: 1, .. })));
    }

    #[test]
    fn what_cannot_be_changed_is_said() {
        let text = "[[pose]]\nname = \"bin\"\nposition_m = [1, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]\n";
        assert_eq!(with_pose(text, "bin", &[0.0]), Err(TaughtError::ByPlace("bin".to_owned())));
        let TaughtError::Text { line, .. } = with_pose("a = 1\nb = ", "x", &[0.0]).unwrap_err() else {
            panic!()
        };
        assert_eq!(line, 2);
    }
}
