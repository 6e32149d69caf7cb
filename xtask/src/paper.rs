//! `cargo xtask paper`: what the paper prints, beside what is measured here, row by row with the command of each.
//!
//! The rows are printed by tests, as `paper: WHAT | PAPER | HERE`, but those of recognition, which come from models that
//! are trained here. A row that does not come is a failure. The paper: docs/SOURCES.md.

use std::fmt::Write as _;
use std::process::{ExitCode, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;

use crate::steps::rows;
use crate::target_dir;
use crate::test::{cargo, cargo_for_all};

/// A table or figure of the paper, and the tests that measure the same here.
struct Part {
    title: &'static str,
    /// As `cargo test` is told.
    test: &'static [&'static str],
    only: &'static str,
    /// What the rows' names begin with; each must come.
    rows: &'static [&'static str],
    /// What a reader must know.
    note: &'static str,
}

const PARTS: &[Part] = &[
    Part {
        title: "Left hand: 400 tilts",
        test: &["--test", "avr_trials"],
        only: "the_papers_400_tilts",
        rows: &["tilts, of", "tilts: taken for the opposite", "start of a tilt"],
        note: "Simulated hands before the emulated board and its very image; the paper's were people. A command waits \
               until a tilt stays (docs/SAFETY.md), which costs some 100 ms.",
    },
    Part {
        title: "Left hand: bends",
        test: &["--test", "avr_trials"],
        only: "bends_count_once",
        rows: &["bends of the index", "bends of the middle", "bends: false counts"],
        note: "",
    },
    Part {
        title: "From a tilt to the wheels",
        test: &["--test", "avr_street"],
        only: "a_voltage_step",
        rows: &["a tilt to 20°", "a tilt to 30°", "a tilt to 45°"],
        note: "From the voltage at the board's pin to the first speed of the simulated base.",
    },
    Part {
        title: "Speed by bends, 10 s",
        test: &["--test", "avr_street"],
        only: "the_papers_speed_modulation",
        rows: &[
            "speed profile, 0.0",
            "speed profile, 1.0",
            "speed profile, 5.2",
            "speed profile, 6.2",
            "speed profile, 9.0",
        ],
        note: "0.478 = 0.9⁷; the paper rounds it to 0.50.",
    },
    Part {
        title: "Arm: time of each motion from home",
        test: &["--test", "arm_kinematics"],
        only: "single_moves",
        rows: &[
            "ready →",
            "home → pick-up",
            "home → place (",
            "home → place-top",
            "home → place-bottom",
            "home → random",
        ],
        note: "By construction: the paper prints no poses, and ours were chosen so that these times come out at its scaling.",
    },
    Part {
        title: "Right hand: the paper's network on the chip",
        test: &["--test", "nrf_cost"],
        only: "a_network_of_the_papers_shape",
        rows: &[
            "its network on the chip: inference",
            "its network on the chip: flash",
            "its network on the chip: RAM",
            "its features and network",
        ],
        note: "Executed instructions of the emulated nRF52840; the paper gives time.",
    },
];

/// Measures every row, prints the table, and writes it where `--out FILE` says.
///
/// # Errors
/// An option that is not known, a row that does not come, a command that fails.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let (mut quick, mut out) = (false, None);
    let mut words = args.iter();
    while let Some(arg) = words.next() {
        match *arg {
            "--quick" => quick = true,
            "--out" => out = Some(*words.next().context("--out takes a file")?),
            _ => bail!("`cargo xtask paper` takes --quick and --out FILE, not `{arg}`"),
        }
    }
    let began = Instant::now();
    let mut text = format!(
        "# The paper beside this project\nMade by `cargo xtask paper{}`. \"Not stated\": the paper gives no such figure. The \
         paper: [SOURCES.md](SOURCES.md).\n",
        if quick { " --quick" } else { "" }
    );
    for part in PARTS {
        text += &measured(part, quick)?;
    }
    text += &recognition(quick)?;
    text += CLAIMS;
    println!("{text}");
    println!("{} s", began.elapsed().as_secs());
    if let Some(out) = out {
        std::fs::write(out, &text).with_context(|| format!("{out} cannot be written"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A part's heading, table, note and command.
fn measured(part: &Part, quick: bool) -> Result<String> {
    let mut cargo = cargo_for_all("test");
    cargo.args(part.test).args(["--", part.only, "--nocapture"]).stdin(Stdio::null());
    if !quick {
        cargo.env("BIMANUAL_FULL", "1");
    }
    let done = cargo.output()?;
    let said = String::from_utf8_lossy(&done.stdout);
    ensure!(
        done.status.success(),
        "{}: the test fails\n{said}{}",
        part.title,
        String::from_utf8_lossy(&done.stderr)
    );
    let rows = triples(&said);
    for wanted in part.rows {
        ensure!(
            rows.iter().any(|row| row[0].starts_with(wanted)),
            "{}: no row `{wanted}`; it needs the emulators (see `cargo xtask test`)",
            part.title
        );
    }
    let full = if quick { "" } else { "BIMANUAL_FULL=1 " };
    let command = format!(
        "{full}cargo test {} {} (with the features of `cargo xtask test`)",
        part.test.join(" "),
        part.only
    );
    Ok(table(part.title, &rows, part.note, &command))
}

/// The rows that a test has printed: what, in the paper, here.
fn triples(said: &str) -> Vec<[String; 3]> {
    rows(said, "paper: ").into_iter().filter_map(|cells| cells.try_into().ok()).collect()
}

fn table(title: &str, rows: &[[String; 3]], note: &str, command: &str) -> String {
    let mut text = format!("\n## {title}\n| | paper | here |\n|---|---|---|\n");
    for [what, paper, here] in rows {
        let _ = writeln!(text, "| {what} | {paper} | {here} |");
    }
    if !note.is_empty() {
        let _ = writeln!(text, "\n{note}");
    }
    let _ = writeln!(text, "\n`{command}`");
    text
}

/// Models of the paper's recipe and of ours, trained on simulated wearers: a random fifth of the recordings, as the paper
/// splits its own, and wearers that the model has never met.
fn recognition(quick: bool) -> Result<String> {
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
    let (mut rows, mut confusions) = (Vec::new(), String::new());
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
            format!("recipe `{recipe}`, a random fifth of the same wearers' recordings: float, int8"),
            papers.to_owned(),
            format!("{:.2} %, {:.2} %", of("float")?, of("int8")?),
        ]);
        let told = models(&["eval", &model.display().to_string(), &unmet])?;
        let met_never = told.lines().last().unwrap_or_default().trim().to_owned();
        met_never.parse::<f64>().context("`models eval` ends with its score")?;
        rows.push([
            format!("recipe `{recipe}`, wearers never met: int8"),
            "not stated".to_owned(),
            format!("{met_never} %"),
        ]);
        confusions += &confusion(recipe, &card)?;
    }
    let note = format!(
        "Simulated wearers ({wearers} known, {strangers} not): the paper's recordings are not public. Real people: \
         [models/README.md](../models/README.md).\n{confusions}"
    );
    let command = "models synth …; models train FOLDER --recipe RECIPE --test 0.2 …; models eval …: as in xtask/src/paper.rs";
    Ok(table("Right hand: recognition", &rows, &note, command))
}

/// Which label was taken for which, int8, in the random fifth.
fn confusion(recipe: &str, card: &Value) -> Result<String> {
    let labels: Vec<&str> =
        card["labels"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let counts = card["test"]["int8"]["confusion"].as_array().context("the card has no confusion matrix")?;
    let mut text = format!(
        "\n| `{recipe}`: made ↓, named → | {} |\n|---{}|\n",
        labels.join(" | "),
        "|---".repeat(labels.len())
    );
    for (label, row) in labels.iter().zip(counts) {
        let row: Vec<String> = row.as_array().into_iter().flatten().map(Value::to_string).collect();
        let _ = writeln!(text, "| {label} | {} |", row.join(" | "));
    }
    Ok(text)
}

/// What the paper says without a figure.
const CLAIMS: &str = "
## What the paper claims without a figure
| | here |
|---|---|
| few false positives at idle | events per hour of daily movement by real people: `models daily events` (models/README.md) |
| low power | share of the time awake, and charge per hour without the radio: `nrf_cost` (firmware-nano33/README.md) |
| several users | people never met, and after three gestures shown: `models people` (models/README.md) |
| both hands at once | `cargo run --release -- demo`: the base drives while the arm moves |
| latency from gesture to motion | both boards' images before ROS 2: `cargo xtask test --only \"ROS 2\"` prints it in parts |
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::root;

    #[test]
    fn rows_are_read_from_what_tests_print_and_nothing_else_is() {
        let said = "running 1 test\npaper: tilts, of 40: right | 93.5 % of 400 | 100.00 %\n paper: broken | row\nok\n";
        assert_eq!(triples(said), [["tilts, of 40: right", "93.5 % of 400", "100.00 %"].map(str::to_owned)]);
    }

    /// The page in the tree has every row that the command prints.
    #[test]
    fn the_page_has_every_row() {
        let page = std::fs::read_to_string(root().join("docs/PAPER.md")).unwrap();
        for part in PARTS {
            assert!(page.contains(part.title), "{}", part.title);
            for row in part.rows {
                assert!(
                    page.contains(&format!("| {row}")),
                    "no row `{row}`: `cargo xtask paper --out docs/PAPER.md`"
                );
            }
        }
        for row in [
            "recipe `paper`, a random fifth",
            "recipe `paper`, wearers never met",
            "recipe `aligned`, wearers never met",
        ] {
            assert!(page.contains(row), "{row}");
        }
    }
}
