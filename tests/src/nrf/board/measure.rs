//! Measurements for tests: calls of functions in instructions, with the contents of registers and memory.

use super::Board;

/// One measured call of a function.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Cycle at the start of the call.
    pub at: u64,
    /// Number of executed instructions, without those of interrupts.
    pub instructions: u64,
    /// Number of written bytes below the stack pointer of the call; 0 unless [requested](Board::probe_stack).
    pub stack_bytes: u32,
}

/// A measured call under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Open {
    pub(super) back: u32,
    pub(super) probe: usize,
    pub(super) at: u64,
    pub(super) instructions_before: u64,
    pub(super) stack_pointer: u32,
}

/// Number of painted bytes below the stack pointer, for measuring the depth of a call.
pub(super) const PAINTED: usize = 2048;
pub(super) const PAINT: u8 = 0x6B;

/// The data of a tap at one call.
#[derive(Clone, Debug)]
pub struct Tapped {
    /// Cycle of the call.
    pub at: u64,
    /// Registers r0 to r3.
    pub registers: [u32; 4],
    /// Bytes behind r0.
    pub bytes: Vec<u8>,
}

impl Board {
    /// Measures every call of a function from now on.
    pub fn probe(&mut self, function: &str) -> usize {
        let address = self.image.function(function);
        let world = self.uc.get_data_mut();
        world.calls.push(Vec::new());
        world.probes.push((address, world.calls.len() - 1));
        world.calls.len() - 1
    }

    /// Like [`Self::probe`], and also measures the stack depth.
    /// If such functions call each other, the depth of the outer one before the call is lost.
    pub fn probe_stack(&mut self, function: &str) -> usize {
        let probe = self.probe(function);
        self.uc.get_data_mut().painting.push(probe);
        probe
    }

    /// Calls measured so far.
    pub fn calls(&self, probe: usize) -> &[Call] {
        &self.uc.get_data().calls[probe]
    }

    /// Records the arguments of a function at every call from now on, and `len` bytes at the first one.
    pub fn tap(&mut self, function: &str, len: usize) -> usize {
        let address = self.image.function(function);
        let world = self.uc.get_data_mut();
        world.tapped.push(Vec::new());
        world.taps.push((address, world.tapped.len() - 1, len));
        world.tapped.len() - 1
    }

    /// Returns the data of a tap so far.
    pub fn tapped(&self, tap: usize) -> &[Tapped] {
        &self.uc.get_data().tapped[tap]
    }
}
