//! A hand with its sensors: converts poses and bends over time to voltages at five pins.
//!
//! The tolerances are from the data sheets. An ADXL335 has an offset of ±0.15 V (x, y) or ±0.3 V (z).
//! The sensitivity is 270 to 330 mV/g. Offset and sensitivity apply at 3.0 V and are ratiometric.
//! The bandwidth is 50 Hz and the noise is 300 µg/√Hz.
//! Flex sensors have 10 kΩ ± 30 % when flat, and two to three times as much when bent.

use std::cell::RefCell;
use std::f64::consts::TAU;
use std::rc::Rc;

use fastrand::Rng;

use super::nano::{CYCLES_PER_MS, PinInput, Voltages};

/// Supply voltage of the sensors, and reference voltage of the converter.
pub const SUPPLY_MV: f64 = 3300.0;
/// Resistance of each resistor that connects A3 or A4 to ground.
const DIVIDER_OHM: f64 = 22_000.0;

/// Draws a number uniformly from a range.
pub fn uniform(rng: &mut Rng, range: std::ops::Range<f64>) -> f64 {
    range.start + rng.f64() * (range.end - range.start)
}

/// Draws a standard normal number.
pub fn normal(rng: &mut Rng) -> f64 {
    (-2.0 * (1.0 - rng.f64()).ln()).sqrt() * (TAU * rng.f64()).cos()
}

/// A path from 0 to 1 with smooth start and end (minimum jerk); `x` is the fraction of the time.
pub fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// One person's sensors.
#[derive(Clone, Debug)]
pub struct Sensors {
    /// Sensitivity of x, y and z, as a multiple of the nominal volts per g.
    pub sensitivity: [f64; 3],
    /// Offsets of x, y and z from half the supply voltage, in mV.
    pub offset_mv: [f64; 3],
    /// Noise of the accelerometer in mV (standard deviation at 50 Hz bandwidth).
    pub noise_mv: f64,
    /// Resistance of the flat flex sensors of index and middle finger, in ohms.
    pub flat_ohm: [f64; 2],
    /// Resistance at the calibrated bend, as a multiple of the flat resistance.
    pub bent_ratio: [f64; 2],
}

impl Sensors {
    /// Returns typical parts according to the data sheets.
    pub fn nominal() -> Self {
        Self {
            sensitivity: [1.0; 3],
            offset_mv: [0.0; 3],
            noise_mv: 0.88,
            flat_ohm: [10_000.0; 2],
            bent_ratio: [2.0; 2],
        }
    }

    /// Returns parts drawn uniformly from the complete range of the data sheets' tolerances.
    pub fn drawn(rng: &mut Rng) -> Self {
        // The values at 3.0 V scale with the supply; the noise is 300 µg/√Hz · √(50 Hz · π/2) · 330 mV/g.
        let scale = 1.1;
        let mut sideways = || uniform(rng, -150.0..150.0) * scale;
        let (x, y) = (sideways(), sideways());
        let z = uniform(rng, -300.0..300.0) * scale;
        let mut each = |range: std::ops::Range<f64>| uniform(rng, range);
        Self {
            sensitivity: [each(0.9..1.1), each(0.9..1.1), each(0.9..1.1)],
            offset_mv: [x, y, z],
            noise_mv: 0.88,
            flat_ohm: [each(7000.0..13_000.0), each(7000.0..13_000.0)],
            bent_ratio: [each(2.0..3.0), each(2.0..3.0)],
        }
    }
}

/// A smooth change from one value to another.
#[derive(Clone, Copy, Debug, Default)]
struct Way {
    from: f64,
    to: f64,
    start_s: f64,
    lasts_s: f64,
}

impl Way {
    fn at(&self, t: f64) -> f64 {
        let share = if self.lasts_s > 0.0 { (t - self.start_s) / self.lasts_s } else { 1.0 };
        self.from + (self.to - self.from) * smooth(share)
    }

    fn go(&mut self, to: f64, start_s: f64, lasts_s: f64) {
        *self = Self { from: self.at(start_s), to, start_s, lasts_s };
    }
}

/// The movement of the hand, which a test controls while the board runs.
#[derive(Debug, Default)]
pub struct Hand {
    pitch: Way,
    roll: Way,
    bend: [Way; 2],
    /// The current hardware fault.
    pub fault: Option<Fault>,
}

impl Hand {
    /// Tilts the hand to these angles in radians relative to neutral.
    /// The tilt starts at `start_s` and takes `lasts_s`.
    pub fn tilt(&mut self, pitch: f64, roll: f64, start_s: f64, lasts_s: f64) {
        self.pitch.go(pitch, start_s, lasts_s);
        self.roll.go(roll, start_s, lasts_s);
    }

    /// Bends finger 0 (index) or 1 (middle) to this depth: 0 = straight, 1 = the calibrated bend.
    pub fn bend(&mut self, finger: usize, depth: f64, start_s: f64, lasts_s: f64) {
        self.bend[finger].go(depth, start_s, lasts_s);
    }
}

/// Tremor of the hand: several sinusoids per axis, whose sum never exceeds `peak` radians.
#[derive(Clone, Debug)]
pub struct Tremor {
    waves: Vec<[f64; 6]>,
}

impl Tremor {
    /// Returns a tremor of at most `peak_rad` about each axis, between `hz.start` and `hz.end`.
    pub fn drawn(rng: &mut Rng, peak_rad: f64, hz: std::ops::Range<f64>) -> Self {
        let count = 4;
        let share = peak_rad / f64::from(count);
        let mut wave = || {
            let f = uniform(rng, hz.clone());
            let g = uniform(rng, hz.clone());
            [share, f, TAU * rng.f64(), share, g, TAU * rng.f64()]
        };
        Self { waves: (0..count).map(|_| wave()).collect() }
    }

    /// Returns pitch and roll at a time in seconds.
    fn at(&self, t: f64) -> (f64, f64) {
        self.waves.iter().fold((0.0, 0.0), |(p, r), [a, f, b, c, g, d]| {
            (p + a * (TAU * f * t + b).sin(), r + c * (TAU * g * t + d).sin())
        })
    }
}

/// Faults of the hardware.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// This channel (0..=4 = x, y, z, index, middle) is disconnected.
    Open(u8),
    /// This channel is shorted to a rail, whose voltage is given in mV.
    Shorted(u8, f64),
    /// All accelerations are multiplied by this factor.
    Gravity(f64),
    /// The converter's input repeats the same five voltages.
    Stuck,
}

/// A wearer who determines the board's voltages as a function of time.
pub struct Wearer {
    sensors: Sensors,
    /// The up direction in the sensor's frame in the neutral pose.
    neutral_up: [f64; 3],
    tremor: Option<Tremor>,
    hand: Rc<RefCell<Hand>>,
    rng: Rng,
    filtered_mv: [f64; 3],
    filtered_at: f64,
    frozen: [Option<f64>; 5],
}

type Vector = [f64; 3];

/// Tilts the hand forward by `angle`, so that the wrist end (+x) goes up.
fn pitched([x, y, z]: Vector, angle: f64) -> Vector {
    let (s, c) = angle.sin_cos();
    [c * x + s * z, y, -s * x + c * z]
}

/// Tilts the hand to the left by `angle`, so that the right edge (+y) goes up.
fn rolled([x, y, z]: Vector, angle: f64) -> Vector {
    let (s, c) = angle.sin_cos();
    [x, c * y + s * z, -s * y + c * z]
}

impl Wearer {
    /// Creates a wearer whose neutral pose is off level by two angles in radians, and the hand that a test controls.
    pub fn new(
        sensors: Sensors,
        off_level: (f64, f64),
        tremor: Option<Tremor>,
        rng: Rng,
    ) -> (Self, Rc<RefCell<Hand>>) {
        let hand = Rc::new(RefCell::new(Hand::default()));
        let wearer = Self {
            sensors,
            neutral_up: rolled(pitched([0.0, 0.0, 1.0], off_level.0), off_level.1),
            tremor,
            hand: Rc::clone(&hand),
            rng,
            filtered_mv: [f64::NAN; 3],
            filtered_at: 0.0,
            frozen: [None; 5],
        };
        (wearer, hand)
    }

    /// Returns the acceleration in g along the sensor's axes.
    fn acceleration(&self, t: f64) -> Vector {
        let (shaken_pitch, shaken_roll) = self.tremor.as_ref().map_or((0.0, 0.0), |tremor| tremor.at(t));
        let hand = self.hand.borrow();
        let (pitch, roll) = (hand.pitch.at(t) + shaken_pitch, hand.roll.at(t) + shaken_roll);
        // The larger of the two tilts is the intended tilt.
        // The larger tilt is applied first, so that theta = atan(ax / sqrt(ay^2 + az^2)) holds exactly.
        if pitch.abs() >= roll.abs() {
            rolled(pitched(self.neutral_up, pitch), roll)
        } else {
            pitched(rolled(self.neutral_up, roll), pitch)
        }
    }

    fn update_filter(&mut self, t: f64, fault: Option<Fault>) {
        let gain = if let Some(Fault::Gravity(gain)) = fault { gain } else { 1.0 };
        let a = self.acceleration(t);
        // The bandwidth is 50 Hz, as a first-order filter.
        let keep = (-(t - self.filtered_at).max(0.0) * TAU * 50.0).exp();
        for (axis, a) in a.into_iter().enumerate() {
            let wanted = SUPPLY_MV / 2.0
                + self.sensors.offset_mv[axis]
                + SUPPLY_MV / 10.0 * self.sensors.sensitivity[axis] * a * gain;
            let before = self.filtered_mv[axis];
            self.filtered_mv[axis] = if before.is_nan() { wanted } else { wanted + (before - wanted) * keep };
        }
        self.filtered_at = t;
    }

    fn flex_mv(&self, finger: usize, bend: f64) -> f64 {
        let flat = self.sensors.flat_ohm[finger];
        let flex = flat * (1.0 + (self.sensors.bent_ratio[finger] - 1.0) * bend.max(-0.1));
        SUPPLY_MV * DIVIDER_OHM / (DIVIDER_OHM + flex)
    }
}

impl Voltages for Wearer {
    fn at(&mut self, pin: u8, cycle: u64) -> PinInput {
        let t = cycle as f64 / CYCLES_PER_MS as f64 / 1000.0;
        let index = pin as usize;
        let fault = self.hand.borrow().fault;
        match fault {
            Some(Fault::Open(open)) if open == pin => return PinInput::Open,
            Some(Fault::Shorted(shorted, mv)) if shorted == pin => return PinInput::Millivolts(mv),
            Some(Fault::Stuck) => {
                if let Some(mv) = self.frozen[index] {
                    return PinInput::Millivolts(mv);
                }
            }
            _ => self.frozen = [None; 5],
        }
        let mv = if pin < 3 {
            self.update_filter(t, fault);
            self.filtered_mv[index] + self.sensors.noise_mv * normal(&mut self.rng)
        } else {
            let bend = self.hand.borrow().bend[index - 3].at(t);
            self.flex_mv(index - 3, bend)
        };
        // The converter itself has a noise of half a bit.
        let mv = mv + 1.6 * normal(&mut self.rng);
        if fault == Some(Fault::Stuck) {
            self.frozen[index] = Some(mv);
        }
        PinInput::Millivolts(mv)
    }
}
