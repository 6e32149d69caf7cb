//! Builds the boards' images as a user does.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Lets `cargo xtask firmware` build what `words` say; returns the image's path, from its place below the target folder.
///
/// # Panics
/// If it does not build; the reason is on the terminal.
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
