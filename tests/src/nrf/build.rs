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

/// The image of a variant, built by `cargo xtask firmware nano33`. `BIMANUAL_NANO33_ELF` and `BIMANUAL_NANO33_BLE_ELF`
/// name other ones, or these where they are built already, as `cargo xtask test` does.
///
/// # Panics
/// Where it does not build; the reason is on the terminal.
pub fn image(variant: Variant) -> Image {
    static BOOTLOADER: OnceLock<PathBuf> = OnceLock::new();
    static BLE: OnceLock<PathBuf> = OnceLock::new();
    let (cell, given) = match variant {
        Variant::Bootloader => (&BOOTLOADER, "BIMANUAL_NANO33_ELF"),
        Variant::Ble => (&BLE, "BIMANUAL_NANO33_BLE_ELF"),
    };
    let path = cell.get_or_init(|| std::env::var_os(given).map_or_else(|| build(variant), PathBuf::from));
    Image::load(path)
}

fn build(variant: Variant) -> PathBuf {
    // Both variants leave their image at the same place first: one after the other.
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    let name = match variant {
        Variant::Bootloader => "bootloader",
        Variant::Ble => "ble",
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests lies in the root");
    let status = Command::new("cargo")
        .current_dir(root)
        .args(["xtask", "firmware", "nano33", name])
        .stdout(Stdio::null())
        .status()
        .expect("cargo starts");
    assert!(status.success(), "`cargo xtask firmware nano33 {name}` failed");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    target.join("thumbv7em-none-eabihf/release").join(format!("nano33-{name}"))
}
