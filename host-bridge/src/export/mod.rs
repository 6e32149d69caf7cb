//! Exports session files for training robots (feature `mcap`; for Parquet files, feature `lerobot`).
//!
//! ```text
//! FILE.mcap ─ session ─► streams over time ─ episodes ─► begun, ended ─ frames ─► rows at an even rate ─► csv, lerobot
//! ```
//!
//! A row contains each stream's newest message at the row's time.
//! The message is at most [`frames::HELD_MS`] old.
//! An episode with older messages is refused; nothing is interpolated.

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
