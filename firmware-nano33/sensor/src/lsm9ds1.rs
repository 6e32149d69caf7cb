//! LSM9DS1: accelerometer and gyroscope on one die, magnetometer on the other (ST DocID025715 Rev 2).
//!
//! **Axes** are the raw chip axes, as Arduino's library and Edge Impulse's firmware give them, so that
//! models and recordings are exchangeable. As drawn in the data sheet's figure 1 the accelerometer's
//! and gyroscope's axes are left-handed; the magnetometer's are right-handed, with X = −X of the
//! others. For a right-handed frame negate X of accelerometer *and* gyroscope.
//!
//! **Filters**: at 238 Hz the gyroscope's low-pass is at 76 Hz and the accelerometer's at 105 Hz, at
//! 119 Hz they are at 38 and 50 Hz.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::{Batch, Imu, ImuError};

/// Bus address of the accelerometer and gyroscope on this board (SA0 high).
pub const ADDRESS_AG: u8 = 0x6B;
/// Bus address of the magnetometer on this board.
pub const ADDRESS_MAG: u8 = 0x1E;
/// Bus address of the BMI270, the motion sensor of a Rev2 board.
pub const ADDRESS_BMI270: u8 = 0x68;

const WHO_AM_I: u8 = 0x0F;
const WHO_AM_I_AG: u8 = 0x68;
const WHO_AM_I_MAG: u8 = 0x3D;
const CHIP_ID_BMI270: u8 = 0x24;

const CTRL_REG1_G: u8 = 0x10;
const OUT_X_G: u8 = 0x18;
const CTRL_REG6_XL: u8 = 0x20;
const CTRL_REG8: u8 = 0x22;
const CTRL_REG9: u8 = 0x23;
const FIFO_CTRL: u8 = 0x2E;
const FIFO_SRC: u8 = 0x2F;

const CTRL_REG1_M: u8 = 0x20;
const CTRL_REG2_M: u8 = 0x21;
const CTRL_REG3_M: u8 = 0x22;
const CTRL_REG4_M: u8 = 0x23;
const CTRL_REG5_M: u8 = 0x24;
const OUT_X_L_M: u8 = 0x28;
/// The magnetometer counts its sub-address up only with this bit set.
const MAG_AUTO_INCREMENT: u8 = 0x80;

const FIFO_CONTINUOUS: u8 = 0b110 << 5;
const FIFO_BYPASS: u8 = 0;
const FIFO_OVERRUN: u8 = 1 << 6;
const FIFO_COUNT: u8 = 0x3F;

/// Sets to drop after a start: the first after a change of the FIFO mode, and four while the
/// gyroscope's filter settles (data sheet, table 12).
const SETTLING_SETS: u8 = 5;

/// Range of the accelerometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AccelRange {
    /// ±2 g, as Edge Impulse's firmware has it (its recordings clip at ±19.61 m/s²).
    G2,
    /// ±4 g.
    #[default]
    G4,
}

/// Sets per second of accelerometer and gyroscope.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rate {
    /// 119 Hz.
    Hz119,
    /// 238 Hz.
    #[default]
    Hz238,
}

/// What a count of gyroscope and magnetometer is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// By the data sheet's sensitivities.
    #[default]
    DataSheet,
    /// Full scale / 32768, as Arduino's library has it: gyroscope and magnetometer read 12.8 % low.
    /// For models trained on recordings made with that library.
    Arduino,
}

/// Settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Config {
    /// Range of the accelerometer.
    pub accel: AccelRange,
    /// Sets per second.
    pub rate: Rate,
    /// What a count is worth.
    pub scale: Scale,
}

impl Config {
    /// Physical value of one count: m/s², deg/s, µT.
    pub fn scale(&self) -> [f32; 3] {
        const G: f32 = 9.80665;
        match (self.scale, self.accel) {
            (Scale::DataSheet, AccelRange::G2) => [0.061e-3 * G, 0.07, 0.014],
            (Scale::DataSheet, AccelRange::G4) => [0.122e-3 * G, 0.07, 0.014],
            (Scale::Arduino, AccelRange::G2) => [2.0 / 32768.0 * G, 2000.0 / 32768.0, 400.0 / 32768.0],
            (Scale::Arduino, AccelRange::G4) => [4.0 / 32768.0 * G, 2000.0 / 32768.0, 400.0 / 32768.0],
        }
    }

    fn ctrl_reg1_g(&self) -> u8 {
        // FS = 11: ±2000 deg/s.
        match self.rate {
            Rate::Hz119 => (3 << 5) | (3 << 3),
            Rate::Hz238 => (4 << 5) | (3 << 3),
        }
    }

    fn ctrl_reg6_xl(&self) -> u8 {
        let rate = match self.rate {
            Rate::Hz119 => 3 << 5,
            Rate::Hz238 => 4 << 5,
        };
        // 01 is ±16 g.
        let range = match self.accel {
            AccelRange::G2 => 0b00 << 3,
            AccelRange::G4 => 0b10 << 3,
        };
        rate | range
    }
}

/// The sensor on its bus.
#[derive(Debug)]
pub struct Lsm9ds1<I> {
    i2c: I,
    config: Config,
    to_drop: u8,
}

impl<I: I2c> Lsm9ds1<I> {
    /// A sensor that has yet to be [started](Imu::start).
    pub fn new(i2c: I, config: Config) -> Self {
        Self { i2c, config, to_drop: 0 }
    }

    /// Gives the bus back.
    pub fn release(self) -> I {
        self.i2c
    }

    async fn write(&mut self, address: u8, register: u8, value: u8) -> Result<(), ImuError> {
        self.i2c.write(address, &[register, value]).await.map_err(|_| ImuError::Bus(address))
    }

    async fn read<const N: usize>(&mut self, address: u8, register: u8) -> Result<[u8; N], ImuError> {
        let mut bytes = [0; N];
        match self.i2c.write_read(address, &[register], &mut bytes).await {
            Ok(()) => Ok(bytes),
            Err(_) => Err(ImuError::Bus(address)),
        }
    }

    /// Both dies are there and are what they should be.
    async fn identify(&mut self) -> Result<(), ImuError> {
        for (address, wanted) in [(ADDRESS_AG, WHO_AM_I_AG), (ADDRESS_MAG, WHO_AM_I_MAG)] {
            match self.read::<1>(address, WHO_AM_I).await {
                Ok([who]) if who == wanted => {}
                Ok([who]) => return Err(ImuError::Unknown(who)),
                Err(_) => {
                    // A Rev2 board has other sensors at other addresses; say so by name.
                    return Err(match self.read::<1>(ADDRESS_BMI270, 0x00).await {
                        Ok([CHIP_ID_BMI270]) => ImuError::Rev2,
                        _ => ImuError::Missing(address),
                    });
                }
            }
        }
        Ok(())
    }
}

impl<I: I2c> Imu for Lsm9ds1<I> {
    fn nominal_hz(&self) -> f32 {
        match self.config.rate {
            Rate::Hz119 => 119.0,
            Rate::Hz238 => 238.0,
        }
    }

    fn scale(&self) -> [f32; 3] {
        self.config.scale()
    }

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        self.identify().await?;
        // Software reset of both dies (with address increment kept on), then the 10 ms of Arduino's library.
        self.write(ADDRESS_AG, CTRL_REG8, 0x05).await?;
        self.write(ADDRESS_MAG, CTRL_REG2_M, 0x0C).await?;
        delay.delay_ms(10).await;

        let config = self.config;
        for (register, value) in [
            // Block data update, address increment.
            (CTRL_REG8, 0x44),
            (CTRL_REG1_G, config.ctrl_reg1_g()),
            (CTRL_REG6_XL, config.ctrl_reg6_xl()),
            // FIFO on, emptied by bypass, then overwriting its oldest.
            (CTRL_REG9, 0x02),
            (FIFO_CTRL, FIFO_BYPASS),
            (FIFO_CTRL, FIFO_CONTINUOUS),
        ] {
            self.write(ADDRESS_AG, register, value).await?;
        }
        for (register, value) in [
            // Temperature compensation, ultra-high performance, 80 Hz.
            (CTRL_REG1_M, 0x80 | (3 << 5) | (7 << 2)),
            // ±4 gauss.
            (CTRL_REG2_M, 0),
            // Z too in ultra-high performance.
            (CTRL_REG4_M, 3 << 2),
            // Block data update.
            (CTRL_REG5_M, 0x40),
            // Continuous conversion.
            (CTRL_REG3_M, 0),
        ] {
            self.write(ADDRESS_MAG, register, value).await?;
        }
        self.to_drop = SETTLING_SETS;
        Ok(())
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        batch.clear();
        let [source] = self.read::<1>(ADDRESS_AG, FIFO_SRC).await?;
        batch.overrun = source & FIFO_OVERRUN != 0;
        for _ in 0..source & FIFO_COUNT {
            // One burst rolls from the gyroscope's registers (18h..1Dh) to the accelerometer's (28h..2Dh).
            let b = self.read::<12>(ADDRESS_AG, OUT_X_G).await?;
            let at = |i: usize| i16::from_le_bytes([b[i], b[i + 1]]);
            if self.to_drop > 0 {
                self.to_drop -= 1;
            } else {
                batch.push([at(6), at(8), at(10), at(0), at(2), at(4)]);
            }
        }
        let b = self.read::<6>(ADDRESS_MAG, OUT_X_L_M | MAG_AUTO_INCREMENT).await?;
        batch.magnetometer = [0, 2, 4].map(|i| i16::from_le_bytes([b[i], b[i + 1]]));
        Ok(())
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        let [ag] = self.read::<1>(ADDRESS_AG, CTRL_REG1_G).await?;
        let [mag] = self.read::<1>(ADDRESS_MAG, CTRL_REG3_M).await?;
        if ag == self.config.ctrl_reg1_g() && mag == 0 { Ok(()) } else { Err(ImuError::Reset) }
    }
}
