//! SAADC: one single-ended channel in 12 bits, with the internal reference of 0.6 V and a gain of 1/6 (embassy-nrf's default:
//! 0 to 3.6 V), or with a quarter of the supply and a gain of 1/4 (0 to the supply). A burst averages several conversions.

use super::events::Events;
use super::memory::Ram;
use super::time::us;

const STARTED: u32 = 0;
const END: u32 = 1;
const CALIBRATEDONE: u32 = 4;
const STOPPED: u32 = 5;
/// Duration of acquisition and conversion.
const CONVERSION: u64 = us(12);
/// Supply of the chip in millivolts.
pub const SUPPLY_MV: f64 = 3300.0;
/// Gains by their number in the register.
const GAINS: [f64; 8] = [1.0 / 6.0, 0.2, 0.25, 1.0 / 3.0, 0.5, 1.0, 2.0, 4.0];
/// Bits of a channel's configuration: reference and burst.
const QUARTER_OF_SUPPLY: u32 = 1 << 12;
const BURST: u32 = 1 << 24;

/// The analog converter.
#[derive(Clone, Debug, Default)]
pub struct Saadc {
    /// Events of this peripheral.
    pub events: Events,
    /// Voltages at the analog inputs in millivolts.
    pub inputs_mv: [f64; 8],
    enabled: bool,
    positive: u32,
    config: u32,
    oversample: u32,
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
            let counts = (mv / self.full_scale_mv() * 4096.0).round().clamp(0.0, 4095.0) as i16;
            ram.put(self.pointer, &counts.to_le_bytes());
            self.amount = 1;
            self.events.fire(END);
        }
    }

    fn full_scale_mv(&self) -> f64 {
        let reference_mv = if self.config & QUARTER_OF_SUPPLY != 0 { SUPPLY_MV / 4.0 } else { 600.0 };
        reference_mv / GAINS[self.config as usize >> 8 & 7]
    }

    fn conversions(&self) -> u64 {
        if self.config & BURST != 0 { 1 << self.oversample } else { 1 }
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
            0x518 => self.config,
            0x5F4 => self.oversample,
            0x62C => self.pointer,
            0x634 => self.amount,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 && self.enabled => self.events.fire(STARTED),
            0x004 if value & 1 != 0 && self.enabled => {
                self.due = Some(now + self.conversions() * CONVERSION);
            }
            0x008 if value & 1 != 0 => {
                self.due = None;
                self.events.fire(STOPPED);
            }
            0x00C if value & 1 != 0 => self.events.fire(CALIBRATEDONE),
            0x500 => self.enabled = value & 1 != 0,
            0x510 => self.positive = value,
            0x518 => self.config = value,
            0x5F4 => self.oversample = value & 0xF,
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

    #[test]
    fn relative_to_the_supply_a_burst_takes_eight_conversions() {
        let (mut adc, mut ram) = (Saadc::default(), Ram::default());
        adc.inputs_mv[1] = SUPPLY_MV / 4.0;
        let channel = QUARTER_OF_SUPPLY | BURST | 2 << 8;
        for (offset, value) in
            [(0x500, 1), (0x510, 2), (0x518, channel), (0x5F4, 3), (0x62C, RAM_START), (0x000, 1), (0x004, 1)]
        {
            adc.write(offset, value, 0);
        }
        assert_eq!(adc.due(), Some(us(96)));
        adc.advance(us(96), &mut ram);
        assert_eq!(ram.get(RAM_START, 2), Some(&1024i16.to_le_bytes()[..]));
    }
}
