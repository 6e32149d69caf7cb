//! Converts data files to `OUT/<label>/<person>__<n>.csv`.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use models::edge_impulse::{
    self,
    export::{Labelled, Labels, Part},
};
use models::errors::in_full;
use models::labels::canonical;
use models::recording::Recording;
use models::sheet;
use rayon::prelude::*;

use super::report::Report;
use super::{Cmd, is_plain, plain};

/// A longer pause (in ms) separates recordings, because the movement during the pause is unknown.
const HOLE_MS: f64 = 1000.0;
/// Shorter recordings (in seconds) are omitted, because no gesture is that short.
const SHORTEST_S: f64 = 0.3;

/// Files that are read together because they form one recording.
struct Source {
    /// The files of one recording: either a single file, or one file per sensor.
    files: Vec<PathBuf>,
    /// The folder given on the command line, or the folder of a given file.
    below: PathBuf,
    labelled: Option<Labelled>,
    part: Option<Part>,
}

impl Source {
    /// Returns the name of the recording in the output.
    fn name(&self) -> String {
        match self.files.as_slice() {
            [file] => file.display().to_string(),
            files => {
                files.first().and_then(|file| file.parent()).unwrap_or(Path::new("")).display().to_string()
            }
        }
    }
}

/// A recording during its import.
struct Item {
    label: String,
    person: String,
    part: Option<Part>,
    recording: Recording,
}

/// The result of a source.
#[derive(Default)]
struct Read {
    items: Vec<Item>,
    notes: Vec<String>,
    /// Whether the label comes only from the file's name.
    label_from_name: bool,
}

impl Cmd {
    pub(super) fn recordings(&self, sources: &[PathBuf]) -> anyhow::Result<()> {
        for name in self.person.iter().chain(&self.label) {
            ensure!(
                is_plain(name) && !name.contains("__"),
                "{name:?}: use letters, digits, - and single _ only"
            );
        }
        let mut found = Vec::new();
        for source in sources {
            let before = found.len();
            let below = if source.is_dir() {
                source.clone()
            } else {
                source.parent().unwrap_or(Path::new("")).to_owned()
            };
            collect(source, &below, &mut found)?;
            ensure!(found.len() > before, "{}: no .csv, .json or .cbor files in it", source.display());
        }
        let mut labels = Labels::default();
        for source in &mut found {
            (source.labelled, source.part) = labels.of(&source.files[0]);
        }
        let unlabelled = |source: &Source| self.label.is_none() && source.labelled == Some(Labelled::Not);
        let (skipped, found): (Vec<Source>, Vec<Source>) = found.into_iter().partition(unlabelled);
        for source in &skipped {
            println!("{}: nobody has labelled it: left out (--label says what it is)", source.name());
        }
        // All files are read before the first is written, so that an error leaves nothing behind.
        let read: Vec<anyhow::Result<Read>> = found.par_iter().map(|source| self.read(source)).collect();
        let bad = read.iter().filter(|read| read.is_err()).count();
        let mut report = Report::default();
        let mut items = Vec::new();
        let mut by_name = 0;
        for (source, read) in found.iter().zip(read) {
            match read {
                Ok(read) => {
                    by_name += usize::from(read.label_from_name);
                    report.note(&source.name(), read.notes);
                    items.extend(read.items);
                }
                Err(error) if self.skip_bad => println!("left out: {}", in_full(&*error)),
                Err(error) if bad > 1 => {
                    bail!(
                        "{}\n{} of {} files cannot be read; --skip-bad imports the others",
                        in_full(&*error),
                        bad,
                        found.len()
                    )
                }
                Err(error) => return Err(error),
            }
        }
        ensure!(!items.is_empty(), "nothing is left to import");
        if by_name > 0 {
            println!(
                "the labels of {by_name} files are taken from their names; --label, a folder per label or an export says otherwise"
            );
        }
        report.print_notes();
        self.write(items, report)
    }

    /// Returns the labelled recordings of one source.
    fn read(&self, source: &Source) -> anyhow::Result<Read> {
        let reading = self.reading();
        let file = &source.files[0];
        let mut read = Read::default();
        let ending = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let mut device = None;
        let takes = if matches!(ending.as_str(), "json" | "cbor") {
            let imported = edge_impulse::read(file, &reading)?;
            device = imported.device;
            read.notes = imported.notes;
            vec![imported.recording]
        } else {
            let bytes = |file: &PathBuf| {
                std::fs::read(file).with_context(|| format!("{}: check that it may be read", file.display()))
            };
            let sheet = match source.files.as_slice() {
                [file] => sheet::parse(file, &bytes(file)?, &reading)?,
                files => {
                    let files: Vec<(&Path, Vec<u8>)> = files
                        .iter()
                        .map(|file| Ok((file.as_path(), bytes(file)?)))
                        .collect::<anyhow::Result<_>>()?;
                    let merged = sheet::merge(&files, &reading)?;
                    merged.with_context(|| format!("{}: its sensors' times do not overlap", source.name()))?
                }
            };
            read.notes = sheet.notes;
            sheet.takes
        };
        let (label, by_name) = self.label_of(source);
        let person = match (&self.person, person_of(file)) {
            (Some(person), _) => person.clone(),
            (None, Some(person)) => person,
            (None, None) => plain(device.as_deref().unwrap_or("somebody")),
        };
        let mut item = |label: &str, recording: Recording| -> anyhow::Result<()> {
            ensure!(
                is_plain(label),
                "{}: label {label:?} cannot be a folder's name; give another with --label",
                source.name()
            );
            let (label, person, part) = (label.to_owned(), person.clone(), source.part);
            read.items.push(Item { label, person, part, recording });
            Ok(())
        };
        let mut short = 0;
        for take in takes {
            let cuts = match (&self.label, &source.labelled) {
                (None, Some(Labelled::Cuts(cuts))) => cuts.clone(),
                _ => Vec::new(),
            };
            for cut in &cuts {
                ensure!(
                    cut.start <= cut.end && cut.end < take.len(),
                    "{}: label {} is of samples {} to {}, but there are {}",
                    source.name(),
                    cut.label,
                    cut.start,
                    cut.end,
                    take.len()
                );
                for part in parted(&take.slice(cut.start, cut.end + 1 - cut.start), &mut short) {
                    item(&cut.label, part)?;
                }
            }
            if cuts.is_empty() {
                let label = label
                    .as_deref()
                    .with_context(|| format!("{}: which gesture? --label says", source.name()))?;
                read.label_from_name = by_name;
                let holes = take.holes(HOLE_MS);
                if let Some((_, longest)) = holes.iter().max_by(|a, b| a.1.total_cmp(&b.1)) {
                    let s = longest / 1000.0;
                    read.notes.push(format!(
                        "{} pause(s), the longest of {s:.1} s, part it into recordings",
                        holes.len()
                    ));
                }
                for part in parted(&take, &mut short) {
                    item(label, part)?;
                }
            }
        }
        if short > 0 {
            read.notes.push(format!("{short} pieces are shorter than {SHORTEST_S} s and left out"));
        }
        Ok(read)
    }

    /// Returns the label of a source, and whether only a file's name gave it.
    fn label_of(&self, source: &Source) -> (Option<String>, bool) {
        if let Some(label) = &self.label {
            return (Some(canonical(label)), false);
        }
        match &source.labelled {
            Some(Labelled::As(label)) => return (Some(label.clone()), false),
            Some(_) => return (None, false),
            None => {}
        }
        let file = &source.files[0];
        // A folder that contains one recording counts as if it were a file.
        let (parent, name) = match source.files.len() {
            1 => (file.parent(), file.file_name()),
            _ => (file.parent().and_then(Path::parent), file.parent().and_then(Path::file_name)),
        };
        let folder = parent.filter(|folder| folder.starts_with(&source.below) && *folder != source.below);
        let folder = folder.and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
        if let Some(folder) = folder.filter(|folder| !matches!(folder.as_str(), "training" | "testing")) {
            return (Some(canonical(&folder)), false);
        }
        if person_of(file).is_some()
            && let Some(folder) = parent.and_then(Path::file_name)
        {
            return (Some(canonical(&folder.to_string_lossy())), false);
        }
        let name = name.unwrap_or_default().to_string_lossy().into_owned();
        let stem = name.split('.').next().unwrap_or_default();
        // Numbers, dates and times after a name are serial numbers, and not part of the name.
        let stem = stem.trim_end_matches(|c: char| c.is_ascii_digit() || matches!(c, '-' | '_' | ' '));
        ((!stem.is_empty()).then(|| canonical(stem)), true)
    }

    /// Writes the recordings that do not exist yet.
    fn write(&self, items: Vec<Item>, mut report: Report) -> anyhow::Result<()> {
        let parts: HashSet<Option<Part>> = items.iter().map(|item| item.part).collect();
        let apart = parts.contains(&Some(Part::Training)) && parts.contains(&Some(Part::Testing));
        let root = |part: Option<Part>| match part {
            Some(part) if apart => self.out.join(part.name()),
            None if apart => self.out.join(Part::Training.name()),
            _ => self.out.clone(),
        };
        let texts: Vec<String> = items.par_iter().map(|item| item.recording.to_edge_impulse_csv()).collect();
        let mut known = known(&self.out)?;
        let mut writes = Vec::new();
        let mut numbers: BTreeMap<(PathBuf, String), u32> = BTreeMap::new();
        let mut twice = 0;
        for (item, text) in items.iter().zip(&texts) {
            if !known.insert(models::train::sha256(text.as_bytes())) {
                twice += 1;
                continue;
            }
            let folder = root(item.part).join(&item.label);
            let number = numbers.entry((folder.clone(), item.person.clone())).or_default();
            let file = loop {
                *number += 1;
                let file = folder.join(format!("{}__{number}.csv", item.person));
                if !file.exists() {
                    break file;
                }
            };
            report.add(item.part.filter(|_| apart), &item.label, &item.person, &item.recording);
            writes.push((file, text));
        }
        for folder in writes.iter().filter_map(|(file, _)| file.parent()).collect::<HashSet<_>>() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{}: the folder cannot be made", folder.display()))?;
        }
        writes.par_iter().try_for_each(|(file, text)| {
            // Writes each file completely or not at all. For speed, it does not wait 10,000 times for the disk.
            let part = file.with_extension("csv.part");
            std::fs::write(&part, text)
                .and_then(|()| std::fs::rename(&part, file))
                .with_context(|| format!("{}", file.display()))
        })?;
        if twice > 0 {
            println!("{twice} recordings are there already, with the same samples: not written again");
        }
        report.print();
        let (train, test) = (root(Some(Part::Training)), root(Some(Part::Testing)));
        println!("next: models train {} --out trained", train.display());
        if apart {
            println!("then: models eval trained/gestures.tflite {}", test.display());
        }
        Ok(())
    }
}

/// Splits the recording at its pauses, and adds the number of short pieces that it discarded to `short`.
fn parted(recording: &Recording, short: &mut usize) -> Vec<Recording> {
    let ends = recording.holes(HOLE_MS).into_iter().map(|(before, _)| before + 1).chain([recording.len()]);
    let mut start = 0;
    let mut parts = Vec::new();
    for end in ends {
        let part = recording.slice(start, end - start);
        start = end;
        if part.len() > 1 && part.seconds() >= SHORTEST_S {
            parts.push(part);
        } else {
            *short += 1;
        }
    }
    parts
}

/// Returns the person, if the file name has our format.
fn person_of(file: &Path) -> Option<String> {
    let name = file.file_name()?.to_string_lossy().into_owned();
    let (person, number) = name.strip_suffix(".csv")?.split_once("__")?;
    (is_plain(person) && !number.is_empty()).then(|| person.to_owned())
}

/// Returns checksums of the recordings in a folder and its subfolders.
fn known(folder: &Path) -> anyhow::Result<HashSet<String>> {
    let mut files = Vec::new();
    if folder.is_dir() {
        collect(folder, folder, &mut files)?;
    }
    let sum = |source: &Source| Some(models::train::sha256(&std::fs::read(&source.files[0]).ok()?));
    Ok(files.par_iter().filter_map(sum).collect())
}

/// Collects data files from a folder and its subfolders, sorted. A folder with one file per sensor is one source.
fn collect(source: &Path, below: &Path, found: &mut Vec<Source>) -> anyhow::Result<()> {
    let about = || format!("{}: give data files, or a folder of them", source.display());
    let one = |files| Source { files, below: below.to_owned(), labelled: None, part: None };
    if !source.is_dir() {
        ensure!(source.exists(), "{}: there is no such file", source.display());
        found.push(one(vec![source.to_owned()]));
        return Ok(());
    }
    let entries = std::fs::read_dir(source).with_context(about)?;
    let mut entries =
        entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>().with_context(about)?;
    entries.sort();
    if let Some(files) = one_per_sensor(&entries) {
        found.push(one(files));
        return Ok(());
    }
    for entry in entries {
        let name = entry.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let ending = name.rsplit_once('.').map_or("", |(_, ending)| ending);
        if entry.is_dir() {
            collect(&entry, below, found)?;
        } else if matches!(ending, "json" | "cbor" | "csv" | "tsv")
            && name != "index.csv"
            && !name.starts_with('.')
        {
            found.push(one(vec![entry]));
        }
    }
    Ok(())
}

/// Returns the files to join, if a phone wrote one file per sensor to a folder.
fn one_per_sensor(entries: &[PathBuf]) -> Option<Vec<PathBuf>> {
    let find = |names: &[&str]| {
        let is = |file: &&PathBuf| {
            let stem = file.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
            names.contains(&stem.as_str())
                && file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"))
        };
        entries.iter().find(is).cloned()
    };
    let total = find(&["totalacceleration"]);
    let alone = find(&["accelerometer", "acceleration"]);
    let gyroscope = find(&["gyroscope"]);
    let magnetometer = find(&["magnetometer"]);
    // Sensor Logger subtracts gravity in Accelerometer.csv, so the file with gravity is needed too.
    let gravity = find(&["gravity"]).filter(|_| total.is_none());
    let others = [gravity, gyroscope, magnetometer];
    if total.is_none() && others.iter().all(Option::is_none) {
        return None;
    }
    let base = total.or(alone)?;
    Some([Some(base)].into_iter().chain(others).flatten().collect())
}
