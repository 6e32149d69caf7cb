//! Plays recordings as boards: converts raw samples to frames by the same code that boards run.

mod delayed;
mod left;
mod right;
pub mod virtual_board;
mod wired;

pub use delayed::Delayed;
pub use left::{LeftBoard, refused_at_start};
pub use right::{Joined, ModelFile, ModelFileError, RightBoard, join};
pub use wired::Wired;

use host_core::observe::Sample;

/// A board in virtual time that behaves like a real one on the wire. Its clock starts with the session.
pub trait Board {
    /// Advances the time to `now_ms`, and appends the sent bytes to `wire`.
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>);

    /// Processes bytes from the laptop, and appends answers to `wire`.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);

    /// Returns the sensor sample of the last step for observers, if there was one.
    fn sample(&self) -> Option<Sample<'_>> {
        None
    }

    /// Returns whether the recording has ended. The board is silent from then on.
    fn ended(&self) -> bool;
}
