//! Arduino Nano 33 BLE Sense, Rev1 (LSM9DS1) and Rev2 (BMI270): same pins, one image.

use embassy_nrf::Peripherals;
use nano33_sensor::found::Kind;
use shared_proto::message::{Board, Sensor};

use super::{Parts, UsbNames, off};
use crate::bus::{SensorBus, SensorPins};
use crate::{uart, vibrate, watch};

/// The sensors of Rev1 and Rev2.
pub const SENSORS: &[Kind] = &[Kind::Lsm9ds1, Kind::Bmi270];

/// From power to a sensor that answers: ST's sensors of this kind take up to 35 ms to turn on; SparkFun waits 100 ms.
pub const START_MS: u64 = 50;

/// Arduino's ids for a sketch on this board, which its drivers and udev rules know.
pub const USB: UsbNames = UsbNames { ids: (0x2341, 0x805A), product: "bimanual right hand" };

/// The revisions differ by their sensor.
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
                // Driven high, or the bus has no pull-ups. Also SWO, which must stay off.
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

/// Clears away what the stock bootloader leaves behind. It also leaves the MPU, RTC1's compare interrupt and PWM0 on
/// P0.13 on, which disturb nobody.
pub fn begin() {
    // If the slow crystal started late, its interrupt would be enabled with nobody to clear it.
    const CLOCK_INTENCLR: *mut u32 = 0x4000_0308 as _;
    // UARTE0 receives into a byte of RAM that is ours, and pins may be chosen only while it is off.
    const UARTE0_STOPRX: *mut u32 = 0x4000_2004 as _;
    const UARTE0_RXTO: *mut u32 = 0x4000_2144 as _;
    const UARTE0_ENABLE: *mut u32 = 0x4000_2500 as _;
    // SAFETY: registers of this chip; nobody else runs yet.
    unsafe {
        CLOCK_INTENCLR.write_volatile(u32::MAX);
        if UARTE0_ENABLE.read_volatile() != 0 {
            UARTE0_STOPRX.write_volatile(1);
            // Bounded: about five byte times.
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
/// It never feeds a watchdog, and a soft reset does not stop one: an upload of 6 s would end after 2. So the watchdog
/// itself does the reset, which stops it, and the bootloader's own mark of a double press says that it shall stay.
#[cfg(not(feature = "ble"))]
pub fn enter_bootloader() -> ! {
    const DOUBLE_PRESS: *mut u32 = 0x2000_7FFC as _;
    const DOUBLE_PRESSED: u32 = 0x0773_8135;
    const STAY: u8 = 0xB0;
    cortex_m::interrupt::disable();
    // The laptop sees the port go at once.
    embassy_nrf::pac::USBD.usbpullup().write(|w| w.set_connect(false));
    // What Arduino's bootloaders look for after a soft reset.
    embassy_nrf::pac::POWER.gpregret().write(|w| w.set_gpregret(STAY));
    // SAFETY: whatever stood there is nobody's any more: nothing of this run goes on.
    unsafe { DOUBLE_PRESS.write_volatile(DOUBLE_PRESSED) };
    if embassy_nrf::pac::WDT.runstatus().read().0 != 0 {
        loop {
            cortex_m::asm::wfe();
        }
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Restarts: behind S140 there is no bootloader.
#[cfg(feature = "ble")]
pub fn enter_bootloader() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
