//! `models infer`: runs a network on rows of inputs, to compare it with other runtimes.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use models::blob::ModelFiles;
use models::tflite::{Network, infer_float};
use shared_dsp::right::network::Model;

/// Run a network on rows of (scaled) inputs and print its scores
#[derive(Args)]
pub struct Cmd {
    /// A .tflite file, float or int8, with its card in the same folder
    model: PathBuf,
    /// CSV file without header, one row of inputs per line: integers from -128 to 127 for int8
    inputs: PathBuf,
}

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        let files = ModelFiles::read(&self.model)?;
        let text = std::fs::read_to_string(&self.inputs)
            .with_context(|| format!("{}: cannot be read; check the path", self.inputs.display()))?;
        let width = files.network.inputs();
        let blob = match &files.network {
            Network::Int8(_) => files.blob().map_err(anyhow::Error::msg)?,
            Network::Float(_) => Vec::new(),
        };
        let mut out = String::new();
        for (line, row) in text.lines().enumerate() {
            let place = || format!("{}, line {}", self.inputs.display(), line + 1);
            let found = row.split(',').count();
            anyhow::ensure!(found == width, "{}: {found} values, {width} are needed", place());
            let scores: Vec<String> = match &files.network {
                Network::Float(layers) => {
                    let row: Vec<f32> = parse(row).with_context(place)?;
                    infer_float(layers, &row).iter().map(f32::to_string).collect()
                }
                Network::Int8(_) => {
                    let row: Vec<i8> = parse(row).with_context(place)?;
                    let model = Model::parse(&blob)?;
                    let mut scores = vec![0i8; model.info().label_count];
                    model.infer(&row, &mut scores)?;
                    scores.iter().map(i8::to_string).collect()
                }
            };
            writeln!(out, "{}", scores.join(","))?;
        }
        print!("{out}");
        Ok(())
    }
}

fn parse<T: std::str::FromStr>(row: &str) -> anyhow::Result<Vec<T>> {
    row.split(',')
        .enumerate()
        .map(|(column, text)| {
            text.trim()
                .parse()
                .map_err(|_| anyhow::anyhow!("column {}: {text:?} is not a number that fits", column + 1))
        })
        .collect()
}
