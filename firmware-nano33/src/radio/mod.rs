//! Bluetooth, whose service and habits are described in the crate `nano33_radio`. Two stacks can carry it, chosen by feature:
//! Nordic's S140 (`ble`), known only to `softdevice`, and the one that is linked in (`trouble`), known only to that crate. Each offers
//! [`Radio`] (`start`, `random`, `flash`, `spawn`), [`RadioFlash`] and [`cable`].

#[cfg(feature = "ble")]
mod softdevice;
#[cfg(feature = "trouble")]
mod trouble;

#[cfg(feature = "ble")]
pub use softdevice::{Radio, RadioFlash, cable};
#[cfg(feature = "trouble")]
pub use trouble::{Radio, RadioFlash, cable};
