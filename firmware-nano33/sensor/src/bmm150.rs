//! BMM150: magnetometer of the Nano 33 BLE Sense Rev2, on the same wires as the BMI270 (Bosch BST-BMM150-DS001).
//!
//! **No image runs it.** How its axes lie against the accelerometer's has yet to be measured on a board: Arduino's
//! library gives them raw, another program mirrors one of them, and a wrong sign would look like a working sensor. So a
//! Rev2 is a board of six axes, and models that read nine are refused there. Whoever holds a board can measure with this:
//! turn it so that each edge points down and north in turn, and compare signs with [`crate::Set`]'s.
//!
//! Raw counts mean little by themselves: each chip has trimming values of its own, and the resistance of its Hall plates
//! (its temperature) enters, too.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

use crate::ImuError;
use crate::i2c::{Setting, read, set, verify};

/// Bus address on this board.
pub const ADDRESS: u8 = 0x10;
const CHIP_ID: u8 = 0x40;
/// The value of CHIP_ID once the chip has power.
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
/// From power to a chip that can be read.
const START_MS: u32 = 3;

const SETTINGS: [Setting; 3] = [
    // The data sheet's regular preset.
    (REPETITIONS_XY, 4),
    (REPETITIONS_Z, 7),
    // 30 Hz, the most it has, by itself.
    (MODE, 7 << 3),
];

/// In the last word of the data: the bit for new data.
const READY: u8 = 1;
/// What is read instead of a value beyond the converter's range.
const OVERFLOW_XY: i16 = -4096;
const OVERFLOW_Z: i16 = -16384;

/// One reading: 13, 13 and 15 bits, and the Hall plates' resistance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Raw {
    /// x, y and z in the chip's counts.
    pub field: [i16; 3],
    /// Resistance of the Hall plates; 0 = not measured.
    pub hall: u16,
}

impl Raw {
    /// From the registers.
    fn from_bytes(bytes: [u8; 8]) -> Self {
        let word = |i: usize| i16::from_le_bytes([bytes[i], bytes[i + 1]]);
        Self { field: [word(0) >> 3, word(2) >> 3, word(4) >> 1], hall: word(6) as u16 >> 2 }
    }
}

/// A chip's own trimming values, named as in the data sheet.
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
    /// What chips of this kind have.
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

    /// A chip whose trimming values are all unusual, to test with.
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

    /// From the registers 0x5D, 0x62 and 0x68 on.
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

    /// The field in µT along the chip's axes; `None` if an axis is beyond its range, or what it takes is missing.
    pub fn field_ut(&self, raw: Raw) -> Option<[f32; 3]> {
        let [x, y, z] = raw.field;
        if x == OVERFLOW_XY || y == OVERFLOW_XY || z == OVERFLOW_Z {
            return None;
        }
        if raw.hall == 0 || self.xyz1 == 0 || self.z1 == 0 || self.z2 == 0 {
            return None;
        }
        let (hall, reference) = (f32::from(raw.hall), f32::from(self.xyz1));
        // How far the plates' resistance is from where the chip was trimmed: linear and square share.
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

/// The chip on its bus.
#[derive(Debug)]
pub struct Bmm150<I> {
    i2c: I,
    trim: Trim,
}

impl<I: I2c> Bmm150<I> {
    /// A chip that has yet to be [started](Self::start).
    pub fn new(i2c: I) -> Self {
        Self { i2c, trim: Trim::default() }
    }

    /// Gives it power, reads its trimming, and lets it measure by itself.
    ///
    /// # Errors
    /// Says what is wrong with the chip or the bus.
    pub async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError> {
        // Without its power bit nothing but that can be read. A reset keeps it.
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

    /// The newest field in µT along the chip's axes; `None` while there is none, or if it is beyond the chip's range (a
    /// magnet).
    ///
    /// # Errors
    /// A failed transfer.
    pub async fn field_ut(&mut self) -> Result<Option<[f32; 3]>, ImuError> {
        let bytes = read::<8, _>(&mut self.i2c, ADDRESS, DATA).await?;
        let is_new = bytes[6] & READY != 0;
        Ok(if is_new { self.trim.field_ut(Raw::from_bytes(bytes)) } else { None })
    }

    /// Whether the chip still has its settings.
    ///
    /// # Errors
    /// [`ImuError::Reset`] if it has lost them, or a failed transfer.
    pub async fn check(&mut self) -> Result<(), ImuError> {
        verify(&mut self.i2c, ADDRESS, &SETTINGS).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bosch's own program (BMM150_SensorAPI, in floating point) gave these.
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
        // The lowest bits of each register belong to other things.
        let bytes = [0x07 | 0x08, 0xFF, 0xF8 | 0x05, 0x7F, 0x01, 0x80, 0x03, 0xFF];
        let raw = Raw::from_bytes(bytes);
        assert_eq!(raw, Raw { field: [-31, 4095, -16384], hall: 0x3FC0 });
    }
}
