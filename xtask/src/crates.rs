//! Checks all crates: their licences, whether they come from the registry, and whether the project uses them.
//! Also checks that they support this project's Rust version.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use crate::steps::{output, sh};
use crate::{python, root};

/// The workspace of the laptop programs, and the workspace of each board.
const WORKSPACES: [&str; 3] = ["", "firmware-nano-avr", "firmware-nano33"];

/// Checks licences, bans and sources (`deny.toml`), and unused dependencies.
///
/// # Errors
/// Names each crate that is not allowed, and each invalid line of a Cargo.toml.
pub fn check() -> Result<()> {
    let python = python::environment()?;
    let tools = python.parent().context("the environment's folder")?;
    for workspace in WORKSPACES {
        let folder = root().join(workspace);
        let mut deny = Command::new(tools.join("cargo-deny"));
        deny.current_dir(&folder)
            .arg("--config")
            .arg(root().join("deny.toml"))
            .args(["--workspace", "--locked"]);
        sh(deny.args(["check", "--hide-inclusion-graph", "licenses", "bans", "sources"]))?;
        sh(Command::new(tools.join("cargo-shear")).current_dir(&folder).arg("--locked"))?;
        oldest_rust(&folder)?;
    }
    Ok(())
}

/// Checks that no crate needs a newer Rust version than the workspace promises.
/// The tests run with exactly this version, which shows that the workspace itself compiles with it.
/// Clippy's `incompatible_msrv` checks for newer parts of the standard library.
fn oldest_rust(folder: &Path) -> Result<()> {
    let mut cargo = Command::new("cargo");
    cargo.current_dir(folder).args(["metadata", "--format-version", "1", "--locked", "--all-features"]);
    let metadata: Value = serde_json::from_str(&output(&mut cargo)?)?;
    let packages = metadata["packages"].as_array().context("no packages")?;
    let promised = packages.iter().filter(|package| package["source"].is_null()).map(wanted).max();
    let promised = promised.context("a workspace has a crate")?;
    if promised == (0, 0) {
        // One compiler builds all images of a board, and `toolchain` selects it.
        return Ok(());
    }
    for package in packages {
        ensure!(
            wanted(package) <= promised,
            "{} {} wants Rust {}, and {} promises {}: raise rust-version, or take an older version of the crate",
            package["name"],
            package["version"],
            package["rust_version"],
            folder.join("Cargo.toml").display(),
            shown(promised)
        );
    }
    println!("{} crates compile with Rust {} or older, as they say", packages.len(), shown(promised));
    let rustc = output(Command::new("rustc").arg("--version"))?;
    let here = rustc.split_whitespace().nth(1).map(version).unwrap_or_default();
    println!(
        "tested with {}: {}",
        rustc.trim(),
        if here == promised { "the oldest" } else { "not the oldest" }
    );
    Ok(())
}

/// Returns the Rust version that a package requires, or 0 if it requires none.
fn wanted(package: &Value) -> (u32, u32) {
    package["rust_version"].as_str().map(version).unwrap_or_default()
}

/// Of `1.95`, `1.95.0` and the like.
fn version(text: &str) -> (u32, u32) {
    let mut parts = text.split('.').map(|part| part.parse().unwrap_or(0));
    (parts.next().unwrap_or(0), parts.next().unwrap_or(0))
}

fn shown((major, minor): (u32, u32)) -> String {
    format!("{major}.{minor}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_rust_are_compared_as_numbers() {
        assert!(version("1.100") > version("1.95.0"));
        assert_eq!(version("1.95"), version("1.95.0"));
        assert_eq!(wanted(&serde_json::json!({ "rust_version": null })), (0, 0));
    }
}
