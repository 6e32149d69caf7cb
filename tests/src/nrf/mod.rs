//! The emulated right hand: a Nano 33 BLE Sense, from its processor's instructions to its I2C bus.
//!
//! The emulation needs the package `libunicorn-dev` (Debian) and the Cargo feature `nrf`.
//! Each peripheral has its own file with its own tests, because emulators are not always accurate.
//! The emulation omits bus contention, analog behaviour of pins, and radio waves.
//! It also omits wait states of the flash (see `board::CYCLES_PER_TWO`).

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
pub mod left_hand;
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
pub mod update_file;
pub mod usb_host;
pub mod usbd;
