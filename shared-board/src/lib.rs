//! The logic of the boards without their pins.
//! The inputs are samples, bytes and time. The outputs are frames, memory operations and the light.
//!
//! ```text
//!  samples ─▶ ┌───────────────────────┐ ─▶ frames
//!  bytes   ─▶ │ LeftBoard, RightBoard │ ─▶ light
//!  time    ─▶ └───────────────────────┘
//!                      │ ModelRequest
//!                      ▼
//!                  ModelStore ─▶ flash
//! ```
//!
//! * [`left::LeftBoard`]: tilts and bends, a calibration in EEPROM, and thresholds.
//! * [`right::RightBoard`]: gestures, record mode, and requirements of the model.
//! * [`vibration::Vibration`]: patterns of the motor at the right board.
//! * [`models::ModelStore`]: receives a model over the wire into one of two slots of NOR flash.
//! * [`images::ImageStore`]: receives a new image for the board, which [`swap`] then installs.
//!
//! The firmware of both boards, replayed recordings, keyboard hands and the test doubles all use this code.
//! These programs differ only in where samples come from and where frames go.
//!
//! This code never waits, reads a clock or accesses a register.
//! All times are on the board's own clock, which counts milliseconds since the start and wraps after 49 days.
//!
//! # A left board in ten lines
//! ```
//! use shared_board::Identity;
//! use shared_board::left::{LeftBoard, Start};
//! # use shared_board::memory::RamEeprom;
//! # use shared_dsp::left::AdcCounts;
//! # use shared_proto::message::{Board, Status};
//! # let (eeprom, level) = (RamEeprom::blank(), AdcCounts::from_ten_bit([512, 512, 614, 704, 704]));
//! let mut line = Vec::new();
//! let mut out = |frame: &[u8]| {
//!     line.extend_from_slice(frame);
//!     true // false if the line has no room
//! };
//! let who = Identity { board: Board::LeftNano, firmware: "0.1.0", boot_id: 1, sample_hz: 100 };
//! let mut board = LeftBoard::start(who, eeprom, Start::default(), &mut out);
//! for now_ms in (10..=1000).step_by(10) {
//!     if board.period(now_ms, &mut out) {
//!         board.status(Status::default(), now_ms, &mut out); // what the drivers have counted
//!     }
//!     board.sample(level, now_ms, &mut out);
//!     board.receive(0, now_ms, &mut out); // bytes from the laptop, as they come
//!     assert!(!board.light());
//! }
//! // A hello, fifty states and one more for the first neutral, a status: each ends in a zero byte.
//! assert_eq!(line.iter().filter(|&&byte| byte == 0).count(), 1 + 1 + 51 + 1);
//! ```
#![no_std]
#![forbid(unsafe_code)]

#[cfg(any(test, feature = "host"))]
extern crate std;

mod almost;
pub mod bonds;
pub mod calibration_store;
pub mod eeprom_log;
pub mod faults;
pub mod guard;
pub mod hand;
pub mod images;
pub mod left;
#[cfg(any(test, feature = "host"))]
pub mod memory;
pub mod models;
pub(crate) mod pages;
pub mod passkey;
pub mod right;
pub mod slots;
pub mod swap;
pub mod update;
pub mod vibration;

use shared_proto::frame::encode_body;
use shared_proto::message::{
    Board, BoardBody, Hello, PROTOCOL_MAJOR, PROTOCOL_MINOR, Pairing, PairingKind, Text,
};

/// A destination of frames, such as a serial line, a radio or a vector of bytes.
///
/// Every `FnMut(&[u8]) -> bool` implements this trait.
pub trait FrameOut {
    /// Accepts a complete frame, or returns false if there is no room.
    fn send(&mut self, frame: &[u8]) -> bool;
}

impl<F: FnMut(&[u8]) -> bool> FrameOut for F {
    fn send(&mut self, frame: &[u8]) -> bool {
        self(frame)
    }
}

/// The identity of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The kind of board, which also determines its hand.
    pub board: Board,
    /// Version of the program, for example `0.1.0`.
    pub firmware: &'static str,
    /// A number that differs after each start.
    pub boot_id: u32,
    /// Samples per second.
    pub sample_hz: u16,
}

impl Identity {
    /// Creates the hello message of this board. `model_id` is 0 if no model runs.
    fn hello(&self, model_id: u32) -> Hello<'static> {
        Hello {
            major: PROTOCOL_MAJOR,
            minor: PROTOCOL_MINOR,
            board: self.board,
            firmware: Text(self.firmware),
            boot_id: self.boot_id,
            model_id,
            sample_hz: self.sample_hz,
        }
    }
}

/// Time between two statuses.
pub const STATUS_INTERVAL_MS: u32 = 1000;

/// Says how a laptop pairs or has paired over Bluetooth.
pub fn say_pairing(kind: PairingKind, passkey: u32, out: &mut impl FrameOut) {
    send::<{ Pairing::FRAME_MAX }>(&Pairing { kind, passkey }, out);
}

/// Encodes a message into a buffer of `N` bytes, which must be at least its [`BoardBody::FRAME_MAX`], and sends it.
fn send<const N: usize>(body: &impl BoardBody, out: &mut impl FrameOut) -> bool {
    let mut buffer = [0; N];
    match encode_body(body, &mut buffer) {
        Ok(frame) => out.send(frame),
        Err(_) => false,
    }
}
