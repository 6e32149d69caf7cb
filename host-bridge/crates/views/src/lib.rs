//! The observers of a session: page, terminal, Foxglove and session files, all attached to the engine's tap.

pub mod foxglove;
#[cfg(feature = "mcap")]
pub mod journal;
pub mod view;
pub mod web;
