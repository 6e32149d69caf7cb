//! Drivers of the right hand's motion sensors. The crate does not depend on the board and also runs on a laptop.
//!
//! ```text
//! FIFO (the sensor's own clock) -> Imu::poll -> Grid -> 100 Hz, the board's crystal
//! ```
//!
//! * The drivers are [`lsm9ds1`] (Nano 33 BLE Sense), [`bmi270`] (Rev2) and [`lsm6ds3`] (XIAO nRF52840 Sense).
//!   The drivers use asynchronous I2C of embedded-hal-async. [`found`] detects the sensor on the bus.
//! * [`grid`] estimates the time of each set and interpolates the sets to the 100 Hz grid.
//! * [`Imu`] is the trait that all drivers implement.
//!   All drivers return the same units and axes, so one model works with all sensors.
#![no_std]

pub mod bmi270;
pub mod bmm150;
pub mod found;
pub mod grid;
mod i2c;
pub mod lsm6ds3;
pub mod lsm9ds1;

/// One set of accelerometer and gyroscope values: accX accY accZ gyrX gyrY gyrZ.
/// The values are in counts of [`SCALE`] along the raw axes of a Rev1 board's LSM9DS1 (left-handed, see [`lsm9ds1`]).
pub type Set = [i16; 6];

/// Value of one count of accelerometer (m/s²), gyroscope (deg/s) and magnetometer (µT), for every supported sensor.
/// The values are the LSM9DS1's sensitivities at ±4 g, ±2000 deg/s and ±4 gauss.
/// The drivers of other sensors convert their counts.
pub const SCALE: [f32; 3] = [0.122e-3 * 9.80665, 0.07, 0.014];

/// Maximum number of sets that one poll fetches. More waiting sets count as an overrun.
pub const FIFO_SETS: usize = 32;

/// The sets that the sensor collected since the last poll.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    sets: [Set; FIFO_SETS],
    len: usize,
    /// True if the sensor's FIFO was full, so that sets before the first set in this batch were lost.
    pub overrun: bool,
    /// The newest counts of the magnetometer, or zeros if the sensor has six axes.
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

    /// Removes all sets. The magnetometer values do not change.
    pub fn clear(&mut self) {
        self.len = 0;
        self.overrun = false;
    }

    /// Adds a set, or sets [`Self::overrun`] if the batch is full.
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

/// Reason why a sensor cannot be used at the moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuError {
    /// No device answers at this address on the I2C bus.
    Missing(u8),
    /// A different device answers, whose WHO_AM_I register has this value.
    Unknown(u8),
    /// A transfer to this I2C address failed.
    Bus(u8),
    /// The settings of the sensor at this I2C address differ from the settings that were written.
    /// Either a write was lost, or a drop of the supply voltage reset the sensor.
    Reset(u8),
}

/// A motion sensor with a FIFO.
#[allow(async_fn_in_trait, reason = "used with one executor, on one core")]
pub trait Imu {
    /// Number of sets per second according to the data sheet. The true rate may differ by some per cent.
    fn nominal_hz(&self) -> f32;

    /// Number of valid values per sample: 9, or 6 without a magnetometer.
    fn axes(&self) -> usize;

    /// Resets and configures the sensor, reads its settings back, and starts its FIFO.
    ///
    /// # Errors
    /// Fails if the sensor was not recognised or did not accept its settings, or if a transfer failed.
    async fn start(&mut self, delay: &mut impl embedded_hal_async::delay::DelayNs) -> Result<(), ImuError>;

    /// Clears the batch and moves all waiting sets from the sensor to it.
    ///
    /// # Errors
    /// Fails if a transfer failed. The batch contains the sets that were read before the failure.
    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError>;

    /// Checks that the sensor's settings are still in effect.
    /// The firmware calls this when sets stop arriving.
    ///
    /// # Errors
    /// Returns [`ImuError::Reset`] if the settings were lost, or another error if a transfer failed.
    async fn check(&mut self) -> Result<(), ImuError>;
}
