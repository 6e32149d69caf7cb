//! What tests look at: calls of functions, counted in instructions, and what was in registers and memory then.

use super::Board;

/// One measured call of a function.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Cycle at which it began.
    pub at: u64,
    /// Executed instructions, those of interrupts in between left out.
    pub instructions: u64,
    /// Bytes below the stack pointer of the call that were written to; 0 unless [asked for](Board::probe_stack).
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

/// Bytes below the stack pointer that are painted to see how deep a call goes.
pub(super) const PAINTED: usize = 2048;
pub(super) const PAINT: u8 = 0x6B;

/// What a tap saw at one call.
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

    /// As [`Self::probe`], and measures how deep the stack gets. If such functions call each other, what the outer one
    /// did before the call is forgotten.
    pub fn probe_stack(&mut self, function: &str) -> usize {
        let probe = self.probe(function);
        self.uc.get_data_mut().painting.push(probe);
        probe
    }

    /// Calls measured so far.
    pub fn calls(&self, probe: usize) -> &[Call] {
        &self.uc.get_data().calls[probe]
    }

    /// Records arguments of a function at every call from now on, and `len` bytes behind the first one.
    pub fn tap(&mut self, function: &str, len: usize) -> usize {
        let address = self.image.function(function);
        let world = self.uc.get_data_mut();
        world.tapped.push(Vec::new());
        world.taps.push((address, world.tapped.len() - 1, len));
        world.tapped.len() - 1
    }

    /// What a tap has seen so far.
    pub fn tapped(&self, tap: usize) -> &[Tapped] {
        &self.uc.get_data().tapped[tap]
    }
}
