//! Real links: serial ports, each read by a thread of its own, and the clock they share.
//!
//! A link opens its port, hands on every byte with its time of arrival, and opens the port again by
//! itself when it fails. It never sends into a board that has just been reset: opening the port of an
//! Arduino Nano restarts it, and its bootloader would take our bytes for a program to be flashed.

mod ports;
mod serial;

pub use ports::{PortAbout, hints, ports};
pub use serial::{SerialLink, SerialSettings};

use std::time::Instant;

/// Milliseconds that never step back. Everything behind the links gets its time from here.
pub trait Clock: Send + Sync {
    /// Time since some fixed moment.
    fn now_ms(&self) -> u64;
}

/// The machine's monotonic clock, from the moment it was made.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl SystemClock {
    /// A clock that shows 0 now.
    pub fn start() -> Self {
        SystemClock(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now_ms(&self) -> u64 {
        self.0.elapsed().as_millis() as u64
    }
}

/// What a link has to say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkEvent<I> {
    /// Which link.
    pub link: I,
    /// When, on the link's clock.
    pub at_ms: u64,
    /// What.
    pub news: News,
}

/// What can happen to a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// The port is open; a Nano behind it starts anew.
    Opened,
    /// Bytes, as they came.
    Bytes(Vec<u8>),
    /// The port cannot be opened or has failed. The text says why and what to do. Said once per reason;
    /// the link goes on trying.
    Closed(String),
}
