//! `models import`: Edge Impulse's data files and foreign int8 networks into our layout.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::Args;
use models::blob;
use models::card::{Card, Data, FORMAT, Scaling, Training};
use models::edge_impulse::{self, label_of};
use models::labels::canonical;
use models::recording::{Recording, write_whole};
use models::tflite::{self, Network};
use models::train::sha256;

/// Import Edge Impulse exports: data files (.json, .cbor) as recordings, or an int8 .tflite of dense layers
#[derive(Args)]
pub struct Cmd {
    /// Data files, folders of them (an unpacked export), or one .tflite
    #[arg(required = true, value_name = "FILE|FOLDER")]
    sources: Vec<PathBuf>,
    /// Folder for <label>/<person>__<n>.csv, or for NAME.tflite and its card
    #[arg(long)]
    out: PathBuf,
    /// Data: who recorded it [default: what the file calls the device]
    #[arg(long)]
    person: Option<String>,
    /// Data: which gesture it is [default: from the export's info.labels, else the file's name up to the first dot]
    #[arg(long)]
    label: Option<String>,
    /// Network: names of its outputs in order
    #[arg(long, value_delimiter = ',', value_name = "A,B,...")]
    labels: Vec<String>,
    /// Network: axes of its features
    #[arg(long, default_value = "9", value_parser = clap::builder::PossibleValuesParser::new(["3", "6", "9"]))]
    axes: String,
    /// Network: the features it was trained on, as cards name them
    #[arg(long, default_value = "raw", value_parser = clap::builder::PossibleValuesParser::new(["raw", "log-power", "aligned"]))]
    features: String,
    /// Network: JSON file with `mean`, `deviation` (one per feature) and `limit` [default: features as they are]
    #[arg(long, value_name = "FILE")]
    scaling: Option<PathBuf>,
    /// Network: name of the new files [default: as the .tflite]
    #[arg(long)]
    name: Option<String>,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        let is_network = |file: &PathBuf| file.extension().is_some_and(|ending| ending == "tflite");
        match self.sources.as_slice() {
            [network] if is_network(network) => self.network(network),
            sources if sources.iter().any(is_network) => {
                bail!("import a .tflite alone, data files without it: they become different things")
            }
            sources => self.recordings(sources),
        }
    }

    fn recordings(&self, sources: &[PathBuf]) -> anyhow::Result<()> {
        for name in self.person.iter().chain(&self.label) {
            ensure!(
                is_plain(name) && !name.contains("__"),
                "{name:?}: use letters, digits, - and single _ only"
            );
        }
        let mut files = Vec::new();
        for source in sources {
            let before = files.len();
            collect(source, &mut files)?;
            ensure!(files.len() > before, "{}: no .json or .cbor files in it", source.display());
        }
        // All are read before one is written: an error leaves nothing behind.
        let mut recordings: BTreeMap<(String, String), Vec<Recording>> = BTreeMap::new();
        for file in &files {
            let imported = edge_impulse::read(file)?;
            let label = match &self.label {
                Some(label) => canonical(label),
                None => label_of(file)
                    .with_context(|| format!("{}: which gesture? --label says", file.display()))?,
            };
            ensure!(
                is_plain(&label),
                "{}: label {label:?} cannot be a folder's name; give another with --label",
                file.display()
            );
            let person = self
                .person
                .clone()
                .unwrap_or_else(|| plain(imported.device.as_deref().unwrap_or("somebody")));
            if !imported.left_out.is_empty() {
                println!("{}: left out {}", file.display(), imported.left_out.join(", "));
            }
            recordings.entry((label, person)).or_default().push(imported.recording);
        }
        for ((label, person), recordings) in &recordings {
            let folder = self.out.join(label);
            std::fs::create_dir_all(&folder)
                .with_context(|| format!("{}: the folder cannot be made", folder.display()))?;
            let free = |n: &u32| !folder.join(format!("{person}__{n}.csv")).exists();
            let mut numbers = (1u32..).filter(free);
            let mut seconds = 0.0;
            for recording in recordings {
                let number = numbers.next().unwrap_or_default();
                let file = folder.join(format!("{person}__{number}.csv"));
                let text = recording.to_csv().replacen("timestamp_ms", "timestamp", 1);
                write_whole(&file, text.as_bytes()).with_context(|| format!("{}", file.display()))?;
                seconds += recording.seconds();
            }
            println!("{label}: {} recordings of {person}, {seconds:.1} s", recordings.len());
        }
        println!("next: models train {} --out trained", self.out.display());
        Ok(())
    }

    fn network(&self, file: &Path) -> anyhow::Result<()> {
        let at = |what: String| anyhow::anyhow!("{}: {what}", file.display());
        let bytes = std::fs::read(file).map_err(|error| at(format!("{error}; check the path")))?;
        let network = tflite::read(&bytes).map_err(|error| at(error.to_string()))?;
        let Network::Int8(layers) = &network else {
            return Err(at("a float32 network; export the quantized (int8) one".to_owned()));
        };
        let labels: Vec<String> = self.labels.iter().map(|label| canonical(label)).collect();
        ensure!(!labels.is_empty(), "--labels: name the network's {} outputs in order", network.outputs());
        ensure!(
            labels.len() == network.outputs(),
            "{}: {} outputs, but --labels names {}",
            file.display(),
            network.outputs(),
            labels.len()
        );
        let axes: usize = self.axes.parse().unwrap_or_default();
        let recipe = blob::recipe(&self.features).context("--features: no such recipe")?;
        let inputs = recipe.feature_count(axes);
        ensure!(
            inputs == network.inputs(),
            "{}: {} inputs, but {} axes make {inputs} features ({}); a network for other features cannot run here: \
             train one with `models train`, on the same data imported",
            file.display(),
            network.inputs(),
            axes,
            self.features
        );
        let scaling = match &self.scaling {
            None => Scaling { mean: vec![0.0; inputs], deviation: vec![1.0; inputs], limit: 1e6 },
            Some(file) => {
                let text = std::fs::read(file).with_context(|| format!("{}", file.display()))?;
                serde_json::from_slice(&text).with_context(|| format!("{}", file.display()))?
            }
        };
        let name = match &self.name {
            Some(name) => name.clone(),
            None => file.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        ensure!(is_plain(&name), "--name {name:?}: use letters, digits, - and _ only");
        let mut card = card(&name, labels, axes, &self.features, scaling, file);
        card.tflite_sha256 = sha256(&bytes);
        // The card's own checks (lengths, ranges), before anything is written.
        let card_file = Card::path(&self.out.join(format!("{name}.tflite")));
        Card::parse(&card_file, card.to_json().as_bytes())?;
        let built = blob::build(&card, layers).map_err(&at)?;
        card.model_id = blob::model_id(&built);
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("{}: the folder cannot be made", self.out.display()))?;
        let copy = self.out.join(format!("{name}.tflite"));
        write_whole(&copy, &bytes).with_context(|| format!("{}", copy.display()))?;
        write_whole(&card_file, card.to_json().as_bytes())
            .with_context(|| format!("{}", card_file.display()))?;
        println!("{}\n{}\nmodel id {}", copy.display(), card_file.display(), card.model_id);
        println!("score it on recordings before you trust it: models eval {} FOLDER", copy.display());
        Ok(())
    }
}

fn card(name: &str, labels: Vec<String>, axes: usize, features: &str, scaling: Scaling, from: &Path) -> Card {
    let from = from.file_name().unwrap_or_default().to_string_lossy();
    Card {
        format: FORMAT,
        name: name.to_owned(),
        about: format!("imported from {from}; what it was trained on is not known here"),
        model_id: String::new(),
        tflite_sha256: String::new(),
        labels,
        axes,
        rate_hz: models::RATE_HZ as u16,
        window: models::WINDOW as u16,
        hop: models::HOP as u16,
        features: features.to_owned(),
        scaling,
        training: Training {
            recipe: "imported".to_owned(),
            seed: 0,
            tool: format!("models {}", env!("CARGO_PKG_VERSION")),
            epochs: 0,
            best_epoch: 0,
            batch: 0,
            learning_rate: 0.0,
            validation_fraction: 0.0,
            augmentation: "not known".to_owned(),
            windows: 0,
        },
        data: Data {
            sha256: String::new(),
            recordings: 0,
            minutes: 0.0,
            padded: 0,
            resampled: 0,
            labels: BTreeMap::new(),
            people: BTreeMap::new(),
            excluded: Vec::new(),
            test: Vec::new(),
        },
        test: None,
        validation: None,
    }
}

/// Can be a part of a path.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_')
}

/// A device's name as a person's in a file name.
fn plain(name: &str) -> String {
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    if name.is_empty() { "somebody".to_owned() } else { name }
}

/// Data files in a folder and its folders, sorted.
fn collect(source: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    let about = || format!("{}: give data files, or a folder of them", source.display());
    if !source.is_dir() {
        ensure!(source.exists(), "{}: there is no such file", source.display());
        files.push(source.to_owned());
        return Ok(());
    }
    let entries = std::fs::read_dir(source).with_context(about)?;
    let mut entries =
        entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>().with_context(about)?;
    entries.sort();
    for entry in entries {
        let ending = entry.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        if entry.is_dir() {
            collect(&entry, files)?;
        } else if matches!(ending.as_deref(), Some("json" | "cbor")) {
            files.push(entry);
        }
    }
    Ok(())
}
