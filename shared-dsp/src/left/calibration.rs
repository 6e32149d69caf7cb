//! Calibration of a wearer's left hand. It captures readings in known poses and stores them in a record.
//!
//! A calibration has three steps in this order: *neutral* (hand level and still), *rest* (fingers straight), *bend* (bent).
//! Each step averages [`CAPTURE_SAMPLES`] samples.
//! A calibration step is refused, and changes nothing, if the hand moves or the pose is implausible.

use crate::left::{AdcCounts, ONE_G, OVERSAMPLING};
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

/// The calibration of one hand. Readings are in units of [`AdcCounts`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calibration {
    /// Readings of x, y and z at 0 g, chosen so that the neutral pose counts as level: (0, 0, 1 g).
    pub zero: [i16; 3],
    /// Readings while the index and the middle finger are straight.
    pub rest: [u16; 2],
    /// Readings while the index and the middle finger are bent.
    pub bend: [u16; 2],
}

impl Calibration {
    /// Nominal values for an ADXL335 whose outputs are at half the reference when nothing accelerates it.
    /// The flex sensor has 10 kΩ, is in series with 22 kΩ, and doubles its resistance when bent.
    ///
    /// These values suffice for a good sensor. Real parts differ by ±0.5 g and ±30 %, so calibrate.
    pub const DEFAULT: Self = Self {
        zero: [512 * OVERSAMPLING as i16; 3],
        rest: [704 * OVERSAMPLING; 2],
        bend: [536 * OVERSAMPLING; 2],
    };
}

impl Default for Calibration {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The steps of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptureStep {
    /// The hand is level and still.
    Neutral,
    /// Both fingers are straight.
    Rest,
    /// Both fingers are bent.
    Bend,
}

/// The reason why a step was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptureError {
    /// The hand or the fingers moved.
    Moved,
    /// The readings do not match the pose, or a channel is open or shorted to a rail.
    Impossible,
}

/// Number of samples that one step averages: 0.64 s at 100 Hz, which is several periods of hand tremor.
pub const CAPTURE_SAMPLES: u16 = 64;
/// Maximum peak-to-peak change of an acceleration during a capture: 0.15 g, about ±4° of tremor.
const STEADY_ACCELERATION: u16 = (ONE_G * 15 / 100) as u16;
/// Maximum peak-to-peak change of a flex reading: 25 of 1024.
const STEADY_FLEX: u16 = 25 * OVERSAMPLING;
/// Minimum distance between rest and bend: 40 of 1024, eighty times the converter's noise.
const LEAST_WAY: u16 = 40 * OVERSAMPLING;
/// Maximum offset of x and y: ±0.5 g from the data sheet, plus sin 15° for a pose that is not quite level.
const MOST_SIDEWAYS: i16 = (ONE_G as i32 * 76 / 100) as i16;
/// Range of z at neutral: 1 g ± 10 %, ± the 1 g offset of the data sheet, plus some tolerance for the pose.
const UPRIGHT: core::ops::RangeInclusive<i16> =
    (ONE_G as i32 * -15 / 100) as i16..=(ONE_G as i32 * 215 / 100) as i16;

/// A calibration step in progress.
#[derive(Clone, Copy, Debug)]
pub struct Capture {
    step: CaptureStep,
    taken: u16,
    sums: [u32; 5],
    least: [u16; 5],
    most: [u16; 5],
}

impl Capture {
    /// Begins a step.
    pub fn new(step: CaptureStep) -> Self {
        Self { step, taken: 0, sums: [0; 5], least: [u16::MAX; 5], most: [0; 5] }
    }

    /// Adds one sample. The last sample returns the new calibration (based on `old`) or the reason for the refusal.
    #[inline(never)]
    pub fn step(
        &mut self,
        counts: AdcCounts,
        old: &Calibration,
    ) -> Option<Result<Calibration, CaptureError>> {
        for (i, value) in counts.as_array().into_iter().enumerate() {
            self.sums[i] += u32::from(value);
            self.least[i] = self.least[i].min(value);
            self.most[i] = self.most[i].max(value);
        }
        self.taken += 1;
        (self.taken >= CAPTURE_SAMPLES).then(|| self.finish(old))
    }

    #[inline(never)]
    fn finish(&self, old: &Calibration) -> Result<Calibration, CaptureError> {
        let (looked_at, allowed) = match self.step {
            CaptureStep::Neutral => (0..3, STEADY_ACCELERATION),
            CaptureStep::Rest | CaptureStep::Bend => (3..5, STEADY_FLEX),
        };
        for i in looked_at {
            if self.most[i] - self.least[i] > allowed {
                return Err(CaptureError::Moved);
            }
        }
        let mut mean = [0u16; 5];
        for (mean, sum) in mean.iter_mut().zip(self.sums) {
            *mean = ((sum + u32::from(CAPTURE_SAMPLES / 2)) / u32::from(CAPTURE_SAMPLES)) as u16;
        }
        let [x, y, z, index, middle] = mean;
        let mut new = *old;
        match self.step {
            CaptureStep::Neutral => {
                let from_middle = |v: u16| v as i16 - Calibration::DEFAULT.zero[0];
                if from_middle(x).abs() > MOST_SIDEWAYS
                    || from_middle(y).abs() > MOST_SIDEWAYS
                    || !UPRIGHT.contains(&from_middle(z))
                {
                    return Err(CaptureError::Impossible);
                }
                new.zero = [x as i16, y as i16, z as i16 - ONE_G];
            }
            CaptureStep::Rest => {
                // The step *bend* measures the distance from rest to bend. Until then, the old distance is used.
                for (i, rest) in [index, middle].into_iter().enumerate() {
                    let way = old.bend[i] as i16 - old.rest[i] as i16;
                    new.rest[i] = rest;
                    new.bend[i] = (rest as i16 + way).clamp(0, AdcCounts::MAX as i16) as u16;
                }
            }
            CaptureStep::Bend => {
                for (i, bend) in [index, middle].into_iter().enumerate() {
                    if bend.abs_diff(old.rest[i]) < LEAST_WAY {
                        return Err(CaptureError::Impossible);
                    }
                    new.bend[i] = bend;
                }
            }
        }
        Ok(new)
    }
}

/// Length of a stored calibration in bytes.
///
/// ```text
/// 0      1           2          8         12        16     20
/// ┌──────┬───────────┬──────────┬─────────┬─────────┬──────┐
/// │ 0x01 │ generation│ zero x3  │ rest x2 │ bend x2 │CRC-32│   all little endian
/// └──────┴───────────┴──────────┴─────────┴─────────┴──────┘
/// ```
pub const RECORD_BYTES: usize = 20;
/// The first byte of a record. Every new layout must have a new number.
const RECORD_VERSION: u8 = 1;
/// The checksum is computed bit by bit, because a table would take half of an ATmega's RAM.
const RECORD_CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// A calibration as it is stored, with version, generation and checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Counter of written records. The counter wraps. If both slots are valid, the newer record is used.
    pub generation: u8,
    /// The stored calibration.
    pub calibration: Calibration,
}

impl Record {
    /// Encodes the record.
    #[inline(never)]
    pub fn to_bytes(&self) -> [u8; RECORD_BYTES] {
        let Calibration { zero, rest, bend } = self.calibration;
        let words = [zero[0] as u16, zero[1] as u16, zero[2] as u16, rest[0], rest[1], bend[0], bend[1]];
        let mut bytes = [0; RECORD_BYTES];
        bytes[0] = RECORD_VERSION;
        bytes[1] = self.generation;
        for (i, word) in words.into_iter().enumerate() {
            bytes[2 + 2 * i..4 + 2 * i].copy_from_slice(&word.to_le_bytes());
        }
        let crc = RECORD_CRC.checksum(&bytes[..16]);
        bytes[16..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// Decodes a record. Returns `None` unless this version has written the record completely.
    #[inline(never)]
    pub fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Option<Self> {
        let word = |i: usize| u16::from_le_bytes([bytes[2 + 2 * i], bytes[3 + 2 * i]]);
        let stored = u32::from_le_bytes([bytes[16], bytes[17], bytes[18], bytes[19]]);
        if bytes[0] != RECORD_VERSION || stored != RECORD_CRC.checksum(&bytes[..16]) {
            return None;
        }
        Some(Self {
            generation: bytes[1],
            calibration: Calibration {
                zero: [word(0) as i16, word(1) as i16, word(2) as i16],
                rest: [word(3), word(4)],
                bend: [word(5), word(6)],
            },
        })
    }
}

/// The contents of the two slots of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    /// Neither slot was ever written.
    Blank,
    /// At least one slot was written, but neither is valid.
    Damaged,
    /// There is a valid record. If both slots are valid, this is the newer record.
    Good {
        /// The record.
        record: Record,
        /// The slot that contains the record (0 or 1).
        /// The next record goes to the other slot, so a power cut can destroy only the new record.
        slot: usize,
    },
}

impl Stored {
    /// Selects the newest valid record from both slots.
    #[inline(never)]
    pub fn choose(slots: [&[u8; RECORD_BYTES]; 2]) -> Self {
        let blank = |slot: &[u8; RECORD_BYTES]| slot.iter().all(|&byte| byte == 0xFF);
        match slots.map(Record::from_bytes) {
            // The newer record is ahead by less than half the range of the wrapping counter.
            [Some(a), Some(b)] if b.generation.wrapping_sub(a.generation) < 128 => {
                Stored::Good { record: b, slot: 1 }
            }
            [Some(record), _] => Stored::Good { record, slot: 0 },
            [None, Some(record)] => Stored::Good { record, slot: 1 },
            [None, None] if blank(slots[0]) && blank(slots[1]) => Stored::Blank,
            [None, None] => Stored::Damaged,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(x: u16, y: u16, z: u16, index: u16, middle: u16) -> AdcCounts {
        AdcCounts::from_ten_bit([x, y, z, index, middle])
    }

    fn capture(
        step: CaptureStep,
        old: &Calibration,
        samples: impl Fn(u16) -> AdcCounts,
    ) -> Result<Calibration, CaptureError> {
        let mut capture = Capture::new(step);
        for i in 0..CAPTURE_SAMPLES - 1 {
            assert_eq!(capture.step(samples(i), old), None);
        }
        capture.step(samples(CAPTURE_SAMPLES - 1), old).unwrap()
    }

    #[test]
    fn three_steps_make_a_calibration() {
        let mut c = Calibration::DEFAULT;
        c = capture(CaptureStep::Neutral, &c, |i| counts(540 + i % 3, 470, 630, 650, 760)).unwrap();
        // The mean of 540, 541, 542, 540 … is 540.98. At neutral, z is 1 g above its zero.
        assert_eq!(c.zero, [4328, 3760, 5040 - 819]);
        c = capture(CaptureStep::Rest, &c, |_| counts(540, 470, 630, 650, 760)).unwrap();
        assert_eq!(c.rest, [5200, 6080]);
        c = capture(CaptureStep::Bend, &c, |_| counts(540, 470, 630, 480, 560)).unwrap();
        assert_eq!(c.bend, [3840, 4480]);
    }

    #[test]
    fn a_moving_hand_and_impossible_poses_are_refused() {
        let old = Calibration::DEFAULT;
        let neutral = |f: &dyn Fn(u16) -> AdcCounts| capture(CaptureStep::Neutral, &old, f);
        assert_eq!(neutral(&|i| counts(512 + i / 3, 512, 614, 700, 700)), Err(CaptureError::Moved));
        assert_eq!(neutral(&|_| counts(600, 512, 614, 700, 700)), Err(CaptureError::Impossible));
        // The hand is upside down.
        assert_eq!(neutral(&|_| counts(512, 512, 410, 700, 700)), Err(CaptureError::Impossible));
        let bend = |f: &dyn Fn(u16) -> AdcCounts| capture(CaptureStep::Bend, &old, f);
        assert_eq!(bend(&|_| counts(512, 512, 614, 540, 690)), Err(CaptureError::Impossible));
        assert_eq!(bend(&|i| counts(512, 512, 614, 540, 500 + i)), Err(CaptureError::Moved));
    }

    #[test]
    fn fingers_may_move_while_neutral_is_taken() {
        let c =
            capture(CaptureStep::Neutral, &Calibration::DEFAULT, |i| counts(512, 512, 614, 500 + 3 * i, 700));
        assert!(c.is_ok());
    }

    #[test]
    fn a_record_survives_the_trip_and_has_golden_bytes() {
        let record = Record {
            generation: 7,
            calibration: Calibration { zero: [-2, 4096, 3000], rest: [5632, 5600], bend: [4288, 4000] },
        };
        let bytes = record.to_bytes();
        assert_eq!(Record::from_bytes(&bytes), Some(record));
        assert_eq!(
            bytes[..16],
            [1, 7, 0xFE, 0xFF, 0x00, 0x10, 0xB8, 0x0B, 0x00, 0x16, 0xE0, 0x15, 0xC0, 0x10, 0xA0, 0x0F]
        );
    }

    #[test]
    fn any_flipped_bit_is_damage() {
        let bytes = Record { generation: 0, calibration: Calibration::DEFAULT }.to_bytes();
        for bit in 0..RECORD_BYTES * 8 {
            let mut damaged = bytes;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Record::from_bytes(&damaged), None, "bit {bit}");
        }
        assert_eq!(Record::from_bytes(&[0; RECORD_BYTES]), None);
        assert_eq!(Record::from_bytes(&[0xFF; RECORD_BYTES]), None);
    }

    #[test]
    fn the_newer_whole_slot_is_used() {
        let at = |generation| Record { generation, calibration: Calibration::DEFAULT };
        let bytes = |generation| at(generation).to_bytes();
        let blank = [0xFF; RECORD_BYTES];
        let mut damaged = bytes(9);
        damaged[5] ^= 1;
        let good = |generation, slot| Stored::Good { record: at(generation), slot };
        assert_eq!(Stored::choose([&bytes(1), &bytes(2)]), good(2, 1));
        assert_eq!(Stored::choose([&bytes(3), &bytes(2)]), good(3, 0));
        assert_eq!(Stored::choose([&bytes(255), &bytes(0)]), good(0, 1));
        assert_eq!(Stored::choose([&bytes(0), &bytes(255)]), good(0, 0));
        assert_eq!(Stored::choose([&damaged, &bytes(2)]), good(2, 1));
        assert_eq!(Stored::choose([&bytes(2), &damaged]), good(2, 0));
        assert_eq!(Stored::choose([&bytes(2), &blank]), good(2, 0));
        assert_eq!(Stored::choose([&blank, &blank]), Stored::Blank);
        assert_eq!(Stored::choose([&blank, &damaged]), Stored::Damaged);
    }
}
