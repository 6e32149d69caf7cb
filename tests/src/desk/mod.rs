//! Emulated boards on the desk. Their images run behind pseudo-terminals, so the program uses them like real boards.
//! A test can disconnect cables and restart boards, and it controls the common time.
//!
//! - [`left`] is the Nano with its USB-serial chip, and [`right`] is the Nano 33 with its own USB;
//! - [`programs`] builds the programs;
//! - the desk itself belongs to host-bridge's own tests.

#[path = "../../../host-bridge/tests/support/graph.rs"]
pub mod graph;
#[path = "../../../host-bridge/tests/support/lateness.rs"]
pub mod lateness;
#[cfg(feature = "avr")]
pub mod left;
pub mod programs;
#[cfg(feature = "nrf")]
pub mod right;
#[path = "../../../host-bridge/tests/support/desk/mod.rs"]
mod shared;

pub use shared::{port, program, station, time};

fn host_bridge() -> std::path::PathBuf {
    programs::folder().join("host-bridge")
}
