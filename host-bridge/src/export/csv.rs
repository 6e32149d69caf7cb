//! Writes episodes as CSV: `episode_000000.csv` and so on with one column per value, and `episodes.csv`.

use std::fmt::Write as _;
use std::path::Path;

use super::frames::{Columns, Rows};
use super::session::ExportError;

/// Writes the files to a new or empty folder.
///
/// # Errors
/// [`ExportError::Write`].
pub fn write(folder: &Path, columns: &Columns, episodes: &[Rows], fps: u32) -> Result<(), ExportError> {
    fresh(folder)?;
    let mut list = String::from("episode_index,frames,seconds,task\n");
    for (index, rows) in episodes.iter().enumerate() {
        let mut text = String::from("timestamp,frame_index");
        let names = columns.state.iter().map(|name| format!("state.{name}"));
        for name in names.chain(columns.action.iter().map(|name| format!("action.{name}"))) {
            let _ = write!(text, ",{name}");
        }
        text.push('\n');
        for (frame, (state, action)) in rows.state.iter().zip(&rows.action).enumerate() {
            let _ = write!(text, "{},{frame}", frame as f64 / f64::from(fps));
            for value in state.iter().chain(action) {
                let _ = write!(text, ",{value}");
            }
            text.push('\n');
        }
        put(&folder.join(format!("episode_{index:06}.csv")), text.as_bytes())?;
        let seconds = rows.state.len() as f64 / f64::from(fps);
        let _ =
            writeln!(list, "{index},{},{seconds},\"{}\"", rows.state.len(), rows.task.replace('"', "\"\""));
    }
    put(&folder.join("episodes.csv"), list.as_bytes())
}

/// Creates a folder, or accepts an empty one.
///
/// # Errors
/// Fails if the folder is not empty or cannot be created.
pub(super) fn fresh(folder: &Path) -> Result<(), ExportError> {
    let error = |error: &dyn std::fmt::Display| ExportError::Write(format!("{}: {error}", folder.display()));
    if std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(error(&"not empty; give a new folder"));
    }
    std::fs::create_dir_all(folder).map_err(|e| error(&e))
}

pub(super) fn put(file: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    models::recording::write_whole(file, bytes)
        .map_err(|error| ExportError::Write(format!("{}: {error}", file.display())))
}
