//! Who a board is, and what it is made of.

use super::{FIRMWARE_MAX, Text};
use core::fmt;
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};
use shared_words::Hand;

open_list! {
    /// Which hand a board is on, and which board it is.
    Board {
        /// Arduino Nano (ATmega328P): tilt and bends.
        LeftNano = 0,
        /// Arduino Nano 33 BLE Sense Rev1 (LSM9DS1): gestures.
        RightNano33 = 1,
        /// Arduino Nano 33 BLE Sense Rev2 (BMI270 + BMM150): gestures.
        RightNano33Rev2 = 2,
        /// A recording played by the laptop as the left hand.
        LeftReplay = 3,
        /// A recording played by the laptop as the right hand.
        RightReplay = 4,
        /// Seeed XIAO nRF52840 Sense (LSM6DS3TR-C): gestures.
        RightXiao = 5,
    }
}

impl Board {
    /// Which hand it is for, if it is known.
    pub const fn hand(self) -> Option<Hand> {
        match self {
            Self::LeftNano | Self::LeftReplay => Some(Hand::Left),
            Self::RightNano33 | Self::RightNano33Rev2 | Self::RightXiao | Self::RightReplay => {
                Some(Hand::Right)
            }
            Self::Unknown(_) => None,
        }
    }

    /// The folder of its firmware, below this project's root.
    pub const fn folder(self) -> Option<&'static str> {
        match self {
            Self::LeftNano => Some("firmware-nano-avr/"),
            Self::RightNano33 | Self::RightNano33Rev2 | Self::RightXiao => Some("firmware-nano33/"),
            Self::LeftReplay | Self::RightReplay | Self::Unknown(_) => None,
        }
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::LeftNano => "the left hand (Arduino Nano)",
            Self::RightNano33 => "the right hand (Nano 33 BLE Sense)",
            Self::RightNano33Rev2 => "the right hand (Nano 33 BLE Sense Rev2)",
            Self::RightXiao => "the right hand (XIAO nRF52840 Sense)",
            Self::LeftReplay => "the recorded left hand",
            Self::RightReplay => "the recorded right hand",
            Self::Unknown(number) => return write!(f, "a board of unknown kind {number}"),
        })
    }
}

/// Who a board is. The layout of this message never changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Hello<'a> {
    /// [`PROTOCOL_MAJOR`](super::PROTOCOL_MAJOR) of the sender.
    pub major: u8,
    /// [`PROTOCOL_MINOR`](super::PROTOCOL_MINOR) of the sender.
    pub minor: u8,
    /// The sender.
    pub board: Board,
    /// Version of the firmware, such as `0.1.0`.
    #[serde(borrow)]
    pub firmware: Text<'a, FIRMWARE_MAX>,
    /// Different after each start. A new one re-bases counters and clock and needs neutral again.
    pub boot_id: u32,
    /// CRC-32 of the running model's blob; 0 if there is none.
    pub model_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
}

open_list! {
    /// Motion sensors of right hands.
    Sensor {
        /// None has been found yet.
        None = 0,
        /// Nano 33 BLE Sense: nine axes.
        Lsm9ds1 = 1,
        /// Nano 33 BLE Sense Rev2: six axes that may be used.
        Bmi270 = 2,
        /// XIAO nRF52840 Sense: six axes.
        Lsm6ds3 = 3,
    }
}

open_list! {
    /// What a right hand's image runs behind.
    Image {
        /// The stock Arduino bootloader, without Bluetooth.
        Bootloader = 0,
        /// Nordic's S140, flashed with a probe.
        S140 = 1,
        /// S140 and a UF2 bootloader, as the XIAO is sold.
        Uf2 = 2,
        /// The board's own bootloader, with Bluetooth in the image.
        Linked = 3,
    }
}

open_list! {
    /// Why a board started.
    ResetCause {
        /// Power.
        PowerUp = 0,
        /// The reset button.
        Pin = 1,
        /// The watchdog.
        Watchdog = 2,
        /// The program itself, or a bootloader.
        Software = 3,
        /// Something else, such as a debugger.
        Other = 4,
    }
}

/// What a right hand's board is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct About {
    /// The sensor that was found.
    pub sensor: Sensor,
    /// Values per sample that mean something: 9, 6, or 0 while no sensor is found. A model that reads more cannot run.
    pub axes: u8,
    /// The variant of the firmware.
    pub image: Image,
    /// Why the board started.
    pub reset: ResetCause,
    /// Battery in millivolts; 0 = unknown.
    pub battery_mv: u16,
}
