//! Joins recordings from `../shared/data` into one recording for the emulated sensor.

use std::path::PathBuf;

use models::recording::Recording;

use super::lsm9ds1::Replay;

/// Folder of the shared data; `BIMANUAL_SHARED` may select another `shared` folder.
pub fn data() -> PathBuf {
    std::env::var_os("BIMANUAL_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared")), PathBuf::from)
        .join("data")
}

/// Joins the first recordings of a class, or returns `None` if the folder does not exist.
///
/// # Panics
/// Panics if a file differs from its documentation.
pub fn joined(set: &str, class: &str, most: usize) -> Option<(Replay, usize)> {
    let mut files: Vec<_> =
        std::fs::read_dir(data().join(set).join(class)).ok()?.flatten().map(|f| f.path()).collect();
    files.sort();
    files.truncate(most);
    let mut rows = Vec::new();
    for file in &files {
        let text = std::fs::read_to_string(file).expect("a recording");
        for line in text.lines().skip(1) {
            let mut row = [0.0; 9];
            for (place, field) in row.iter_mut().zip(line.split(',').skip(1)) {
                *place = field.trim().parse().expect("a number");
            }
            rows.push(row);
        }
    }
    (!rows.is_empty()).then_some((Replay { rows, interval: 0.01, start: 0.2 }, files.len()))
}

/// Returns the rows of a recording with nine axes.
pub fn rows(recording: &Recording) -> Vec<[f64; 9]> {
    recording.samples().map(|sample| std::array::from_fn(|axis| f64::from(sample[axis]))).collect()
}
