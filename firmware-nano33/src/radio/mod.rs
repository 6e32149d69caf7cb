//! Bluetooth; the crate `nano33_radio` describes its service and its rules.
//! A feature selects one of two stacks: Nordic's S140 (`ble`) or the linked-in stack (`trouble`).
//! Only `softdevice` uses S140, and only the crate `nano33_radio` uses the linked-in stack.
//! Each stack provides [`Radio`] (`start`, `random`, `flash`, `spawn`), [`RadioFlash`] and [`cable`].

#[cfg(feature = "ble")]
mod softdevice;
#[cfg(feature = "trouble")]
mod trouble;

#[cfg(feature = "ble")]
pub use softdevice::{Radio, RadioFlash, cable};
#[cfg(feature = "trouble")]
pub use trouble::{Radio, RadioFlash, cable, passkey, say_paired, say_passkey};
