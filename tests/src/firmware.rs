//! Builds the boards' images with the same command that users run.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Runs `cargo xtask firmware` with these arguments and returns the path of the image in the target folder.
///
/// # Panics
/// Panics if the firmware does not build. The terminal shows the reason.
pub(crate) fn build(words: &[&str], image: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests lies in the root");
    let status = Command::new("cargo")
        .current_dir(root)
        .args(["xtask", "firmware"])
        .args(words)
        .stdout(Stdio::null())
        .status()
        .expect("cargo starts");
    assert!(status.success(), "`cargo xtask firmware {}` failed", words.join(" "));
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    target.join(image)
}
