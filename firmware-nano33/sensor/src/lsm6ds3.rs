//! LSM6DS3TR-C: accelerometer and gyroscope of the XIAO nRF52840 Sense (ST DocID030071, application note AN5130).
//!
//! One count has the same value as in the LSM9DS1: 0.122 mg at ±4 g and 70 mdps at ±2000 deg/s.
//! **The orientation of the chip's axes relative to the board's case is not known.**
//! The driver returns the axes of the chip.
//! The bundled model works with any orientation, because its recipe rotates the data of every hand into the hand's own
//! frame.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::i2c::{Setting, read, read_into, set, triple, verify};
use crate::{Batch, FIFO_SETS, Imu, ImuError};

/// I2C address of the LSM6DS3 on this board (SA0 low).
pub const ADDRESS: u8 = 0x6A;
pub(crate) const WHO_AM_I: u8 = 0x0F;
/// Expected value of WHO_AM_I.
pub(crate) const ID: u8 = 0x6A;

const FIFO_CTRL3: u8 = 0x08;
const FIFO_CTRL5: u8 = 0x0A;
const CTRL1_XL: u8 = 0x10;
const CTRL2_G: u8 = 0x11;
const CTRL3_C: u8 = 0x12;
const FIFO_STATUS1: u8 = 0x3A;
const FIFO_DATA_OUT: u8 = 0x3E;

const SOFTWARE_RESET: u8 = 1;
/// The FIFO runs at 208 Hz in continuous mode: new data overwrites the oldest data.
const FIFO_CONTINUOUS: u8 = 0x2E;
const FIFO_BYPASS: u8 = 0;
/// Overrun bit in the second byte of the FIFO status.
const FIFO_OVERRUN: u8 = 1 << 6;
const FIFO_COUNT_HIGH: u8 = 0x07;

const SETTINGS: [Setting; 5] = [
    // Enables block data update and address auto-increment.
    (CTRL3_C, 0x44),
    // 208 Hz, ±4 g.
    (CTRL1_XL, 0x58),
    // 208 Hz, ±2000 deg/s.
    (CTRL2_G, 0x5C),
    // Stores every gyroscope and accelerometer set in the FIFO.
    (FIFO_CTRL3, 0x09),
    (FIFO_CTRL5, FIFO_CONTINUOUS),
];

/// Number of 16-bit words in a set: three of the gyroscope, then three of the accelerometer.
const WORDS: usize = 6;
/// The gyroscope takes 35 ms to start, and the sets from that time are discarded.
const SETTLING_SETS: u8 = 8;

/// Driver of the sensor on an I2C bus.
#[derive(Debug)]
pub struct Lsm6ds3<I> {
    i2c: I,
    to_drop: u8,
    buffer: [u8; 2 * WORDS * FIFO_SETS],
}

impl<I: I2c> Lsm6ds3<I> {
    /// Creates a driver. Call [`Imu::start`] before any other method.
    pub fn new(i2c: I) -> Self {
        Self { i2c, to_drop: 0, buffer: [0; 2 * WORDS * FIFO_SETS] }
    }

    /// Gives the bus back.
    pub fn release(self) -> I {
        self.i2c
    }

    async fn empty_fifo(&mut self) -> Result<(), ImuError> {
        set(&mut self.i2c, ADDRESS, &[(FIFO_CTRL5, FIFO_BYPASS), (FIFO_CTRL5, FIFO_CONTINUOUS)]).await
    }
}

impl<I: I2c> Imu for Lsm6ds3<I> {
    fn nominal_hz(&self) -> f32 {
        208.0
    }

    fn axes(&self) -> usize {
        6
    }

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        match read::<1, _>(&mut self.i2c, ADDRESS, WHO_AM_I).await {
            Ok([ID]) => {}
            Ok([who]) => return Err(ImuError::Unknown(who)),
            Err(_) => return Err(ImuError::Missing(ADDRESS)),
        }
        set(&mut self.i2c, ADDRESS, &[(CTRL3_C, SOFTWARE_RESET)]).await?;
        delay.delay_ms(1).await;
        set(&mut self.i2c, ADDRESS, &SETTINGS).await?;
        verify(&mut self.i2c, ADDRESS, &SETTINGS).await?;
        self.to_drop = SETTLING_SETS;
        Ok(())
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        batch.clear();
        let [low, high, pattern, _] = read::<4, _>(&mut self.i2c, ADDRESS, FIFO_STATUS1).await?;
        let waiting = usize::from(u16::from_le_bytes([low, high & FIFO_COUNT_HIGH]));
        // If the FIFO is aligned, its next word is the first word of a set.
        if high & FIFO_OVERRUN != 0 || waiting / WORDS > FIFO_SETS || usize::from(pattern) % WORDS != 0 {
            batch.overrun = true;
            return self.empty_fifo().await;
        }
        let bytes = &mut self.buffer[..2 * WORDS * (waiting / WORDS)];
        if bytes.is_empty() {
            return Ok(());
        }
        // During a burst read, the address stays at the output register of the FIFO.
        read_into(&mut self.i2c, ADDRESS, FIFO_DATA_OUT, bytes).await?;
        for set in bytes.chunks_exact(2 * WORDS) {
            let ([gx, gy, gz], [ax, ay, az]) = (triple(&set[..6]), triple(&set[6..]));
            if self.to_drop > 0 {
                self.to_drop -= 1;
            } else {
                batch.push([ax, ay, az, gx, gy, gz]);
            }
        }
        Ok(())
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        verify(&mut self.i2c, ADDRESS, &SETTINGS).await
    }
}
