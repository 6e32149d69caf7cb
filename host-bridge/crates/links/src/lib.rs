//! Sources of hands (serial ports, Bluetooth, recordings, keys), and a client for a single board.
//!
//! * [`links`]: ports, and the clock that they share,
//! * [`hands`], [`keyboard`]: hands that behave like boards inside this program,
//! * [`wire`]: the simulated line to such a board,
//! * [`talk`], [`upload`], [`capture`], [`survey`]: communication with one board, for programs such as `doctor`,
//! * [`showing`]: gestures that a wearer shows during a session, and the transfer of the trained model to the board.

pub mod capture;
pub mod hands;
pub mod keyboard;
pub mod links;
pub mod showing;
pub mod survey;
pub mod talk;
pub mod upload;
pub mod wire;
