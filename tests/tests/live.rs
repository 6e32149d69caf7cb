//! Runs the programs with emulated boards, as one test binary that `cargo xtask test` runs in parallel.
//! `cargo test -- --skip live::` skips these tests, each of which takes a minute.

#[path = "../../host-bridge/tests/support/renamed.rs"]
mod renamed;

mod live {
    mod ble;
    mod desk;
    mod ros2;
    mod update;
    mod walk_through;
}
