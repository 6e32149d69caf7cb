//! `cargo xtask firmware nano33`: builds the images for boards with an nRF52840, and prints the size of each part.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use shared_proto::message::Board;

use crate::steps::{output, sh};
use crate::toolchain::{Target, cargo};
use crate::{is_full, root, second_stage, target_dir, tools, uf2};

/// A variant's name, and the arguments with which cargo builds it.
const VARIANTS: [(&str, &[&str], &str); 6] = [
    ("ble", &[], "Nano 33 BLE Sense and Rev2, behind S140 at 0x27000 (needs an SWD probe)"),
    (
        "bootloader",
        &["--no-default-features", "--features", "bootloader"],
        "Nano 33 BLE Sense and Rev2, behind the stock Arduino bootloader at 0x10000, without Bluetooth",
    ),
    (
        "xiao",
        &["--features", "xiao"],
        "XIAO nRF52840 Sense, behind the S140 that it is sold with, by drag and drop",
    ),
    (
        "trouble",
        &["--no-default-features", "--features", "trouble"],
        "Nano 33 BLE Sense and Rev2, behind the stock Arduino bootloader and a second stage at 0x10000, with Bluetooth linked in",
    ),
    (
        "xiao-trouble",
        &["--no-default-features", "--features", "trouble,xiao"],
        "XIAO nRF52840 Sense, with Bluetooth linked in, by drag and drop",
    ),
    (
        "xiao-left",
        &["--no-default-features", "--features", "trouble,xiao,left"],
        "XIAO nRF52840 Sense as a left hand, with Bluetooth linked in, by drag and drop",
    ),
];

/// Address at which a XIAO's file for flashing starts, behind S140.
pub const XIAO_ORIGIN: u32 = 0x27000;

/// Parts of the image, each with words that occur in its symbols' names. The first part that matches counts.
const PARTS: [(&str, &[&str]); 6] = [
    (
        "network",
        &[
            "10shared_dsp5right7network",
            "10shared_dsp5right7softmax",
            "10shared_dsp5right4kind",
            "5model7BUNDLED",
        ],
    ),
    ("features", &["10shared_dsp"]),
    ("driver", &["nano33_sensor", "4twim", "6sample", "3bus"]),
    (
        "bluetooth",
        &[
            "14nrf_softdevice",
            "nrf_softdevice",
            "5radio",
            "12nano33_radio",
            "12trouble_host",
            "7nrf_sdc",
            "8nrf_mpsl",
            "6bt_hci",
            // Names that Nordic's libraries use (hidden or not), and names of the cryptography.
            "sym_",
            "sdc_",
            "mpsl_",
            "MPSL_",
            "P256",
            "p256",
            "3aes",
            "4cmac",
            "rand_chacha",
        ],
    ),
    ("usb", &["11embassy_usb", "3usb", "usbd"]),
    ("rest", &[""]),
];

fn is_xiao(name: &str) -> bool {
    name.starts_with("xiao")
}

/// The images with Bluetooth linked in are those that a second stage starts.
fn has_second_stage(options: &[&str]) -> bool {
    options.iter().any(|option| option.contains("trouble"))
}

/// Returns the board that takes an update of this variant.
fn board(name: &str) -> Board {
    match name {
        "xiao-left" => Board::LeftXiao,
        name if is_xiao(name) => Board::RightXiao,
        _ => Board::RightNano33,
    }
}

/// Builds all variants, or only the named one, and prints their sizes.
/// `--key` gives the file with the public key. Boards use this key to check updates over Bluetooth.
///
/// # Errors
/// Fails if a variant does not build, or if the name is unknown.
pub fn run(args: &[&str]) -> Result<()> {
    let (args, key) = match args {
        [args @ .., "--key", key] => (args, Some(Path::new(key))),
        args => (args, None),
    };
    let chosen = |name: &str| match args {
        [] => true,
        ["--board", "nano33"] => !is_xiao(name),
        ["--board", "xiao"] => is_xiao(name),
        [only] => name == *only,
        _ => false,
    };
    if !VARIANTS.iter().any(|(name, ..)| chosen(name)) {
        let names = VARIANTS.map(|(name, ..)| name).join(", ");
        bail!(
            "`cargo xtask firmware nano33` takes one of {names}, or --board nano33 or xiao, not `{}`",
            args.join(" ")
        );
    }
    for (name, options, what) in VARIANTS.into_iter().filter(|(name, ..)| chosen(name)) {
        let image = build(name, options)?;
        println!("\n{name}: {what}\n  {}", image.display());
        if has_second_stage(options) {
            let stage = second_stage::keep(&image)?;
            let files = second_stage::make_files(&image, &stage, board(name), key)?;
            println!("  to flash: {}\n  for host-bridge update: {}", files[0].display(), files[1].display());
        } else if is_xiao(name) {
            objcopy(&image, "binary", &image.with_extension("bin"))?;
        }
        if is_xiao(name) {
            println!("  {}", make_uf2(&image)?.display());
        }
        report(&image)?;
    }
    println!("\nFlash it: firmware-nano33/README.md");
    Ok(())
}

/// Builds the variants that the tests run.
/// Only `--full` builds `xiao-trouble`, whose code is also in the other variants.
///
/// # Errors
/// As [`run`].
pub fn run_for_tests() -> Result<()> {
    VARIANTS
        .iter()
        .filter(|(name, ..)| is_full() || *name != "xiao-trouble")
        .try_for_each(|(name, ..)| run(&[name]))
}

/// Returns a cargo command for the images.
/// Images with Bluetooth linked in contain a little C code, and bindings that are generated from Nordic's headers.
/// The generic code of these images is optimised for size.
fn cargo_for(options: &[&str], subcommand: &str) -> Result<Command> {
    let mut command = cargo(Target::Thumb, subcommand)?;
    if has_second_stage(options) {
        tools::ensure_where_known(&tools::C_FOR_BOARDS)?;
        command.args(["--config", "profile.release.package.firmware-nano33.opt-level='z'"]);
        // Boards with these images have no probe, so nobody reads debug information, which a third of the build would make.
        command.args(["--config", "profile.release.debug=false"]);
    }
    Ok(command)
}

fn build(name: &str, options: &[&str]) -> Result<PathBuf> {
    let target = target_dir();
    let mut command = cargo_for(options, "build")?;
    command.args(["--release", "--locked"]).args(options);
    if has_second_stage(options) {
        // Both are built by one command, because with other features their common dependencies would be built twice.
        command.args(["-p", "firmware-nano33", "-p", "nano33-stage"]);
        if is_xiao(name) {
            command.args(["--features", "nano33-stage/xiao"]);
        }
    }
    command.current_dir(root().join("firmware-nano33")).env("CARGO_TARGET_DIR", &target);
    sh(&mut command)?;
    let image = image(name);
    let last = image.with_file_name("nano33");
    std::fs::copy(&last, &image).with_context(|| format!("{} is not there", last.display()))?;
    Ok(image)
}

/// Runs the drivers' own tests on the laptop.
///
/// # Errors
/// Names each problem.
pub fn test_drivers() -> Result<()> {
    let host = output(Command::new("rustc").args(["--print", "host-tuple"]))?;
    let mut tests = Command::new("cargo");
    tests.args(["test", "--locked", "--target", host.trim()]);
    // This step has its own folder, because in the common one it would wait until the laptop's side is built.
    let folder = target_dir().join("drivers");
    sh(tests.current_dir(root().join("firmware-nano33/sensor")).env("CARGO_TARGET_DIR", folder))
}

/// Runs clippy on all variants.
///
/// # Errors
/// Names each problem.
pub fn check() -> Result<()> {
    let folder = root().join("firmware-nano33");
    for (_, options, _) in VARIANTS {
        let mut clippy = cargo_for(options, "clippy")?;
        clippy.args(["--release", "--locked", "--workspace"]).args(options).args(["--", "-D", "warnings"]);
        sh(clippy.current_dir(&folder).env("CARGO_TARGET_DIR", target_dir()))?;
    }
    Ok(())
}

/// Returns the path of a variant's built image.
pub fn image(name: &str) -> PathBuf {
    target_dir().join(Target::Thumb.triple()).join("release").join(format!("nano33-{name}"))
}

/// Converts an image to another format.
///
/// # Errors
/// Fails if the image does not exist.
pub fn objcopy(image: &Path, format: &str, file: &Path) -> Result<()> {
    sh(Command::new(tool("objcopy")).args(["-O", format]).arg(image).arg(file))
}

/// Converts the image's `.bin` file to the format of the XIAO's bootloader.
/// Writes the result to the same folder.
fn make_uf2(image: &Path) -> Result<PathBuf> {
    let file = image.with_extension("uf2");
    let raw = std::fs::read(image.with_extension("bin"))?;
    std::fs::write(&file, uf2::encode(&raw, XIAO_ORIGIN, uf2::NRF52840))?;
    Ok(file)
}

fn report(image: &Path) -> Result<()> {
    // The names remain mangled. Each contains its path as `length name`.
    let nm = tool("nm");
    let text = output(Command::new(nm).args(["--print-size", "--radix=d"]).arg(image))?;
    let mut sizes: BTreeMap<&str, (u64, u64)> = BTreeMap::new();
    for line in text.lines() {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let [address, size, kind, symbol] = fields[..] else { continue };
        let (Ok(address), Ok(size)) = (address.parse::<u64>(), size.parse::<u64>()) else { continue };
        // The strings of defmt are never loaded to the board.
        if address < 0x1_0000 || kind.eq_ignore_ascii_case("a") {
            continue;
        }
        let part =
            PARTS.iter().find(|(_, words)| words.iter().any(|w| symbol.contains(w))).map_or("rest", |p| p.0);
        let entry = sizes.entry(part).or_default();
        if address >= 0x2000_0000 {
            entry.1 += size;
        }
        if address < 0x2000_0000 || kind.eq_ignore_ascii_case("d") {
            entry.0 += size;
        }
    }
    println!("  {:<10} {:>9} {:>9}", "part", "flash B", "RAM B");
    let mut total = (0, 0);
    for (part, _) in PARTS {
        let (flash, ram) = sizes.get(part).copied().unwrap_or_default();
        println!("  {part:<10} {flash:>9} {ram:>9}");
        total = (total.0 + flash, total.1 + ram);
    }
    println!("  {:<10} {:>9} {:>9}   (named symbols)", "sum", total.0, total.1);
    for line in output(Command::new(tool("size")).arg("-A").arg(image))?.lines() {
        let mut fields = line.split_whitespace();
        if let (
            Some(section @ (".vector_table" | ".text" | ".rodata" | ".data" | ".bss" | ".uninit")),
            Some(bytes),
        ) = (fields.next(), fields.next())
        {
            println!("  {section:<14} {bytes:>9} B");
        }
    }
    Ok(())
}

/// Returns `llvm-nm` and `llvm-size`, or the versions in binutils if they support ELF files of any machine.
pub fn tool(name: &str) -> String {
    let llvm = format!("llvm-{name}");
    if Command::new(&llvm).arg("--version").output().is_ok_and(|o| o.status.success()) {
        llvm
    } else {
        name.into()
    }
}
