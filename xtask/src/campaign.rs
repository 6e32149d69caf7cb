//! `cargo xtask campaign`: runs all safety tests under faults at full length, and prints one table.
//!
//! A test prints each of its rows as `row: WHAT | COUNT | WORST | LIMIT`.
//! A test program without such lines is one row.
//! `cargo xtask test` includes the short form of every row: the same tests without `BIMANUAL_FULL`.

use std::process::{ExitCode, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};

use crate::steps::rows;
use crate::test::{announce, cargo, cargo_for_all, programs};
use crate::{jazzy, python};

/// One fault of the campaign, with the tests for it.
struct Fault {
    /// Name of the row in docs/SAFETY.md.
    name: &'static str,
    /// The tests to run, as arguments of `cargo test`.
    test: &'static [&'static str],
    /// The tests' environment.
    only: &'static [&'static str],
    needs: Needs,
}

/// Additional requirements of a fault's tests.
#[derive(Clone, Copy, PartialEq)]
enum Needs {
    Nothing,
    /// A release build, because these tests run millions of turns.
    Speed,
    /// An independent robot on Cyclone DDS.
    Cyclone,
    /// ROS 2's own client library on Fast DDS.
    Rclpy,
}

const fn fault(name: &'static str, test: &'static [&'static str], only: &'static [&'static str]) -> Fault {
    Fault { name, test, only, needs: Needs::Nothing }
}

const fn with(needs: Needs, fault: Fault) -> Fault {
    Fault { needs, ..fault }
}

const LIVE: &[&str] = &["--test", "live"];

/// The order is that of the table in docs/SAFETY.md. Tests with the wall clock run one after another.
const FAULTS: &[Fault] = &[
    fault(
        "virtual: delays that are constant, step or drift by ±5 %, and restarts that nobody sees",
        &["--test", "lateness"],
        &[],
    ),
    with(
        Needs::Speed,
        fault("virtual: ten million steps of a hostile link", &["-p", "host-core", "--test", "hostile"], &[]),
    ),
    fault(
        "virtual: bursts, single neutral frames, pauses, suspend, stops and releases",
        &["--test", "safety_rules"],
        &[],
    ),
    fault("virtual: ten thousand random sessions", &["--test", "random_sessions"], &[]),
    fault(
        "virtual: a robot that refuses, an arm that is ended alone, unbonded boards",
        &["--test", "refusals"],
        &[],
    ),
    fault(
        "virtual: palm up, walking, shaking, humming pins: 30 min of 10 wearers",
        &["--test", "left_judgement"],
        &[],
    ),
    fault("virtual: driving in proportion to the tilt", &["--test", "proportional"], &[]),
    fault(
        "virtual: one hand drives: its link cut, silent or frozen; a gesture begins",
        &["--test", "one_handed"],
        &["a_cut_link", "a_gesture_that_begins"],
    ),
    with(Needs::Speed, fault("mutated streams", &["-p", "shared-proto", "--test", "mutations"], &[])),
    fault("mutated files", &["--test", "hostile_files"], &[]),
    fault(
        "virtual: the program dead or frozen, its cable cut, in each motion",
        &["--test", "third_stop"],
        &[],
    ),
    fault(
        "virtual: two servers, late and forged replies, invalid joint states, 40,000 joint names",
        &["--test", "servers"],
        &[],
    ),
    fault("virtual: a gripper that fails, and holds within a sequence", &["--test", "gripper_robot"], &[]),
    fault("virtual: clocks apart, simulated time", &["-p", "host-ros2", "--lib"], &["clocks::"]),
    with(
        Needs::Cyclone,
        fault("kill -9, SIGSTOP for good, each signal, before a robot", LIVE, &["live::ros2::however"]),
    ),
    with(
        Needs::Rclpy,
        fault("kill -9 before a robot with ROS 2's own client library", LIVE, &["live::ros2::however"]),
    ),
    with(
        Needs::Cyclone,
        fault(
            "a bridge that is stopped and continued, or killed, in real and in simulated time",
            LIVE,
            &["live::ros2::a_killed"],
        ),
    ),
    with(
        Needs::Cyclone,
        fault("e-stop, fault flag, a publisher that is gone", LIVE, &["live::ros2::an_e_stop"]),
    ),
    with(
        Needs::Cyclone,
        fault("forged participants, damaged datagrams", LIVE, &["live::ros2::forged_participants"]),
    ),
    with(
        Needs::Cyclone,
        fault(
            "the firmware images of both boards before a robot; one board is silent",
            LIVE,
            &["live::ros2::both_boards"],
        ),
    ),
    fault(
        "each signal, and a closed or stalled terminal",
        LIVE,
        &["live::stops::each_signal", "live::stops::a_signal", "live::stops::a_terminal"],
    ),
    fault("a panic in any thread", &["-p", "host-bridge", "--lib"], &["ending::"]),
    fault(
        "floods, and a thousand connections",
        LIVE,
        &["live::stops::floods", "live::stops::a_hand_that_falls_silent", "live::stops::a_thousand"],
    ),
    fault(
        "the reader of --json stops; output that nobody reads",
        LIVE,
        &["live::stops::a_reader", "live::stops::output"],
    ),
    fault("stopped and continued, 0.3 to 60 s", LIVE, &["live::stops::a_program"]),
    fault(
        "virtual: the laptop asleep, both boards' images awake",
        LIVE,
        &["live::desk::a_laptop_that_slept"],
    ),
    fault("delays on the real program", LIVE, &["live::stops::a_board"]),
    fault("record cut short, or twice at a time", LIVE, &["live::stops::a_recording", "live::stops::two"]),
];

/// Runs every row, prints the table, and returns whether all limits were respected.
///
/// # Errors
/// Fails if an option is unknown, or `cargo` does not start.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let (mut short, mut only) = (false, None);
    let mut words = args.iter();
    while let Some(arg) = words.next() {
        match *arg {
            "--short" => short = true,
            "--only" => only = Some(*words.next().context("--only takes a word of a fault's name")?),
            _ => bail!("`cargo xtask campaign` takes --short and --only WORD, not `{arg}`"),
        }
    }
    let faults = FAULTS.iter().filter(|fault| only.is_none_or(|word| fault.name.contains(word)));
    ensure!(faults.clone().count() > 0, "no fault is named like that");
    announce("PROGRAMS", &programs()?);
    let began = Instant::now();
    let mut table = Vec::new();
    let mut held = true;
    for fault in faults {
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

/// Measures the rows of one fault. Returns whether all its tests passed.
fn measure(fault: &Fault, short: bool) -> Result<(Vec<Vec<String>>, bool)> {
    let mut cargo = match fault.needs {
        // Builds only one crate, so that nothing else is built in release mode.
        Needs::Speed => cargo(&["test", "--locked", "--release"]),
        // The whole workspace is tested with the features of its tests, so that nothing is compiled again.
        _ => cargo_for_all("test"),
    };
    cargo.args(fault.test).arg("--").args(fault.only);
    // The tests run one after another, because concurrent tests would affect the measurements.
    cargo.args(["--nocapture", "--test-threads", "1"]).stdin(Stdio::null());
    if !short {
        cargo.env("BIMANUAL_FULL", "1");
    }
    match fault.needs {
        Needs::Nothing | Needs::Speed => {}
        Needs::Cyclone => {
            cargo.env("BIMANUAL_ROS2_PYTHON", python::environment()?);
        }
        Needs::Rclpy => {
            if let Some(python) = jazzy::environment()? {
                cargo.env("BIMANUAL_ROS2_PYTHON", python).env("BIMANUAL_ROS2_PEER", "rclpy_peer.py");
            }
        }
    }
    let done = cargo.output()?;
    let said = String::from_utf8_lossy(&done.stdout);
    let tests = said.lines().filter_map(passed).sum::<usize>();
    let mut rows = rows(&said, "row: ");
    if rows.is_empty() {
        rows.push(vec!["tests".into(), tests.to_string(), "0 failed".into(), "0 failed".into()]);
    }
    // A filter that matches no tests proves nothing.
    // Skipped tests prove nothing either, nor do measurements on a machine that is too busy.
    let ok = done.status.success() && tests > 0 && !said.contains("SKIPPED") && !said.contains("NOT JUDGED");
    if !ok {
        println!("{said}{}", String::from_utf8_lossy(&done.stderr));
    }
    Ok((rows, ok))
}

/// Returns the number of passed tests in a line of `cargo test`.
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
