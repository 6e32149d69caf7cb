//! PWM: the first channel of a generator that loads a value at the start of each sequence, as in embassy-nrf.

use super::events::Events;
use super::memory::Ram;

const SEQSTARTED: u32 = 2;
const SEQEND: u32 = 4;
/// Core cycles per cycle of the generator's 16 MHz clock.
const CLOCK: u64 = 4;

/// A state of the pin that begins at a given cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Cycle at which the state begins.
    pub at: u64,
    /// Port and pin of the output.
    pub pin: (u32, u32),
    /// Fraction of the time in which the pin is high.
    pub high: f64,
    /// Frequency of the output signal.
    pub period_hz: f64,
}

/// The PWM generator.
#[derive(Clone, Debug)]
pub struct Pwm {
    /// Events of this peripheral.
    pub events: Events,
    /// All changes of the pin.
    /// While the generator is off, the port controls the pin and nothing is recorded here.
    pub drives: Vec<Drive>,
    enabled: bool,
    top: u32,
    prescaler: u32,
    pointer: u32,
    count: u32,
    pin: u32,
    /// Cycle at which the sequence ends.
    due: Option<u64>,
}

impl Default for Pwm {
    fn default() -> Self {
        Self {
            events: Events::default(),
            drives: Vec::new(),
            enabled: false,
            top: 0,
            prescaler: 0,
            pointer: 0,
            count: 0,
            pin: u32::MAX,
            due: None,
        }
    }
}

impl Pwm {
    /// Resets the chip. Recorded changes are kept.
    pub fn reset(&mut self) {
        *self = Self { drives: std::mem::take(&mut self.drives), ..Self::default() };
    }

    /// Returns whether the generator and its clock are on.
    pub fn is_enabled(&self) -> bool {
        self.enabled
    }

    fn period_cycles(&self) -> u64 {
        (u64::from(self.top) << self.prescaler) * CLOCK
    }

    /// Loads the first value of the sequence.
    fn start(&mut self, now: u64, ram: &Ram) {
        // EasyDMA cannot read flash, and nothing happens if the counter has no maximum.
        let value = ram.get(self.pointer, 2).map(|bytes| u16::from_le_bytes([bytes[0], bytes[1]]));
        let (Some(value), true) = (value.filter(|_| self.count > 0), self.top >= 3) else { return };
        let (falls, below) = (value & 0x8000 != 0, f64::from(value & 0x7FFF) / f64::from(self.top));
        let below = below.min(1.0);
        let drive = Drive {
            at: now,
            pin: (self.pin >> 5 & 1, self.pin & 0x1F),
            high: if falls { below } else { 1.0 - below },
            period_hz: super::time::HZ as f64 / self.period_cycles() as f64,
        };
        if self.pin >> 31 == 0 {
            self.drives.push(drive);
        }
        self.events.fire(SEQSTARTED);
        self.due = Some(now + self.period_cycles());
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64) {
        if self.due.is_some_and(|due| due <= now) {
            self.due = None;
            self.events.fire(SEQEND);
        }
    }

    /// Returns the cycle of the next event.
    pub fn due(&self) -> Option<u64> {
        self.due
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x500 => self.enabled.into(),
            0x508 => self.top,
            0x50C => self.prescaler,
            0x520 => self.pointer,
            0x524 => self.count,
            0x560 => self.pin,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64, ram: &Ram) {
        match offset {
            0x004 if value & 1 != 0 => self.due = None,
            0x008 if value & 1 != 0 && self.enabled => self.start(now, ram),
            0x500 => self.enabled = value & 1 != 0,
            0x508 => self.top = value & 0x7FFF,
            0x50C => self.prescaler = value & 7,
            0x520 => self.pointer = value,
            0x524 => self.count = value & 0x7FFF,
            0x560 => self.pin = value,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::memory::RAM_START;
    use crate::nrf::time::us;

    fn generator(value: u16) -> (Pwm, Ram) {
        let (mut pwm, mut ram) = (Pwm::default(), Ram::default());
        ram.put(RAM_START, &value.to_le_bytes());
        for (offset, value) in
            [(0x560, 1 << 5 | 11), (0x500, 1), (0x508, 800), (0x50C, 0), (0x520, RAM_START), (0x524, 4)]
        {
            pwm.write(offset, value, 0, &ram);
        }
        (pwm, ram)
    }

    #[test]
    fn the_value_says_how_long_the_pin_is_high_by_its_polarity_and_the_sequence_ends_with_the_period() {
        for (value, high) in [(0x8000 | 200, 0.25), (200, 0.75), (0x8000, 0.0), (0x8000 | 900, 1.0)] {
            let (mut pwm, ram) = generator(value);
            pwm.write(0x008, 1, 7, &ram);
            assert_eq!(pwm.drives, [Drive { at: 7, pin: (1, 11), high, period_hz: 20_000.0 }]);
            pwm.advance(7 + us(50) - 1);
            assert!(!pwm.events.stands(SEQEND));
            pwm.advance(7 + us(50));
            assert!(pwm.events.stands(SEQEND));
        }
    }

    #[test]
    fn nothing_starts_while_it_is_off_or_out_of_flash() {
        let (mut pwm, ram) = generator(0x8000 | 200);
        pwm.write(0x500, 0, 0, &ram);
        pwm.write(0x008, 1, 0, &ram);
        pwm.write(0x500, 1, 0, &ram);
        pwm.write(0x520, 0x1_0000, 0, &ram);
        pwm.write(0x008, 1, 0, &ram);
        assert!(pwm.drives.is_empty() && pwm.due().is_none());
    }
}
