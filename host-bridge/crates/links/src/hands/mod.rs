//! Recordings that behave like boards: raw samples in, frames out, through the very code that boards run.

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

/// A board in virtual time: on the wire it looks like a real one. Its clock starts with the session.
pub trait Board {
    /// Lets the time become `now_ms`; the bytes sent meanwhile are appended to `wire`.
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>);

    /// Takes bytes from the laptop; answers are appended to `wire`.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);

    /// The reading of its sensors that it took in the last step, if any, for observers.
    fn sample(&self) -> Option<Sample<'_>> {
        None
    }

    /// The recording is over: the board is silent from now on.
    fn ended(&self) -> bool;
}
