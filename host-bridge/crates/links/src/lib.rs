//! Sources of hands (serial ports, Bluetooth, recordings, keys), and a client for a single board.
//!
//! * [`links`]: ports, and their common clock,
//! * [`hands`], [`keyboard`]: simulated boards inside this program, connected by [`wire`],
//! * [`talk`], [`upload`], [`capture`], [`survey`]: requests to one board for `doctor`, `record` and `send-model`.

pub mod capture;
pub mod hands;
pub mod keyboard;
pub mod links;
pub mod survey;
pub mod talk;
pub mod upload;
pub mod wire;
