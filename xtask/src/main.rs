//! The project's commands. Both users and CI run `cargo xtask test`.

mod campaign;
mod crates;
mod firmware_avr;
mod firmware_nano33;
mod jazzy;
mod package;
mod paper;
mod prose;
mod python;
mod real_data;
mod second_stage;
mod sizes;
mod steps;
mod test;
mod toolchain;
mod tools;
mod uf2;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;

const HELP: &str = "\
usage: cargo xtask VERB

  test [--quick | --full] [--only WORD]
                                every test, in under 30 minutes on 2 cores; --quick only format, clippy and unit
                                tests of the laptop's side, for daily work (under 5 minutes); --full the long
                                forms (under 90); --only the steps whose name contains WORD, --list names them
  campaign [--short] [--only WORD]
                                what must hold when something else fails, in one table (under 80 minutes); --only
                                the faults whose name contains WORD
  firmware avr [--baud N] [--no-stack]
                                the left hand's image: size, stack, how to flash it
  firmware nano33 [ble|bootloader|xiao|trouble|xiao-trouble|xiao-left] [--key FILE.pub]
                                the right hand's images, and the left hand's for a XIAO: flash and RAM per part
  paper [--quick] [--out FILE] [--html FILE]
                                the paper's tables beside what is measured here, in under 30 minutes; --html one page
                                with plots
  sizes                         the flash of micromath's functions on both boards, beside ours
  package                       an archive for Linux on x86-64 under target/package
  ros2                          ROS 2 Jazzy's rclpy below target, for tests/ros2/rclpy_peer.py: prints its Python
  help                          this text
";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match run(&args) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &[String]) -> Result<ExitCode> {
    let words: Vec<&str> = args.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["test", rest @ ..] => test::run(rest),
        ["campaign", rest @ ..] => campaign::run(rest),
        ["firmware", "avr", rest @ ..] => {
            firmware_avr::run(rest)?;
            Ok(ExitCode::SUCCESS)
        }
        ["firmware", "nano33", rest @ ..] => {
            firmware_nano33::run(rest)?;
            Ok(ExitCode::SUCCESS)
        }
        ["paper", rest @ ..] => paper::run(rest),
        ["sizes"] => {
            sizes::run()?;
            Ok(ExitCode::SUCCESS)
        }
        ["package"] => {
            package::run()?;
            Ok(ExitCode::SUCCESS)
        }
        ["ros2"] => {
            if let Some(python) = jazzy::environment()? {
                println!("{}", python.display());
            }
            Ok(ExitCode::SUCCESS)
        }
        [] | ["help" | "--help" | "-h"] => {
            print!("{HELP}");
            Ok(ExitCode::SUCCESS)
        }
        [verb, ..] => {
            eprint!("error: no verb `{verb}`\n{HELP}");
            Ok(ExitCode::FAILURE)
        }
    }
}

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the root").to_path_buf()
}

/// Returns whether this is the long run (`cargo xtask test --full`).
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// Returns cargo's folder for build results.
pub fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}
