//! End-to-end tests.

#[cfg(feature = "avr")]
pub mod avr;

#[cfg(feature = "nrf")]
pub mod nrf;

#[cfg(all(feature = "avr", feature = "nrf"))]
pub mod two_hands;
