//! Applies a recording of the left hand to the emulated board's pins. Counts are converted back to voltages.

use std::cell::Cell;
use std::rc::Rc;

use fastrand::Rng;
use host_bridge::script::CalibrationTable;
use shared_dsp::left::ONE_G;
use shared_proto::message::{AckResult, CalibrationStep};

use super::image;
use super::nano::{CYCLES_PER_MS, Nano, PinInput, Voltages};
use super::session::{BLANK, LeftRig};
use super::wearer::{SUPPLY_MV, normal};

/// Number of conversions that the board adds up per sample.
const OVERSAMPLING: f64 = 8.0;

/// Returns the voltage in the middle of a 10-bit step, in mV.
fn millivolts(counts: f64) -> f64 {
    (counts + 0.5) / 1024.0 * SUPPLY_MV
}

/// Samples of all five channels at 100 Hz, interpolated linearly. The first and last values are held.
pub struct Recorded {
    samples: Vec<[u16; 5]>,
    start_cycle: u64,
}

impl Recorded {
    /// Creates a recording whose first sample is due at a given cycle of the board's clock.
    pub fn new(samples: Vec<[u16; 5]>, start_cycle: u64) -> Self {
        Self { samples, start_cycle }
    }
}

impl Voltages for Recorded {
    fn at(&mut self, pin: u8, cycle: u64) -> PinInput {
        let place = cycle.saturating_sub(self.start_cycle) as f64 / (10 * CYCLES_PER_MS) as f64;
        let sample =
            |index: usize| f64::from(self.samples[index.min(self.samples.len() - 1)][usize::from(pin)]);
        let (before, after) = (sample(place as usize), sample(place as usize + 1));
        PinInput::Millivolts(millivolts(before + (after - before) * place.fract()))
    }
}

/// Returns a running board that was calibrated over the wire, with sensor readings from this table.
///
/// # Panics
/// Panics if the board refuses a step.
pub fn calibrated(table: &CalibrationTable) -> Nano {
    let [x, y, z] = table.zero;
    let level = [x, y, z + ONE_G].map(f64::from);
    let held = Rc::new(Cell::new([0.0; 5]));
    let hold = |flex: [u16; 2]| {
        let [x, y, z] = level;
        held.set([x, y, z, flex[0].into(), flex[1].into()].map(|sum| sum / OVERSAMPLING));
    };
    hold(table.rest);
    let mut rng = Rng::with_seed(3);
    let pins = {
        let held = Rc::clone(&held);
        move |pin: u8, _| {
            PinInput::Millivolts(millivolts(held.get()[usize::from(pin)]) + 1.6 * normal(&mut rng))
        }
    };
    let mut session = LeftRig::new(&image::path(), &BLANK, Box::new(pins));
    session.run_ms(300.0);
    assert_eq!(session.calibrate(CalibrationStep::Neutral), AckResult::Ok, "neutral");
    assert_eq!(session.calibrate(CalibrationStep::Rest), AckResult::Ok, "rest");
    hold(table.bend);
    session.run_ms(100.0);
    assert_eq!(session.calibrate(CalibrationStep::Bend), AckResult::Ok, "bend");
    hold(table.rest);
    session.run_ms(500.0);
    session.nano
}
