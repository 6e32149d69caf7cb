//! What runs at the pace of the wall clock: the programs at a desk with emulated boards. One binary, so that
//! `cargo xtask test` runs them side by side while nothing else has the processor's first attention;
//! `cargo test -- --skip live::` leaves them out.

#[path = "../../host-bridge/tests/support/renamed.rs"]
mod renamed;

mod live {
    mod ble;
    mod desk;
    mod ros2;
    mod walk_through;
}
