//! A folder of recordings, `FOLDER/<label>/<person>__<n>.csv`.
//!
//! Every CSV file in every label folder is read.
//! `index.csv`, other files at the top level (licences) and hidden files are ignored and listed in `ignored`.
//! If a folder has recordings with 3, 6 and 9 axes, the reader uses the axes common to all recordings.
//! The sets of axes are nested: accelerometer, then gyroscope, then magnetometer.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::labels;
use crate::recording::{Recording, RecordingError};
use crate::sheet::Reading;

/// A recording, with the information that its path contains.
#[derive(Clone, Debug)]
pub struct Item {
    /// The file as found.
    pub file: PathBuf,
    /// Path `<label folder>/<file name>` as on disk, but with `/` on every system.
    pub name: String,
    /// The standard name of the label, derived from the folder.
    pub label: String,
    /// The person, which is the part of the file name before `__`.
    pub person: String,
    /// The recording from the file, reduced to the data set's axes.
    pub recording: Recording,
}

/// All recordings of a folder, sorted by name.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The folder.
    pub folder: PathBuf,
    /// The recordings.
    pub items: Vec<Item>,
    /// Labels in the order of a network's outputs ([`labels::sort`]).
    pub labels: Vec<String>,
    /// Number of axes of every recording: 3, 6 or 9.
    pub axes: usize,
    /// Files that were ignored because they are not recordings.
    pub ignored: Vec<PathBuf>,
    /// Number of recordings that had more axes than the data set.
    pub narrowed: usize,
}

/// The reason why a folder cannot be used. Its text contains a remedy.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The folder cannot be listed.
    #[error("{folder}: {source}; give a folder with FOLDER/<label>/<person>__<n>.csv")]
    Io {
        /// The folder.
        folder: PathBuf,
        /// The system's error message.
        source: std::io::Error,
    },
    /// A file name does not contain the person.
    #[error("{file}: the name must be <person>__<n>.csv (two underscores); rename the file")]
    Name {
        /// The file.
        file: PathBuf,
    },
    /// The folder contains no recordings.
    #[error("{folder}: no recordings; put them in {folder}/<label>/<person>__<n>.csv")]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// A recording has too few axes.
    #[error(
        "{file}: {found} axes, but {wanted} are wanted; leave the file out, or use a model of {found} axes \
         (`models train --axes {found}`)"
    )]
    Axes {
        /// The file.
        file: PathBuf,
        /// Axes it has.
        found: usize,
        /// Axes wanted.
        wanted: usize,
    },
    /// A recording is damaged.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

impl Dataset {
    /// Reads a folder. `axes` selects the first 3, 6 or 9 axes of every recording; `None` selects all common axes.
    pub fn read(folder: &Path, axes: Option<usize>) -> Result<Self, DatasetError> {
        Self::read_where(folder, axes, |_, _| true)
    }

    /// Returns the people in a folder, sorted, using only file names.
    pub fn people_of(folder: &Path) -> Result<Vec<String>, DatasetError> {
        let mut people = BTreeSet::new();
        for entry in list(folder)?.into_iter().filter(|entry| entry.is_dir()) {
            for name in list(&entry)?.iter().map(|file| file_name(file)) {
                if let Some((person, _)) = name.strip_suffix(".csv").and_then(|stem| stem.split_once("__")) {
                    people.insert(person.to_owned());
                }
            }
        }
        Ok(people.into_iter().collect())
    }

    /// Reads only the recordings whose label and person satisfy `wanted`. Other files are not opened.
    pub fn read_where(
        folder: &Path,
        axes: Option<usize>,
        wanted: impl Fn(&str, &str) -> bool,
    ) -> Result<Self, DatasetError> {
        let mut items = Vec::new();
        let mut ignored = Vec::new();
        let mut doubts: Vec<(String, RecordingError)> = Vec::new();
        let in_degrees = Reading { units: "deg/s".parse().unwrap_or_default(), ..Reading::default() };
        for entry in list(folder)? {
            if !entry.is_dir() {
                ignored.push(entry);
                continue;
            }
            let folder_name = file_name(&entry);
            for file in list(&entry)? {
                let name = file_name(&file);
                let stem = name.strip_suffix(".csv");
                let (Some(stem), false) = (stem, name.starts_with('.') || name == "index.csv") else {
                    ignored.push(file);
                    continue;
                };
                let person = match stem.split_once("__") {
                    Some((person, number)) if !person.is_empty() && !number.is_empty() => person,
                    _ => return Err(DatasetError::Name { file }),
                };
                if !wanted(&labels::canonical(&folder_name), person) {
                    continue;
                }
                // A single recording may contain little rotation.
                // If most of a person's recordings contain little rotation, the unit is wrong.
                let recording = match Recording::read(&file) {
                    Err(error) => match Recording::read_as(&file, &in_degrees) {
                        Ok(recording) => {
                            doubts.push((person.to_owned(), error));
                            recording
                        }
                        Err(_) => return Err(error.into()),
                    },
                    Ok(recording) => recording,
                };
                if let Some(wanted) = axes
                    && recording.axes() < wanted
                {
                    return Err(DatasetError::Axes { found: recording.axes(), wanted, file });
                }
                items.push(Item {
                    name: format!("{folder_name}/{name}"),
                    label: labels::canonical(&folder_name),
                    person: person.to_owned(),
                    recording,
                    file,
                });
            }
        }
        let of = |person: &str| items.iter().filter(|item| item.person == person).count();
        let doubted = |person: &str| doubts.iter().filter(|(name, _)| name == person).count();
        if let Some(place) = doubts.iter().position(|(person, _)| 2 * doubted(person) > of(person)) {
            return Err(doubts.swap_remove(place).1.into());
        }
        let Some(common) = items.iter().map(|item| item.recording.axes()).min() else {
            return Err(DatasetError::Empty { folder: folder.to_owned() });
        };
        let axes = axes.unwrap_or(common);
        let mut narrowed = 0;
        for item in &mut items {
            if item.recording.axes() > axes {
                item.recording = item.recording.with_axes(axes);
                narrowed += 1;
            }
        }
        items.sort_by(|a, b| a.name.cmp(&b.name));
        let labels = label_list(&items);
        Ok(Self { folder: folder.to_owned(), items, labels, axes, ignored, narrowed })
    }

    /// The people, sorted.
    pub fn people(&self) -> Vec<String> {
        let people: BTreeSet<_> = self.items.iter().map(|item| item.person.clone()).collect();
        people.into_iter().collect()
    }

    /// Returns the part of the data set that satisfies `keep`, with the remaining labels.
    pub fn filtered(&self, keep: impl Fn(&Item) -> bool) -> Self {
        let items: Vec<_> = self.items.iter().filter(|item| keep(item)).cloned().collect();
        Self { labels: label_list(&items), items, ..self.clone_without_items() }
    }

    fn clone_without_items(&self) -> Self {
        Self {
            folder: self.folder.clone(),
            items: Vec::new(),
            labels: Vec::new(),
            axes: self.axes,
            ignored: self.ignored.clone(),
            narrowed: self.narrowed,
        }
    }
}

fn label_list(items: &[Item]) -> Vec<String> {
    let set: BTreeSet<_> = items.iter().map(|item| item.label.clone()).collect();
    let mut list: Vec<_> = set.into_iter().collect();
    labels::sort(&mut list);
    list
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn list(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let error = |source| DatasetError::Io { folder: folder.to_owned(), source };
    let mut entries = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>())
        .map_err(error)?;
    entries.sort();
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACC: &str = "timestamp,accX,accY,accZ\n0,1,2,3\n10,1,2,3\n";
    const IMU: &str = "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ\n0,1,2,3,4,5,6\n10,1,2,3,4,5,6\n";

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let file = folder.path().join(name);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, text).unwrap();
        }
        folder
    }

    #[test]
    fn label_and_person_come_from_the_path_and_only_recordings_are_read() {
        let data = folder(&[
            ("leftright/s1__001.csv", ACC),
            ("idle/s2__7.csv", ACC),
            ("index.csv", "path,label\n"),
            ("LICENSE.txt", "free"),
        ]);
        let set = Dataset::read(data.path(), None).unwrap();
        assert_eq!(set.labels, ["idle", "left-right"]);
        assert_eq!(set.people(), ["s1", "s2"]);
        assert_eq!(set.items[1].name, "leftright/s1__001.csv");
        assert_eq!(set.ignored.len(), 2);
    }

    #[test]
    fn a_mixed_folder_keeps_the_axes_that_all_have() {
        let data = folder(&[("a/p__1.csv", ACC), ("b/p__1.csv", IMU)]);
        let set = Dataset::read(data.path(), None).unwrap();
        assert_eq!((set.axes, set.narrowed), (3, 1));
        assert!(set.items.iter().all(|item| item.recording.axes() == 3));
        let text = Dataset::read(data.path(), Some(6)).unwrap_err().to_string();
        assert!(text.contains("a/p__1.csv: 3 axes, but 6 are wanted"), "{text}");
        assert!(text.contains("models train --axes 3"), "{text}");
    }

    #[test]
    fn a_hand_that_moves_without_turning_is_doubted_only_if_it_never_turns() {
        let rows = |turn: f64| {
            let row = |n: u32| {
                let angle = f64::from(n) * 0.12;
                format!("{},{:.3},0,9.8,{:.3},0,0\n", 10 * n, 5.0 * angle.sin(), turn * angle.cos())
            };
            format!("timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ\n{}", (0..200).map(row).collect::<String>())
        };
        let (stiff, loose) = (rows(2.0), rows(80.0));
        let data = folder(&[("a/p__1.csv", &stiff), ("a/p__2.csv", &loose)]);
        let set = Dataset::read(data.path(), None).unwrap();
        assert!((set.items[0].recording.samples().next().unwrap()[3] - 2.0).abs() < 1e-3, "deg/s");
        let data = folder(&[("a/p__1.csv", &stiff), ("a/p__2.csv", &stiff), ("a/q__1.csv", &loose)]);
        let text = Dataset::read(data.path(), None).unwrap_err().to_string();
        assert!(text.contains("p__1.csv") && text.contains("rad/s"), "{text}");
    }

    #[test]
    fn bad_names_missing_and_empty_folders_say_what_to_do() {
        let data = folder(&[("a/noperson.csv", ACC)]);
        let text = Dataset::read(data.path(), None).unwrap_err().to_string();
        assert!(text.contains("a/noperson.csv: the name must be <person>__<n>.csv"), "{text}");
        let empty = folder(&[("README", "x")]);
        let text = Dataset::read(empty.path(), None).unwrap_err().to_string();
        assert!(text.contains("no recordings; put them in"), "{text}");
        let text = Dataset::read(Path::new("/nowhere"), None).unwrap_err().to_string();
        assert!(text.starts_with("/nowhere: "), "{text}");
    }

    #[test]
    fn a_damaged_recording_stops_the_reading_with_its_place() {
        let data = folder(&[("a/p__1.csv", ACC), ("a/p__2.csv", "timestamp,accX,accY,accZ\n0,1,2,?\n")]);
        let text = Dataset::read(data.path(), None).unwrap_err().to_string();
        assert!(text.contains("a/p__2.csv, line 2, column 4 (accZ)"), "{text}");
    }
}
