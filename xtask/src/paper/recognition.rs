//! Trains and tests models with the paper's recipe and with ours.

use std::process::Stdio;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use super::{Matrix, Section};
use crate::target_dir;
use crate::test::cargo;

/// Trains models with the paper's recipe and with ours on simulated wearers.
/// Tests them on a random 20 % of the recordings, as in the paper.
/// Also tests them on wearers who are not in the training data.
pub fn section(quick: bool) -> Result<Section> {
    let folder = target_dir().join("paper");
    let _ = std::fs::remove_dir_all(&folder);
    let path = |name: &str| folder.join(name).display().to_string();
    let (wearers, strangers) = if quick { ("6", "3") } else { ("30", "10") };
    let models = |args: &[&str]| -> Result<String> {
        let mut cargo = cargo(&["run", "--quiet", "--release", "-p", "models", "--"]);
        let done = cargo.args(args).stdin(Stdio::null()).output()?;
        ensure!(
            done.status.success(),
            "models {}: {}",
            args.join(" "),
            String::from_utf8_lossy(&done.stderr)
        );
        Ok(String::from_utf8_lossy(&done.stdout).into_owned())
    };
    let (known, unmet) = (path("known"), path("strangers"));
    models(&["synth", "--whole", "--out", &known, "--wearers", wearers])?;
    models(&["synth", "--whole", "--out", &unmet, "--wearers", strangers, "--group", "evaluation"])?;
    let (mut rows, mut matrices) = (Vec::new(), Vec::new());
    for (recipe, papers) in [("paper", "99.9 %, people"), ("aligned", "–")] {
        models(&[
            "train",
            &known,
            "--recipe",
            recipe,
            "--test",
            "0.2",
            "--name",
            recipe,
            "--out",
            &path("models"),
        ])?;
        let model = folder.join("models").join(format!("{recipe}.tflite"));
        let card = std::fs::read_to_string(model.with_extension("card.json")).context("the model's card")?;
        let card: Value = serde_json::from_str(&card)?;
        let of =
            |network: &str| card["test"][network]["per_recording"].as_f64().context("the card has no scores");
        rows.push([
            format!(
                "recipe `{recipe}`, tested on a random 20 % of the same wearers' recordings (float, int8)"
            ),
            papers.to_owned(),
            format!("{:.2} %, {:.2} %", of("float")?, of("int8")?),
        ]);
        let told = models(&["eval", &model.display().to_string(), &unmet])?;
        let met_never = told.lines().last().unwrap_or_default().trim().to_owned();
        met_never.parse::<f64>().context("`models eval` ends with its score")?;
        rows.push([
            format!("recipe `{recipe}`, tested on unknown wearers (int8)"),
            "not stated".to_owned(),
            format!("{met_never} %"),
        ]);
        matrices.push(confusion(recipe, &card)?);
    }
    let note = format!(
        "The wearers are simulated, {wearers} known and {strangers} unknown ones, because the paper's recordings are not \
         public. See [models/README.md](../models/README.md) for real people."
    );
    let command = "models synth …; models train FOLDER --recipe RECIPE --test 0.2 …; models eval …: as in xtask/src/paper/recognition.rs";
    Ok(Section {
        title: "Right hand: recognition",
        rows,
        note,
        command: command.to_owned(),
        matrices,
        figures: Vec::new(),
    })
}

/// Returns the int8 confusion matrix for the random 20 % of the recordings.
fn confusion(recipe: &str, card: &Value) -> Result<Matrix> {
    let labels: Vec<String> = card["labels"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .map(str::to_owned)
        .collect();
    let counts = card["test"]["int8"]["confusion"].as_array().context("the card has no confusion matrix")?;
    let row = |row: &Value| row.as_array().into_iter().flatten().filter_map(Value::as_u64).collect();
    let counts = counts.iter().map(row).collect();
    Ok(Matrix { name: format!("recipe {recipe}"), made: labels.clone(), named: labels, counts })
}
