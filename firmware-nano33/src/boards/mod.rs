//! The boards that this firmware is built for, one file each: pins, sensors, names, memory (the `.x` files), and what their
//! bootloader leaves behind and wants. Nothing else here knows which board it is.
//!
//! A file offers `SENSORS`, `START_MS`, `USB`, `kind` (its name on the wire), [`Parts`] from `parts`, `begin` (before
//! anything else runs) and `enter_bootloader`.

#[cfg(not(feature = "xiao"))]
mod nano33;
#[cfg(feature = "xiao")]
mod xiao;

#[cfg(not(feature = "xiao"))]
pub use nano33::{SENSORS, START_MS, USB, begin, enter_bootloader, kind, parts};
#[cfg(feature = "xiao")]
pub use xiao::{SENSORS, START_MS, USB, begin, enter_bootloader, kind, parts};

use embassy_nrf::Peri;
use embassy_nrf::gpio::{AnyPin, Level, Output, OutputDrive};
use embassy_nrf::peripherals::{USBD, WDT};

use crate::bus::SensorBus;
use crate::{uart, vibrate, watch};

/// How the board names itself at the USB cable.
pub struct UsbNames {
    /// Vendor and product, by which operating systems choose their drivers and rules.
    pub ids: (u16, u16),
    /// What people read.
    pub product: &'static str,
}

/// The chip's peripherals in their roles.
pub struct Parts {
    /// The sensor and its bus.
    pub bus: SensorBus,
    /// The serial port.
    pub uart: uart::Parts,
    /// The light.
    pub led: watch::Led,
    /// A vibration motor, if one is wired.
    pub vibration: vibrate::Parts,
    /// The battery's divider.
    #[cfg(feature = "xiao")]
    pub battery: crate::battery::Parts,
    /// The watchdog.
    pub watchdog: Peri<'static, WDT>,
    /// USB.
    pub usbd: Peri<'static, USBD>,
    /// The flash controller; the radio's otherwise.
    #[cfg(not(feature = "radio"))]
    pub flash: Peri<'static, embassy_nrf::peripherals::NVMC>,
    /// Random numbers; the radio's otherwise.
    #[cfg(not(feature = "radio"))]
    pub random: Peri<'static, embassy_nrf::peripherals::RNG>,
    /// What the linked-in radio takes.
    #[cfg(feature = "trouble")]
    pub radio: nano33_radio::trouble::Parts,
}

/// What the linked-in radio takes of the chip: the same on each board.
#[cfg(feature = "trouble")]
macro_rules! radio_parts {
    ($p:ident) => {
        nano33_radio::trouble::Parts {
            timing: nano33_radio::trouble::Timing::new(
                $p.RTC0,
                $p.TIMER0,
                $p.TEMP,
                $p.PPI_CH19,
                $p.PPI_CH30,
                $p.PPI_CH31,
            ),
            controller: nano33_radio::trouble::Wiring::new(
                $p.PPI_CH17,
                $p.PPI_CH18,
                $p.PPI_CH20,
                $p.PPI_CH21,
                $p.PPI_CH22,
                $p.PPI_CH23,
                $p.PPI_CH24,
                $p.PPI_CH25,
                $p.PPI_CH26,
                $p.PPI_CH27,
                $p.PPI_CH28,
                $p.PPI_CH29,
            ),
            flash: $p.NVMC,
            random: $p.RNG,
        }
    };
}
#[cfg(feature = "trouble")]
use radio_parts;

/// A light that is off; low is on.
fn off(pin: Peri<'static, AnyPin>) -> Output<'static> {
    Output::new(pin, Level::High, OutputDrive::Standard)
}
