//! What runs at the pace of the wall clock: the program with boards behind pseudo-terminals.
//! `cargo test -- --skip live::` leaves it out.
#![cfg(unix)]

#[path = "support/double.rs"]
mod double;
#[cfg(feature = "ros2")]
#[path = "support/graph.rs"]
mod graph;
#[path = "support/renamed.rs"]
mod renamed;
#[path = "support/talker.rs"]
mod talker;

mod live {
    mod desk;
    #[cfg(feature = "ros2")]
    mod ros2;
    mod stops;
}

#[cfg(feature = "ros2")]
fn starting() -> std::sync::MutexGuard<'static, ()> {
    double::STARTING.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[cfg(feature = "ros2")]
fn host_bridge() -> &'static str {
    env!("CARGO_BIN_EXE_host-bridge")
}
