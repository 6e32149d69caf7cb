//! A left hand's sensors on a XIAO: converts readings as the left hand's logic has them to acceleration and voltages.

use shared_board::calibration_store::Eeprom as _;
use shared_board::eeprom_log::{BYTES, EepromLog};
use shared_board::memory::{RamEeprom, RamFlash, at_once};
use shared_board::models::MappedFlash as _;
use shared_dsp::left::calibration::Calibration;
use shared_dsp::left::{AdcCounts, ONE_G};

use super::board::Board;
use super::lsm9ds1::Replay;
use super::saadc::SUPPLY_MV;
use super::soc::SLOTS_END;

/// The reading at 0 g, as the image defines it.
const MIDDLE: f64 = 4096.0;
const GRAVITY: f64 = 9.80665;
/// Flash pages that hold the calibration.
const CALIBRATION: std::ops::Range<usize> = SLOTS_END as usize - 0x2000..SLOTS_END as usize;

/// Returns the acceleration in m/s² that gives these readings of x, y and z. The other six values are 0.
pub fn acceleration(readings: [f64; 3]) -> [f64; 9] {
    let mut values = [0.0; 9];
    for (value, reading) in values.iter_mut().zip(readings) {
        *value = (reading - MIDDLE) / f64::from(ONE_G) * GRAVITY;
    }
    values
}

/// Returns the voltage of a divider that gives this reading, in mV.
pub fn millivolts(reading: f64) -> f64 {
    reading / 2.0 / 4096.0 * SUPPLY_MV
}

/// Sets the voltages of both fingers' dividers.
pub fn set_flex(board: &mut Board, readings: [f64; 2]) {
    let inputs = &mut board.soc().saadc.inputs_mv;
    [inputs[0], inputs[1]] = readings.map(millivolts);
}

/// Stores a calibration in the flash of a board, as the board itself does.
pub fn store(board: &mut Board, calibration: &Calibration) {
    let eeprom = RamEeprom::with(calibration);
    let mut log = EepromLog::open(RamFlash::blank());
    for address in 0..BYTES as u16 {
        at_once(log.write(address, eeprom.read(address))).expect("flash in RAM");
    }
    let flash = log.into_flash();
    board.soc().flash[CALIBRATION].copy_from_slice(&flash.mapped()[..CALIBRATION.len()]);
}

/// A recording of the left hand at 100 Hz, for a XIAO.
pub struct Recorded {
    samples: Vec<AdcCounts>,
    start_s: f64,
}

impl Recorded {
    /// Creates a recording whose first sample is due at this time of the board's clock.
    pub fn new(samples: Vec<AdcCounts>, start_s: f64) -> Self {
        Self { samples, start_s }
    }

    /// The motion of the accelerometer.
    pub fn motion(&self) -> Replay {
        let row = |counts: &AdcCounts| acceleration([counts.x, counts.y, counts.z].map(f64::from));
        Replay { rows: self.samples.iter().map(row).collect(), interval: 0.01, start: self.start_s }
    }

    /// The readings of both fingers.
    pub fn flex(&self, seconds: f64) -> [f64; 2] {
        let place = ((seconds - self.start_s) / 0.01).max(0.0) as usize;
        let counts = self.samples[place.min(self.samples.len() - 1)];
        [counts.index.into(), counts.middle.into()]
    }
}
