//! Emulated boards at the desk. Their images run behind pseudo-terminals, so the program uses them like real ones.
//! Cables can be pulled and boards restarted, and the test controls a common time.
//!
//! - [`left`] is the Nano with its USB-serial chip, [`right`] the Nano 33 with its own USB;
//! - [`programs`] builds the programs;
//! - the desk itself is that of host-bridge's own tests.

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
