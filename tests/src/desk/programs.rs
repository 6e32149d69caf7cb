//! The programs that a user runs.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::OnceLock;

use super::port::alone;
use super::program::{Desk, Running};

/// Returns the folder of `host-bridge` and `models`, built in the same way as the tests.
/// `BIMANUAL_PROGRAMS` selects a folder with programs that are already built, as `cargo xtask test` does.
///
/// # Panics
/// Panics if the programs do not build. The terminal shows the reason.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        if let Some(folder) = std::env::var_os("BIMANUAL_PROGRAMS") {
            return folder.into();
        }
        let exe = std::env::current_exe().expect("a path");
        let debug = exe.ancestors().nth(2).expect("target/debug/deps/test");
        let mut build = Command::new("cargo");
        build.current_dir(env!("CARGO_MANIFEST_DIR")).args(["build", "-q", "--locked"]);
        build.args(["-p", "host-bridge", "-p", "models", "-p", "host-links", "--bins"]);
        build.args(["--features", "host-links/test-clock"]);
        if cfg!(feature = "ble") {
            build.args(["--features", "host-bridge/ble"]);
        }
        build.arg("--target-dir").arg(debug.parent().expect("target"));
        let child = {
            let _alone = alone();
            build.spawn()
        };
        let status = child.and_then(|mut child| child.wait()).expect("cargo starts");
        assert!(status.success(), "host-bridge and models do not build");
        debug.to_path_buf()
    })
}

/// Starts `host-bridge` with these arguments.
pub fn bridge(desk: &Desk, args: &[&str]) -> Running {
    desk.run(&folder().join("host-bridge"), args)
}

/// Runs `host-bridge` until it ends.
pub fn run(desk: &Desk, args: &[&str]) -> (ExitStatus, String) {
    bridge(desk, args).end()
}
