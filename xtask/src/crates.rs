//! What every crate that is built here must keep: its licence is allowed, it comes from the registry, it is used, and it
//! compiles with the Rust that this project asks for.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use crate::steps::{output, sh};
use crate::{python, root};

/// The workspaces: the laptop's side, and each board's.
const WORKSPACES: [&str; 3] = ["", "firmware-nano-avr", "firmware-nano33"];

/// Licences, bans and sources (`deny.toml`), and dependencies that nothing uses.
///
/// # Errors
/// Names each crate and each line of a Cargo.toml that is wrong.
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

/// No crate wants a newer Rust than the workspace promises. That the workspace itself compiles with it is seen where the
/// tests run with that very Rust, and clippy's `incompatible_msrv` knows which parts of the library are newer.
fn oldest_rust(folder: &Path) -> Result<()> {
    let mut cargo = Command::new("cargo");
    cargo.current_dir(folder).args(["metadata", "--format-version", "1", "--locked", "--all-features"]);
    let metadata: Value = serde_json::from_str(&output(&mut cargo)?)?;
    let packages = metadata["packages"].as_array().context("no packages")?;
    let promised = packages.iter().filter(|package| package["source"].is_null()).map(wanted).max();
    let promised = promised.context("a workspace has a crate")?;
    if promised == (0, 0) {
        // The boards' images are built by one compiler each, which `toolchain` names.
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

/// The Rust that a package says it needs; none is 0.
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
