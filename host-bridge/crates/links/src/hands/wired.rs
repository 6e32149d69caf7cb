//! A board behind a simulated serial line.

use host_core::observe::Sample;
use host_core::source::HandSource;

use super::Board;
use crate::wire::{Pipe, SERIAL_115200};

/// A board with both directions of its line.
pub struct Wired<B> {
    board: B,
    up: Pipe,
    down: Pipe,
}

impl<B: Board> Wired<B> {
    /// A line at 115200 baud.
    pub fn new(board: B) -> Self {
        Wired { board, up: Pipe::new(SERIAL_115200), down: Pipe::new(SERIAL_115200) }
    }
}

impl<B: Board + Send> HandSource for Wired<B> {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        let mut bytes = Vec::new();
        self.down.step(&mut bytes);
        let mut answer = Vec::new();
        self.board.receive(&bytes, now_ms, &mut answer);
        self.board.step(now_ms, &mut answer);
        self.up.write(&answer);
        self.up.step(wire);
    }

    fn receive(&mut self, bytes: &[u8], _now_ms: u64, _wire: &mut Vec<u8>) {
        self.down.write(bytes);
    }

    fn sample(&self) -> Option<Sample<'_>> {
        self.board.sample()
    }

    fn ended(&self) -> bool {
        self.board.ended()
    }
}
