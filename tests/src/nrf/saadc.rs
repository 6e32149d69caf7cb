//! SAADC: one single-ended channel with an internal reference of 0.6 V and a gain of 1/6 (embassy-nrf's default).
//! The range is therefore 0 to 3.6 V in 12 bits.

use super::events::Events;
use super::memory::Ram;
use super::time::us;

const STARTED: u32 = 0;
const END: u32 = 1;
const CALIBRATEDONE: u32 = 4;
const STOPPED: u32 = 5;
/// Duration of acquisition and conversion.
const CONVERSION: u64 = us(12);
/// Full range in millivolts.
const FULL_SCALE_MV: f64 = 3600.0;

/// The analog converter.
#[derive(Clone, Debug, Default)]
pub struct Saadc {
    /// Events of this peripheral.
    pub events: Events,
    /// Voltages at the analog inputs in millivolts.
    pub inputs_mv: [f64; 8],
    enabled: bool,
    positive: u32,
    pointer: u32,
    amount: u32,
    due: Option<u64>,
}

impl Saadc {
    /// Resets the chip. Connected voltages are kept.
    pub fn reset(&mut self) {
        *self = Self { inputs_mv: self.inputs_mv, ..Self::default() };
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64, ram: &mut Ram) {
        if self.due.is_some_and(|due| due <= now) {
            self.due = None;
            // The value 0 means no input, and n means AIN(n − 1).
            let input = (self.positive as usize).checked_sub(1).and_then(|n| self.inputs_mv.get(n));
            let mv = input.copied().unwrap_or(0.0);
            let counts = (mv / FULL_SCALE_MV * 4096.0).round().clamp(0.0, 4095.0) as i16;
            ram.put(self.pointer, &counts.to_le_bytes());
            self.amount = 1;
            self.events.fire(END);
        }
    }

    /// Returns the cycle of the next result.
    pub fn due(&self) -> Option<u64> {
        self.due
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x500 => self.enabled.into(),
            0x510 => self.positive,
            0x62C => self.pointer,
            0x634 => self.amount,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 && self.enabled => self.events.fire(STARTED),
            0x004 if value & 1 != 0 && self.enabled => self.due = Some(now + CONVERSION),
            0x008 if value & 1 != 0 => {
                self.due = None;
                self.events.fire(STOPPED);
            }
            0x00C if value & 1 != 0 => self.events.fire(CALIBRATEDONE),
            0x500 => self.enabled = value & 1 != 0,
            0x510 => self.positive = value,
            0x62C => self.pointer = value,
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

    #[test]
    fn a_sample_of_the_chosen_input_lands_in_ram_after_the_conversion() {
        let (mut adc, mut ram) = (Saadc::default(), Ram::default());
        adc.inputs_mv[7] = 1800.0;
        for (offset, value) in [(0x500, 1), (0x510, 8), (0x62C, RAM_START), (0x000, 1), (0x004, 1)] {
            adc.write(offset, value, 0);
        }
        adc.advance(us(11), &mut ram);
        assert!(!adc.events.stands(END));
        adc.advance(us(12), &mut ram);
        assert!(adc.events.stands(END));
        assert_eq!(ram.get(RAM_START, 2), Some(&2048i16.to_le_bytes()[..]));
    }
}
