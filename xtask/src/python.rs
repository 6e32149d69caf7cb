//! A virtual environment for the independent checks in Python.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::steps::sh;
use crate::{root, target_dir};

/// The folder of the arms' judges.
const ARMS: &str = "arms-venv";

/// What the checks want, each beside its check.
const REQUIREMENTS: [&str; 11] = [
    "models/tests/requirements.txt",
    "shared-dsp/tests/reference/requirements.txt",
    "tests/bumble/requirements.txt",
    "tests/crates/requirements.txt",
    "tests/foxglove/requirements.txt",
    "tests/lerobot/requirements.txt",
    "tests/mcap/requirements.txt",
    "tests/mujoco/requirements.txt",
    "tests/prose/requirements.txt",
    "tests/ros2/requirements.txt",
    "tests/web/requirements.txt",
];

/// Returns the interpreter of an environment with all requirements, and creates it at the first use.
///
/// # Errors
/// Fails if there is no Python 3 with `venv`, or a package cannot be installed. The error names the missing package.
pub fn environment() -> Result<PathBuf> {
    made("venv", &REQUIREMENTS)
}

/// The same for the judges of arms, whose packages hold 170 MB of meshes: an environment of its own.
///
/// # Errors
/// As [`environment`].
pub fn arms() -> Result<PathBuf> {
    made(ARMS, &["tests/arms/requirements.txt"])
}

/// Whether somebody has made that one.
pub fn has_arms() -> bool {
    works(&target_dir().join(ARMS).join("bin/python"))
}

fn made(name: &str, requirements: &[&'static str]) -> Result<PathBuf> {
    let place = target_dir().join(name);
    let python = place.join("bin/python");
    let mut wanted = String::new();
    for file in requirements {
        wanted += &fs::read_to_string(root().join(file)).with_context(|| (*file).to_owned())?;
    }
    let stamp = place.join("requirements.installed");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) && works(&python) {
        return Ok(python);
    }
    // A working environment is kept, and installed packages are not installed again.
    if !works(&python) {
        sh(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&place))
            .context("needs Python 3.11 or later with venv (Debian: apt-get install python3 python3-venv)")?;
    }
    let mut pip = Command::new(&python);
    // Modules are compiled at their first use and not all at once.
    pip.current_dir(root()).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-compile",
    ]);
    for &file in requirements {
        pip.args(["-r", file]);
    }
    sh(&mut pip)?;
    if !works(&python) {
        bail!("{} does not run", python.display());
    }
    fs::write(&stamp, wanted)?;
    Ok(python)
}

fn works(python: &Path) -> bool {
    Command::new(python).arg("--version").output().is_ok_and(|o| o.status.success())
}
