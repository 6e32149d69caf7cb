//! The identity and hardware of a board.

use super::{FIRMWARE_MAX, Text};
use core::fmt;
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};
use shared_words::Hand;

open_list! {
    /// The kind of board. The kind also determines the hand.
    Board {
        /// Arduino Nano (ATmega328P), which reports tilts and bends.
        LeftNano = 0,
        /// Arduino Nano 33 BLE Sense Rev1 (LSM9DS1), which recognises gestures.
        RightNano33 = 1,
        /// Arduino Nano 33 BLE Sense Rev2 (BMI270 + BMM150), which recognises gestures.
        RightNano33Rev2 = 2,
        /// A recording that the laptop plays as the left hand.
        LeftReplay = 3,
        /// A recording that the laptop plays as the right hand.
        RightReplay = 4,
        /// Seeed XIAO nRF52840 Sense (LSM6DS3TR-C), which recognises gestures.
        RightXiao = 5,
        /// Seeed XIAO nRF52840 Sense (LSM6DS3TR-C), which reports tilts and bends.
        LeftXiao = 6,
    }
}

impl Board {
    /// Returns the hand that uses this kind of board, if the kind is known.
    pub const fn hand(self) -> Option<Hand> {
        match self {
            Self::LeftNano | Self::LeftXiao | Self::LeftReplay => Some(Hand::Left),
            Self::RightNano33 | Self::RightNano33Rev2 | Self::RightXiao | Self::RightReplay => {
                Some(Hand::Right)
            }
            Self::Unknown(_) => None,
        }
    }

    /// Returns the folder of the board's firmware below the project's root.
    pub const fn folder(self) -> Option<&'static str> {
        match self {
            Self::LeftNano => Some("firmware-nano-avr/"),
            Self::RightNano33 | Self::RightNano33Rev2 | Self::RightXiao | Self::LeftXiao => {
                Some("firmware-nano33/")
            }
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
            Self::LeftXiao => "the left hand (XIAO nRF52840 Sense)",
            Self::LeftReplay => "the recorded left hand",
            Self::RightReplay => "the recorded right hand",
            Self::Unknown(number) => return write!(f, "a board of unknown kind {number}"),
        })
    }
}

/// The identity of a board. The layout of this message never changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Hello<'a> {
    /// [`PROTOCOL_MAJOR`](super::PROTOCOL_MAJOR) of the sender.
    pub major: u8,
    /// [`PROTOCOL_MINOR`](super::PROTOCOL_MINOR) of the sender.
    pub minor: u8,
    /// The kind of board.
    pub board: Board,
    /// Version of the firmware, for example `0.1.0`.
    #[serde(borrow)]
    pub firmware: Text<'a, FIRMWARE_MAX>,
    /// A number that differs after each start.
    /// After a new number, counters and clock start again, and the hands must be neutral again.
    pub boot_id: u32,
    /// CRC-32 of the running model's blob; 0 if there is none.
    pub model_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
}

open_list! {
    /// Motion sensors of right hands.
    Sensor {
        /// No sensor has been detected.
        None = 0,
        /// The sensor of the Nano 33 BLE Sense, which has nine axes.
        Lsm9ds1 = 1,
        /// The sensor of the Nano 33 BLE Sense Rev2, which has six usable axes.
        Bmi270 = 2,
        /// The sensor of the XIAO nRF52840 Sense, which has six axes.
        Lsm6ds3 = 3,
    }
}

open_list! {
    /// The bootloader and the Bluetooth stack of a right hand's image.
    Image {
        /// The stock Arduino bootloader, without Bluetooth.
        Bootloader = 0,
        /// Nordic's S140, flashed with a probe.
        S140 = 1,
        /// S140 and the UF2 bootloader that new XIAO boards contain.
        Uf2 = 2,
        /// The board's own bootloader, with Bluetooth in the image.
        Linked = 3,
    }
}

open_list! {
    /// The reason why a board started.
    ResetCause {
        /// The power was switched on.
        PowerUp = 0,
        /// The reset button was pressed.
        Pin = 1,
        /// The watchdog expired.
        Watchdog = 2,
        /// The program or a bootloader restarted the board.
        Software = 3,
        /// Another reason, such as a debugger.
        Other = 4,
    }
}

/// The hardware of a right hand's board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct About {
    /// The detected sensor.
    pub sensor: Sensor,
    /// Number of valid values per sample: 9, 6, or 0 if there is no sensor.
    /// A model that reads more values cannot run.
    pub axes: u8,
    /// The variant of the firmware.
    pub image: Image,
    /// The reason why the board started.
    pub reset: ResetCause,
    /// Battery in millivolts; 0 = unknown.
    pub battery_mv: u16,
}
