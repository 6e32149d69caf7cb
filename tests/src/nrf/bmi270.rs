//! Simulates a BMI270 moved by a [`Motion`]: registers, upload of the configuration, headerless FIFO and error register.
//!
//! The simulation follows the data sheet (BST-BMI270-DS000).
//! The sensor's axes are those of a Rev2 board. In terms of the Rev1's raw axes, x = −y, y = −x and z = z.
//! A [`Motion`] uses the Rev1's axes.

use std::collections::VecDeque;

use super::lsm9ds1::Motion;
use super::registers::{Chip, Registers};
use super::time::{HZ, ms, us};

/// CRC-32 of Bosch's configuration file of 8192 bytes.
const CONFIGURATION_CRC: u32 = 0x229a1189;
const CONFIGURATION_BYTES: usize = 8192;
const SET_BYTES: usize = 12;
/// Size of the FIFO: 2 KB.
const FIFO_SETS: usize = 2048 / SET_BYTES;

/// Durations of three actions: leaving power-save mode, a reset, and the start of the loaded program.
const WAKE: u64 = us(450);
const RESET: u64 = ms(2);
const INITIALISE: u64 = ms(20);
/// Time from the start of the gyroscope to its first value.
const GYRO_START_SECONDS: f64 = 0.045;

const FIFO_LENGTH: u8 = 0x24;
const FIFO_DATA: u8 = 0x26;
const INIT_CTRL: u8 = 0x59;
const INIT_DATA: u8 = 0x5E;
const POWER_CONF: u8 = 0x7C;
const POWER_CTRL: u8 = 0x7D;
const COMMAND: u8 = 0x7E;

/// The simulated sensor.
pub struct Bmi270 {
    registers: Registers,
    configuration: Vec<u8>,
    /// Position at which the next byte of the configuration is stored.
    place: usize,
    /// Cycle at which power-save mode ended.
    awake_since: u64,
    /// Time at which the loaded program has started or failed.
    starts: Option<u64>,
    fifo: VecDeque<[u8; SET_BYTES]>,
    /// Number of bytes that the current transfer has read from the FIFO.
    from_fifo: usize,
    next_set: Option<f64>,
    gyro_since: Option<f64>,
}

impl Bmi270 {
    /// Returns a sensor after power-up.
    pub fn new(motion: Box<dyn Motion>) -> Self {
        let mut sensor = Self {
            registers: Registers::new(motion),
            configuration: Vec::new(),
            place: 0,
            awake_since: 0,
            starts: None,
            fifo: VecDeque::new(),
            from_fifo: 0,
            next_set: None,
            gyro_since: None,
        };
        sensor.reset();
        sensor
    }

    fn register(&self, register: u8) -> u8 {
        self.registers.get(register)
    }

    fn is_initialised(&self) -> bool {
        self.register(0x21) & 0xF == 1 && self.register(0x02) & 1 == 0
    }

    /// Returns `None` if a sensor is off, or if the two sensors do not have the same rate.
    fn period(&self) -> Option<f64> {
        let hz = match (self.register(0x40) & 0xF, self.register(0x42) & 0xF) {
            (8, 8) => 100.0,
            (9, 9) => 200.0,
            (10, 10) => 400.0,
            _ => return None,
        };
        let on = self.register(POWER_CTRL) & 0x06 == 0x06 && self.is_initialised();
        on.then_some(self.registers.clock_ratio / hz)
    }

    fn clip(value: f64) -> i16 {
        value.round() as i16
    }

    fn set(&self, at: f64) -> [u8; SET_BYTES] {
        let v = self.registers.motion.at(at);
        let turn = |v: &[f64]| [-v[1], -v[0], v[2]];
        let g = f64::from(2 << (self.register(0x41) & 3));
        let dps = 2000.0 / f64::from(1 << (self.register(0x43) & 7));
        let accel = turn(&v[..3]).map(|v| Self::clip(v / 9.80665 / g * 32_768.0));
        let gyro = if self.gyro_since.is_some_and(|since| at < since + GYRO_START_SECONDS) {
            [i16::MIN; 3]
        } else {
            turn(&v[3..6]).map(|v| Self::clip(v / dps * 32_768.0))
        };
        let mut bytes = [0; SET_BYTES];
        for (place, value) in bytes.chunks_exact_mut(2).zip(gyro.into_iter().chain(accel)) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }
}

impl Chip for Bmi270 {
    const ADDRESS: u8 = 0x68;

    fn registers(&self) -> &Registers {
        &self.registers
    }

    fn registers_mut(&mut self) -> &mut Registers {
        &mut self.registers
    }

    fn reset(&mut self) {
        self.registers.reset(&[
            (0x00, 0x24),
            (0x40, 0xA8),
            (0x41, 0x02),
            (0x42, 0xA9),
            (0x48, 0x02),
            (0x49, 0x10),
            (0x59, 0x90),
            (POWER_CONF, 0x03),
        ]);
        self.configuration = vec![0; CONFIGURATION_BYTES];
        self.starts = None;
        self.fifo.clear();
        self.next_set = None;
        self.gyro_since = None;
    }

    fn advance(&mut self, now: u64) {
        if self.starts.is_some_and(|at| at <= now) {
            self.starts = None;
            let good = shared_dsp::right::network::crc32(&self.configuration) == CONFIGURATION_CRC;
            // The status contains the state or error of the initialisation, and the state of the sensor's processor.
            self.registers.set(0x21, if good { 1 } else { 2 });
            self.registers.set(0x02, self.register(0x02) | if good { 0 } else { 1 << 1 });
        }
        let seconds = now as f64 / HZ as f64;
        while let (Some(at), Some(period)) = (self.next_set, self.period()) {
            if at > seconds {
                break;
            }
            self.registers.sets += 1;
            // The FIFO must be headerless and contain both sensors.
            if self.register(0x49) & 0xD0 == 0xC0 {
                if self.fifo.len() == FIFO_SETS {
                    self.fifo.pop_front();
                }
                let set = self.set(at);
                self.fifo.push_back(set);
            }
            self.next_set = Some(at + period);
        }
    }

    fn written(&mut self, register: u8, value: u8, now: u64) {
        let saves_power = self.register(POWER_CONF) & 1 != 0 || now < self.awake_since + WAKE;
        match register {
            // This register is read only.
            0x00..=0x3F => {}
            COMMAND if value == 0xB6 => {
                self.reset();
                self.registers.busy_until = now + RESET;
            }
            COMMAND if value == 0xB0 => self.fifo.clear(),
            POWER_CONF => {
                self.registers.set(register, value);
                self.awake_since = now;
            }
            // Other writes are ignored in power-save mode.
            _ if saves_power => {}
            INIT_CTRL => {
                self.registers.set(register, value);
                if value == 1 {
                    self.starts = Some(now + INITIALISE);
                }
            }
            0x5B | 0x5C => {
                self.registers.set(register, value);
                let words = usize::from(self.register(0x5B) & 0xF) + 16 * usize::from(self.register(0x5C));
                self.place = 2 * words;
            }
            INIT_DATA if self.register(INIT_CTRL) == 0 => {
                if let Some(place) = self.configuration.get_mut(self.place) {
                    *place = value;
                }
                self.place += 1;
            }
            _ => {
                self.registers.set(register, value);
                if register == POWER_CTRL {
                    let seconds = now as f64 / HZ as f64;
                    self.next_set = self.period().map(|period| seconds + period);
                    self.gyro_since = Some(seconds);
                }
            }
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        let waiting = (self.fifo.len() * SET_BYTES) as u16;
        match register {
            FIFO_LENGTH => waiting.to_le_bytes()[0],
            0x25 => waiting.to_le_bytes()[1],
            FIFO_DATA => {
                let at = self.from_fifo;
                self.from_fifo += 1;
                // After the newest set of values, the FIFO returns 0x8000.
                self.fifo.get(at / SET_BYTES).map_or([0x00, 0x80][at % 2], |set| set[at % SET_BYTES])
            }
            // A read of this register does not return the written value.
            COMMAND => 0,
            register => self.register(register),
        }
    }

    fn next(&self, register: u8) -> u8 {
        match register {
            FIFO_DATA | INIT_DATA => register,
            register => (register + 1) & 0x7F,
        }
    }

    /// A set of values that was read only partially remains in the FIFO.
    fn read_ended(&mut self) {
        let whole = std::mem::take(&mut self.from_fifo) / SET_BYTES;
        self.fifo.drain(..whole.min(self.fifo.len()));
    }

    /// Makes the sensor's own processor fail permanently.
    fn break_down(&mut self) {
        self.registers.set(0x02, self.register(0x02) | 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::i2c::Sensor as _;
    use crate::nrf::lsm9ds1::Still;
    use crate::nrf::registers::tests::{get, set};

    /// Uploads this file and returns the time of completion.
    fn upload(sensor: &mut Bmi270, file: &[u8]) -> u64 {
        set(sensor, &[(POWER_CONF, 0)], 0);
        let now = us(450);
        set(sensor, &[(INIT_CTRL, 0)], now);
        for (i, piece) in file.chunks(32).enumerate() {
            let word = i * 16;
            sensor.write(0, &[0x5B, (word & 0xF) as u8, (word >> 4) as u8], now);
            let bytes: Vec<u8> = std::iter::once(INIT_DATA).chain(piece.iter().copied()).collect();
            sensor.write(0, &bytes, now);
        }
        set(sensor, &[(INIT_CTRL, 1)], now);
        now
    }

    fn running(motion: Box<dyn Motion>) -> (Bmi270, u64) {
        let mut sensor = Bmi270::new(motion);
        let now = upload(&mut sensor, &nano33_sensor::bmi270::CONFIGURATION) + INITIALISE;
        let settings = [(0x40, 0xA9), (0x41, 0x01), (0x42, 0xE9), (0x43, 0), (0x49, 0xC0), (0x7D, 0x0E)];
        set(&mut sensor, &settings, now);
        (sensor, now)
    }

    #[test]
    fn identity_and_reset_values_are_the_data_sheets() {
        let mut sensor = Bmi270::new(Box::new(Still));
        assert_eq!(get(&mut sensor, 0x00, 0), [0x24]);
        assert_eq!(get(&mut sensor, 0x40, 0), [0xA8, 0x02, 0xA9]);
        assert_eq!(get(&mut sensor, POWER_CONF, 0), [0x03, 0x00]);
    }

    #[test]
    fn it_starts_with_the_whole_configuration_only_and_20_ms_after_it() {
        let mut sensor = Bmi270::new(Box::new(Still));
        let now = upload(&mut sensor, &nano33_sensor::bmi270::CONFIGURATION);
        assert_eq!(get(&mut sensor, 0x21, now + ms(19)), [0]);
        assert_eq!(get(&mut sensor, 0x21, now + ms(20)), [1]);
        assert_eq!(get(&mut sensor, 0x02, now + ms(20)), [0]);
        let mut sensor = Bmi270::new(Box::new(Still));
        let mut file = nano33_sensor::bmi270::CONFIGURATION;
        file[5000] ^= 1;
        let now = upload(&mut sensor, &file);
        assert_eq!(get(&mut sensor, 0x21, now + ms(20)), [2]);
        assert_eq!(get(&mut sensor, 0x02, now + ms(20)), [2]);
    }

    #[test]
    fn in_power_save_mode_nothing_is_taken() {
        let mut sensor = Bmi270::new(Box::new(Still));
        set(&mut sensor, &[(0x41, 0x01)], 0);
        assert_eq!(get(&mut sensor, 0x41, 0), [0x02]);
        set(&mut sensor, &[(POWER_CONF, 0)], 0);
        set(&mut sensor, &[(0x41, 0x01)], us(449));
        assert_eq!(get(&mut sensor, 0x41, us(449)), [0x02]);
        set(&mut sensor, &[(0x41, 0x01)], us(450));
        assert_eq!(get(&mut sensor, 0x41, us(450)), [0x01]);
    }

    /// A motion with 1 m/s² to the left in Rev1's frame, and a rotation of 100 deg/s about x.
    struct Moved;
    impl Motion for Moved {
        fn at(&self, _: f64) -> [f64; 9] {
            [0.0, 1.0, 9.80665, 100.0, 0.0, -2500.0, 0.0, 0.0, 0.0]
        }
    }

    #[test]
    fn a_set_is_gyroscope_then_accelerometer_scaled_turned_and_clipped() {
        let (mut sensor, now) = running(Box::new(Moved));
        let now = now + ms(102);
        // The rate is 200 Hz, and the gyroscope's first values come after 45 ms.
        assert_eq!(get(&mut sensor, FIFO_LENGTH, now), (20 * 12u16).to_le_bytes());
        let bytes: [u8; 240] = get(&mut sensor, FIFO_DATA, now);
        let set = |n: usize| -> Vec<i16> {
            bytes[12 * n..12 * n + 12].chunks(2).map(|c| i16::from_le_bytes([c[0], c[1]])).collect()
        };
        assert_eq!(set(0)[..3], [i16::MIN; 3]);
        // The scales are 16.384 counts per deg/s and 8192 per g.
        assert_eq!(set(19), [0, -1638, i16::MIN, -835, 0, 8192]);
        assert_eq!(get(&mut sensor, FIFO_LENGTH, now), [0, 0]);
        assert_eq!(get(&mut sensor, FIFO_DATA, now), [0x00, 0x80, 0x00, 0x80]);
    }

    #[test]
    fn a_set_read_in_part_stays_and_the_fifo_keeps_the_newest_170() {
        let (mut sensor, now) = running(Box::new(Still));
        let now = now + ms(21);
        let _: [u8; 18] = get(&mut sensor, FIFO_DATA, now);
        assert_eq!(get(&mut sensor, FIFO_LENGTH, now), (3 * 12u16).to_le_bytes());
        assert_eq!(get(&mut sensor, FIFO_LENGTH, now + ms(5000)), (170 * 12u16).to_le_bytes());
        set(&mut sensor, &[(COMMAND, 0xB0)], now + ms(5000));
        assert_eq!(get(&mut sensor, FIFO_LENGTH, now + ms(5000)), [0, 0]);
    }
}
