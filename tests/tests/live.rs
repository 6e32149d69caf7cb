//! The programs at a desk with emulated boards, one binary for `cargo xtask test` to run side by side.
//! `cargo test -- --skip live::` leaves them out: each takes a minute.

#[path = "../../host-bridge/tests/support/renamed.rs"]
mod renamed;

mod live {
    mod ble;
    mod desk;
    mod ros2;
    mod walk_through;
}
