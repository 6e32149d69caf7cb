//! Simulates an LSM9DS1 that is moved by a [`Motion`]: two dies with registers, address increment, FIFO and clipping.
//!
//! The sensor has its own clock ([`Sensor::set_clock_ratio`]), independent of the board's crystal.

use std::collections::VecDeque;

use super::i2c::Sensor;
use super::time::{HZ, ms};

/// The motion of the hand: accX accY accZ in m/s², gyrX gyrY gyrZ in deg/s, magX magY magZ in µT.
pub trait Motion {
    /// Returns the values of the motion at this time.
    fn at(&self, seconds: f64) -> [f64; 9];
}

/// A board that lies flat and does not move.
pub struct Still;

impl Motion for Still {
    fn at(&self, _: f64) -> [f64; 9] {
        [0.0, 0.0, 9.80665, 0.0, 0.0, 0.0, 20.0, 0.0, -40.0]
    }
}

/// Recorded rows at constant intervals, interpolated linearly. The last row is held.
pub struct Replay {
    /// The recorded rows.
    pub rows: Vec<[f64; 9]>,
    /// Seconds between two rows.
    pub interval: f64,
    /// Time of the first row.
    pub start: f64,
}

impl Motion for Replay {
    fn at(&self, seconds: f64) -> [f64; 9] {
        let place = ((seconds - self.start) / self.interval).max(0.0);
        let index = (place as usize).min(self.rows.len() - 1);
        let next = (index + 1).min(self.rows.len() - 1);
        let part = (place - index as f64).min(1.0);
        std::array::from_fn(|i| self.rows[index][i] + (self.rows[next][i] - self.rows[index][i]) * part)
    }
}

/// The addresses of the two dies if SA0 and SA1 are high.
const ADDRESS_AG: u8 = 0x6B;
const ADDRESS_MAG: u8 = 0x1E;
const FIFO_SETS: usize = 32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Die {
    AccelGyro,
    Mag,
}

/// The simulated sensor.
pub struct Lsm9ds1 {
    motion: Box<dyn Motion>,
    clock_ratio: f64,
    ag: [u8; 128],
    mag: [u8; 128],
    selected: (Die, u8, bool),
    fifo: VecDeque<[i16; 6]>,
    overrun: bool,
    /// Times of the next set and of the next magnetometer values, in seconds.
    next_set: Option<f64>,
    next_mag: Option<f64>,
    sets: u64,
    latest: [i16; 6],
    /// Until this cycle, BOOT_STATUS is set and written settings are lost.
    boots_until: u64,
    /// The register whose next write is lost, as bus address and register number.
    loses_write: Option<(u8, u8)>,
}

/// Duration for which the accelerometer's die is busy after a software reset.
const RESET_TIME: u64 = ms(10);

impl Lsm9ds1 {
    /// Returns a sensor after power-up.
    pub fn new(motion: Box<dyn Motion>) -> Self {
        let mut sensor = Self {
            motion,
            clock_ratio: 1.0,
            ag: [0; 128],
            mag: [0; 128],
            selected: (Die::AccelGyro, 0, false),
            fifo: VecDeque::new(),
            overrun: false,
            next_set: None,
            next_mag: None,
            sets: 0,
            latest: [0; 6],
            boots_until: 0,
            loses_write: None,
        };
        sensor.power_cycle();
        sensor
    }

    fn reset_ag(&mut self) {
        self.ag = [0; 128];
        self.ag[0x0F] = 0x68;
        self.ag[0x22] = 0x04;
        self.fifo.clear();
        self.overrun = false;
        self.next_set = None;
    }

    fn reset_mag(&mut self) {
        self.mag = [0; 128];
        self.mag[0x0F] = 0x3D;
        self.mag[0x20] = 0x10;
        self.mag[0x22] = 0x03;
        self.next_mag = None;
    }

    fn ag_period(&self) -> Option<f64> {
        let hz = match self.ag[0x10] >> 5 {
            1 => 14.9,
            2 => 59.5,
            3 => 119.0,
            4 => 238.0,
            5 => 476.0,
            6 => 952.0,
            _ => return None,
        };
        Some(self.clock_ratio / hz)
    }

    fn mag_period(&self) -> Option<f64> {
        let hz = 0.625 * f64::from(1 << ((self.mag[0x20] >> 2) & 7));
        (self.mag[0x22] & 3 == 0).then_some(self.clock_ratio / hz)
    }

    /// Returns the sensitivities of the data sheet: m/s² per count, and deg/s per count.
    fn ag_scale(&self) -> (f64, f64) {
        let mg = [0.061, 0.732, 0.122, 0.244][usize::from(self.ag[0x20] >> 3) & 3];
        let mdps = [8.75, 17.5, f64::NAN, 70.0][usize::from(self.ag[0x10] >> 3) & 3];
        (mg * 1e-3 * 9.80665, mdps * 1e-3)
    }

    fn clip(value: f64) -> i16 {
        // The conversion with `as` saturates like the sensor.
        value.round() as i16
    }

    /// Takes all samples up to this time.
    fn advance(&mut self, now: u64) {
        let seconds = now as f64 / HZ as f64;
        while let (Some(at), Some(period)) = (self.next_set, self.ag_period()) {
            if at > seconds {
                break;
            }
            let v = self.motion.at(at);
            let (accel, gyro) = self.ag_scale();
            let set = [
                Self::clip(v[3] / gyro),
                Self::clip(v[4] / gyro),
                Self::clip(v[5] / gyro),
                Self::clip(v[0] / accel),
                Self::clip(v[1] / accel),
                Self::clip(v[2] / accel),
            ];
            self.latest = set;
            self.sets += 1;
            let fifo_on = self.ag[0x23] & 0x02 != 0;
            match self.ag[0x2E] >> 5 {
                1 if fifo_on && self.fifo.len() < FIFO_SETS => self.fifo.push_back(set),
                1 if fifo_on => self.overrun = true,
                6 if fifo_on => {
                    if self.fifo.len() == FIFO_SETS {
                        self.fifo.pop_front();
                        self.overrun = true;
                    }
                    self.fifo.push_back(set);
                }
                _ => {}
            }
            self.ag[0x17] |= 3;
            self.ag[0x27] |= 3;
            self.next_set = Some(at + period);
        }
        while let (Some(at), Some(period)) = (self.next_mag, self.mag_period()) {
            if at > seconds {
                break;
            }
            let v = self.motion.at(at);
            let gauss_range = usize::from(self.mag[0x21] >> 5) & 3;
            let ut = [0.014, 0.029, 0.043, 0.058][gauss_range];
            for axis in 0..3 {
                let counts = Self::clip(v[6 + axis] / ut);
                self.mag[0x28 + 2 * axis..0x2A + 2 * axis].copy_from_slice(&counts.to_le_bytes());
            }
            self.mag[0x27] |= 0x0F;
            self.next_mag = Some(at + period);
        }
    }

    fn write_register(&mut self, die: Die, register: u8, value: u8, now: u64) {
        let seconds = now as f64 / HZ as f64;
        match (die, register) {
            // This register is read only.
            (_, 0x0F) | (Die::AccelGyro, 0x15..=0x1D | 0x26..=0x2D | 0x2F) | (Die::Mag, 0x27..=0x2D) => {}
            (Die::AccelGyro, 0x22) if value & 1 != 0 => {
                self.reset_ag();
                self.boots_until = now + RESET_TIME;
            }
            (Die::Mag, 0x21) if value & 0x04 != 0 => self.reset_mag(),
            (Die::AccelGyro, register) => {
                self.ag[usize::from(register)] = value;
                match register {
                    0x10 => self.next_set = self.ag_period().map(|p| seconds + p),
                    0x2E if value >> 5 == 0 => {
                        self.fifo.clear();
                        self.overrun = false;
                    }
                    _ => {}
                }
            }
            (Die::Mag, register) => {
                self.mag[usize::from(register)] = value;
                if register == 0x22 || register == 0x20 {
                    self.next_mag = self.mag_period().map(|p| seconds + p);
                }
            }
        }
    }

    fn read_register(&mut self, die: Die, register: u8) -> u8 {
        if die == Die::Mag {
            if (0x28..=0x2D).contains(&register) {
                self.mag[0x27] &= !0x0F;
            }
            return self.mag[usize::from(register)];
        }
        let fifo_on = self.ag[0x23] & 0x02 != 0 && self.ag[0x2E] >> 5 != 0;
        let set = if fifo_on { self.fifo.front().copied().unwrap_or(self.latest) } else { self.latest };
        match register {
            0x18..=0x1D | 0x28..=0x2D => {
                let index = if register < 0x20 { register - 0x18 } else { register - 0x28 + 6 };
                let byte = set[usize::from(index / 2)].to_le_bytes()[usize::from(index % 2)];
                self.ag[0x17] &= !3;
                self.ag[0x27] &= !3;
                // After the last byte of the accelerometer was read, the set is removed.
                if register == 0x2D {
                    self.fifo.pop_front();
                }
                byte
            }
            0x2F => {
                let threshold = usize::from(self.ag[0x2E] & 0x1F);
                let reached = threshold > 0 && self.fifo.len() >= threshold;
                let source = self.fifo.len() as u8 | u8::from(self.overrun) << 6 | u8::from(reached) << 7;
                self.overrun = false;
                source
            }
            _ => self.ag[usize::from(register)],
        }
    }
}

impl Sensor for Lsm9ds1 {
    fn has_address(&self, address: u8) -> bool {
        address == ADDRESS_AG || address == ADDRESS_MAG
    }

    fn write(&mut self, address: u8, bytes: &[u8], now: u64) {
        self.advance(now);
        let Some((&register, data)) = bytes.split_first() else { return };
        let die = if address == 0x1E { Die::Mag } else { Die::AccelGyro };
        self.selected = match die {
            // The accelerometer's die increments if IF_ADD_INC is set.
            // The magnetometer's die increments if bit 7 is set.
            Die::AccelGyro => (die, register & 0x7F, self.ag[0x22] & 0x04 != 0),
            Die::Mag => (die, register & 0x7F, register & 0x80 != 0),
        };
        for &value in data {
            let (die, register, increments) = self.selected;
            let lost = self.loses_write.take_if(|lost| *lost == (address, register)).is_some();
            if !lost && (die == Die::Mag || now >= self.boots_until) {
                self.write_register(die, register, value, now);
            }
            if increments {
                self.selected.1 = (register + 1) & 0x7F;
            }
        }
    }

    fn read(&mut self, address: u8, bytes: &mut [u8], now: u64) {
        self.advance(now);
        let die = if address == 0x1E { Die::Mag } else { Die::AccelGyro };
        if self.selected.0 != die {
            bytes.fill(0);
            return;
        }
        for byte in bytes {
            let (_, register, increments) = self.selected;
            *byte = self.read_register(die, register);
            if (die, register) == (Die::AccelGyro, 0x17) && now < self.boots_until {
                *byte |= 1 << 3;
            }
            if increments {
                // A burst that reads past the gyroscope's output registers continues with those of the accelerometer.
                self.selected.1 = match (die, register) {
                    (Die::AccelGyro, 0x1D) => 0x28,
                    _ => (register + 1) & 0x7F,
                };
            }
        }
    }

    fn power_cycle(&mut self) {
        self.reset_ag();
        self.reset_mag();
    }

    fn set_motion(&mut self, motion: Box<dyn Motion>) {
        self.motion = motion;
    }

    fn set_clock_ratio(&mut self, ratio: f64) {
        self.clock_ratio = ratio;
    }

    fn lose_write(&mut self, register: u8) {
        self.loses_write = Some((ADDRESS_AG, register));
    }

    fn sets(&self) -> u64 {
        self.sets
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::time::ms;

    fn get<const N: usize>(sensor: &mut Lsm9ds1, address: u8, register: u8, now: u64) -> [u8; N] {
        sensor.write(address, &[register], now);
        let mut bytes = [0; N];
        sensor.read(address, &mut bytes, now);
        bytes
    }

    struct Ramp;
    impl Motion for Ramp {
        fn at(&self, seconds: f64) -> [f64; 9] {
            [seconds, 100.0, -9.80665, 2_500.0, -2_500.0, 0.0, 56.0, 0.0, -56.0]
        }
    }

    #[test]
    fn identities_and_reset_values_are_the_data_sheets() {
        let mut sensor = Lsm9ds1::new(Box::new(Still));
        assert_eq!(get(&mut sensor, 0x6B, 0x0F, 0), [0x68]);
        assert_eq!(get(&mut sensor, 0x1E, 0x0F, 0), [0x3D]);
        assert_eq!(get(&mut sensor, 0x6B, 0x22, 0), [0x04]);
        assert_eq!(get(&mut sensor, 0x1E, 0x22, 0), [0x03]);
    }

    #[test]
    fn each_die_counts_its_address_up_by_its_own_rule() {
        let mut sensor = Lsm9ds1::new(Box::new(Still));
        sensor.write(0x6B, &[0x10, 0x98, 0x01], 0);
        assert_eq!(get(&mut sensor, 0x6B, 0x10, 0), [0x98, 0x01]);
        sensor.write(0x6B, &[0x22, 0x00], 0);
        assert_eq!(get(&mut sensor, 0x6B, 0x10, 0), [0x98, 0x98]);
        sensor.write(0x1E, &[0x20, 0x11], 0);
        assert_eq!(get(&mut sensor, 0x1E, 0x20, 0), [0x11, 0x11]);
        assert_eq!(get(&mut sensor, 0x1E, 0xA0, 0), [0x11, 0x00]);
    }

    #[test]
    fn values_are_scaled_and_clipped_and_a_burst_rolls_from_gyroscope_to_accelerometer() {
        let mut sensor = Lsm9ds1::new(Box::new(Ramp));
        for (register, value) in [(0x10, 0x98), (0x20, 0x90)] {
            sensor.write(0x6B, &[register, value], 0);
        }
        let b: [u8; 12] = get(&mut sensor, 0x6B, 0x18, ms(100));
        let v: Vec<i16> = b.chunks(2).map(|c| i16::from_le_bytes([c[0], c[1]])).collect();
        // 2500 deg/s and 100 m/s² are beyond the ranges; −1 g is −1000 / 0.122 counts.
        assert_eq!(v[..3], [i16::MAX, i16::MIN, 0]);
        assert_eq!(v[4..], [i16::MAX, -8197]);
        sensor.write(0x1E, &[0x22, 0], ms(100));
        let m: [u8; 6] = get(&mut sensor, 0x1E, 0xA8, ms(300));
        assert_eq!(m, [0xA0, 0x0F, 0, 0, 0x60, 0xF0]);
    }

    #[test]
    fn the_fifo_keeps_the_newest_32_sets_says_how_many_and_that_some_are_lost() {
        let mut sensor = Lsm9ds1::new(Box::new(Ramp));
        for (register, value) in [(0x20, 0x90), (0x23, 0x02), (0x2E, 0xC0), (0x10, 0x98)] {
            sensor.write(0x6B, &[register, value], 0);
        }
        // At 238 Hz, there are 11 sets in 50 ms.
        assert_eq!(get(&mut sensor, 0x6B, 0x2F, ms(50)), [11]);
        for left in (0..11).rev() {
            let _: [u8; 12] = get(&mut sensor, 0x6B, 0x18, ms(50));
            assert_eq!(get(&mut sensor, 0x6B, 0x2F, ms(50)), [left]);
        }
        assert_eq!(get(&mut sensor, 0x6B, 0x2F, ms(1000)), [32 | 0x40]);
        assert_eq!(get(&mut sensor, 0x6B, 0x2F, ms(1000)), [32]);
        sensor.write(0x6B, &[0x2E, 0], ms(1000));
        assert_eq!(get(&mut sensor, 0x6B, 0x2F, ms(1000)), [0]);
    }

    #[test]
    fn the_sensors_own_clock_may_be_off() {
        let mut sensor = Lsm9ds1::new(Box::new(Still));
        sensor.set_clock_ratio(1.05);
        sensor.write(0x6B, &[0x10, 0x98], 0);
        let _: [u8; 1] = get(&mut sensor, 0x6B, 0x0F, ms(10_000));
        assert!((2266..=2267).contains(&sensor.sets()));
    }

    #[test]
    fn a_replay_gives_its_rows_at_their_times_and_lines_between() {
        let mut rows = vec![[0.0; 9]; 3];
        rows[1][0] = 10.0;
        rows[2][0] = 20.0;
        let replay = Replay { rows, interval: 0.01, start: 1.0 };
        assert_eq!(replay.at(0.5)[0], 0.0);
        assert!((replay.at(1.015)[0] - 15.0).abs() < 1e-9);
        assert_eq!(replay.at(9.0)[0], 20.0);
    }
}
