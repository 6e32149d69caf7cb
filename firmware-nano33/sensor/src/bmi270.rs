//! BMI270: accelerometer and gyroscope of the Nano 33 BLE Sense Rev2 (Bosch BST-BMI270-DS000-07).
//!
//! The sensor starts only after it has received Bosch's configuration file, 8 KB of code for its internal processor.
//! The file is part of the crate `bmi2` (Bosch's notice: `NOTICE-Bosch.txt`).
//!
//! **Counts and axes** are converted to those of a Rev1 board (see [`crate::Set`]): x becomes −y, y becomes −x, and z stays.
//! This relation follows from Arduino's libraries for the two sensors.
//!
//! **The magnetometer** on the same bus (a BMM150) is not used.
//! The orientation of its axes relative to the other sensors has not been measured on a board.
//! A wrong sign would be hard to notice, because the readings would still look plausible.

/// Bosch's configuration file.
pub use bmi2::config::BMI270_CONFIG_FILE as CONFIGURATION;
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::i2c::{Setting, read, read_into, set, triple, verify, write};
use crate::{Batch, FIFO_SETS, Imu, ImuError, Set};

/// I2C address of the BMI270 on this board (SDO low).
pub const ADDRESS: u8 = 0x68;
pub(crate) const CHIP_ID: u8 = 0x00;
/// Expected value of CHIP_ID.
pub(crate) const ID: u8 = 0x24;

const ERROR: u8 = 0x02;
const INTERNAL_STATUS: u8 = 0x21;
const FIFO_LENGTH: u8 = 0x24;
const FIFO_DATA: u8 = 0x26;
const ACC_CONF: u8 = 0x40;
const ACC_RANGE: u8 = 0x41;
const GYR_CONF: u8 = 0x42;
const GYR_RANGE: u8 = 0x43;
const FIFO_CONFIG_1: u8 = 0x49;
const INIT_CTRL: u8 = 0x59;
const INIT_ADDRESS: u8 = 0x5B;
const INIT_DATA: u8 = 0x5E;
const POWER_CONF: u8 = 0x7C;
const POWER_CTRL: u8 = 0x7D;
const COMMAND: u8 = 0x7E;

const SOFT_RESET: u8 = 0xB6;
const FIFO_FLUSH: u8 = 0xB0;
const INITIALISED: u8 = 1;
/// Error bits: a fatal error, or an error of the sensor's internal processor.
const FATAL: u8 = 0x1F;

const SETTINGS: [Setting; 6] = [
    // Accelerometer: 200 Hz, normal filter bandwidth, performance mode.
    (ACC_CONF, 0xA9),
    // ±4 g.
    (ACC_RANGE, 0x01),
    // Gyroscope: 200 Hz, normal filter bandwidth, low noise, performance mode.
    (GYR_CONF, 0xE9),
    // ±2000 deg/s.
    (GYR_RANGE, 0x00),
    // FIFO with gyroscope and accelerometer data, without headers.
    (FIFO_CONFIG_1, 0xC0),
    // Enables gyroscope, accelerometer and thermometer.
    (POWER_CTRL, 0x0E),
];

/// Size of a set in bytes: gyroscope, then accelerometer.
const SET_BYTES: usize = 12;
/// Size in bytes of one transfer of the configuration file.
const PIECE: usize = 128;
/// Number of sets in the 45 ms that the gyroscope takes to start.
const SETTLING_SETS: u8 = 10;
/// Value in the FIFO that replaces a missing measurement.
const NO_VALUE: i16 = i16::MIN;

/// Conversion factors in units of 1/65536.
/// The factors convert ±4 g per 2^15 counts to 0.122 mg, and ±2000 deg/s per 2^15 counts to 70 mdps.
const ACCEL: i64 = (65_536.0 * (4000.0 / 32_768.0) / 0.122 + 0.5) as i64;
const GYRO: i64 = (65_536.0 * (2000.0 / 32_768.0) / 0.07 + 0.5) as i64;

fn convert(counts: i16, factor: i64) -> i16 {
    let value = (i64::from(counts) * factor + 0x8000) >> 16;
    value.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

/// A Rev1 board's axes.
fn turn([x, y, z]: [i16; 3], factor: i64) -> [i16; 3] {
    [y.saturating_neg(), x.saturating_neg(), z].map(|counts| convert(counts, factor))
}

/// Driver of the sensor on an I2C bus.
#[derive(Debug)]
pub struct Bmi270<I> {
    i2c: I,
    to_drop: u8,
    buffer: [u8; SET_BYTES * FIFO_SETS],
}

impl<I: I2c> Bmi270<I> {
    /// Creates a driver. Call [`Imu::start`] before any other method.
    pub fn new(i2c: I) -> Self {
        Self { i2c, to_drop: 0, buffer: [0; SET_BYTES * FIFO_SETS] }
    }

    /// Gives the bus back.
    pub fn release(self) -> I {
        self.i2c
    }

    /// Loads Bosch's configuration file into the sensor.
    async fn configure(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        // Ends the power-save mode, in which only a few registers can be written.
        set(&mut self.i2c, ADDRESS, &[(POWER_CONF, 0)]).await?;
        delay.delay_us(450).await;
        set(&mut self.i2c, ADDRESS, &[(INIT_CTRL, 0)]).await?;
        for (number, piece) in CONFIGURATION.chunks(PIECE).enumerate() {
            // The address counts 16-bit words.
            // One register holds the lowest four bits of the address, and the next register holds the remaining bits.
            let word = number * PIECE / 2;
            write(&mut self.i2c, ADDRESS, &[INIT_ADDRESS, (word & 0xF) as u8, (word >> 4) as u8]).await?;
            // The data is copied to RAM, because the bus controller cannot read flash.
            self.buffer[0] = INIT_DATA;
            self.buffer[1..=piece.len()].copy_from_slice(piece);
            write(&mut self.i2c, ADDRESS, &self.buffer[..=piece.len()]).await?;
        }
        set(&mut self.i2c, ADDRESS, &[(INIT_CTRL, 1)]).await?;
        for _ in 0..15 {
            delay.delay_ms(10).await;
            if read::<1, _>(&mut self.i2c, ADDRESS, INTERNAL_STATUS).await?[0] & 0xF == INITIALISED {
                return Ok(());
            }
        }
        Err(ImuError::Reset(ADDRESS))
    }
}

impl<I: I2c> Imu for Bmi270<I> {
    fn nominal_hz(&self) -> f32 {
        200.0
    }

    fn axes(&self) -> usize {
        6
    }

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        match read::<1, _>(&mut self.i2c, ADDRESS, CHIP_ID).await {
            Ok([ID]) => {}
            Ok([who]) => return Err(ImuError::Unknown(who)),
            Err(_) => return Err(ImuError::Missing(ADDRESS)),
        }
        set(&mut self.i2c, ADDRESS, &[(COMMAND, SOFT_RESET)]).await?;
        delay.delay_ms(2).await;
        self.configure(delay).await?;
        set(&mut self.i2c, ADDRESS, &SETTINGS).await?;
        set(&mut self.i2c, ADDRESS, &[(COMMAND, FIFO_FLUSH)]).await?;
        self.check().await?;
        self.to_drop = SETTLING_SETS;
        Ok(())
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        batch.clear();
        let [low, high] = read::<2, _>(&mut self.i2c, ADDRESS, FIFO_LENGTH).await?;
        let waiting = usize::from(u16::from_le_bytes([low, high & 0x3F]));
        // `FIFO_SETS` is far below the capacity of the sensor's FIFO.
        if waiting / SET_BYTES > FIFO_SETS {
            batch.overrun = true;
            return set(&mut self.i2c, ADDRESS, &[(COMMAND, FIFO_FLUSH)]).await;
        }
        let bytes = &mut self.buffer[..SET_BYTES * (waiting / SET_BYTES)];
        if bytes.is_empty() {
            return Ok(());
        }
        read_into(&mut self.i2c, ADDRESS, FIFO_DATA, bytes).await?;
        for set in bytes.chunks_exact(SET_BYTES) {
            let (gyro, accel) = (triple(&set[..6]), triple(&set[6..]));
            if self.to_drop > 0 {
                self.to_drop -= 1;
            } else if gyro != [NO_VALUE; 3] && accel != [NO_VALUE; 3] {
                batch.push(rev1(gyro, accel));
            }
        }
        Ok(())
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        if read::<1, _>(&mut self.i2c, ADDRESS, ERROR).await?[0] & FATAL != 0 {
            return Err(ImuError::Reset(ADDRESS));
        }
        verify(&mut self.i2c, ADDRESS, &SETTINGS).await
    }
}

/// Converts a set to the counts and axes of a Rev1 board.
fn rev1(gyro: [i16; 3], accel: [i16; 3]) -> Set {
    let ([ax, ay, az], [gx, gy, gz]) = (turn(accel, ACCEL), turn(gyro, GYRO));
    [ax, ay, az, gx, gy, gz]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_reads_as_a_rev1_boards_does() {
        // 1 g is 8192 counts of the BMI270 and 8197 of the Rev1 board; 100 deg/s is 1638 and 1429 counts.
        assert_eq!(rev1([1638, 0, -1638], [0, 8192, 8192]), [-8197, 0, 8197, 0, -1428, -1428]);
        // At the ends of the range, converted values neither wrap nor change their sign.
        assert_eq!(
            rev1([0, i16::MIN, i16::MAX], [i16::MIN, i16::MAX, i16::MIN])[..3],
            [i16::MIN, i16::MAX, i16::MIN]
        );
    }
}
