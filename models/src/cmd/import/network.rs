//! Converts another program's network of dense layers to a model with a card.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, ensure};
use models::blob;
use models::card::{Card, Data, FORMAT, Scaling, Training};
use models::labels::canonical_list;
use models::recording::write_whole;
use models::tflite::{self, End, Network};
use models::train::sha256;

use super::{Cmd, is_plain};

impl Cmd {
    pub(super) fn network(&self, file: &Path) -> anyhow::Result<()> {
        let at = |what: String| anyhow::anyhow!("{}: {what}", file.display());
        let bytes = std::fs::read(file).map_err(|error| at(format!("{error}; check the path")))?;
        let (network, end) = tflite::read_to_end(&bytes).map_err(|error| at(error.to_string()))?;
        let Network::Int8(layers) = &network else {
            return Err(at("a float32 network; export the quantized (int8) one".to_owned()));
        };
        let labels =
            canonical_list(&self.labels).map_err(|problem| anyhow::anyhow!("--labels: {problem}"))?;
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
        // The card's own checks (lengths, ranges) are performed before anything is written.
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
        if end == End::Logits {
            println!("the network ends in logits; the softmax that boards compute follows them");
        }
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
