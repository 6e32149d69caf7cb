//! End-to-end tests with emulated boards.

#[cfg(any(feature = "avr", feature = "nrf"))]
mod firmware;

#[cfg(feature = "avr")]
pub mod avr;

#[cfg(feature = "nrf")]
pub mod nrf;

#[cfg(all(feature = "avr", feature = "nrf"))]
pub mod two_hands;

#[cfg(all(unix, any(feature = "avr", feature = "nrf")))]
pub mod desk;

#[cfg(all(unix, feature = "ble"))]
pub mod bluez;

/// Returns whether to run the tests of the images that have Bluetooth linked in.
/// The build of these images takes minutes, so the tests run only in the long run,
/// and if `BIMANUAL_NANO33_TROUBLE_ELF` selects an image, as `cargo xtask test` does.
pub fn has_linked_image() -> bool {
    let has = is_full() || std::env::var_os("BIMANUAL_NANO33_TROUBLE_ELF").is_some();
    if !has {
        println!(
            "SKIPPED: tests of images with Bluetooth linked in run with `cargo xtask test`, \
             or if BIMANUAL_NANO33_TROUBLE_ELF and BIMANUAL_XIAO_LEFT_ELF name them"
        );
    }
    has
}

/// Returns whether to run those of these tests that take long and whose subject shorter ones cover in part.
pub fn has_linked_image_and_time() -> bool {
    let runs = is_full() && has_linked_image();
    if !runs {
        println!("SKIPPED: runs with `cargo xtask test --full`");
    }
    runs
}

/// Returns whether this is the long run (`cargo xtask test --full`).
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}
