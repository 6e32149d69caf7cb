#![doc = include_str!("../WIRE.md")]
//!
//! # In this crate
//!
//! ```
//! use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_board};
//! use shared_proto::message::{BoardBody, BoardMessage, LeftState};
//!
//! // On the board: one message, one buffer.
//! let mut buffer = [0; LeftState::FRAME_MAX];
//! let state = BoardMessage::Left(LeftState { sequence: 1, ..Default::default() });
//! let bytes = encode_board(&state, &mut buffer)?;
//!
//! // On the laptop: bytes as they come.
//! let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
//! for &byte in bytes {
//!     if let Some(message) = decoder.push_board(byte) {
//!         assert_eq!(message, state);
//!     }
//! }
//! assert_eq!(decoder.counters().frames, 1);
//! # Ok::<(), shared_proto::frame::EncodeError>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod clock;
pub mod counter;
pub mod crc;
pub mod frame;
pub mod message;
pub mod version;
