//! Simulates an LSM6DS3TR-C that is moved by a [`Motion`] in the chip's axes: registers and a FIFO of words.
//!
//! The simulation follows the data sheet (ST DocID030071) and AN5130.

use std::collections::VecDeque;

use super::lsm9ds1::Motion;
use super::registers::{Chip, Registers};
use super::time::{HZ, us};

/// Capacity of the FIFO in words, which is also the maximum of its counter.
const FIFO_WORDS: usize = 2047;
const RESET: u64 = us(50);
const CTRL3_C: u8 = 0x12;
/// If this bit is set, a transfer continues with the next register.
const INCREMENTS: u8 = 0x04;
/// Time from the start of the gyroscope to its first value.
const GYRO_START_SECONDS: f64 = 0.035;

/// The simulated sensor.
pub struct Lsm6ds3 {
    registers: Registers,
    /// Words of complete sets, each with the gyroscope first and the accelerometer second.
    fifo: VecDeque<i16>,
    overrun: bool,
    next_set: Option<f64>,
    gyro_since: f64,
}

impl Lsm6ds3 {
    /// Returns a sensor after power-up.
    pub fn new(motion: Box<dyn Motion>) -> Self {
        let mut sensor = Self {
            registers: Registers::new(motion),
            fifo: VecDeque::new(),
            overrun: false,
            next_set: None,
            gyro_since: 0.0,
        };
        sensor.reset();
        sensor
    }

    fn register(&self, register: u8) -> u8 {
        self.registers.get(register)
    }

    /// Returns `None` if a sensor is off, or if the two sensors do not have the same rate.
    fn period(&self) -> Option<f64> {
        let hz = match (self.register(0x10) >> 4, self.register(0x11) >> 4) {
            (4, 4) => 104.0,
            (5, 5) => 208.0,
            (6, 6) => 416.0,
            _ => return None,
        };
        Some(self.registers.clock_ratio / hz)
    }

    fn clip(value: f64) -> i16 {
        value.round() as i16
    }

    fn set(&self, at: f64) -> [i16; 6] {
        let v = self.registers.motion.at(at);
        // The ranges are ±2, ±16, ±4, ±8 g, and ±250, 500, 1000, 2000 deg/s; a separate bit selects ±125 deg/s.
        let mg = [0.061, 0.488, 0.122, 0.244][usize::from(self.register(0x10) >> 2) & 3];
        let mdps = if self.register(0x11) & 2 != 0 {
            4.375
        } else {
            [8.75, 17.5, 35.0, 70.0][usize::from(self.register(0x11) >> 2) & 3]
        };
        let turned_on = at >= self.gyro_since + GYRO_START_SECONDS;
        std::array::from_fn(|i| match i {
            0..3 if turned_on => Self::clip(v[3 + i] / (mdps * 1e-3)),
            0..3 => 0,
            _ => Self::clip(v[i - 3] / (mg * 1e-3 * 9.80665)),
        })
    }
}

impl Chip for Lsm6ds3 {
    const ADDRESS: u8 = 0x6A;

    fn registers(&self) -> &Registers {
        &self.registers
    }

    fn registers_mut(&mut self) -> &mut Registers {
        &mut self.registers
    }

    fn reset(&mut self) {
        self.registers.reset(&[(0x0F, 0x6A), (CTRL3_C, INCREMENTS)]);
        self.fifo.clear();
        self.overrun = false;
        self.next_set = None;
    }

    fn advance(&mut self, now: u64) {
        let seconds = now as f64 / HZ as f64;
        while let (Some(at), Some(period)) = (self.next_set, self.period()) {
            if at > seconds {
                break;
            }
            self.registers.sets += 1;
            let control = self.register(0x0A);
            // The FIFO must be in continuous mode with a rate, and contain both sensors without decimation.
            if control & 7 == 6 && control >> 3 & 0xF != 0 && self.register(0x08) & 0x3F == 0x09 {
                if self.fifo.len() + 6 > FIFO_WORDS {
                    self.fifo.drain(..6);
                    self.overrun = true;
                }
                let set = self.set(at);
                self.fifo.extend(set);
            }
            self.next_set = Some(at + period);
        }
    }

    fn written(&mut self, register: u8, value: u8, now: u64) {
        match register {
            0x0F | 0x1E | 0x20..=0x2D | 0x3A..=0x3F => {}
            CTRL3_C if value & 1 != 0 => {
                self.reset();
                self.registers.busy_until = now + RESET;
            }
            _ => {
                self.registers.set(register, value);
                let seconds = now as f64 / HZ as f64;
                match register {
                    0x10 | 0x11 => {
                        self.next_set = self.period().map(|period| seconds + period);
                        self.gyro_since = seconds;
                    }
                    0x0A if value & 7 == 0 => {
                        self.fifo.clear();
                        self.overrun = false;
                    }
                    _ => {}
                }
            }
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        let words = self.fifo.len() as u16;
        match register {
            0x3A => words.to_le_bytes()[0],
            0x3B => {
                let empty = u8::from(words == 0) << 4;
                words.to_le_bytes()[1] & 7 | empty | u8::from(self.overrun) << 6
            }
            // Position of the next word in a set.
            0x3C => ((6 - words % 6) % 6) as u8,
            0x3E => self.fifo.front().copied().unwrap_or(0).to_le_bytes()[0],
            0x3F => self.fifo.pop_front().unwrap_or(0).to_le_bytes()[1],
            _ => self.register(register),
        }
    }

    fn next(&self, register: u8) -> u8 {
        match register {
            _ if self.register(CTRL3_C) & INCREMENTS == 0 => register,
            // A burst read stays at the FIFO's output register.
            0x3F => 0x3E,
            register => (register + 1) & 0x7F,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::lsm9ds1::Still;
    use crate::nrf::registers::tests::{get, set};
    use crate::nrf::time::ms;

    fn running(motion: Box<dyn Motion>) -> Lsm6ds3 {
        let mut sensor = Lsm6ds3::new(motion);
        set(&mut sensor, &[(0x12, 0x44), (0x08, 0x09), (0x0A, 0x2E), (0x10, 0x58), (0x11, 0x5C)], 0);
        sensor
    }

    struct Moved;
    impl Motion for Moved {
        fn at(&self, _: f64) -> [f64; 9] {
            [1.0, 50.0, -9.80665, 100.0, 0.0, -2500.0, 0.0, 0.0, 0.0]
        }
    }

    #[test]
    fn identity_and_reset_values_are_the_data_sheets() {
        let mut sensor = Lsm6ds3::new(Box::new(Still));
        assert_eq!(get(&mut sensor, 0x0F, 0), [0x6A]);
        assert_eq!(get(&mut sensor, 0x10, 0), [0, 0, 0x04]);
    }

    #[test]
    fn the_fifo_gives_gyroscope_then_accelerometer_scaled_and_clipped() {
        let mut sensor = running(Box::new(Moved));
        // At 208 Hz, there are 20 sets of six words in 100 ms, so the FIFO is aligned and not empty.
        assert_eq!(get(&mut sensor, 0x3A, ms(100)), [120, 0, 0, 0]);
        let bytes: [u8; 240] = get(&mut sensor, 0x3E, ms(100));
        let set = |n: usize| -> Vec<i16> {
            bytes[12 * n..12 * n + 12].chunks(2).map(|c| i16::from_le_bytes([c[0], c[1]])).collect()
        };
        // The gyroscope starts within 35 ms.
        assert_eq!(set(0)[..3], [0; 3]);
        assert_eq!(set(19), [1429, 0, i16::MIN, 836, i16::MAX, -8197]);
        assert_eq!(get(&mut sensor, 0x3A, ms(100)), [0, 0x10, 0, 0]);
    }

    #[test]
    fn the_fifo_says_how_far_it_is_in_a_set_and_that_some_are_lost() {
        let mut sensor = running(Box::new(Still));
        let _: [u8; 4] = get(&mut sensor, 0x3E, ms(10));
        assert_eq!(get(&mut sensor, 0x3A, ms(10)), [10, 0, 2, 0]);
        let mut sensor = running(Box::new(Still));
        let [low, high, ..] = get::<4>(&mut sensor, 0x3A, ms(3000));
        assert_eq!(u16::from_le_bytes([low, high & 7]) / 6, 341);
        assert_eq!(high & 0x40, 0x40);
        set(&mut sensor, &[(0x0A, 0x00)], ms(3000));
        assert_eq!(get(&mut sensor, 0x3A, ms(3000)), [0, 0x10, 0, 0]);
    }
}
