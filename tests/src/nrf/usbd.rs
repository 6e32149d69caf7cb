//! USBD, to come: absent from the bus until a host is attached.

use super::events::Events;
use super::memory::Ram;

/// The USB device controller.
#[derive(Clone, Debug, Default)]
pub struct Usbd {
    /// Events.
    pub events: Events,
    registers: std::collections::HashMap<u32, u32>,
}

impl Usbd {
    /// After a reset of the chip.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Raises what is due by now.
    pub fn advance(&mut self, _now: u64, _ram: &mut Ram) {}

    /// Cycle of the next change.
    pub fn due(&self) -> Option<u64> {
        None
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        self.events.read(offset).unwrap_or_else(|| self.registers.get(&offset).copied().unwrap_or(0))
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, _now: u64, _ram: &mut Ram) {
        if !self.events.write(offset, value) {
            self.registers.insert(offset, value);
        }
    }
}
