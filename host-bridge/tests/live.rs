//! Runs the program with boards behind pseudo-terminals in simulated time.
//! `cargo test -- --skip live::` skips these tests.
#![cfg(unix)]

#[path = "support/desk/mod.rs"]
#[allow(dead_code)] // each crate of tests uses its own part
mod desk;
#[path = "support/double.rs"]
mod double;
#[cfg(feature = "ros2")]
#[path = "support/graph.rs"]
mod graph;
#[path = "support/lateness.rs"]
mod lateness;
#[path = "support/renamed.rs"]
mod renamed;
#[path = "support/talker.rs"]
mod talker;
#[path = "support/wrist.rs"]
mod wrist;

#[cfg(feature = "ros2")]
use desk::{port, program, time};

mod live {
    mod desk;
    #[cfg(feature = "ros2")]
    mod ros2;
    mod stops;
    #[cfg(feature = "zenoh")]
    mod zenoh;
}

fn host_bridge() -> &'static str {
    env!("CARGO_BIN_EXE_host-bridge")
}
