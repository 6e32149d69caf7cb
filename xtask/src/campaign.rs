//! `cargo xtask campaign`: everything that must hold when something else fails, at full length, in one table.
//!
//! The rows are tests. Each prints `row: WHAT | COUNT | WORST | LIMIT`; a test program without such lines becomes one
//! row itself. The short form of every row is a part of `cargo xtask test`: the same tests without `BIMANUAL_FULL`.

use std::process::{Command, ExitCode, Stdio};
use std::time::Instant;

use anyhow::{Result, bail};

use crate::root;

/// One fault of the campaign, and the tests that hold for it.
struct Fault {
    /// As in docs/SAFETY.md.
    name: &'static str,
    /// What `cargo test` is told.
    test: &'static [&'static str],
    /// What the tests are told.
    only: &'static [&'static str],
}

const fn fault(name: &'static str, test: &'static [&'static str], only: &'static [&'static str]) -> Fault {
    Fault { name, test, only }
}

const LIVE: &[&str] = &["-p", "host-bridge", "--test", "live"];

/// In the order of the table in docs/SAFETY.md. Those on the wall clock run one after the other.
const FAULTS: &[Fault] = &[
    fault(
        "v delays: constant, stepping, drifting ±5 %; restarts unseen",
        &["-p", "host-core", "--test", "lateness"],
        &[],
    ),
    fault(
        "v bursts, single neutral frames, pauses, stops and releases",
        &["-p", "host-bridge", "--test", "safety_rules"],
        &[],
    ),
    fault("v ten thousand random sessions", &["-p", "host-bridge", "--test", "random_sessions"], &[]),
    fault(
        "v palm up, walking, shaking, humming pins: 30 min of 10 wearers",
        &["-p", "shared-dsp", "--test", "left_judgement"],
        &[],
    ),
    fault("mutated streams", &["-p", "shared-proto", "--test", "mutations"], &[]),
    fault(
        "each signal, and a closed or stalled terminal",
        LIVE,
        &["live::stops::each_signal", "live::stops::a_signal", "live::stops::a_terminal"],
    ),
    fault("a panic in any thread", &["-p", "host-bridge", "--lib"], &["ending::"]),
    fault("floods", LIVE, &["live::stops::floods", "live::stops::a_hand_that_falls_silent"]),
    fault(
        "the reader of --json stops; output that nobody takes",
        LIVE,
        &["live::stops::a_reader", "live::stops::output"],
    ),
    fault("stopped and continued", LIVE, &["live::stops::a_program"]),
    fault("delays on the very program", LIVE, &["live::stops::a_board"]),
    fault("record cut short, or twice at a time", LIVE, &["live::stops::a_recording", "live::stops::two"]),
];

/// Runs every row, prints the table, and says whether all held.
///
/// # Errors
/// An option that is not known, or `cargo` does not start.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let mut short = false;
    for arg in args {
        match *arg {
            "--short" => short = true,
            _ => bail!("`cargo xtask campaign` takes --short, not `{arg}`"),
        }
    }
    let began = Instant::now();
    let mut table = Vec::new();
    let mut held = true;
    for fault in FAULTS {
        let started = Instant::now();
        let (rows, ok) = measure(fault, short)?;
        held &= ok;
        let seconds = started.elapsed().as_secs();
        println!("{}  {} ({seconds} s)", if ok { "held  " } else { "MISSED" }, fault.name);
        table.push((fault.name, rows, ok));
    }
    println!("\n| fault | row | count | worst | limit | |\n|---|---|---|---|---|---|");
    for (name, rows, ok) in &table {
        for row in rows {
            println!("| {name} | {} | {} |", row.join(" | "), if *ok { "held" } else { "MISSED" });
        }
    }
    println!(
        "\n{} minutes; {}",
        began.elapsed().as_secs() / 60,
        if held { "every row held" } else { "a row MISSED" }
    );
    Ok(if held { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The rows of one fault, and whether all its tests passed.
fn measure(fault: &Fault, short: bool) -> Result<(Vec<Vec<String>>, bool)> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.current_dir(root()).arg("test").args(fault.test).arg("--").args(fault.only);
    // One after the other: what runs beside would be measured, too.
    cargo.args(["--nocapture", "--test-threads", "1"]).stdin(Stdio::null());
    if !short {
        cargo.env("BIMANUAL_FULL", "1");
    }
    let done = cargo.output()?;
    let said = String::from_utf8_lossy(&done.stdout);
    let tests = said.lines().filter_map(passed).sum::<usize>();
    let rows = said.lines().filter_map(|line| Some(line.split_once("row: ")?.1));
    let mut rows: Vec<Vec<String>> =
        rows.map(|row| row.split('|').map(|cell| cell.trim().to_owned()).collect()).collect();
    if rows.is_empty() {
        rows.push(vec!["tests".into(), tests.to_string(), "0 failed".into(), "0 failed".into()]);
    }
    // A filter that finds no test proves nothing.
    let ok = done.status.success() && tests > 0;
    if !ok {
        println!("{said}{}", String::from_utf8_lossy(&done.stderr));
    }
    Ok((rows, ok))
}

/// The number of tests that a line of `cargo test` says have passed.
fn passed(line: &str) -> Option<usize> {
    let (_, counts) = line.split_once("test result: ")?;
    counts.split_once(" passed")?.0.rsplit(' ').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_tests_is_read_from_what_cargo_says() {
        let line =
            "test result: ok. 12 passed; 0 failed; 0 ignored; 0 measured; 3 filtered out; finished in 1.2s";
        assert_eq!(passed(line), Some(12));
        assert_eq!(passed("test result: FAILED. 7 passed; 1 failed; 0 ignored"), Some(7));
        assert_eq!(passed("running 3 tests"), None);
    }
}
