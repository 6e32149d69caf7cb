//! Reads the labels of an export: `info.labels` at its top, and `structured_labels.labels` beside its files.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::labels;

/// The two parts of an export, which are kept apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Part {
    /// To learn from.
    Training,
    /// To score on.
    Testing,
}

impl Part {
    /// Returns the name of this part's folder.
    pub fn name(self) -> &'static str {
        match self {
            Part::Training => "training",
            Part::Testing => "testing",
        }
    }
}

/// The samples of one label in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Canonical.
    pub label: String,
    /// First sample, from 0.
    pub start: usize,
    /// Last sample.
    pub end: usize,
}

/// The labels that an export gives a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Labelled {
    /// The complete file has this label, given by its standard name.
    As(String),
    /// The file contains several labels in sequence.
    Cuts(Vec<Cut>),
    /// The file has not been labelled.
    Not,
}

/// The labels of all files in an export. Each label file is read once.
#[derive(Debug, Default)]
pub struct Labels {
    /// Contents of `info.labels`, first by folder and then by the path below the folder.
    infos: HashMap<PathBuf, Option<HashMap<String, Entry>>>,
    /// Contents of `structured_labels.labels`, first by folder and then by file name.
    structured: HashMap<PathBuf, HashMap<String, Vec<Cut>>>,
}

#[derive(Clone, Debug)]
struct Entry {
    part: Option<Part>,
    label: Option<Labelled>,
}

fn part(name: &str) -> Option<Part> {
    [Part::Training, Part::Testing].into_iter().find(|part| part.name() == name)
}

fn json(file: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(file).ok()?).ok()
}

fn cuts(list: &Value) -> Option<Vec<Cut>> {
    let index = |value: &Value| usize::try_from(value.as_u64()?).ok();
    let one = |cut: &Value| {
        Some(Cut {
            label: labels::canonical(cut.get("label")?.as_str()?),
            start: index(cut.get("startIndex")?)?,
            end: index(cut.get("endIndex")?)?,
        })
    };
    list.as_array()?.iter().map(one).collect()
}

fn entry(value: &Value) -> Option<(String, Entry)> {
    let path = value.get("path")?.as_str()?.replace('\\', "/");
    let label = value.get("label").and_then(|label| {
        let name = label.as_str().or_else(|| label.get("label")?.as_str());
        match label.get("type").and_then(Value::as_str) {
            Some("unlabeled") => Some(Labelled::Not),
            Some("multi-label") => {
                Some(Labelled::Cuts(label.get("labels").and_then(cuts).unwrap_or_default()))
            }
            _ => name.map(|name| Labelled::As(labels::canonical(name))),
        }
    });
    Some((path, Entry { part: value.get("category").and_then(Value::as_str).and_then(part), label }))
}

impl Labels {
    /// Returns the labels and the part of a file, or `None` if there is no export or it does not list the file.
    pub fn of(&mut self, file: &Path) -> (Option<Labelled>, Option<Part>) {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let folder = file.parent().unwrap_or(Path::new(""));
        // The last parent folder that has the name of a part.
        let by_folder =
            file.ancestors().skip(1).take(2).find_map(|folder| part(&folder.file_name()?.to_string_lossy()));
        let structured = self.structured.entry(folder.to_owned()).or_insert_with(|| structured(folder));
        let structured = structured.get(&name).cloned().map(Labelled::Cuts);
        for folder in file.ancestors().skip(1).take(3) {
            let info = self.infos.entry(folder.to_owned()).or_insert_with(|| info(folder));
            let Some(info) = info else { continue };
            let inside = file.strip_prefix(folder).unwrap_or(file).to_string_lossy().replace('\\', "/");
            let Some(entry) = info.get(&inside) else { break };
            let label = match &entry.label {
                Some(Labelled::Cuts(cuts)) if cuts.is_empty() => structured.or(Some(Labelled::Not)),
                Some(label) => Some(label.clone()),
                None => structured,
            };
            return (label, entry.part.or(by_folder));
        }
        (structured, by_folder)
    }
}

/// Reads `FOLDER/info.labels`, if it exists and is valid.
fn info(folder: &Path) -> Option<HashMap<String, Entry>> {
    let info = json(&folder.join("info.labels"))?;
    Some(info.get("files")?.as_array()?.iter().filter_map(entry).collect())
}

fn structured(folder: &Path) -> HashMap<String, Vec<Cut>> {
    let Some(file) = json(&folder.join("structured_labels.labels")) else { return HashMap::new() };
    let Some(Value::Object(files)) = file.get("structuredLabels") else { return HashMap::new() };
    files.iter().filter_map(|(name, list)| Some((name.clone(), cuts(list)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn an_exports_labels_are_one_several_or_none() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("training")).unwrap();
        let info = json!({"version": 1, "files": [
            {"path": "training/a.cbor", "category": "training", "label": {"type": "label", "label": "Big Wave"}},
            {"path": "training/u.json", "category": "training", "label": {"type": "unlabeled"}},
            {"path": "testing/m.json", "category": "testing", "label": {"type": "multi-label", "labels": [
                {"label": "idle", "startIndex": 0, "endIndex": 9}, {"label": "wave", "startIndex": 10, "endIndex": 19}]}},
            {"path": "training/s.json", "category": "training", "label": {"type": "multi-label"}},
        ]});
        std::fs::write(folder.path().join("info.labels"), info.to_string()).unwrap();
        let structured =
            json!({"structuredLabels": {"s.json": [{"label": "Circle", "startIndex": 3, "endIndex": 5}]}});
        let beside = folder.path().join("training/structured_labels.labels");
        std::fs::write(beside, structured.to_string()).unwrap();
        let mut labels = Labels::default();
        let mut of = |name: &str| labels.of(&folder.path().join(name));
        assert_eq!(of("training/a.cbor"), (Some(Labelled::As("big-wave".to_owned())), Some(Part::Training)));
        assert_eq!(of("training/u.json"), (Some(Labelled::Not), Some(Part::Training)));
        let cut = |label: &str, start, end| Cut { label: label.to_owned(), start, end };
        let cuts = vec![cut("idle", 0, 9), cut("wave", 10, 19)];
        assert_eq!(of("testing/m.json"), (Some(Labelled::Cuts(cuts)), Some(Part::Testing)));
        assert_eq!(of("training/s.json").0, Some(Labelled::Cuts(vec![cut("circle", 3, 5)])));
        assert_eq!(of("training/unknown.json"), (None, Some(Part::Training)));
        assert_eq!(of("elsewhere.json"), (None, None));
    }
}
