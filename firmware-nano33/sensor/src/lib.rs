//! The right hand's motion sensors, without the board: everything here runs on a laptop too.
//!
//! ```text
//! FIFO (the sensor's own clock) -> Imu::poll -> Grid -> 100 Hz, the board's crystal
//! ```
//!
//! * [`lsm9ds1`] (Nano 33 BLE Sense), [`bmi270`] (its Rev2) and [`lsm6ds3`] (XIAO nRF52840 Sense): the drivers, async over
//!   embedded-hal-async I2C. [`found`] looks which one is there.
//! * [`grid`]: finds out when the sensor took each set, and interpolates onto the 100 Hz grid.
//! * [`Imu`]: what a sensor has to offer. All of them speak in the same counts and axes, so one model serves all.
#![no_std]

pub mod bmi270;
pub mod bmm150;
pub mod found;
pub mod grid;
mod i2c;
pub mod lsm6ds3;
pub mod lsm9ds1;

/// One accelerometer and gyroscope set: accX accY accZ gyrX gyrY gyrZ, in counts of [`SCALE`] along the raw axes of a
/// Rev1 board's LSM9DS1 (left-handed, see [`lsm9ds1`]).
pub type Set = [i16; 6];

/// Physical value of one count of accelerometer, gyroscope and magnetometer, whatever sensor it comes from: m/s², deg/s,
/// µT. The LSM9DS1's sensitivities at ±4 g, ±2000 deg/s and ±4 gauss; drivers of other sensors convert.
pub const SCALE: [f32; 3] = [0.122e-3 * 9.80665, 0.07, 0.014];

/// Most sets that one poll fetches; more waiting sets count as an overrun.
pub const FIFO_SETS: usize = 32;

/// The sets that waited in the sensor since the last poll.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    sets: [Set; FIFO_SETS],
    len: usize,
    /// The FIFO was full: sets were lost before the first one here.
    pub overrun: bool,
    /// The newest magnetometer values in counts; zeros from a sensor of six axes.
    pub magnetometer: [i16; 3],
}

impl Default for Batch {
    fn default() -> Self {
        Self { sets: [[0; 6]; FIFO_SETS], len: 0, overrun: false, magnetometer: [0; 3] }
    }
}

impl Batch {
    /// The sets, oldest first.
    pub fn sets(&self) -> &[Set] {
        &self.sets[..self.len]
    }

    /// Forgets the sets, and keeps the magnetometer values.
    pub fn clear(&mut self) {
        self.len = 0;
        self.overrun = false;
    }

    /// Adds a set; one that does not fit raises [`Self::overrun`].
    pub fn push(&mut self, set: Set) {
        match self.sets.get_mut(self.len) {
            Some(place) => {
                *place = set;
                self.len += 1;
            }
            None => self.overrun = true,
        }
    }
}

/// Why a sensor cannot be used now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuError {
    /// Nothing answers at this bus address.
    Missing(u8),
    /// Something else answers; its WHO_AM_I.
    Unknown(u8),
    /// A transfer failed; the bus address.
    Bus(u8),
    /// The sensor at this bus address has other settings than it was given: one did not arrive, or it lost them (power
    /// dip).
    Reset(u8),
}

/// A motion sensor with a FIFO.
#[allow(async_fn_in_trait, reason = "used with one executor, on one core")]
pub trait Imu {
    /// Sets per second by the data sheet. The true rate may differ by some per cent.
    fn nominal_hz(&self) -> f32;

    /// Values per sample that mean something: 9, or 6 without a magnetometer.
    fn axes(&self) -> usize;

    /// Resets and configures the sensor, reads its settings back, and starts its FIFO.
    ///
    /// # Errors
    /// Says what is wrong with the sensor or the bus.
    async fn start(&mut self, delay: &mut impl embedded_hal_async::delay::DelayNs) -> Result<(), ImuError>;

    /// Moves all that waits in the sensor to the batch, which it clears first.
    ///
    /// # Errors
    /// A failed transfer. What was read before it is in the batch.
    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError>;

    /// Whether the sensor still has its settings; asked when sets stop coming.
    ///
    /// # Errors
    /// [`ImuError::Reset`] if it has lost them, or a failed transfer.
    async fn check(&mut self) -> Result<(), ImuError>;
}
