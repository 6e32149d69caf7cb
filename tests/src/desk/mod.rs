//! Emulated boards at the desk: their images run behind pseudo-terminals, so that the program meets them as a user's
//! does, with cables that are pulled and boards that restart. All of it is in one time, which the test holds.
//!
//! - [`left`] is the Nano behind its USB-serial chip, [`right`] the Nano 33 with USB of its own;
//! - [`programs`] has the programs, built;
//! - the desk itself is the one of host-bridge's own tests.

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
