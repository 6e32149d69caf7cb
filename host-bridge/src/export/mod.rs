//! What a session's file holds, for those who train robots (feature `mcap`; `lerobot` for parquet).
//!
//! ```text
//! FILE.mcap ─ session ─► streams over time ─ episodes ─► begun, ended ─ frames ─► rows at an even rate ─► csv, lerobot
//! ```
//!
//! A row holds what was known at its time: the newest message of each stream, which must not be older than
//! [`frames::HELD_MS`]; an episode in which one is older is refused, not filled.

pub mod csv;
pub mod episodes;
pub mod frames;
#[cfg(feature = "lerobot")]
pub mod lerobot;
pub mod session;
#[cfg(feature = "lerobot")]
mod tables;

pub use episodes::{Cut, Episode};
pub use frames::{Columns, Rows};
pub use session::{ExportError, Streams};
