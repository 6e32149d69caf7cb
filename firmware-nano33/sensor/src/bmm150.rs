//! BMM150: magnetometer of the Nano 33 BLE Sense Rev2, on the same bus as the BMI270 (Bosch BST-BMM150-DS001).
//!
//! **No firmware image uses this driver yet.**
//! The orientation of the magnetometer's axes relative to the accelerometer's has not been measured on a board.
//! Arduino's library does not convert the axes, and another program inverts one of them.
//! A wrong sign would be hard to notice, because the readings would still look plausible.
//! The firmware therefore treats a Rev2 as a six-axis board and rejects models that need nine axes.
//! To measure the orientation on a board, turn each edge downwards and then north. Compare the signs with [`crate::Set`].
//!
//! Raw counts alone are not a field strength.
//! The conversion also needs the chip's individual trimming values.
//! The resistance of the chip's Hall plates, which depends on the temperature, is also needed.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::ImuError;
use crate::i2c::{Setting, read, set, verify};

/// I2C address on this board.
pub const ADDRESS: u8 = 0x10;
const CHIP_ID: u8 = 0x40;
/// Value of CHIP_ID after the chip's power bit is set.
const ID: u8 = 0x32;
const DATA: u8 = 0x42;
const POWER: u8 = 0x4B;
const MODE: u8 = 0x4C;
const REPETITIONS_XY: u8 = 0x51;
const REPETITIONS_Z: u8 = 0x52;
const TRIM_1: u8 = 0x5D;
const TRIM_2: u8 = 0x62;
const TRIM_3: u8 = 0x68;

const SOFT_RESET: u8 = 0x83;
const ON: u8 = 0x01;
/// Time from power-up until the chip can be read, in milliseconds.
const START_MS: u32 = 3;

const SETTINGS: [Setting; 3] = [
    // The data sheet's preset "regular".
    (REPETITIONS_XY, 4),
    (REPETITIONS_Z, 7),
    // Normal mode with 30 measurements per second, the highest rate of the chip.
    (MODE, 7 << 3),
];

/// Bit in the last word of the data that shows that the data is ready.
const READY: u8 = 1;
/// Value that replaces a measurement beyond the converter's range.
const OVERFLOW_XY: i16 = -4096;
const OVERFLOW_Z: i16 = -16384;

/// One raw measurement: field values of 13, 13 and 15 bits, and the resistance of the Hall plates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Raw {
    /// Field along x, y and z in counts of the chip.
    pub field: [i16; 3],
    /// Resistance of the Hall plates in counts; 0 means that it was not measured.
    pub hall: u16,
}

impl Raw {
    /// Converts the contents of the registers.
    fn from_bytes(bytes: [u8; 8]) -> Self {
        let word = |i: usize| i16::from_le_bytes([bytes[i], bytes[i + 1]]);
        Self { field: [word(0) >> 3, word(2) >> 3, word(4) >> 1], hall: word(6) as u16 >> 2 }
    }
}

/// The trimming values of an individual chip. The names are those of the data sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the data sheet's names, which it does not explain")]
pub struct Trim {
    pub x1: i8,
    pub y1: i8,
    pub x2: i8,
    pub y2: i8,
    pub z1: u16,
    pub z2: i16,
    pub z3: i16,
    pub z4: i16,
    pub xy1: u8,
    pub xy2: i8,
    pub xyz1: u16,
}

impl Trim {
    /// Typical trimming values for this type of chip.
    pub const TYPICAL: Self = Self {
        x1: 0,
        y1: 0,
        x2: 26,
        y2: 26,
        z1: 24_747,
        z2: 763,
        z3: 0,
        z4: 0,
        xy1: 29,
        xy2: -3,
        xyz1: 6753,
    };

    /// Unusual trimming values, for tests.
    pub const ODD: Self = Self {
        x1: -5,
        y1: 7,
        x2: 30,
        y2: -12,
        z1: 23_100,
        z2: 810,
        z3: -340,
        z4: 21,
        xy1: 31,
        xy2: -4,
        xyz1: 6500,
    };

    /// Decodes the registers that start at 0x5D, 0x62 and 0x68.
    fn from_bytes(one: [u8; 2], two: [u8; 4], three: [u8; 10]) -> Self {
        let word = |i: usize| u16::from_le_bytes([three[i], three[i + 1]]);
        Self {
            x1: one[0] as i8,
            y1: one[1] as i8,
            z4: i16::from_le_bytes([two[0], two[1]]),
            x2: two[2] as i8,
            y2: two[3] as i8,
            z2: word(0) as i16,
            z1: word(2),
            xyz1: word(4),
            z3: word(6) as i16,
            xy2: three[8] as i8,
            xy1: three[9],
        }
    }

    /// Returns the field in µT along the chip's axes.
    /// Returns `None` if an axis is out of range or if a value needed for the conversion is missing.
    pub fn field_ut(&self, raw: Raw) -> Option<[f32; 3]> {
        let [x, y, z] = raw.field;
        if x == OVERFLOW_XY || y == OVERFLOW_XY || z == OVERFLOW_Z {
            return None;
        }
        if raw.hall == 0 || self.xyz1 == 0 || self.z1 == 0 || self.z2 == 0 {
            return None;
        }
        let (hall, reference) = (f32::from(raw.hall), f32::from(self.xyz1));
        // Relative change of the plates' resistance since trimming, with a linear and a quadratic term.
        let drift = reference / hall - 1.0;
        let gain = 256.0 + f32::from(self.xy2) * drift * drift + f32::from(self.xy1) * drift;
        let flat = |counts: i16, slope: i8, offset: i8| {
            let counts = f32::from(counts) * gain * (f32::from(slope) + 160.0) / 8192.0;
            (counts + 8.0 * f32::from(offset)) / 16.0
        };
        let upright = {
            let counts = 131_072.0 * (f32::from(z) - f32::from(self.z4));
            let drift = f32::from(self.z3) * (hall - reference);
            (counts - drift) / (64.0 * (f32::from(self.z2) + f32::from(self.z1) * hall / 32_768.0))
        };
        Some([flat(x, self.x2, self.x1), flat(y, self.y2, self.y1), upright])
    }
}

/// Driver of the chip on an I2C bus.
#[derive(Debug)]
pub struct Bmm150<I> {
    i2c: I,
    trim: Trim,
}

impl<I: I2c> Bmm150<I> {
    /// Creates a driver. Call [`Self::start`] before any other method.
    pub fn new(i2c: I) -> Self {
        Self { i2c, trim: Trim::default() }
    }

    /// Powers the chip up, reads its trimming values and starts continuous measurement.
    ///
    /// # Errors
    /// Fails if the chip was not recognised, or if a transfer failed.
    pub async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        // Until the power bit is set, only that bit can be read. A soft reset does not clear it.
        for value in [ON, SOFT_RESET, ON] {
            set(&mut self.i2c, ADDRESS, &[(POWER, value)]).await.map_err(|_| ImuError::Missing(ADDRESS))?;
            delay.delay_ms(START_MS).await;
        }
        match read::<1, _>(&mut self.i2c, ADDRESS, CHIP_ID).await? {
            [ID] => {}
            [who] => return Err(ImuError::Unknown(who)),
        }
        self.trim = Trim::from_bytes(
            read(&mut self.i2c, ADDRESS, TRIM_1).await?,
            read(&mut self.i2c, ADDRESS, TRIM_2).await?,
            read(&mut self.i2c, ADDRESS, TRIM_3).await?,
        );
        set(&mut self.i2c, ADDRESS, &SETTINGS).await?;
        self.check().await
    }

    /// Returns the newest field in µT along the chip's axes.
    /// Returns `None` if there is no new measurement, or if the field is too strong for the chip.
    /// The field is too strong near a magnet, for example.
    ///
    /// # Errors
    /// Fails if a transfer failed.
    pub async fn field_ut(&mut self) -> Result<Option<[f32; 3]>, ImuError> {
        let bytes = read::<8, _>(&mut self.i2c, ADDRESS, DATA).await?;
        let is_new = bytes[6] & READY != 0;
        Ok(if is_new { self.trim.field_ut(Raw::from_bytes(bytes)) } else { None })
    }

    /// Checks that the chip's settings are still in effect.
    ///
    /// # Errors
    /// Returns [`ImuError::Reset`] if the settings were lost, or another error if a transfer failed.
    pub async fn check(&mut self) -> Result<(), ImuError> {
        verify(&mut self.i2c, ADDRESS, &SETTINGS).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expected values come from Bosch's own driver (BMM150_SensorAPI, floating-point version).
    #[test]
    fn trimming_gives_the_field_that_the_makers_own_program_gives() {
        for (trim, field, hall, wanted) in [
            (Trim::TYPICAL, [0, 0, 0], 6753, [0.0, 0.0, 0.0]),
            (Trim::TYPICAL, [100, -200, 300], 6753, [36.3281, -72.6562, 104.7929]),
            (Trim::TYPICAL, [100, -200, 300], 7100, [36.1260, -72.2520, 100.3094]),
            (Trim::TYPICAL, [-1234, 2345, -3456], 6100, [-453.6651, 862.1107, -1318.0835]),
            (Trim::ODD, [0, 0, 0], 6753, [-2.5, 3.5, -7.4793]),
            (Trim::ODD, [100, -200, 300], 6753, [34.4402, -54.0490, 102.8147]),
            (Trim::ODD, [-1234, 2345, -3456], 6100, [-464.0352, 686.6886, -1393.8743]),
            (Trim::ODD, [4095, -4095, 16383], 6500, [1517.1289, -1180.2109, 6214.3999]),
        ] {
            let seen = trim.field_ut(Raw { field, hall }).expect("within the range");
            for (seen, wanted) in seen.into_iter().zip(wanted) {
                assert!(
                    (seen - wanted).abs() < 1e-3_f32.max(wanted.abs() * 1e-6),
                    "{field:?}: {seen}, not {wanted}"
                );
            }
        }
    }

    #[test]
    fn an_axis_beyond_its_range_or_a_missing_resistance_gives_nothing() {
        let raw = |field, hall| Raw { field, hall };
        for bad in [
            raw([-4096, 10, 20], 6500),
            raw([10, -4096, 20], 6500),
            raw([10, 20, -16384], 6500),
            raw([10, 20, 30], 0),
        ] {
            assert_eq!(Trim::TYPICAL.field_ut(bad), None, "{bad:?}");
        }
        assert_eq!(Trim::default().field_ut(raw([10, 20, 30], 6500)), None, "a chip that was not read");
        assert!(Trim::TYPICAL.field_ut(raw([-4095, 4095, -16383], 6500)).is_some());
    }

    #[test]
    fn values_of_13_13_15_and_14_bits_are_cut_from_the_registers_with_their_signs() {
        // The lowest bits of each register carry other information.
        let bytes = [0x07 | 0x08, 0xFF, 0xF8 | 0x05, 0x7F, 0x01, 0x80, 0x03, 0xFF];
        let raw = Raw::from_bytes(bytes);
        assert_eq!(raw, Raw { field: [-31, 4095, -16384], hall: 0x3FC0 });
    }
}
