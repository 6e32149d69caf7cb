//! LSM9DS1 (ST DocID025715 Rev 2).
//! Accelerometer and gyroscope are on one die, and the magnetometer is on another die.
//!
//! **Axes.** The driver returns the raw chip axes, as Arduino's library and Edge Impulse's firmware do.
//! Models and recordings can therefore be exchanged.
//! Figure 1 of the data sheet shows left-handed axes for the accelerometer and gyroscope.
//! The magnetometer's axes are right-handed, and its X axis points opposite to the X axis of the other two sensors.
//! For a right-handed frame, negate X of both the accelerometer and the gyroscope.
//!
//! **Filters.** The low-pass cut-off frequency of the gyroscope is 76 Hz at 238 Hz and 38 Hz at 119 Hz.
//! The cut-off frequency of the accelerometer is 105 Hz at 238 Hz and 50 Hz at 119 Hz.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::i2c::{Setting, read, set, triple, verify};
use crate::{Batch, Imu, ImuError};

/// I2C address of the die with accelerometer and gyroscope on this board (SA0 high).
pub const ADDRESS_AG: u8 = 0x6B;
/// I2C address of the magnetometer on this board.
pub const ADDRESS_MAG: u8 = 0x1E;

pub(crate) const WHO_AM_I: u8 = 0x0F;
pub(crate) const WHO_AM_I_AG: u8 = 0x68;
const WHO_AM_I_MAG: u8 = 0x3D;

const CTRL_REG1_G: u8 = 0x10;
const STATUS: u8 = 0x17;
/// The sensor has not finished its start-up or its reset.
const BOOT_STATUS: u8 = 1 << 3;
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
/// The magnetometer increments the register address only if this bit of the address is set.
const MAG_AUTO_INCREMENT: u8 = 0x80;

const FIFO_CONTINUOUS: u8 = 0b110 << 5;
const FIFO_BYPASS: u8 = 0;
const FIFO_OVERRUN: u8 = 1 << 6;
const FIFO_COUNT: u8 = 0x3F;

/// Number of sets to discard after a start. The first of these sets follows the change of the FIFO mode.
/// The next four sets arrive while the filter of the gyroscope settles (data sheet, table 12).
const SETTLING_SETS: u8 = 5;

/// Settings of the magnetometer.
const MAG: [Setting; 5] = [
    // Magnetometer: temperature compensation, ultra-high-performance mode for X and Y, 80 Hz.
    (CTRL_REG1_M, 0x80 | (3 << 5) | (7 << 2)),
    // ±4 gauss.
    (CTRL_REG2_M, 0),
    // Ultra-high-performance mode for Z.
    (CTRL_REG4_M, 3 << 2),
    // Block data update.
    (CTRL_REG5_M, 0x40),
    // Continuous conversion.
    (CTRL_REG3_M, 0),
];

/// Range of the accelerometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AccelRange {
    /// Range ±2 g, as in Edge Impulse's firmware. Recordings made with that firmware clip at ±19.61 m/s².
    G2,
    /// ±4 g.
    #[default]
    G4,
}

/// Number of accelerometer and gyroscope sets per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rate {
    /// 119 Hz.
    Hz119,
    /// 238 Hz.
    #[default]
    Hz238,
}

/// Conversion factors of the counts of gyroscope and magnetometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Uses the sensitivities from the data sheet.
    #[default]
    DataSheet,
    /// Uses full scale / 32768, as in Arduino's library. Gyroscope and magnetometer then read 12.8 % too low.
    /// Models trained on recordings made with that library require these factors.
    Arduino,
}

/// Settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Config {
    /// Range of the accelerometer.
    pub accel: AccelRange,
    /// Sets per second.
    pub rate: Rate,
    /// Conversion factors of the sensor's counts.
    pub scale: Scale,
}

impl Config {
    /// Value of one count in m/s², deg/s and µT.
    pub fn scale(&self) -> [f32; 3] {
        const G: f32 = 9.80665;
        match (self.scale, self.accel) {
            (Scale::DataSheet, AccelRange::G2) => [0.061e-3 * G, 0.07, 0.014],
            (Scale::DataSheet, AccelRange::G4) => [0.122e-3 * G, 0.07, 0.014],
            (Scale::Arduino, AccelRange::G2) => [2.0 / 32768.0 * G, 2000.0 / 32768.0, 400.0 / 32768.0],
            (Scale::Arduino, AccelRange::G4) => [4.0 / 32768.0 * G, 2000.0 / 32768.0, 400.0 / 32768.0],
        }
    }

    /// Settings of the accelerometer and gyroscope.
    fn ag(&self) -> [Setting; 5] {
        [
            // Enables block data update and address auto-increment.
            (CTRL_REG8, 0x44),
            (CTRL_REG1_G, self.ctrl_reg1_g()),
            (CTRL_REG6_XL, self.ctrl_reg6_xl()),
            // Enables the FIFO, in which new data overwrites the oldest data.
            (CTRL_REG9, 0x02),
            (FIFO_CTRL, FIFO_CONTINUOUS),
        ]
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

/// Driver of the sensor on an I2C bus.
#[derive(Debug)]
pub struct Lsm9ds1<I> {
    i2c: I,
    config: Config,
    to_drop: u8,
}

impl<I: I2c> Lsm9ds1<I> {
    /// Creates a driver. Call [`Imu::start`] before any other method.
    pub fn new(i2c: I, config: Config) -> Self {
        Self { i2c, config, to_drop: 0 }
    }

    /// Gives the bus back.
    pub fn release(self) -> I {
        self.i2c
    }

    /// Checks the identity of both dies.
    async fn identify(&mut self) -> Result<(), ImuError> {
        for (address, wanted) in [(ADDRESS_AG, WHO_AM_I_AG), (ADDRESS_MAG, WHO_AM_I_MAG)] {
            match read::<1, _>(&mut self.i2c, address, WHO_AM_I).await {
                Ok([who]) if who == wanted => {}
                Ok([who]) => return Err(ImuError::Unknown(who)),
                Err(_) => return Err(ImuError::Missing(address)),
            }
        }
        Ok(())
    }

    /// Waits until the accelerometer and gyroscope have started.
    async fn booted(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        for _ in 0..10 {
            if read::<1, _>(&mut self.i2c, ADDRESS_AG, STATUS).await?[0] & BOOT_STATUS == 0 {
                return Ok(());
            }
            delay.delay_ms(5).await;
        }
        Err(ImuError::Reset(ADDRESS_AG))
    }
}

impl<I: I2c> Imu for Lsm9ds1<I> {
    fn nominal_hz(&self) -> f32 {
        match self.config.rate {
            Rate::Hz119 => 119.0,
            Rate::Hz238 => 238.0,
        }
    }

    fn axes(&self) -> usize {
        9
    }

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        self.identify().await?;
        // Resets both dies by software, enables address auto-increment, and waits 10 ms as Arduino's library does.
        set(&mut self.i2c, ADDRESS_AG, &[(CTRL_REG8, 0x05)]).await?;
        set(&mut self.i2c, ADDRESS_MAG, &[(CTRL_REG2_M, 0x0C)]).await?;
        delay.delay_ms(10).await;
        self.booted(delay).await?;
        // Bypass mode first empties the FIFO.
        set(&mut self.i2c, ADDRESS_AG, &[(FIFO_CTRL, FIFO_BYPASS)]).await?;
        let ag = self.config.ag();
        set(&mut self.i2c, ADDRESS_AG, &ag).await?;
        set(&mut self.i2c, ADDRESS_MAG, &MAG).await?;
        verify(&mut self.i2c, ADDRESS_AG, &ag).await?;
        verify(&mut self.i2c, ADDRESS_MAG, &MAG).await?;
        self.to_drop = SETTLING_SETS;
        Ok(())
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        batch.clear();
        let [source] = read::<1, _>(&mut self.i2c, ADDRESS_AG, FIFO_SRC).await?;
        batch.overrun = source & FIFO_OVERRUN != 0;
        for _ in 0..source & FIFO_COUNT {
            // One burst read continues
            // from the gyroscope's registers (18h to 1Dh) to those of the accelerometer (28h to 2Dh).
            let b = read::<12, _>(&mut self.i2c, ADDRESS_AG, OUT_X_G).await?;
            let ([gx, gy, gz], [ax, ay, az]) = (triple(&b[..6]), triple(&b[6..]));
            if self.to_drop > 0 {
                self.to_drop -= 1;
            } else {
                batch.push([ax, ay, az, gx, gy, gz]);
            }
        }
        let b = read::<6, _>(&mut self.i2c, ADDRESS_MAG, OUT_X_L_M | MAG_AUTO_INCREMENT).await?;
        batch.magnetometer = triple(&b);
        Ok(())
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        verify(&mut self.i2c, ADDRESS_AG, &self.config.ag()).await?;
        verify(&mut self.i2c, ADDRESS_MAG, &[(CTRL_REG3_M, 0)]).await
    }
}
