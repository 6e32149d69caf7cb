//! Builds the firmware images that the tests run, once per test run.

use std::path::PathBuf;
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
    crate::firmware::build(&["nano33", name], &format!("thumbv7em-none-eabihf/release/nano33-{name}"))
}
