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

/// Returns whether this is the long run (`cargo xtask test --full`).
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}
