//! `cargo xtask sizes`: measures the flash of micromath's functions on the boards.
//! The command also measures the flash of our own functions.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};

use crate::firmware_avr::sections;
use crate::firmware_nano33::tool;
use crate::steps::sh;
use crate::toolchain::{self, Target};
use crate::{root, target_dir};

/// Builds one program for each function, and one program that computes nothing.
/// Prints the differences of their sizes.
///
/// # Errors
/// Fails if a program does not build.
pub fn run() -> Result<()> {
    println!("flash in bytes           ours  micromath");
    let boards =
        [("ATmega328P", Target::Avr, "avr-size".to_owned()), ("Cortex-M4F", Target::Thumb, tool("size"))];
    for (processor, target, size) in &boards {
        let nothing = flash(*target, size, "")?;
        for function in ["tilt", "logarithm"] {
            let taken = |whose: &str| -> Result<u64> {
                let all = flash(*target, size, &format!("{whose}-{function}"))?;
                all.checked_sub(nothing).context("the program that computes nothing is larger")
            };
            println!("{processor}, {function:<10} {:>7} {:>10}", taken("our")?, taken("micromath")?);
        }
    }
    Ok(())
}

fn flash(target: Target, size: &str, feature: &str) -> Result<u64> {
    let mut build = toolchain::cargo(target, "build")?;
    build.current_dir(root().join("tests/sizes")).env("CARGO_TARGET_DIR", target_dir());
    sh(build.args(["--release", "--locked", "--features", feature]))?;
    let name = if target == Target::Avr { "sizes.elf" } else { "sizes" };
    code(size, &target_dir().join(target.triple()).join("release").join(name))
}

/// Returns the size of code and constants.
fn code(size: &str, elf: &Path) -> Result<u64> {
    let flash: u64 = [".text", ".rodata", ".data"].map(sections(size, elf)?).iter().sum();
    ensure!(flash > 0, "`{size} -A {}` shows no code", elf.display());
    Ok(flash)
}
