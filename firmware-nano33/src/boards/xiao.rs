//! Seeed XIAO nRF52840 Sense (LSM6DS3TR-C), which is sold with S140 7.3.0 and a UF2 bootloader.
//!
//! Some pins are not used:
//! P0.13 and P0.17 (charging), P0.25 (flash), and P0.16, P1.00 and P1.10 (microphone).
//! **This file has not been tested on a real board.** The pins are from the sources of Zephyr and Seeed.

use embassy_nrf::{Peripherals, saadc};
use nano33_sensor::found::Kind;
#[cfg(not(feature = "left"))]
use shared_proto::message::{Board, Sensor};

use super::{Parts, UsbNames, off};
use crate::bus::{SensorBus, SensorPins};
use crate::{uart, watch};

/// Its sensor.
pub const SENSORS: &[Kind] = &[Kind::Lsm6ds3];

/// Address of the second stage, which starts the image.
#[cfg(feature = "trouble")]
pub const BASE: u32 = 0x0002_7000;

/// Time in milliseconds from power-up until the sensor answers: 35 ms and a margin.
pub const START_MS: u64 = 50;

/// Seeed's USB ids for a program on this board.
pub const USB: UsbNames = UsbNames { ids: (0x2886, 0x8045), product: PRODUCT };
#[cfg(not(feature = "left"))]
const PRODUCT: &str = "bimanual right hand (XIAO)";
#[cfg(feature = "left")]
const PRODUCT: &str = "bimanual left hand (XIAO)";

/// Whatever its sensor.
#[cfg(not(feature = "left"))]
pub fn kind(_: Sensor) -> Board {
    Board::RightXiao
}

/// Wires roles to pins.
pub fn parts(p: Peripherals) -> Parts {
    Parts {
        bus: SensorBus::new(
            p.TWISPI0,
            SensorPins {
                sda: p.P0_07.into(),
                scl: p.P0_27.into(),
                power: p.P1_08.into(),
                // The pull-ups are connected to the power supply of the sensor.
                pull_ups: None,
            },
        ),
        uart: uart::Parts {
            uarte: p.UARTE0,
            timer: p.TIMER1,
            ppi: (p.PPI_CH0, p.PPI_CH1, p.PPI_GROUP0),
            rx: p.P1_12.into(),
            tx: p.P1_11.into(),
        },
        led: watch::Led { red: off(p.P0_26.into()), green: off(p.P0_30.into()), blue: off(p.P0_06.into()) },
        // D0 and D1, each between a flex sensor to 3.3 V and 22 kΩ to ground.
        #[cfg(feature = "left")]
        flex: crate::left::hand::Parts {
            converter: p.SAADC,
            index: saadc::Input::degrade_saadc(p.P0_02),
            middle: saadc::Input::degrade_saadc(p.P0_03),
            battery_low: p.P0_14.into(),
        },
        // D0.
        #[cfg(not(feature = "left"))]
        vibration: crate::vibrate::Parts { pwm: p.PWM1, pin: p.P0_02.into() },
        #[cfg(not(feature = "left"))]
        battery: crate::battery::Parts {
            converter: p.SAADC,
            middle: saadc::Input::degrade_saadc(p.P0_31),
            low: p.P0_14.into(),
            // 1 MΩ above 510 kΩ.
            kilohms: (1510, 510),
        },
        watchdog: p.WDT,
        usbd: p.USBD,
        #[cfg(feature = "trouble")]
        radio: super::radio_parts!(p),
    }
}

/// Does nothing, because the UF2 bootloader leaves no peripheral enabled that would disturb this program.
pub fn begin() {}

/// Restarts into the UF2 bootloader, which shows a USB drive and feeds a watchdog that is running.
pub fn enter_bootloader() -> ! {
    const UF2: u8 = 0x57;
    // SAFETY: these are plain calls of the enabled SoftDevice, which owns the register.
    #[cfg(feature = "ble")]
    unsafe {
        nrf_softdevice::raw::sd_power_gpregret_clr(0, 0xFF);
        nrf_softdevice::raw::sd_power_gpregret_set(0, UF2.into());
    }
    #[cfg(not(feature = "ble"))]
    embassy_nrf::pac::POWER.gpregret().write(|w| w.set_gpregret(UF2));
    cortex_m::peripheral::SCB::sys_reset()
}
