//! Builds the firmware images for the tests, once per test run.

use std::path::PathBuf;
use std::sync::{Mutex, OnceLock};

use super::image::Image;

/// The variants of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// The image behind the stock bootloader at 0x10000, without Bluetooth.
    Bootloader,
    /// The image behind S140 at 0x27000.
    Ble,
    /// The same as `Ble`, for a XIAO nRF52840 Sense.
    Xiao,
    /// The image with Bluetooth linked in. It is stored after the stock bootloader and the second stage.
    Trouble,
    /// The second stage of the `trouble` image.
    Stage,
    /// A left hand's image for a XIAO nRF52840 Sense, with Bluetooth linked in.
    XiaoLeft,
    /// The second stage of that image.
    XiaoStage,
}

/// Returns the image of a variant, built by `cargo xtask firmware nano33`.
/// The variables `BIMANUAL_NANO33_ELF`, `BIMANUAL_NANO33_BLE_ELF`, `BIMANUAL_NANO33_TROUBLE_ELF`,
/// `BIMANUAL_XIAO_ELF` and `BIMANUAL_XIAO_LEFT_ELF` select other images.
/// `cargo xtask test` uses them to select images that are already built.
///
/// # Panics
/// Panics if the image does not build. The terminal shows the reason.
pub fn image(variant: Variant) -> Image {
    Image::load(&path(variant))
}

fn path(variant: Variant) -> PathBuf {
    static BOOTLOADER: OnceLock<PathBuf> = OnceLock::new();
    static BLE: OnceLock<PathBuf> = OnceLock::new();
    static XIAO: OnceLock<PathBuf> = OnceLock::new();
    static TROUBLE: OnceLock<PathBuf> = OnceLock::new();
    static XIAO_LEFT: OnceLock<PathBuf> = OnceLock::new();
    let (cell, given, name) = match variant {
        Variant::Bootloader => (&BOOTLOADER, "BIMANUAL_NANO33_ELF", "bootloader"),
        Variant::Ble => (&BLE, "BIMANUAL_NANO33_BLE_ELF", "ble"),
        Variant::Xiao => (&XIAO, "BIMANUAL_XIAO_ELF", "xiao"),
        Variant::Trouble => (&TROUBLE, "BIMANUAL_NANO33_TROUBLE_ELF", "trouble"),
        Variant::XiaoLeft => (&XIAO_LEFT, "BIMANUAL_XIAO_LEFT_ELF", "xiao-left"),
        // A second stage is built together with its image.
        Variant::Stage => return path(Variant::Trouble).with_file_name("nano33-trouble-stage"),
        Variant::XiaoStage => return path(Variant::XiaoLeft).with_file_name("nano33-xiao-left-stage"),
    };
    cell.get_or_init(|| std::env::var_os(given).map_or_else(|| build(name), PathBuf::from)).clone()
}

/// Returns the XIAO's image in the format of its bootloader.
///
/// # Panics
/// Panics if the file does not exist.
pub fn uf2() -> Vec<u8> {
    let file = path(Variant::Xiao).with_extension("uf2");
    std::fs::read(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

fn build(name: &str) -> PathBuf {
    // All variants use the same file name during the build, so they are built one after another.
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    crate::firmware::build(&["nano33", name], &format!("thumbv7em-none-eabihf/release/nano33-{name}"))
}
