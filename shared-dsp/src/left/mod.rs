//! The complete left hand. It converts readings and times to tilt, heading, bends, stop and health.
//!
//! The Nano runs [`LeftHand`], and the laptop runs it to replay recordings.
//! Board and laptop compute the same bits from the same readings.

pub mod calibration;
pub mod faults;
pub mod flex;
pub mod guided;
pub mod start;
pub mod tilt;

use crate::left::calibration::{Calibration, Capture, CaptureError, CaptureStep};
use crate::left::faults::FaultWatch;
use crate::left::flex::{FlexDetector, bend_permille};
use crate::left::tilt::{Acceleration, Tilt, TiltDetector};
use shared_words::{Heading, TiltThresholds, health};

/// Number of 10-bit conversions that are summed to one reading.
pub const OVERSAMPLING: u16 = 8;
/// 1 g in units of [`AdcCounts`]. The ADXL335 gives a tenth of its supply per g, which is 102.4 of 1024.
pub const ONE_G: i16 = 819;

/// A sample of all five channels. Each value is the sum of [`OVERSAMPLING`] conversions, 0 to [`AdcCounts::MAX`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdcCounts {
    /// Accelerometer x, towards the wrist (A0).
    pub x: u16,
    /// Accelerometer y, towards the right (A1).
    pub y: u16,
    /// Acceleration along z, out of the back of the hand (A2).
    pub z: u16,
    /// Voltage of the index finger's flex sensor (A3).
    pub index: u16,
    /// Voltage of the middle finger's flex sensor (A4).
    pub middle: u16,
}

impl AdcCounts {
    /// The largest reading.
    pub const MAX: u16 = 1023 * OVERSAMPLING;

    /// Converts plain 10-bit conversions (x, y, z, index, middle) from a recording, and clamps larger values.
    pub fn from_ten_bit(conversions: [u16; 5]) -> Self {
        let [x, y, z, index, middle] = conversions.map(|c| c.min(1023) * OVERSAMPLING);
        Self { x, y, z, index, middle }
    }

    /// Returns the readings of x, y, z, index and middle in this order.
    pub fn as_array(&self) -> [u16; 5] {
        [self.x, self.y, self.z, self.index, self.middle]
    }
}

/// The state of the left hand after one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOutput {
    /// Pitch in milliradians, positive = forward; 0 during a fault.
    pub pitch_mrad: i16,
    /// Roll in milliradians, positive = left; 0 during a fault.
    pub roll_mrad: i16,
    /// The debounced heading: `Neutral` (halt) during a fault, `Between` during a calibration step.
    /// After a fault, a calibration step, a start or new thresholds, the hand must first be neutral before any command.
    pub heading: Heading,
    /// Number of bends of the index finger since the start. The number wraps.
    pub index_bends: u8,
    /// Number of bends of the middle finger since the start. The number wraps.
    pub middle_bends: u8,
    /// Both fingers have been held bent for 300 ms.
    pub stop: bool,
    /// Bits of [`health`].
    pub health: u8,
    /// Whether heading, bends, stop or health changed, so that the output should be sent immediately.
    pub changed: bool,
}

/// The state machine of the left hand.
#[derive(Clone, Copy, Debug)]
pub struct LeftHand {
    calibration: Calibration,
    is_calibrated: bool,
    tilt: TiltDetector,
    flex: FlexDetector,
    faults: FaultWatch,
    capture: Option<Capture>,
    captured: Option<Result<Calibration, CaptureError>>,
    last: LeftOutput,
}

impl LeftHand {
    /// Creates a hand that starts at `now_ms`.
    /// With `None`, the hand uses the default calibration, and its health contains a warning.
    pub fn new(calibration: Option<Calibration>, thresholds: TiltThresholds, now_ms: u32) -> Self {
        Self {
            calibration: calibration.unwrap_or_default(),
            is_calibrated: calibration.is_some(),
            tilt: TiltDetector::new(thresholds),
            flex: FlexDetector::new(),
            faults: FaultWatch::new(now_ms),
            capture: None,
            captured: None,
            last: LeftOutput::default(),
        }
    }

    /// Processes the sample that was taken at `now_ms` (on a clock that wraps).
    #[inline(never)]
    pub fn step(&mut self, counts: AdcCounts, now_ms: u32) -> LeftOutput {
        let [x, y, z] = self.calibration.zero;
        let a = Acceleration {
            x: (counts.x as i16).saturating_sub(x),
            y: (counts.y as i16).saturating_sub(y),
            z: counts.z as i16 - z,
        };
        let fault = self.faults.step(counts, a, now_ms);
        if let Some(capture) = &mut self.capture {
            let finished = if fault & (health::SENSOR | health::FLEX | health::STUCK) != 0 {
                Some(Err(CaptureError::Impossible))
            } else {
                capture.step(counts, &self.calibration)
            };
            if finished.is_some() {
                self.capture = None;
                self.captured = finished;
            }
            return self.paused(fault);
        }
        if fault != 0 {
            return self.paused(fault);
        }
        let tilt = Tilt::of(a);
        let heading = if !self.faults.gravity_is_possible(now_ms) {
            self.tilt.hold()
        } else if a.z <= 0 {
            self.tilt.turned_over()
        } else {
            self.tilt.step(tilt)
        };
        let permille = |reading, finger: usize| {
            bend_permille(reading, self.calibration.rest[finger], self.calibration.bend[finger])
        };
        let (index, middle) = (permille(counts.index, 0), permille(counts.middle, 1));
        let bends = self.flex.step(index, middle, now_ms);
        self.publish(LeftOutput {
            pitch_mrad: tilt.pitch_mrad,
            roll_mrad: tilt.roll_mrad,
            heading,
            index_bends: bends.index,
            middle_bends: bends.middle,
            stop: bends.stop,
            health: self.warnings(),
            changed: false,
        })
    }

    /// Reports that the sample at `now_ms` is missing. After 100 ms without samples, the converter counts as stuck.
    #[inline(never)]
    pub fn no_sample(&mut self, now_ms: u32) -> LeftOutput {
        let fault = self.faults.no_sample(now_ms);
        if fault & health::STUCK == 0 {
            return self.publish(self.last);
        }
        if self.capture.take().is_some() {
            self.captured = Some(Err(CaptureError::Impossible));
        }
        self.paused(fault)
    }

    /// Begins a calibration step.
    /// Until the step ends, the hand gives no motion and no bends. After the step, the hand must be neutral.
    ///
    /// Returns false, and changes nothing, if another step is in progress.
    pub fn start_capture(&mut self, step: CaptureStep) -> bool {
        if self.is_capturing() {
            return false;
        }
        self.capture = Some(Capture::new(step));
        // Somebody is working on the hand, so channels with persistent faults get another chance.
        self.faults.forgive();
        true
    }

    /// Returns whether a calibration step is in progress.
    pub fn is_capturing(&self) -> bool {
        self.capture.is_some()
    }

    /// Returns the result of the last calibration step. It does so only once.
    /// The new calibration is not active yet: store it, and then pass it to [`LeftHand::set_calibration`].
    pub fn take_captured(&mut self) -> Option<Result<Calibration, CaptureError>> {
        self.captured.take()
    }

    /// Sets a calibration (with `None`, the default). The hand must then be neutral before any command.
    #[inline(never)]
    pub fn set_calibration(&mut self, calibration: Option<Calibration>) {
        self.is_calibrated = calibration.is_some();
        self.calibration = calibration.unwrap_or_default();
        self.disarm();
    }

    /// Returns the active calibration.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Sets other thresholds. The hand must then be neutral before any command.
    /// Returns false, and changes nothing, if the thresholds are not [sound](TiltThresholds::are_sound).
    pub fn set_thresholds(&mut self, thresholds: TiltThresholds) -> bool {
        if !thresholds.are_sound() {
            return false;
        }
        self.tilt.set_thresholds(thresholds);
        true
    }

    fn disarm(&mut self) {
        self.tilt.disarm();
        self.flex.disarm();
    }

    fn warnings(&self) -> u8 {
        if self.is_calibrated { 0 } else { health::DEFAULT_CALIBRATION }
    }

    /// Returns an output without motion, bends or stop. The counters keep their values.
    #[inline(never)]
    fn paused(&mut self, fault: u8) -> LeftOutput {
        self.disarm();
        let bends = self.flex.bends();
        self.publish(LeftOutput {
            // During a fault, neutral is a safe value, because the heading then has no effect.
            heading: if fault != 0 { Heading::Neutral } else { Heading::Between },
            index_bends: bends.index,
            middle_bends: bends.middle,
            health: fault | self.warnings(),
            ..LeftOutput::default()
        })
    }

    fn publish(&mut self, mut new: LeftOutput) -> LeftOutput {
        let old = self.last;
        new.changed = new.heading != old.heading
            || new.index_bends != old.index_bends
            || new.middle_bends != old.middle_bends
            || new.stop != old.stop
            || new.health != old.health;
        self.last = new;
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rig {
        hand: LeftHand,
        now_ms: u32,
        dither: u16,
    }

    impl Rig {
        fn new() -> Self {
            let now_ms = u32::MAX - 300;
            let hand = LeftHand::new(Some(Calibration::DEFAULT), TiltThresholds::DEFAULT, now_ms);
            Self { hand, now_ms, dither: 0 }
        }

        fn neutral() -> Self {
            let mut rig = Self::new();
            assert_eq!(rig.run(LEVEL, 100).heading, Heading::Neutral);
            rig
        }

        /// Feeds constant 10-bit readings, but with noise in the last bit of z.
        fn run(&mut self, conversions: [u16; 5], ms: u32) -> LeftOutput {
            let mut output = self.hand.last;
            for _ in 0..ms / 10 {
                self.now_ms = self.now_ms.wrapping_add(10);
                self.dither ^= 1;
                let mut counts = AdcCounts::from_ten_bit(conversions);
                counts.z += self.dither;
                output = self.hand.step(counts, self.now_ms);
            }
            output
        }
    }

    const LEVEL: [u16; 5] = [512, 512, 614, 704, 704];
    /// 30° forward.
    const FORWARD: [u16; 5] = [563, 512, 601, 704, 704];

    #[test]
    fn a_tilt_becomes_a_command_and_a_bend_a_count() {
        let mut rig = Rig::neutral();
        let out = rig.run(FORWARD, 100);
        assert_eq!(out.heading, Heading::Forward);
        assert!((out.pitch_mrad - 524).abs() < 10, "{out:?}");
        let out = rig.run([563, 512, 601, 536, 704], 130);
        assert_eq!((out.index_bends, out.middle_bends), (1, 0));
        assert_eq!(out.heading, Heading::Forward);
        assert_eq!(out.health, 0);
    }

    #[test]
    fn only_changes_worth_sending_are_marked() {
        let mut rig = Rig::neutral();
        assert!(!rig.run(LEVEL, 10).changed);
        // The heading changes from neutral to between.
        assert!(!rig.run(FORWARD, 10).changed);
        assert!(rig.run(FORWARD, 10).changed);
        assert!(!rig.run(FORWARD, 70).changed);
        // The heading changes to forward.
        assert!(rig.run(FORWARD, 10).changed);
        assert!(!rig.run(FORWARD, 10).changed);
    }

    #[test]
    fn a_line_at_a_rail_is_a_fault_at_once_and_needs_neutral_afterwards() {
        for channel in 0..5 {
            for value in [0, 39, 984, 1023] {
                let mut rig = Rig::neutral();
                rig.run(FORWARD, 100);
                let mut broken = FORWARD;
                broken[channel] = value;
                let out = rig.run(broken, 10);
                let bit = if channel < 3 { health::SENSOR } else { health::FLEX };
                assert_eq!(out.health, bit, "channel {channel} at {value}");
                assert_eq!(out.heading, Heading::Neutral);
                assert!(out.changed);
                assert!(!rig.run(broken, 10_000).heading.is_command());
                // The line has been repaired, but the hand is still tilted, so there is no command.
                let out = rig.run(FORWARD, 1000);
                assert_eq!((out.health, out.heading), (0, Heading::Between));
                rig.run(LEVEL, 50);
                assert_eq!(rig.run(FORWARD, 100).heading, Heading::Forward);
            }
        }
    }

    #[test]
    fn impossible_gravity_is_a_fault_after_200_ms() {
        for conversions in [[512, 512, 530, 704, 704], [512, 512, 700, 704, 704]] {
            let mut rig = Rig::neutral();
            assert_eq!(rig.run(conversions, 190).health, 0);
            let out = rig.run(conversions, 20);
            assert_eq!(out.health, health::GRAVITY);
            assert_eq!(out.heading, Heading::Neutral);
            assert_eq!(rig.run(LEVEL, 180).health, health::GRAVITY);
            assert_eq!(rig.run(LEVEL, 30).health, 0);
        }
    }

    #[test]
    fn the_direction_of_impossible_gravity_commands_nothing() {
        let mut rig = Rig::neutral();
        // The hand is tilted 30° forward, first with 2 g and then with 0.2 g.
        for conversions in [[614, 512, 689, 704, 704], [522, 512, 530, 704, 704]] {
            for _ in 0..30 {
                assert!(!rig.run(conversions, 10).heading.is_command());
            }
            rig.run(LEVEL, 400);
        }
    }

    #[test]
    fn a_converter_that_repeats_itself_is_stuck_after_a_second() {
        let mut rig = Rig::neutral();
        rig.run(FORWARD, 100);
        let counts = AdcCounts::from_ten_bit(FORWARD);
        let mut out = LeftOutput::default();
        for i in 0..=101u32 {
            rig.now_ms = rig.now_ms.wrapping_add(10);
            out = rig.hand.step(counts, rig.now_ms);
            if i < 99 {
                assert_eq!(out.health, 0, "sample {i}");
            }
        }
        assert_eq!(out.health, health::STUCK);
        assert_eq!(out.heading, Heading::Neutral);
    }

    #[test]
    fn a_silent_converter_is_stuck_after_100_ms() {
        let mut rig = Rig::neutral();
        rig.run(FORWARD, 100);
        for _ in 0..9 {
            rig.now_ms = rig.now_ms.wrapping_add(10);
            assert_eq!(rig.hand.no_sample(rig.now_ms).heading, Heading::Forward);
        }
        rig.now_ms = rig.now_ms.wrapping_add(10);
        let out = rig.hand.no_sample(rig.now_ms);
        assert_eq!((out.heading, out.health), (Heading::Neutral, health::STUCK));
        assert_eq!(rig.run(FORWARD, 1000).heading, Heading::Between);
    }

    #[test]
    fn default_calibration_is_a_warning_that_does_not_stop_the_hand() {
        let mut hand = LeftHand::new(None, TiltThresholds::DEFAULT, 0);
        for i in 0..5 {
            hand.step(AdcCounts::from_ten_bit(LEVEL), 10 * i);
        }
        let mut out = LeftOutput::default();
        for i in 5..15 {
            out = hand.step(AdcCounts::from_ten_bit(FORWARD), 10 * i);
        }
        assert_eq!(out.health, health::DEFAULT_CALIBRATION);
        assert_eq!(out.heading, Heading::Forward);
    }

    #[test]
    fn calibration_pauses_the_hand_and_then_measures_from_the_new_neutral() {
        let mut rig = Rig::neutral();
        rig.run(FORWARD, 100);
        // The wearer's neutral pose is tilted 8° forward, and the sensor has an offset of 20 counts.
        let pose = [546, 495, 613, 704, 704];
        assert!(rig.hand.start_capture(CaptureStep::Neutral));
        assert!(!rig.hand.start_capture(CaptureStep::Rest));
        assert_eq!(rig.run(pose, 630).heading, Heading::Between);
        assert_eq!(rig.hand.take_captured(), None);
        rig.run(pose, 10);
        let calibration = rig.hand.take_captured().unwrap().unwrap();
        rig.hand.set_calibration(Some(calibration));
        let out = rig.run(pose, 50);
        assert_eq!((out.pitch_mrad, out.roll_mrad), (0, 0));
        assert_eq!(out.heading, Heading::Neutral);
    }

    #[test]
    fn bending_both_fingers_for_calibration_is_neither_stop_nor_count() {
        let mut rig = Rig::neutral();
        let bent = [512, 512, 614, 500, 520];
        rig.hand.start_capture(CaptureStep::Bend);
        let out = rig.run(bent, 640);
        assert_eq!((out.index_bends, out.middle_bends, out.stop), (0, 0, false));
        let calibration = rig.hand.take_captured().unwrap().unwrap();
        assert_eq!(calibration.bend, [4000, 4160]);
    }

    #[test]
    fn a_broken_line_ends_a_calibration_step() {
        let mut rig = Rig::neutral();
        rig.hand.start_capture(CaptureStep::Neutral);
        rig.run(LEVEL, 100);
        rig.run([0, 512, 614, 704, 704], 10);
        assert_eq!(rig.hand.take_captured(), Some(Err(CaptureError::Impossible)));
        assert!(!rig.hand.is_capturing());
    }

    #[test]
    fn unsound_thresholds_are_refused() {
        let mut rig = Rig::neutral();
        assert!(!rig.hand.set_thresholds(TiltThresholds {
            neutral_mrad: 87,
            end_mrad: 262,
            start_mrad: 209,
        }));
        assert!(rig.hand.set_thresholds(TiltThresholds { neutral_mrad: 87, end_mrad: 349, start_mrad: 436 }));
        rig.run(LEVEL, 50);
        assert_eq!(rig.run(FORWARD, 100).heading, Heading::Forward);
    }
}
