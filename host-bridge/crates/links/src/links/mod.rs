//! Real links: serial ports and (feature `ble`) Bluetooth.
//! Each link has its own thread, and all share one clock.
//!
//! A link opens its port, passes on every byte with its time of arrival, and reopens the port after a failure.
//! The program never sends to a board that was just reset.
//! Opening the port of an Arduino Nano restarts the board, and its bootloader would interpret our bytes as a program.

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

/// Returns whether this name (`ble` or `ble:NAME`) denotes a board behind Bluetooth.
pub fn is_ble(port: &str) -> bool {
    port == "ble" || port.starts_with("ble:")
}

/// Returns whether this is a serial port over Bluetooth, whose bond and encryption cannot be checked.
pub fn is_serial_over_air(port: &str) -> bool {
    let name = port.rsplit('/').next().unwrap_or(port);
    name.starts_with("rfcomm") || name.contains("HC-0") || name.to_lowercase().contains("bluetooth")
}

/// A link to a board of any kind. Dropping the link closes it.
pub enum Link {
    /// A serial port, either of a USB-serial chip or of the board's own USB.
    Serial(SerialLink),
    /// Bluetooth.
    #[cfg(feature = "ble")]
    Ble(BleLink),
}

impl Link {
    /// Starts the link's thread, which reports everything to `events`, marked with `link`.
    pub fn start<I: Copy + Send + 'static>(
        link: I,
        port: &str,
        settings: SerialSettings,
        clock: Arc<dyn Clock>,
        events: EventSender<I>,
    ) -> Self {
        #[cfg(feature = "ble")]
        if is_ble(port) {
            return Link::Ble(BleLink::start(link, port, settings, clock, events));
        }
        Link::Serial(SerialLink::start(link, port, settings, clock, events))
    }

    /// Name of the port, as the user entered it.
    pub fn port(&self) -> &str {
        match self {
            Link::Serial(link) => link.port(),
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.port(),
        }
    }

    /// Returns whether bytes can be sent now.
    pub fn is_ready(&self) -> bool {
        match self {
            Link::Serial(link) => link.is_ready(),
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.is_ready(),
        }
    }

    /// Strength of the radio signal in dBm when the board was found, if it is behind Bluetooth.
    pub fn signal_dbm(&self) -> Option<i16> {
        match self {
            Link::Serial(_) => None,
            #[cfg(feature = "ble")]
            Link::Ble(link) => link.signal_dbm(),
        }
    }

    /// Sends one frame. Returns false if it cannot be sent now; nothing is queued for later.
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
    /// The time on the link's clock.
    pub at_ms: u64,
    /// What.
    pub news: News,
}

/// The events of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// The port is open. A Nano on this port restarts.
    Opened,
    /// Bytes, as they came.
    Bytes(Vec<u8>),
    /// The port cannot be opened or has failed, with the reason and a remedy.
    /// Each reason is reported only once, and the link keeps trying.
    Closed(String),
}
