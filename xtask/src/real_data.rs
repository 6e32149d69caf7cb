//! Tests the tools on real recordings: `models splits`, `models train` and `host-bridge replay`.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};

use crate::steps::{output, sh};
use crate::test::built;
use crate::{is_full, root, target_dir};

/// Minimum mean accuracy per recording over random splits of the LSM9DS1 set, in per cent.
/// The first value is for two splits, and the second is for twenty.
const SPLITS_MIN: [f64; 2] = [97.0, 99.0];
/// Minimum percentage of unknown people's gestures that cause exactly one correct event.
const EVENTS_MIN: f64 = 95.0;
/// Maximum percentage of recordings without a gesture that cause an event (the goal is 0).
const FALSE_MAX: f64 = 1.5;
/// Maximum difference between the means of int8 and float, in percentage points.
const INT8_GAP_MAX: f64 = 0.5;

/// Returns the folder of one data set, if this machine has it.
fn set(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("BIMANUAL_SHARED").map_or_else(|| root().join("../shared"), PathBuf::from);
    let folder = shared.join("data").join(name);
    if !folder.is_dir() {
        println!("skipped: {} is not here (BIMANUAL_SHARED names the folder)", folder.display());
        return None;
    }
    Some(folder)
}

/// Measures the mean accuracy, for float and int8, over random splits of the nine-axis set (twenty with `--full`).
pub fn splits() -> Result<()> {
    let Some(folder) = set("nano33-lsm9ds1-9axis") else { return Ok(()) };
    let (splits, least) = if is_full() { ("20", SPLITS_MIN[1]) } else { ("2", SPLITS_MIN[0]) };
    let text = output(built("models")?.arg("splits").arg(&folder).args(["--splits", splits]))?;
    print!("{text}");
    let mean = text.lines().last().context("`models splits` printed nothing")?;
    let figures: Vec<f64> = mean.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let [float, int8, ..] = figures[..] else { bail!("no figures in the last line: {mean}") };
    ensure!(float >= least && int8 >= least, "the mean is below {least} %: {mean}");
    ensure!(
        (float - int8).abs() <= INT8_GAP_MAX,
        "float and int8 are over {INT8_GAP_MAX} points apart: {mean}"
    );
    Ok(())
}

/// Tests models on unknown people: accuracy, accuracy after three examples, and events.
/// The short test uses one seed and only the nine-axis set, with limits that are two points lower.
/// `--full` uses both sets with five seeds, and ten hours of simulated wearers without gestures.
pub fn strangers() -> Result<()> {
    let (Some(nine), Some(acc)) = (set("nano33-lsm9ds1-9axis"), set("nano33rev2-acc-people")) else {
        return Ok(());
    };
    let full = is_full();
    let slack = if full { 0.0 } else { 2.0 };
    let acc = format!("{}:circle,leftright,idle", acc.display());
    let mut people = built("models")?;
    people.arg("people").arg(&nine).args(["--recipe", "aligned", "--examples", "3"]);
    let mut events = built("models")?;
    events.arg("events").arg(&nine);
    if full {
        people.arg(&acc);
        events.arg(&acc).args(["--hours", "10"]);
    } else {
        // Half of the steps are enough for these floors, and the teachers of a model take time.
        people.args(["--seeds", "1", "--steps", "2000"]);
        events.args(["--seeds", "1", "--steps", "2000", "--hours", "0.2"]);
    }
    let text = output(&mut people)?;
    print!("{text}");
    // These are the int8 results, and the nine-axis set comes first.
    for (what, floors) in [
        ("never met: mean", [92.0, 96.0]),
        ("never met: worst", [90.0, 90.0]),
        ("3 shown per class: mean", [98.0, 98.0]),
        ("3 shown per class: worst", [96.0, 96.0]),
    ] {
        let lines: Vec<&str> = text.lines().filter(|line| line.contains(what)).collect();
        ensure!(lines.len() == if full { 2 } else { 1 }, "{} lines with {what:?}", lines.len());
        for (line, floor) in lines.iter().zip(floors) {
            let figure: f64 = line.split_whitespace().last().context("an empty line")?.parse()?;
            ensure!(figure >= floor - slack, "{what}: {figure} % is below {} %", floor - slack);
        }
    }
    let text = output(&mut events)?;
    print!("{text}");
    let lines: Vec<&str> = text.lines().filter(|line| line.starts_with("all ")).collect();
    ensure!(lines.len() == if full { 2 } else { 1 }, "{} lines of all people's events", lines.len());
    for line in lines {
        let figure = |place: usize| -> Result<f64> {
            Ok(line.split_whitespace().nth(place).context("a figure is missing")?.parse()?)
        };
        let (right, no_gesture, wrong) = (figure(2)?, figure(7)?, figure(8)?);
        ensure!(right >= EVENTS_MIN - slack, "{right} % of gestures gave exactly one right event");
        // One seed plays 146 recordings, so a difference of two recordings may be random.
        ensure!(
            wrong <= no_gesture * (FALSE_MAX + slack) / 100.0,
            "{wrong} events in {no_gesture} recordings of no gesture"
        );
    }
    Ok(())
}

/// Trains a model, and then replays joined recordings to the simulator. The model has never seen these recordings.
pub fn replay() -> Result<()> {
    let Some(folder) = set("nano33-lsm9ds1-9axis") else { return Ok(()) };
    let out = target_dir().join("real-data");
    fs::create_dir_all(&out)?;
    sh(built("models")?
        .arg("train")
        .arg(&folder)
        .args(["--test", "0.2", "--name", "held-out", "--about", "real recordings", "--out"])
        .arg(&out))?;
    let list = fs::read_to_string(out.join("held-out.test.txt"))?;
    let mut replay = built("host-bridge")?;
    replay.args([
        "replay",
        "--headless",
        "--speed",
        "0",
        "--json",
        "--map",
        "peak=pick-up",
        "--map",
        "wave=place",
    ]);
    replay.arg("--model").arg(out.join("held-out.tflite"));
    for file in list.lines().filter(|line| !line.is_empty()) {
        replay.arg("--right").arg(folder.join(file));
    }
    let summary = output(&mut replay)?;
    println!("{}", summary.trim());
    let events = summary.matches("\"confidence\"").count();
    println!("{} recordings that training never saw, joined: {events} gesture events", list.lines().count());
    ensure!(events > 0, "no gesture event came out of real recordings");
    Ok(())
}
