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

/// The image of a variant, built by `cargo xtask firmware nano33`. `BIMANUAL_NANO33_ELF` names another one behind the
/// stock bootloader.
///
/// # Panics
/// Where it does not build; the reason is on the terminal.
pub fn image(variant: Variant) -> Image {
    static BOOTLOADER: OnceLock<PathBuf> = OnceLock::new();
    static BLE: OnceLock<PathBuf> = OnceLock::new();
    if let (Variant::Bootloader, Some(path)) = (variant, std::env::var_os("BIMANUAL_NANO33_ELF")) {
        return Image::load(Path::new(&path));
    }
    let cell = match variant {
        Variant::Bootloader => &BOOTLOADER,
        Variant::Ble => &BLE,
    };
    Image::load(cell.get_or_init(|| build(variant)))
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
