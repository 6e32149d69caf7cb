//! Sources of hands (serial ports, Bluetooth, recordings, keys), and a client for a single board.
//!
//! * [`links`]: ports, and the clock that they share,
//! * [`hands`], [`keyboard`]: what behaves like a board inside this program, with [`wire`] between,
//! * [`talk`], [`upload`], [`capture`], [`survey`]: one board asked for something, as `doctor`, `record` and
//!   `send-model` do,
//! * [`showing`]: a wearer shows gestures within a session, and the board gets what was learnt.

pub mod capture;
pub mod hands;
pub mod keyboard;
pub mod links;
pub mod showing;
pub mod survey;
pub mod talk;
pub mod upload;
pub mod wire;
