//! `cargo xtask package`: what a user unpacks who has no Rust: programs, model, documents, licences, udev rules.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use crate::steps::{output, sh};
use crate::test::cargo;
use crate::tools::{self, BLUETOOTH};
use crate::{root, target_dir};

/// Files of the repository and where they go.
const FILES: [(&str, &str); 15] = [
    ("README.md", "README.md"),
    ("CHANGELOG.md", "CHANGELOG.md"),
    ("LICENSE-MIT", "LICENSE-MIT"),
    ("LICENSE-APACHE", "LICENSE-APACHE"),
    ("xtask/package/INSTALL.txt", "INSTALL.txt"),
    ("xtask/package/99-bimanual.rules", "udev/99-bimanual.rules"),
    ("models/bundled/right-9axis.tflite", "models/right-9axis.tflite"),
    ("models/bundled/right-9axis.card.json", "models/right-9axis.card.json"),
    ("docs/wiring.svg", "docs/wiring.svg"),
    ("host-bridge/README.md", "doc/host-bridge.md"),
    ("host-bridge/src/plan/README.md", "doc/planning.md"),
    ("models/README.md", "doc/models.md"),
    ("shared-proto/WIRE.md", "doc/WIRE.md"),
    ("firmware-nano-avr/README.md", "doc/firmware-nano-avr.md"),
    ("firmware-nano33/README.md", "doc/firmware-nano33.md"),
];
const PROGRAMS: [&str; 2] = ["host-bridge", "models"];

/// Builds the archive under `target/package`, unpacks it once and runs what is in it.
///
/// # Errors
/// Where something does not build, a file is missing, or the unpacked programs do not run.
pub fn run() -> Result<()> {
    ensure!(
        cfg!(all(target_os = "linux", target_arch = "x86_64")),
        "the archive is for Linux on x86-64: make it there; elsewhere `cargo install --path host-bridge`"
    );
    tools::ensure(&[&BLUETOOTH])?;
    // With all its features: Bluetooth and whatever else is optional.
    sh(&mut cargo(&["build", "--release", "--locked", "-p", "host-bridge", "--all-features", "--bins"]))?;
    sh(&mut cargo(&["build", "--release", "--locked", "-p", "models", "--bins"]))?;
    let name = format!("bimanual-{}-x86_64-linux", env!("CARGO_PKG_VERSION"));
    let place = target_dir().join("package");
    let folder = place.join(&name);
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    for (from, to) in FILES {
        copy(&root().join(from), &folder.join(to))?;
    }
    for program in PROGRAMS {
        let to = folder.join("bin").join(program);
        copy(&target_dir().join("release").join(program), &to)?;
        // Line tables are for developers; where binutils is missing they stay.
        let _ = Command::new("strip").arg(&to).status();
    }
    let licences = output(&mut cargo(&[
        "tree",
        "--locked",
        "-p",
        "host-bridge",
        "-p",
        "models",
        "--all-features",
        "--edges",
        "normal",
        "--prefix",
        "none",
        "--no-dedupe",
        "--target",
        "x86_64-unknown-linux-gnu",
        "--format",
        "{p}: {l}",
    ]))?;
    fs::write(folder.join("LICENCES-OF-PARTS.txt"), parts(&licences)?)?;
    let archive = place.join(format!("{name}.tar.gz"));
    // The same content gives the same bytes.
    let mut tar = Command::new("tar");
    tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--mtime=@0", "--mode=u+rw,go=rX"]);
    sh(tar.arg("-C").arg(&place).arg("-czf").arg(&archive).arg(&name))?;
    try_out(&archive, &name, &place.join("unpacked"))?;
    println!("{} ({:.1} MB)", archive.display(), fs::metadata(&archive)?.len() as f64 / 1e6);
    Ok(())
}

fn copy(from: &Path, to: &PathBuf) -> Result<()> {
    fs::create_dir_all(to.parent().context("a folder")?)?;
    fs::copy(from, to).with_context(|| format!("{} is not there", from.display()))?;
    Ok(())
}

/// One line per foreign crate with its licence.
fn parts(tree: &str) -> Result<String> {
    let ours = |line: &str| line.contains("(/");
    let mut lines: Vec<&str> = tree.lines().filter(|line| !line.trim().is_empty() && !ours(line)).collect();
    lines.sort_unstable();
    lines.dedup();
    if let Some(line) = lines.iter().find(|line| line.trim_end().ends_with(':') || line.contains("GPL")) {
        bail!("{line}: a part without a licence, or with one that the archive must not carry");
    }
    Ok(format!(
        "The programs are built from these crates. Their sources, with the texts of their licences, are in the Rust \
         package registry.\n\n{}\n",
        lines.join("\n")
    ))
}

/// As a user: unpack, run.
fn try_out(archive: &Path, name: &str, into: &Path) -> Result<()> {
    if into.exists() {
        fs::remove_dir_all(into)?;
    }
    fs::create_dir_all(into)?;
    sh(Command::new("tar").arg("-C").arg(into).arg("-xzf").arg(archive))?;
    let bin = into.join(name).join("bin");
    for program in PROGRAMS {
        print!("{}", output(Command::new(bin.join(program)).arg("--version"))?);
    }
    let demo = output(Command::new(bin.join("host-bridge")).args(["demo", "--headless", "--speed", "0"]))?;
    ensure!(!demo.contains("FAILED"), "the unpacked demo does not come out as scripted:\n{demo}");
    // There may be no radio here; what counts is that the program looks for one.
    let doctor = Command::new(bin.join("host-bridge"))
        .args(["doctor", "--right", "ble"])
        .env("DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nonexistent")
        .output()?;
    let said =
        String::from_utf8_lossy(&doctor.stdout).into_owned() + &String::from_utf8_lossy(&doctor.stderr);
    ensure!(said.contains("Bluetooth") && !said.contains("--features ble"), "no Bluetooth in it: {said}");
    Ok(fs::remove_dir_all(into)?)
}
