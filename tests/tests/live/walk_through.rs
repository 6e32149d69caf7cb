//! Runs the walk-through of README.md as a new user would.
//! The test reads the commands from README.md and runs them unchanged, with both emulated boards and a simulated wearer.
//! The commands lead from `list` to the user's own gesture that moves the arm.
//!
//! There are three differences from a real desk.
//! The ports are pseudo-terminals. `BIMANUAL_PORTS` passes their names to `list`.
//! The test inserts the names where the user would insert them.
//! The programs are those that were built for the tests.
//! The time limit applies to the sum of the boards' time and the actual duration of the training.
#![cfg(all(feature = "avr", feature = "nrf", unix))]

use std::process::Command;
use std::time::{Duration, Instant};

use models::synth::{Motion, Wearer};
use tests::desk::left::Left;
use tests::desk::program::{Desk, Running};
use tests::desk::programs::folder;
use tests::desk::right::Right;

/// Maximum total of the boards' time and the training time.
const LIMIT_S: f64 = 600.0;
const SOON: Duration = Duration::from_secs(15);

/// Returns the lines of the section's last command block, including comments.
fn lines() -> Vec<String> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md");
    let text = std::fs::read_to_string(file).expect("README.md");
    let (_, section) = text.split_once("## Your own gestures in ten minutes").expect("the section");
    let section = section.split("\n## ").next().unwrap_or_default();
    let block = section.split("```sh\n").nth(2).expect("a second block of commands");
    let block = block.split("```").next().unwrap_or_default();
    block.lines().filter(|line| !line.trim().is_empty()).map(str::to_owned).collect()
}

struct Shell {
    desk: Desk,
    ports: [String; 2],
}

impl Shell {
    /// Runs a command line exactly as printed.
    fn start(&self, line: &str) -> Running {
        println!("$ {line}");
        let mut command = Command::new("sh");
        let path = format!("{}:{}", folder().display(), std::env::var("PATH").unwrap_or_default());
        // `exec` replaces the shell, so that a signal reaches the program itself.
        command.arg("-c").arg(format!("exec {line}")).current_dir(self.desk.path("")).env("PATH", path);
        command.env("LEFT", &self.ports[0]).env("RIGHT", &self.ports[1]);
        command.env("BIMANUAL_PORTS", self.ports.join(":"));
        if line.starts_with("host-bridge") {
            self.desk.start(command)
        } else {
            // This program does not use boards.
            self.desk.start_on_its_own(command)
        }
    }
}

#[test]
fn the_lines_of_the_readme_lead_from_list_to_a_gesture_of_ones_own_in_ten_minutes() {
    let lines = lines();
    let verbs: Vec<&str> = lines.iter().filter_map(|line| line.split_whitespace().nth(1)).collect();
    for verb in ["list", "doctor", "calibrate", "record", "train", "send-model", "run"] {
        assert!(verbs.contains(&verb), "{verb} is not in the walk-through: {lines:#?}");
    }
    let desk = Desk::new("walk-through");
    let left = Left::start(&desk, "usb0");
    // A wearer whose data were not used for training any model.
    let right = Right::start(&desk, "acm0", Wearer::evaluation(77, 1));
    let shell = Shell { ports: [left.port(), right.port()], desk };
    let (begun, board_began_ms) = (Instant::now(), right.board_ms());
    let mut training_s = 0.0;
    let mut new_id = String::new();
    let mut moved = false;
    for line in &lines {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["#", ..] => {
                assert!(line.contains("press reset on the right board"), "nobody knows how to: {line}");
                right.restart();
                shell.desk.pass(Duration::from_millis(1500));
            }
            ["export", left_is, right_is] => {
                assert!(left_is.starts_with("LEFT=") && right_is.starts_with("RIGHT="), "{line}");
            }
            ["host-bridge", "list", ..] => {
                let (status, text) = shell.start(line).end();
                assert!(status.success(), "{text}");
                let said = |port: &str, hand: &str| {
                    text.lines().any(|line| line.starts_with(port) && line.contains(hand))
                };
                assert!(
                    said(&shell.ports[0], "the left hand") && said(&shell.ports[1], "the right hand"),
                    "{text}"
                );
            }
            ["host-bridge", "doctor", ..] => {
                let (_, text) = shell.start(line).end();
                if new_id.is_empty() {
                    assert!(text.contains("not calibrated"), "{text}");
                } else {
                    assert!(text.contains(&format!("model {new_id}")) && text.contains("wave"), "{text}");
                }
            }
            ["host-bridge", "calibrate", ..] => {
                let mut calibrate = shell.start(line);
                left.take_three_poses(&mut calibrate);
                let (status, text) = calibrate.end();
                assert!(status.success(), "{text}");
                left.with(|board| board.bend(0.0));
            }
            ["host-bridge", "record", ..] => {
                let mut record = shell.start(line);
                for label in ["idle", "up-down", "wave"] {
                    record.wait(&["go:", label]);
                    match label {
                        "idle" => right.with(|board| board.be_idle(23.0)),
                        "up-down" => right.with(|board| board.perform(Motion::UpDown, 23.0)),
                        _ => right.with(|board| board.perform(Motion::LeftRight, 23.0)),
                    }
                    record.wait(&["saved", label]);
                }
                let (status, text) = record.end();
                assert!(status.success(), "{text}");
            }
            ["models", "train", ..] => {
                let training = Instant::now();
                let (status, text) = shell.start(line).end();
                assert!(status.success(), "{text}");
                training_s = training.elapsed().as_secs_f64();
                let id = text.lines().find_map(|line| line.strip_prefix("model id "));
                new_id = id.expect("the model's id").to_owned();
            }
            ["host-bridge", "send-model", ..] => {
                let (status, text) = shell.start(line).end();
                assert!(status.success() && text.contains(&format!("→ {new_id}")), "{text}");
            }
            ["host-bridge", "run", ..] => {
                let mut run = shell.start(line);
                // The left board restarts when its port is opened, so the right hand may be armed first.
                run.wait(&["left hand: the left hand"]);
                run.wait(&["armed"]);
                for _ in 0..6 {
                    right.with(|board| board.perform(Motion::LeftRight, 4.0));
                    if run.wait_for(SOON, &["right hand: wave", "the arm starts"]).is_some() {
                        moved = true;
                        break;
                    }
                }
                run.interrupt();
            }
            _ => panic!("nobody knows what this does: {line}"),
        }
    }
    assert!(moved, "the gesture of one's own does not move the arm");
    let board_s = (right.board_ms() - board_began_ms) as f64 / 1000.0;
    let all_s = board_s + training_s;
    println!(
        "walk-through: {board_s:.0} s of board time and {training_s:.1} s of training, {:.0} s on this machine",
        begun.elapsed().as_secs_f64()
    );
    assert!(all_s <= LIMIT_S, "{all_s:.0} s are more than ten minutes");
}
