//! Arduino Nano 33 BLE Sense, Rev1 (LSM9DS1) and Rev2 (BMI270).
//! Both revisions have the same pins and use the same image.

use embassy_nrf::Peripherals;
use nano33_sensor::found::Kind;
use shared_proto::message::{Board, Sensor};

use super::{Parts, UsbNames, off};
use crate::bus::{SensorBus, SensorPins};
use crate::{uart, vibrate, watch};

/// The sensors of Rev1 and Rev2.
pub const SENSORS: &[Kind] = &[Kind::Lsm9ds1, Kind::Bmi270];

/// Address of the second stage, which starts the image.
#[cfg(feature = "trouble")]
pub const BASE: u32 = 0x0001_0000;

/// Time from power-up until the sensor answers, in milliseconds.
/// ST's sensors of this type need up to 35 ms, and SparkFun's library waits 100 ms.
pub const START_MS: u64 = 50;

/// Arduino's ids for a sketch on this board, which Arduino's drivers and udev rules recognise.
pub const USB: UsbNames = UsbNames { ids: (0x2341, 0x805A), product: "bimanual right hand" };

/// Returns the revision of the board, which the sensor reveals.
pub fn kind(sensor: Sensor) -> Board {
    if sensor == Sensor::Bmi270 { Board::RightNano33Rev2 } else { Board::RightNano33 }
}

/// Wires roles to pins.
pub fn parts(p: Peripherals) -> Parts {
    Parts {
        bus: SensorBus::new(
            p.TWISPI0,
            SensorPins {
                sda: p.P0_14.into(),
                scl: p.P0_15.into(),
                power: p.P0_22.into(),
                // This pin must be high, because it supplies the pull-ups of the bus.
                // The pin is also SWO, which must stay disabled.
                pull_ups: Some(p.P1_00.into()),
            },
        ),
        uart: uart::Parts {
            uarte: p.UARTE0,
            timer: p.TIMER1,
            ppi: (p.PPI_CH0, p.PPI_CH1, p.PPI_GROUP0),
            rx: p.P1_10.into(),
            tx: p.P1_03.into(),
        },
        led: watch::Led { red: off(p.P0_24.into()), green: off(p.P0_16.into()), blue: off(p.P0_06.into()) },
        // D2.
        vibration: vibrate::Parts { pwm: p.PWM1, pin: p.P1_11.into() },
        watchdog: p.WDT,
        usbd: p.USBD,
        #[cfg(not(feature = "radio"))]
        flash: p.NVMC,
        #[cfg(not(feature = "radio"))]
        random: p.RNG,
        #[cfg(feature = "trouble")]
        radio: super::radio_parts!(p),
    }
}

/// Resets peripherals that the stock bootloader leaves running.
/// The bootloader also leaves the MPU, the compare interrupt of RTC1 and PWM0 on P0.13 enabled. They do no harm here.
pub fn begin() {
    // If the slow crystal started late, its interrupt would be enabled without a handler that clears it.
    const CLOCK_INTENCLR: *mut u32 = 0x4000_0308 as _;
    // UARTE0 writes received data to a byte of RAM that this image uses for itself.
    // The pins of UARTE0 can be changed only while it is off.
    const UARTE0_STOPRX: *mut u32 = 0x4000_2004 as _;
    const UARTE0_RXTO: *mut u32 = 0x4000_2144 as _;
    const UARTE0_ENABLE: *mut u32 = 0x4000_2500 as _;
    // SAFETY: these are registers of this chip, and no other code runs yet.
    unsafe {
        CLOCK_INTENCLR.write_volatile(u32::MAX);
        if UARTE0_ENABLE.read_volatile() != 0 {
            UARTE0_STOPRX.write_volatile(1);
            // The loop ends after about five byte times.
            for _ in 0..8_000 {
                if UARTE0_RXTO.read_volatile() != 0 {
                    break;
                }
            }
            UARTE0_RXTO.write_volatile(0);
            UARTE0_ENABLE.write_volatile(0);
        }
    }
}

/// Restarts into the stock bootloader, which waits for an upload.
///
/// The bootloader never feeds a watchdog, and a soft reset does not stop a watchdog.
/// An upload of 6 s would therefore end after 2 s.
/// The watchdog therefore performs the reset, which also stops the watchdog.
/// The mark of a double press keeps the bootloader running.
#[cfg(not(feature = "ble"))]
pub fn enter_bootloader() -> ! {
    const DOUBLE_PRESS: *mut u32 = 0x2000_7FFC as _;
    const DOUBLE_PRESSED: u32 = 0x0773_8135;
    const STAY: u8 = 0xB0;
    cortex_m::interrupt::disable();
    // Without the pull-up, the laptop detects a disconnection of the USB port immediately.
    embassy_nrf::pac::USBD.usbpullup().write(|w| w.set_connect(false));
    // Arduino's bootloaders look for this value after a soft reset.
    embassy_nrf::pac::POWER.gpregret().write(|w| w.set_gpregret(STAY));
    // SAFETY: no code of this run continues, so this word's previous content is not needed.
    unsafe { DOUBLE_PRESS.write_volatile(DOUBLE_PRESSED) };
    if embassy_nrf::pac::WDT.runstatus().read().0 != 0 {
        loop {
            cortex_m::asm::wfe();
        }
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Restarts the board. An image with S140 has no bootloader.
#[cfg(feature = "ble")]
pub fn enter_bootloader() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
