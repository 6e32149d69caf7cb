//! Detects the type of sensor on the bus, because boards with the same name carry different sensors.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::bmi270::{self, Bmi270};
use crate::i2c::read;
use crate::lsm6ds3::{self, Lsm6ds3};
use crate::lsm9ds1::{self, Lsm9ds1};
use crate::{Batch, Imu, ImuError};

/// The supported sensors, with their numbers in the protocol's list `Sensor`.
/// A sensor missing from that list still works, and the laptop then shows its number instead of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Nano 33 BLE Sense.
    Lsm9ds1 = 1,
    /// Nano 33 BLE Sense Rev2.
    Bmi270 = 2,
    /// XIAO nRF52840 Sense.
    Lsm6ds3 = 3,
}

impl Kind {
    /// Returns the I2C address, the identity register and the register's expected value.
    const fn identity(self) -> (u8, u8, u8) {
        match self {
            Self::Lsm9ds1 => (lsm9ds1::ADDRESS_AG, lsm9ds1::WHO_AM_I, lsm9ds1::WHO_AM_I_AG),
            Self::Bmi270 => (bmi270::ADDRESS, bmi270::CHIP_ID, bmi270::ID),
            Self::Lsm6ds3 => (lsm6ds3::ADDRESS, lsm6ds3::WHO_AM_I, lsm6ds3::ID),
        }
    }

    /// Its bus address.
    pub const fn address(self) -> u8 {
        self.identity().0
    }
}

/// The detected sensor.
#[derive(Debug)]
pub enum Found<I> {
    /// As its kind says.
    Lsm9ds1(Lsm9ds1<I>),
    /// As its kind says.
    Bmi270(Bmi270<I>),
    /// As its kind says.
    Lsm6ds3(Lsm6ds3<I>),
}

impl<I: I2c> Found<I> {
    /// Probes the given sensors in order.
    ///
    /// # Errors
    /// Returns [`ImuError::Unknown`] if a different chip answers at one of the addresses.
    /// Returns [`ImuError::Missing`] with the first address if no chip answers.
    pub async fn find(mut i2c: I, kinds: &[Kind]) -> Result<Self, ImuError> {
        let mut why = ImuError::Missing(kinds.first().map_or(0, |kind| kind.address()));
        for &kind in kinds {
            let (address, register, wanted) = kind.identity();
            match read::<1, _>(&mut i2c, address, register).await {
                Ok([id]) if id == wanted => {
                    return Ok(match kind {
                        Kind::Lsm9ds1 => Self::Lsm9ds1(Lsm9ds1::new(i2c, lsm9ds1::Config::default())),
                        Kind::Bmi270 => Self::Bmi270(Bmi270::new(i2c)),
                        Kind::Lsm6ds3 => Self::Lsm6ds3(Lsm6ds3::new(i2c)),
                    });
                }
                Ok([id]) => why = ImuError::Unknown(id),
                Err(_) => {}
            }
        }
        Err(why)
    }

    /// Which one it is.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Lsm9ds1(_) => Kind::Lsm9ds1,
            Self::Bmi270(_) => Kind::Bmi270,
            Self::Lsm6ds3(_) => Kind::Lsm6ds3,
        }
    }
}

macro_rules! whichever {
    ($found:expr, $imu:ident => $do:expr) => {
        match $found {
            Found::Lsm9ds1($imu) => $do,
            Found::Bmi270($imu) => $do,
            Found::Lsm6ds3($imu) => $do,
        }
    };
}

impl<I: I2c> Imu for Found<I> {
    fn nominal_hz(&self) -> f32 {
        whichever!(self, imu => imu.nominal_hz())
    }

    fn axes(&self) -> usize {
        whichever!(self, imu => imu.axes())
    }

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        whichever!(self, imu => imu.start(delay).await)
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        whichever!(self, imu => imu.poll(batch).await)
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        whichever!(self, imu => imu.check().await)
    }
}
