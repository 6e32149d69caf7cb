//! What runs at the pace of the wall clock: the program with boards behind pseudo-terminals.
//! `cargo test -- --skip live::` leaves it out.
#![cfg(unix)]

#[path = "support/double.rs"]
mod double;

mod live {
    mod desk;
}
