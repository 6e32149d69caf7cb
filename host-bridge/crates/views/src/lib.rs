//! The observers: the page, the terminal, Foxglove and session files. Each is an output on the engine's one tap.

pub mod foxglove;
#[cfg(feature = "mcap")]
pub mod journal;
pub mod view;
pub mod web;
