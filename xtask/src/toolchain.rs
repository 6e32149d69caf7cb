//! Selects the compiler for other targets.
//! Uses rustup's compiler if that supports the target, and otherwise the compiler in Debian's packages.
//!
//! Either compiler builds the images of both boards from the same sources.
//! Debian's `rustc-web` contains the source of the library but no compiled core, so `core` is built too.
//! Building `core` needs `-Zbuild-std`, which a stable compiler permits only with `RUSTC_BOOTSTRAP=1`.
//! For AVR, no compiler contains a compiled core.

use std::path::Path;
use std::process::Command;

use anyhow::{Result, bail};

use crate::tools;

/// The two boards, and the other platforms for the laptop programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// ATmega328P.
    Avr,
    /// nRF52840.
    Thumb,
    /// A laptop with Windows.
    Windows,
    /// A laptop with macOS.
    Mac,
}

impl Target {
    /// Returns the name that the compiler uses for the target.
    pub fn triple(self) -> &'static str {
        match self {
            Target::Avr => "avr-none",
            Target::Thumb => "thumbv7em-none-eabihf",
            Target::Windows => "x86_64-pc-windows-msvc",
            Target::Mac => "aarch64-apple-darwin",
        }
    }

    /// Returns the parts of the library to build, if no compiled parts exist for the target.
    fn library(self) -> &'static str {
        match self {
            Target::Avr | Target::Thumb => "-Zbuild-std=core",
            Target::Windows | Target::Mac => "-Zbuild-std=std,panic_unwind,proc_macro",
        }
    }
}

/// Returns a `cargo` for the target, ready for a subcommand such as `build --release`.
///
/// # Errors
/// Fails if neither rustup nor Debian's compiler supports the target. The error says which package to install.
pub fn cargo(target: Target, subcommand: &str) -> Result<Command> {
    let mut command = if has_rustup(target) {
        let mut command = Command::new("cargo");
        if target == Target::Avr {
            command.args(["+nightly", subcommand, target.library()]);
        } else {
            command.arg(subcommand);
        }
        command
    } else if has_debian() {
        let mut command = Command::new("/usr/bin/cargo");
        command.env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
        // Rustup's clippy and rustdoc would not match Debian's compiler.
        command.env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTDOC");
        if target == Target::Thumb {
            // Debian's compiler has no linker for this target.
            command.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld");
        }
        // Debian's clippy is in the same folder as its compiler.
        let path = std::env::var_os("PATH").unwrap_or_default();
        let folders = std::iter::once("/usr/bin".into()).chain(std::env::split_paths(&path));
        command.env("PATH", std::env::join_paths(folders)?);
        command.args([subcommand, target.library()]);
        command
    } else {
        bail!(
            "no compiler for {}.\n  With rustup: {}\n  On Debian:   {}",
            target.triple(),
            match target {
                Target::Avr =>
                    "rustup toolchain install nightly --component rust-src (and avr-gcc from your packages)"
                        .into(),
                other => format!("rustup target add {}", other.triple()),
            },
            tools::CROSS_RUST.install_line(),
        )
    };
    // The cargo that runs this program sets these variables, and the inner cargo must use its own.
    for name in ["CARGO", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS", "LD_LIBRARY_PATH"] {
        command.env_remove(name);
    }
    command.args(["--target", target.triple()]);
    Ok(command)
}

/// Returns whether this machine has a compiler for both boards.
pub fn is_complete() -> bool {
    has_debian() || (has_rustup(Target::Avr) && has_rustup(Target::Thumb))
}

fn has_rustup(target: Target) -> bool {
    let lists = |args: &[&str], what: &str| {
        Command::new("rustup")
            .args(args)
            .output()
            .is_ok_and(|o| o.status.success() && String::from_utf8_lossy(&o.stdout).contains(what))
    };
    match target {
        Target::Thumb | Target::Windows | Target::Mac => {
            lists(&["target", "list", "--installed"], target.triple())
        }
        Target::Avr => lists(&["component", "list", "--toolchain", "nightly", "--installed"], "rust-src"),
    }
}

fn has_debian() -> bool {
    let Ok(output) =
        Command::new("/usr/bin/rustc").env_remove("RUSTUP_TOOLCHAIN").args(["--print", "sysroot"]).output()
    else {
        return false;
    };
    let sysroot = String::from_utf8_lossy(&output.stdout);
    Path::new("/usr/bin/cargo").exists()
        && Path::new(sysroot.trim()).join("lib/rustlib/src/rust/library/core").exists()
}
