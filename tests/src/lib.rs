//! End-to-end tests.

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
