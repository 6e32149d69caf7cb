//! Builds the firmware images that the tests run, once per test run.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, OnceLock};

use super::image::Image;

/// The variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// Behind the stock bootloader at 0x10000, without Bluetooth.
    Bootloader,
    /// Behind S140 at 0x27000.
    Ble,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests lies in the root").to_path_buf()
}

/// The image of a variant, built by the same toolchain choice as `cargo xtask firmware`.
///
/// # Panics
/// Where it does not build; the compiler's words are shown.
pub fn image(variant: Variant) -> Image {
    static BOOTLOADER: OnceLock<PathBuf> = OnceLock::new();
    static BLE: OnceLock<PathBuf> = OnceLock::new();
    let cell = match variant {
        Variant::Bootloader => &BOOTLOADER,
        Variant::Ble => &BLE,
    };
    Image::load(cell.get_or_init(|| build(variant)))
}

fn build(variant: Variant) -> PathBuf {
    // Both variants leave their image at the same place: one after the other.
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    let folder = root().join("firmware-nano33");
    // The host's target folder, so that a clean removes it too and both variants share what they can.
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    let name = match variant {
        Variant::Bootloader => "bootloader",
        Variant::Ble => "ble",
    };
    let triple = "thumbv7em-none-eabihf";
    let rustup = Command::new("rustup")
        .args(["target", "list", "--installed"])
        .output()
        .is_ok_and(|o| String::from_utf8_lossy(&o.stdout).contains(triple));
    let mut command = if rustup {
        let mut command = Command::new("cargo");
        command.arg("build");
        command
    } else {
        let mut command = Command::new("/usr/bin/cargo");
        command
            .env("RUSTC", "/usr/bin/rustc")
            .env("RUSTC_BOOTSTRAP", "1")
            .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld")
            .env_remove("RUSTUP_TOOLCHAIN")
            .args(["build", "-Zbuild-std=core"]);
        command
    };
    for name in ["CARGO", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS", "RUSTDOC", "LD_LIBRARY_PATH"] {
        command.env_remove(name);
    }
    command.args(["--release", "--locked", "--target", triple]);
    if variant == Variant::Bootloader {
        command.args(["--no-default-features", "--features", "bootloader"]);
    }
    let status = command
        .current_dir(&folder)
        .env("CARGO_TARGET_DIR", &target)
        .stdin(Stdio::null())
        .status()
        .unwrap_or_else(|e| panic!("no compiler for the board ({e}); see firmware-nano33/README.md"));
    assert!(status.success(), "the {name} image does not build; see firmware-nano33/README.md");
    let image = target.join(triple).join("release").join("nano33");
    let kept = image.with_file_name(format!("nano33-{name}"));
    std::fs::copy(&image, &kept).unwrap_or_else(|e| panic!("{}: {e}", image.display()));
    kept
}
