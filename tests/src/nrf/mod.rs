//! The emulated right hand: a Nano 33 BLE Sense from its instructions to its I2C bus.
//!
//! Needs the package `libunicorn-dev` (Debian) and the cargo feature `nrf`. One peripheral per file, each
//! with its own tests, since emulators lie a little. What is not modelled: wait states of the flash (see
//! `board::CYCLES_PER_TWO`), bus contention, analog behaviour of pins, the radio's waves.

pub mod air_host;
pub mod ble_host;
pub mod bmi270;
pub mod bmm150;
pub mod board;
pub mod build;
pub mod controller;
pub mod events;
pub mod flash;
pub mod gpio;
pub mod i2c;
pub mod image;
pub mod lsm6ds3;
pub mod lsm9ds1;
pub mod memory;
pub mod nvic;
pub mod ppi;
pub mod pwm;
pub mod recordings;
pub mod registers;
pub mod rtc;
pub mod saadc;
pub mod session;
pub mod soc;
pub mod softdevice;
pub mod system;
pub mod time;
pub mod timer;
pub mod transfer;
pub mod twim;
pub mod uarte;
pub mod usb_host;
pub mod usbd;
