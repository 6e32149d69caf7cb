//! Simulates a BMM150 in the field of a [`Motion`]: power bit, trimming values, and 13- and 15-bit readings.
//! The motion uses the chip's axes, because the chip's orientation on a Rev2 is unknown.
//!
//! The simulation follows the data sheet (BST-BMM150-DS001).
//! A field is converted to counts by the inverse of the maker's compensation.

use nano33_sensor::bmm150::Trim;

use super::lsm9ds1::Motion;
use super::registers::{Chip, Registers};
use super::time::{HZ, ms};

const START: u64 = ms(3);
const POWER: u8 = 0x4B;
const MODE: u8 = 0x4C;

/// The simulated chip.
pub struct Bmm150 {
    registers: Registers,
    trim: Trim,
    /// Resistance of the Hall plates, which depends on their temperature.
    pub hall: u16,
    next: Option<f64>,
}

impl Bmm150 {
    /// Returns a chip after power-up with these trimming values.
    pub fn new(motion: Box<dyn Motion>, trim: Trim) -> Self {
        let mut chip = Self { registers: Registers::new(motion), trim, hall: trim.xyz1, next: None };
        chip.reset();
        chip
    }

    fn has_power(&self) -> bool {
        self.registers.get(POWER) & 1 != 0
    }

    fn period(&self) -> Option<f64> {
        let mode = self.registers.get(MODE);
        let hz = [10.0, 2.0, 6.0, 8.0, 15.0, 20.0, 25.0, 30.0][usize::from(mode >> 3) & 7];
        (self.has_power() && mode & 6 == 0).then_some(self.registers.clock_ratio / hz)
    }

    /// Returns the counts from which the compensation computes this field.
    fn counts(&self, [x, y, z]: [f64; 3]) -> [i16; 3] {
        let t = self.trim;
        let (hall, reference) = (f64::from(self.hall), f64::from(t.xyz1));
        let far = 16384.0 * reference / hall - 16384.0;
        let gain = f64::from(t.xy2) * far * far / 268_435_456.0 + far * f64::from(t.xy1) / 16384.0 + 256.0;
        let flat = |field: f64, slope: i8, offset: i8| {
            (16.0 * field - 8.0 * f64::from(offset)) * 8192.0 / gain / (f64::from(slope) + 160.0)
        };
        let upright = (64.0 * z * (f64::from(t.z2) + f64::from(t.z1) * hall / 32768.0)
            + f64::from(t.z3) * (hall - reference))
            / 131_072.0
            + f64::from(t.z4);
        let within = |counts: f64, limit: f64, overflow: i16| {
            if counts.round().abs() < limit { counts.round() as i16 } else { overflow }
        };
        [
            within(flat(x, t.x2, t.x1), 4096.0, -4096),
            within(flat(y, t.y2, t.y1), 4096.0, -4096),
            within(upright, 16384.0, -16384),
        ]
    }

    fn measure(&mut self, at: f64) {
        let v = self.registers.motion.at(at);
        let [x, y, z] = self.counts([v[6], v[7], v[8]]);
        let words = [x << 3, y << 3, z << 1, (self.hall << 2) as i16 | 1];
        for (register, byte) in (0x42..).zip(words.into_iter().flat_map(i16::to_le_bytes)) {
            self.registers.set(register, byte);
        }
        self.registers.sets += 1;
    }
}

impl Chip for Bmm150 {
    const ADDRESS: u8 = 0x10;

    fn registers(&self) -> &Registers {
        &self.registers
    }

    fn registers_mut(&mut self) -> &mut Registers {
        &mut self.registers
    }

    fn reset(&mut self) {
        self.registers.reset(&[(0x40, 0x32), (MODE, 0x06)]);
        self.next = None;
        let t = self.trim;
        let put = |registers: &mut Registers, at: u8, bytes: &[u8]| {
            for (register, &byte) in (at..).zip(bytes) {
                registers.set(register, byte);
            }
        };
        put(&mut self.registers, 0x5D, &[t.x1 as u8, t.y1 as u8]);
        put(&mut self.registers, 0x62, &t.z4.to_le_bytes());
        put(&mut self.registers, 0x64, &[t.x2 as u8, t.y2 as u8]);
        put(&mut self.registers, 0x68, &t.z2.to_le_bytes());
        put(&mut self.registers, 0x6A, &t.z1.to_le_bytes());
        put(&mut self.registers, 0x6C, &t.xyz1.to_le_bytes());
        put(&mut self.registers, 0x6E, &t.z3.to_le_bytes());
        put(&mut self.registers, 0x70, &[t.xy2 as u8, t.xy1]);
    }

    fn advance(&mut self, now: u64) {
        let seconds = now as f64 / HZ as f64;
        while let (Some(at), Some(period)) = (self.next, self.period()) {
            if at > seconds {
                break;
            }
            self.measure(at);
            self.next = Some(at + period);
        }
    }

    fn written(&mut self, register: u8, value: u8, now: u64) {
        match register {
            POWER if value & 0x82 != 0 => {
                // A soft reset does not clear the power bit.
                self.reset();
                self.registers.set(POWER, value & 1);
                self.registers.busy_until = now + START;
            }
            POWER => {
                if value & 1 != 0 && !self.has_power() {
                    self.registers.busy_until = now + START;
                }
                self.registers.set(POWER, value);
            }
            _ if !self.has_power() => {}
            0x4C..=0x52 => {
                self.registers.set(register, value);
                let seconds = now as f64 / HZ as f64;
                self.next = self.period().map(|period| seconds + period);
            }
            _ => {}
        }
    }

    /// In suspend mode, only the power register can be read.
    fn read(&mut self, register: u8) -> u8 {
        let value = if self.has_power() || register == POWER { self.registers.get(register) } else { 0 };
        // Data that was already read is no longer new.
        if register == 0x48 {
            self.registers.set(0x48, value & !1);
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::registers::tests::{get, set};

    struct Field([f64; 3]);
    impl Motion for Field {
        fn at(&self, _: f64) -> [f64; 9] {
            let [x, y, z] = self.0;
            [0.0, 0.0, 9.8, 0.0, 0.0, 0.0, x, y, z]
        }
    }

    fn running(field: [f64; 3]) -> (Bmm150, u64) {
        let mut chip = Bmm150::new(Box::new(Field(field)), Trim::TYPICAL);
        set(&mut chip, &[(POWER, 1)], 0);
        set(&mut chip, &[(0x51, 4), (0x52, 7), (MODE, 0x38)], START);
        (chip, START)
    }

    #[test]
    fn without_its_power_bit_nothing_is_there_and_it_takes_3_ms() {
        let mut chip = Bmm150::new(Box::new(Field([0.0; 3])), Trim::TYPICAL);
        assert_eq!(get(&mut chip, 0x40, 0), [0]);
        set(&mut chip, &[(MODE, 0x38), (POWER, 1)], 0);
        set(&mut chip, &[(0x51, 4)], START - 1);
        assert_eq!(get(&mut chip, 0x40, START), [0x32]);
        assert_eq!([get(&mut chip, MODE, START), get(&mut chip, 0x51, START)], [[0x06], [0]]);
        // The trimming values are at the addresses in the data sheet.
        // The test reads those of x and y, those of z, and all others.
        assert_eq!(get(&mut chip, 0x64, START), [26, 26]);
        assert_eq!(get(&mut chip, 0x6A, START), 24_747u16.to_le_bytes());
        assert_eq!(get(&mut chip, 0x70, START), [0xFD, 29]);
        set(&mut chip, &[(0x51, 4), (POWER, 0x83)], START);
        assert_eq!(get(&mut chip, 0x51, 2 * START), [0], "a soft reset");
        assert_eq!(get(&mut chip, 0x40, 2 * START), [0x32], "and it still has power");
    }

    #[test]
    fn thirty_times_a_second_a_reading_is_new_and_reads_as_the_data_sheets_counts() {
        // At the trimmed temperature, 100 counts of x or y are 36.328 uT, and 300 counts of z are 104.793 uT.
        let (mut chip, start) = running([36.328, -72.656, 104.793]);
        assert_eq!(get::<8>(&mut chip, 0x42, start + ms(33))[6] & 1, 0);
        let bytes: [u8; 8] = get(&mut chip, 0x42, start + ms(34));
        let word = |i: usize| i16::from_le_bytes([bytes[i], bytes[i + 1]]);
        assert_eq!([word(0) >> 3, word(2) >> 3, word(4) >> 1, word(6) >> 2], [100, -200, 300, 6753]);
        assert_eq!(bytes[6] & 1, 1);
        assert_eq!(get::<1>(&mut chip, 0x48, start + ms(35))[0] & 1, 0, "read once");
        let _: [u8; 8] = get(&mut chip, 0x42, start + ms(1001));
        assert_eq!(chip.registers.sets, 30);
    }

    #[test]
    fn a_magnet_reads_as_overflow_of_its_axis() {
        // The data sheet's range is 1300 uT for x and y, and 2500 uT for z. The converter has a slightly larger range.
        let (mut chip, start) = running([1300.0, -1300.0, 2500.0]);
        let bytes: [u8; 8] = get(&mut chip, 0x42, start + ms(40));
        assert_ne!([bytes[0] & 0xF8, bytes[1]], [0, 0x80]);
        let (mut chip, start) = running([-1500.0, 10.0, 5800.0]);
        let bytes: [u8; 6] = get(&mut chip, 0x42, start + ms(40));
        assert_eq!([bytes[0] & 0xF8, bytes[1]], [0, 0x80]);
        assert_ne!([bytes[2] & 0xF8, bytes[3]], [0, 0x80]);
        assert_eq!([bytes[4] & 0xFE, bytes[5]], [0, 0x80]);
    }
}
