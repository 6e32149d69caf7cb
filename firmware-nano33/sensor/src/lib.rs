//! The Nano 33 BLE Sense's motion sensor, without the board: everything here runs on a laptop too.
//!
//! ```text
//! LSM9DS1 FIFO (238 Hz, the sensor's own clock) -> Imu::poll -> Grid -> 100 Hz, the board's crystal
//! ```
//!
//! * [`lsm9ds1`]: the driver, async over embedded-hal-async I2C.
//! * [`grid`]: finds out when the sensor took each set, and interpolates onto the 100 Hz grid.
//! * [`Imu`]: what a second sensor (Rev2: BMI270 + BMM150) would have to offer.
#![no_std]

pub mod grid;
pub mod lsm9ds1;

/// One accelerometer and gyroscope set in counts: accX accY accZ gyrX gyrY gyrZ.
pub type Set = [i16; 6];

/// Deepest FIFO of a supported sensor, in sets.
pub const FIFO_SETS: usize = 32;

/// What waited in the sensor since the last poll.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    sets: [Set; FIFO_SETS],
    len: usize,
    /// The FIFO was full: sets were lost before the first one here.
    pub overrun: bool,
    /// The newest magnetometer values in counts.
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
    /// The sensors of a Rev2 board answer (BMI270), which this image does not support.
    Rev2,
    /// A transfer failed; the bus address.
    Bus(u8),
    /// The sensor lost its settings (power dip).
    Reset,
}

/// A motion sensor with a FIFO.
#[allow(async_fn_in_trait, reason = "used with one executor, on one core")]
pub trait Imu {
    /// Sets per second by the data sheet. The true rate may differ by some per cent.
    fn nominal_hz(&self) -> f32;

    /// Physical value of one count: m/s², deg/s, µT.
    fn scale(&self) -> [f32; 3];

    /// Checks who answers, resets and configures the sensor, and starts its FIFO.
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
    /// [`ImuError::Reset`] where it has lost them, or a failed transfer.
    async fn check(&mut self) -> Result<(), ImuError>;
}
