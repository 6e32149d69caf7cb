//! Real links: serial ports and (feature `ble`) Bluetooth, each with a thread of its own, and the clock they
//! share.
//!
//! A link opens its port, hands on every byte with its time of arrival, and opens the port again by
//! itself when it fails. It never sends into a board that has just been reset: opening the port of an
//! Arduino Nano restarts it, and its bootloader would take our bytes for a program to be flashed.

#[cfg(feature = "ble")]
mod ble;
mod clock;
mod ports;
mod queue;
mod serial;
#[cfg(feature = "test-clock")]
mod test_clock;

#[cfg(feature = "ble")]
pub use ble::{BleLink, ble_devices};
pub use clock::{Clock, SystemClock, Waiter, Waker};
pub use ports::{PortAbout, hints, ports};
pub use queue::{EventReceiver, EventSender, queue};
pub use serial::{SerialLink, SerialSettings};

use std::sync::Arc;

/// Does this name (`ble` or `ble:NAME`) mean a board behind Bluetooth?
pub fn is_ble(port: &str) -> bool {
    port == "ble" || port.starts_with("ble:")
}

/// Is this a serial port over Bluetooth? Nothing shows whether its module is bonded and the link encrypted.
pub fn is_serial_over_air(port: &str) -> bool {
    let name = port.rsplit('/').next().unwrap_or(port);
    name.starts_with("rfcomm") || name.contains("HC-0") || name.to_lowercase().contains("bluetooth")
}

/// A link to a board, whatever lies between; dropping it closes it.
pub enum Link {
    /// A serial port: a USB-serial chip, or USB of the board's own.
    Serial(SerialLink),
    /// Bluetooth.
    #[cfg(feature = "ble")]
    Ble(BleLink),
}

impl Link {
    /// Starts the link's thread. Everything that it reports goes to `events`, marked with `link`.
    pub fn start<I: Copy + Send + 'static>(
        link: I,
        port: &str,
        settings: SerialSettings,
        clock: Arc<dyn Clock>,
        events: EventSender<I>,
    ) -> Self {
        #[cfg(feature = "ble")]
        if is_ble(port) {
            return Link::Ble(BleLink::start(link, port, settings.allow_unbonded, clock, events));
        }
        Link::Serial(SerialLink::start(link, port, settings, clock, events))
    }

    /// As the user named it.
    pub fn port(&self) -> &str {
        match self {
            Link::Serial(link) => link.port(),
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.port(),
        }
    }

    /// May bytes be sent now?
    pub fn is_ready(&self) -> bool {
        match self {
            Link::Serial(link) => link.is_ready(),
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.is_ready(),
        }
    }

    /// Sends one frame; false when it is not on its way. Nothing is kept for later: late is dropped.
    pub fn send(&self, frame: &[u8]) -> bool {
        match self {
            Link::Serial(link) => link.send(frame),
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.send(frame),
        }
    }
}

/// What a link reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkEvent<I> {
    /// Which link.
    pub link: I,
    /// The time, on the link's clock.
    pub at_ms: u64,
    /// What.
    pub news: News,
}

/// What can happen to a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// The port is open; a Nano behind it restarts.
    Opened,
    /// Bytes, as they came.
    Bytes(Vec<u8>),
    /// The port cannot be opened or has failed. The text says why and what to do. Reported once per reason;
    /// the link goes on trying.
    Closed(String),
}
