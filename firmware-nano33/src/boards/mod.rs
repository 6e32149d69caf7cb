//! The supported boards, one file each.
//! Each file defines pins, sensors, names and memory (the `.x` files), and handles the board's bootloader.
//! No other code in this crate depends on the board.
//!
//! Each file provides `SENSORS`, `START_MS`, `USB` and `kind` (the board's name in the protocol).
//! Each file also provides `begin`, which runs before all other code, and `enter_bootloader`.
//! The function `parts` of each file returns [`Parts`].

#[cfg(not(feature = "xiao"))]
mod nano33;
#[cfg(feature = "xiao")]
mod xiao;

#[cfg(all(feature = "trouble", not(feature = "xiao")))]
pub use nano33::BASE;
#[cfg(not(feature = "xiao"))]
pub use nano33::{SENSORS, START_MS, USB, begin, enter_bootloader, kind, parts};
#[cfg(all(feature = "trouble", feature = "xiao"))]
pub use xiao::BASE;
#[cfg(all(feature = "xiao", not(feature = "left")))]
pub use xiao::kind;
#[cfg(feature = "xiao")]
pub use xiao::{SENSORS, START_MS, USB, begin, enter_bootloader, parts};

use embassy_nrf::Peri;
use embassy_nrf::gpio::{AnyPin, Level, Output, OutputDrive};
use embassy_nrf::peripherals::{USBD, WDT};

use crate::bus::SensorBus;
use crate::{uart, watch};

/// Names of the board in the USB descriptors.
pub struct UsbNames {
    /// USB vendor and product ids, which operating systems use to select drivers and rules.
    pub ids: (u16, u16),
    /// Names for people.
    pub product: &'static str,
}

/// The chip's peripherals, grouped by function.
pub struct Parts {
    /// The sensor's bus and power pins.
    pub bus: SensorBus,
    /// The serial port.
    pub uart: uart::Parts,
    /// The light.
    pub led: watch::Led,
    /// Pin and peripheral for an optional vibration motor.
    #[cfg(not(feature = "left"))]
    pub vibration: crate::vibrate::Parts,
    /// The flex sensors.
    #[cfg(feature = "left")]
    pub flex: crate::left::hand::Parts,
    /// The battery's divider.
    #[cfg(all(feature = "xiao", not(feature = "left")))]
    pub battery: crate::battery::Parts,
    /// The watchdog.
    pub watchdog: Peri<'static, WDT>,
    /// USB.
    pub usbd: Peri<'static, USBD>,
    /// The flash controller. In images with Bluetooth, the radio's stack owns it instead.
    #[cfg(not(feature = "radio"))]
    pub flash: Peri<'static, embassy_nrf::peripherals::NVMC>,
    /// The random number generator. In images with Bluetooth, the radio's stack owns it instead.
    #[cfg(not(feature = "radio"))]
    pub random: Peri<'static, embassy_nrf::peripherals::RNG>,
    /// Peripherals that the linked-in radio stack owns.
    #[cfg(feature = "trouble")]
    pub radio: nano33_radio::trouble::Parts,
}

/// Peripherals that the linked-in radio stack owns, which are the same on each board.
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

/// An LED that is off; a low pin switches it on.
fn off(pin: Peri<'static, AnyPin>) -> Output<'static> {
    Output::new(pin, Level::High, OutputDrive::Standard)
}
