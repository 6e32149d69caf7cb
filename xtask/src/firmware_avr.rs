//! `cargo xtask firmware avr`: builds the left hand's image, prints its size, and explains how to flash it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::steps::{output, sh};
use crate::toolchain::{self, Target};
use crate::{root, target_dir};

/// Limits in bytes. They follow from an ATmega328P with a 2 KB bootloader, and from this project.
const FLASH_LIMIT: u64 = 24 * 1024;
const RAM_LIMIT: u64 = 1536;
const RAM: u64 = 2048;

/// Builds and measures the image, and prints the avrdude commands.
///
/// `--baud 57600|115200|250000` selects the serial speed, and `--no-stack` skips the measurement in the emulator.
///
/// # Errors
/// Fails if the image does not build, or if it is larger than permitted.
pub fn run(args: &[&str]) -> Result<()> {
    let mut baud = "115200";
    let mut measure = true;
    let mut args = args.iter();
    while let Some(&arg) = args.next() {
        match arg {
            "--no-stack" => measure = false,
            "--baud" => match args.next() {
                Some(&value @ ("57600" | "115200" | "250000")) => baud = value,
                _ => bail!("--baud takes 57600, 115200 or 250000"),
            },
            _ => bail!("`cargo xtask firmware avr` takes --baud and --no-stack, not `{arg}`"),
        }
    }
    let mut build = toolchain::cargo(Target::Avr, "build")?;
    build.current_dir(root().join("firmware-nano-avr")).env("CARGO_TARGET_DIR", target_dir());
    build.args(["--release", "--locked", "--no-default-features", "--features", &format!("baud-{baud}")]);
    sh(&mut build)?;
    let elf = image();
    let hex = elf.with_extension("hex");
    sh(Command::new("avr-objcopy").args(["-O", "ihex", "-R", ".eeprom"]).arg(&elf).arg(&hex))
        .context("avr-objcopy comes with binutils-avr")?;

    let size = Size::of(&elf)?;
    let stack = if measure { Some(deepest_stack(&elf)?) } else { None };
    println!("left hand, serial at {baud} baud      bytes   allowed");
    println!("flash (code and constants)        {:>7}   {FLASH_LIMIT:>7}", size.flash);
    println!("static RAM                        {:>7}", size.ram);
    let ram = match stack {
        Some(stack) => {
            println!("deepest stack, in the emulator    {stack:>7}");
            println!("static RAM + deepest stack        {:>7}   {RAM_LIMIT:>7}", size.ram + stack);
            size.ram + stack
        }
        None => {
            println!("deepest stack                  (not measured)");
            size.ram
        }
    };
    println!("left of {RAM}                      {:>7}", RAM.saturating_sub(ram));
    let line = |baud| {
        format!("avrdude -p atmega328p -c arduino -P PORT -b {baud} -D -U flash:w:{}:i", hex.display())
    };
    println!("\nflash it (PORT is such as /dev/ttyUSB0):");
    println!("  new bootloader  {}", line(115_200));
    println!("  old bootloader  {}", line(57_600));
    if size.flash > FLASH_LIMIT || ram > RAM_LIMIT {
        bail!("the image is larger than allowed");
    }
    Ok(())
}

/// Runs clippy on the image.
///
/// # Errors
/// Names each problem.
pub fn check() -> Result<()> {
    let mut clippy = toolchain::cargo(Target::Avr, "clippy")?;
    clippy.args(["--release", "--locked", "--", "-D", "warnings"]);
    sh(clippy.current_dir(root().join("firmware-nano-avr")).env("CARGO_TARGET_DIR", target_dir()))
}

/// Returns the path of the built image.
pub fn image() -> PathBuf {
    target_dir().join("avr-none/release/firmware-nano-avr.elf")
}

struct Size {
    flash: u64,
    ram: u64,
}

impl Size {
    fn of(elf: &Path) -> Result<Self> {
        let section = sections("avr-size", elf)?;
        let size = Self {
            flash: section(".text") + section(".data"),
            ram: section(".data") + section(".bss") + section(".noinit"),
        };
        if size.flash == 0 {
            bail!("`avr-size -A {}` shows no .text", elf.display());
        }
        Ok(size)
    }
}

/// Returns a function that gives the size of a section in bytes, or 0 if the program has no such section.
/// `size` is the tool that lists the sections.
pub fn sections(size: &str, elf: &Path) -> Result<impl Fn(&str) -> u64> {
    let text = output(Command::new(size).arg("-A").arg(elf))?;
    Ok(move |name: &str| {
        let line = text.lines().find(|line| line.split_whitespace().next() == Some(name));
        line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok()).unwrap_or(0)
    })
}

/// Runs all functions of the image in the emulator, and returns the deepest use of the stack.
fn deepest_stack(elf: &PathBuf) -> Result<u64> {
    let mut emulator = Command::new("cargo");
    emulator.current_dir(root()).env("BIMANUAL_AVR_ELF", elf);
    emulator.args(["run", "--quiet", "-p", "tests", "--features", "avr", "--bin", "avr_trials", "stack"]);
    let text = output(&mut emulator)?;
    // simavr also prints to standard output, so the result is the last line.
    let last = text.lines().last().unwrap_or("");
    last.trim().parse().with_context(|| format!("`avr_trials stack` printed `{last}`"))
}
