//! Bluetooth for boards with an nRF52840. Its only service notifies the laptop and accepts writes.
//!
//! | | UUID |
//! |---|---|
//! | service of a right hand | `b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33` |
//! | service of a left hand | `b1a40011-…` |
//! | frames to the laptop (notify) | `b1a40002-…` |
//! | frames to the board (write, write without response; needs an encrypted, bonded link) | `b1a40003-…` |
//!
//! Frames form a byte stream in both directions, which is cut into pieces according to the MTU.
//! This file contains the parts that all Bluetooth stacks share.
//! The feature `trouble` adds the stack that is linked into the image.
//! The code is a separate crate, so that the compiler can optimise it for size. Most of the code runs rarely.
#![no_std]
#![allow(async_fn_in_trait, reason = "one executor, one core")]

#[cfg(feature = "trouble")]
pub mod trouble;

use embassy_time::Duration;

/// Maximum bytes of one notification or write: the largest MTU without its three bytes of header.
pub const PAYLOAD: usize = 244;
/// Connection intervals that the board requests one after another, in units of 1.25 ms.
/// The board first requests 7.5 to 15 ms, and then 15 ms for systems that refuse shorter intervals.
pub const INTERVALS: [(u16, u16); 2] = [(6, 12), (12, 12)];
/// A laptop answers a request for a connection interval within this time.
pub const ANSWER: Duration = Duration::from_secs(5);
/// Number of connection events that the board may skip while it has nothing to send, so that the radio stays off.
/// The board's next frame still leaves within one interval.
/// A frame from the laptop arrives within five intervals.
pub const LATENCY: u16 = 4;
/// A link that is silent for this long (in units of 10 ms) is lost.
/// After a restart of one side, the other side notices this only then.
/// With one second, both sides are linked again within two seconds of a restart.
pub const SUPERVISION: u16 = if cfg!(feature = "trouble") { 100 } else { 200 };
/// Advertising interval in units of 0.625 ms: 30 ms.
pub const ADVERTISING: u32 = 48;
/// A laptop that has not bonded within this time is disconnected, because it occupies the board's only link.
pub const STRANGER: Duration = Duration::from_secs(10);
/// For this long after a start, a laptop may bond even if another laptop is bonded.
pub const PAIRING: Duration = Duration::from_secs(120);
/// Name of the board in Bluetooth advertisements.
pub const NAME: &str = if cfg!(feature = "left") { "bimanual-left" } else { "bimanual-right" };
/// UUID of the service, little-endian as in an advertisement.
pub const SERVICE_UUID: [u8; 16] = if cfg!(feature = "left") {
    0xb1a4_0011_6d61_4e75_a1b2_5c3d_9e7f_0a33_u128.to_le_bytes()
} else {
    0xb1a4_0001_6d61_4e75_a1b2_5c3d_9e7f_0a33_u128.to_le_bytes()
};
