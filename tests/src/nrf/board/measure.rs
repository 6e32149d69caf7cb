//! Measurements for tests: instructions per function call, and the contents of registers and memory.

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

/// A call that is being measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Open {
    pub(super) back: u32,
    pub(super) probe: usize,
    pub(super) at: u64,
    pub(super) instructions_before: u64,
    pub(super) stack_pointer: u32,
}

/// Number of bytes below the stack pointer that are filled with a pattern, for measuring the depth of a call.
pub(super) const PAINTED: usize = 2048;
pub(super) const PAINT: u8 = 0x6B;

/// The data of a tap at one call.
#[derive(Clone, Debug)]
pub struct Tapped {
    /// Cycle at the start of the call.
    pub at: u64,
    /// Values of the registers r0 to r3.
    pub registers: [u32; 4],
    /// Bytes to which r0 points.
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
    /// If measured functions call each other, the depth of the outer function up to that call is lost.
    pub fn probe_stack(&mut self, function: &str) -> usize {
        let probe = self.probe(function);
        self.uc.get_data_mut().painting.push(probe);
        probe
    }

    /// Returns the calls measured so far.
    pub fn calls(&self, probe: usize) -> &[Call] {
        &self.uc.get_data().calls[probe]
    }

    /// From now on, records the arguments of every call of a function, and `len` bytes to which r0 points.
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

    /// From now on, records where the image panics.
    pub fn tap_panics(&mut self) -> Option<usize> {
        let handler = self.image.functions_with(&["rust_begin_unwind"]).pop()?;
        Some(self.tap(&handler, 8))
    }

    /// Returns the places in the source at which the image has panicked.
    pub fn panics(&self, tap: usize) -> Vec<String> {
        let text = |place: u32| -> Option<String> {
            let (start, len) = (self.image.word(place)?, self.image.word(place + 4)?);
            let line = self.image.word(place + 8)?;
            let bytes: Vec<u8> = (start..start.checked_add(len)?)
                .map_while(|at| Some(self.image.word(at & !3)?.to_le_bytes()[at as usize & 3]))
                .collect();
            Some(format!("{}:{line}", String::from_utf8(bytes).ok()?))
        };
        let place = |call: &Tapped| {
            let words = call.bytes.chunks_exact(4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]));
            words.filter(|word| word & 3 == 0).find_map(text).unwrap_or_else(|| "nowhere known".into())
        };
        self.tapped(tap).iter().map(place).collect()
    }
}
