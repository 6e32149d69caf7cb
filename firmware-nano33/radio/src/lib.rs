//! Bluetooth of the boards with an nRF52840: one own service, notify out, write in.
//!
//! | | UUID |
//! |---|---|
//! | service | `b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33` |
//! | frames to the laptop (notify) | `b1a40002-…` |
//! | frames to the board (write, write without response; needs an encrypted, bonded link) | `b1a40003-…` |
//!
//! Frames are a byte stream in both directions, cut wherever the MTU says. Here is what every stack shares, and with the feature
//! `trouble` the one that is linked into the image. It is a crate of its own so that it is built for size: hardly any of it runs
//! often.
#![no_std]
#![allow(async_fn_in_trait, reason = "one executor, one core")]

#[cfg(feature = "trouble")]
pub mod trouble;

use embassy_time::Duration;

/// Bytes of one notification or write: the largest MTU less three of header.
pub const PAYLOAD: usize = 244;
/// Connection intervals in 1.25 ms that are asked for in turn: 7.5 to 15 ms, and 15 ms for systems that refuse less.
pub const INTERVALS: [(u16, u16); 2] = [(6, 12), (12, 12)];
/// A laptop answers a request for an interval within this long.
pub const ANSWER: Duration = Duration::from_secs(5);
/// Connection events that the board may sleep through while it has nothing to say: what it has to say leaves
/// within one interval all the same, a laptop's frame arrives within five, and the radio is off in between.
pub const LATENCY: u16 = 4;
/// A link that is silent for this long (10 ms) is gone.
pub const SUPERVISION: u16 = 200;
/// Advertising interval in 0.625 ms: 30 ms.
pub const ADVERTISING: u32 = 48;
/// A laptop that is not bonded by then is disconnected, since it holds the board's only link.
pub const STRANGER: Duration = Duration::from_secs(10);
/// After a start a laptop may bond for this long, even if another one is bonded.
pub const PAIRING: Duration = Duration::from_secs(120);
/// What the board calls itself.
pub const NAME: &str = "bimanual-right";
/// The service's UUID, little-endian as in an advertisement.
pub const SERVICE_UUID: [u8; 16] = 0xb1a4_0001_6d61_4e75_a1b2_5c3d_9e7f_0a33_u128.to_le_bytes();
