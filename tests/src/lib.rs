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

/// Returns whether to run the tests of updates, which take minutes on an emulated board.
/// They run in the long run, or if `BIMANUAL_NANO33_TROUBLE_ELF` selects an image.
pub fn has_linked_image() -> bool {
    let has = is_full() || std::env::var_os("BIMANUAL_NANO33_TROUBLE_ELF").is_some();
    if !has {
        println!(
            "skipped: `cargo xtask test --full` updates boards, or BIMANUAL_NANO33_TROUBLE_ELF names an image"
        );
    }
    has
}

/// Returns whether this is the long run (`cargo xtask test --full`).
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}
