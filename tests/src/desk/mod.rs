//! Emulated boards at the desk: their images run at the pace of the wall clock behind pseudo-terminals,
//! so that the program meets them as a user's does, with cables that are pulled and boards that restart.
//!
//! - [`station`] keeps one board's thread: its pace, its port, and what a test does to it;
//! - [`left`] is the Nano behind its USB-serial chip, [`right`] the Nano 33 with USB of its own;
//! - [`program`] runs what a user types and reads what comes out.

#[path = "../../../host-bridge/tests/support/graph.rs"]
pub mod graph;
#[cfg(feature = "avr")]
pub mod left;
pub mod port;
pub mod program;
#[cfg(feature = "nrf")]
pub mod right;
pub mod station;

fn starting() -> std::sync::MutexGuard<'static, ()> {
    port::alone()
}

fn host_bridge() -> std::path::PathBuf {
    program::folder().join("host-bridge")
}
