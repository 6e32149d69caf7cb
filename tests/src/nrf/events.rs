//! The common parts of all nRF peripherals: events, interrupt enable bits, shortcuts.

/// The registers EVENTS_* (0x100…), INTEN, INTENSET, INTENCLR and SHORTS of one peripheral.
///
/// The number of an event, `(offset - 0x100) / 4`, is also its bit in INTEN, in every peripheral of this chip.
#[derive(Clone, Debug, Default)]
pub struct Events {
    happened: u64,
    enabled: u32,
    /// The shortcut register SHORTS.
    pub shorts: u32,
    fired: Vec<u32>,
}

impl Events {
    /// Raises an event.
    pub fn fire(&mut self, event: u32) {
        self.happened |= 1 << event;
        self.fired.push(event);
    }

    /// Returns whether the event is set.
    pub fn stands(&self, event: u32) -> bool {
        self.happened & (1 << event) != 0
    }

    /// Returns whether the event's interrupt is enabled.
    pub fn is_enabled(&self, event: u32) -> bool {
        event < 32 && self.enabled & (1 << event) != 0
    }

    /// Returns the level of the interrupt line.
    pub fn irq(&self) -> bool {
        self.happened & u64::from(self.enabled) != 0
    }

    /// Returns whether there are events for the PPI.
    pub fn has_fired(&self) -> bool {
        !self.fired.is_empty()
    }

    /// Returns the events raised since the last call, for the PPI.
    pub fn take_fired(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.fired)
    }

    /// Reads a register of this block, if there is one at the offset.
    pub fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x100..=0x1FC => u32::from(self.stands((offset - 0x100) / 4)),
            0x200 => self.shorts,
            0x300 | 0x304 | 0x308 => self.enabled,
            _ => return None,
        })
    }

    /// Writes a register of this block. Returns false if the offset has no register.
    pub fn write(&mut self, offset: u32, value: u32) -> bool {
        match offset {
            0x100..=0x1FC => {
                let bit = 1 << ((offset - 0x100) / 4);
                if value & 1 == 0 {
                    self.happened &= !bit;
                } else {
                    self.happened |= bit;
                }
            }
            0x200 => self.shorts = value,
            0x300 => self.enabled = value,
            0x304 => self.enabled |= value,
            0x308 => self.enabled &= !value,
            _ => return false,
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupt_needs_the_event_and_its_enable_bit_and_ends_when_the_event_is_cleared() {
        let mut events = Events::default();
        events.fire(16);
        assert!(!events.irq());
        events.write(0x304, 1 << 16);
        assert!(events.irq());
        assert_eq!(events.read(0x140), Some(1));
        events.write(0x140, 0);
        assert!(!events.irq());
        assert_eq!(events.take_fired(), [16]);
        assert_eq!(events.read(0x308), Some(1 << 16));
        events.write(0x308, 1 << 16);
        assert_eq!(events.read(0x300), Some(0));
    }
}
