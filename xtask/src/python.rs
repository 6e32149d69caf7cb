//! A virtual environment in which the independent checks in Python run.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::steps::sh;
use crate::{root, target_dir};

/// The folder of the checks that compare arms with other libraries.
const ARMS: &str = "arms-venv";

/// Requirements files of the checks, each in the folder of its check.
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

/// Returns the interpreter of an environment with all requirements. Creates the environment at the first use.
///
/// # Errors
/// Fails if there is no Python 3 with `venv`, or a package cannot be installed. The error names the missing package.
pub fn environment() -> Result<PathBuf> {
    made("venv", &REQUIREMENTS)
}

/// Returns the interpreter for the checks of arms.
/// The arms have a separate environment, because their packages contain 170 MB of meshes.
///
/// # Errors
/// As [`environment`].
pub fn arms() -> Result<PathBuf> {
    made(ARMS, &["tests/arms/requirements.txt"])
}

/// Whether the environment for the checks of arms exists.
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
    // If the environment works, it is kept, and installed packages are not installed again.
    if !works(&python) {
        sh(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&place))
            .context("needs Python 3.11 or later with venv (Debian: apt-get install python3 python3-venv)")?;
    }
    let mut pip = Command::new(&python);
    // Modules are compiled at their first use and not all in advance.
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
