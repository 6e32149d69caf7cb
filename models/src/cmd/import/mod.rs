//! `models import`: converts recordings and networks of other programs to our formats.

mod network;
mod recordings;
mod report;

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use models::sheet::{Columns, Reading, Units};

/// Import recordings of other programs (CSV, Edge Impulse's JSON and CBOR), or an int8 .tflite of dense layers
#[derive(Args)]
pub struct Cmd {
    /// Data files, folders of them (such as an unpacked export), or one .tflite file
    #[arg(required = true, value_name = "FILE|FOLDER")]
    sources: Vec<PathBuf>,
    /// Folder for <label>/<person>__<n>.csv (below training/ and testing/ if an export has both), or for NAME.tflite
    /// and its card
    #[arg(long)]
    out: PathBuf,
    /// Data: the recorded person [default: from the file's name or the export]
    #[arg(long)]
    person: Option<String>,
    /// Data: the label [default: from the export, the folder, or the file's name]
    #[arg(long)]
    label: Option<String>,
    /// Data: samples per second of files without times
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
    /// Data: units, overriding the file: g, mg or m/s2; rad/s or deg/s; uT or gauss; 16384/g for counts
    #[arg(long, value_name = "UNIT,...", value_parser = |text: &str| text.parse::<Units>())]
    units: Option<Units>,
    /// Data: columns, either our names in the file's order (time,accX,accY,accZ,-) or OURS=THEIRS,... by name or number
    #[arg(long, value_name = "COLUMNS", value_parser = |text: &str| text.parse::<Columns>())]
    columns: Option<Columns>,
    /// Data: report files that cannot be read, and import the others
    #[arg(long)]
    skip_bad: bool,
    /// Network: names of its outputs, in order
    #[arg(long, value_delimiter = ',', value_name = "A,B,...")]
    labels: Vec<String>,
    /// Network: number of axes of its features
    #[arg(long, default_value = "9", value_parser = clap::builder::PossibleValuesParser::new(["3", "6", "9"]))]
    axes: String,
    /// Network: kind of features used in its training, as named in cards
    #[arg(long, default_value = "raw", value_parser = clap::builder::PossibleValuesParser::new(["raw", "log-power", "aligned"]))]
    features: String,
    /// Network: JSON file with `mean`, `deviation` (one per feature) and `limit` [default: unscaled features]
    #[arg(long, value_name = "FILE")]
    scaling: Option<PathBuf>,
    /// Network: name of the new files [default: the name of the .tflite file]
    #[arg(long)]
    name: Option<String>,
}

fn rate(text: &str) -> Result<f64, String> {
    let range = models::recording::MIN_RATE_HZ..=models::recording::MAX_RATE_HZ;
    let rate = text.parse().map_err(|_| "give samples per second".to_owned())?;
    if range.contains(&rate) {
        Ok(rate)
    } else {
        Err(format!("{} to {} Hz can be used", range.start(), range.end()))
    }
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

    /// Returns the rules of the reader, which infers and reports undeclared properties.
    fn reading(&self) -> Reading {
        let units = self.units.unwrap_or_default();
        Reading { units, rate_hz: self.rate, columns: self.columns.clone(), guess: true }
    }
}

/// Returns whether the name can be a part of a path.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_')
}

/// Converts the name of a device to the name of a person in a file name.
fn plain(name: &str) -> String {
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let name = name.trim_matches('-');
    if name.is_empty() { "somebody".to_owned() } else { name.to_owned() }
}
