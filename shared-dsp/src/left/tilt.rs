//! Converts three accelerometer readings of the left hand to two angles and a heading.
//!
//! The code uses only integers, so an 8-bit board and a laptop give the same bits, and the board needs no soft floats.
//!
//! **Axes and signs.** The sensor's +x points to the wrist, +y to the right, and +z out of the back of the hand.
//! This system is right-handed, and an axis that points up reads +1 g.
//! The *pitch* θ = atan(ax / √(ay² + az²)) is positive when the hand tips **forward** (fingers down).
//! The *roll* φ = atan(ay / √(ax² + az²)) is positive when the hand tips to the **left** (left edge down).
//!
//! ```text
//!            both within 5°                     larger tilt beyond 15°, and meant
//!  unarmed ───────────────▶ Neutral ◀──▶ Between ──────────────▶ Forward/Backward/Left/Right
//!     ▲                                     ▲                         │
//!     └── start, fault, capture, palm up    └──── below 12°, twice ───┘
//! ```
//!
//! [`crate::left::start`] decides whether a tilt is intended.

use crate::left::start::{Start, Swing};
use shared_words::{Heading, TiltThresholds};

/// Acceleration along the sensor's axes. The unit does not matter, because only ratios are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Acceleration {
    /// Component towards the wrist.
    pub x: i16,
    /// Component towards the right.
    pub y: i16,
    /// Acceleration along +z, out of the back of the hand.
    pub z: i16,
}

/// Two angles in milliradians, each within ±1571 (π/2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tilt {
    /// Positive = forward.
    pub pitch_mrad: i16,
    /// Positive = left.
    pub roll_mrad: i16,
}

impl Tilt {
    /// Computes θ = atan(ax / √(ay² + az²)) and φ = atan(ay / √(ax² + az²)). Zero acceleration gives 0, 0.
    ///
    /// The error is at most 1 mrad for vectors longer than 400 units (a test compares it with `f64`).
    #[inline(never)]
    pub fn of(a: Acceleration) -> Self {
        Self {
            pitch_mrad: atan_mrad(a.x, root_of_squares(a.y, a.z)),
            roll_mrad: atan_mrad(a.y, root_of_squares(a.x, a.z)),
        }
    }

    /// Returns the tilt towards the heading of a command, or 0 for other headings.
    fn along(self, heading: Heading) -> i16 {
        match heading {
            Heading::Forward => self.pitch_mrad,
            Heading::Backward => -self.pitch_mrad,
            Heading::Left => self.roll_mrad,
            Heading::Right => -self.roll_mrad,
            Heading::Neutral | Heading::Between => 0,
        }
    }
}

/// Number of consecutive samples that must agree before a command ends or neutral begins: 20 ms at 100 Hz.
/// If gravity is on the palm's side for the same number of samples, the hand is turned over.
pub const DEBOUNCE_SAMPLES: u8 = 2;

/// Converts a tilt per sample to a heading, with debouncing and hysteresis.
#[derive(Clone, Copy, Debug)]
pub struct TiltDetector {
    thresholds: TiltThresholds,
    heading: Heading,
    candidate: Heading,
    agreed: u8,
    armed: bool,
    /// The command that may start next, if any command may start.
    start: Option<(Heading, Start)>,
    swings: [Swing; 2],
    turned_over: u8,
}

impl TiltDetector {
    /// Creates a detector that gives no command until the hand has been neutral.
    pub fn new(thresholds: TiltThresholds) -> Self {
        Self {
            thresholds,
            heading: Heading::Between,
            candidate: Heading::Between,
            agreed: 0,
            armed: false,
            start: None,
            swings: [Swing::new(); 2],
            turned_over: 0,
        }
    }

    /// Uses other thresholds from the next sample on. The hand must then be neutral before any command.
    pub fn set_thresholds(&mut self, thresholds: TiltThresholds) {
        *self = Self::new(thresholds);
    }

    /// Returns the active thresholds.
    pub fn thresholds(&self) -> TiltThresholds {
        self.thresholds
    }

    /// Ends any command immediately. The hand must then be neutral before the next command.
    pub fn disarm(&mut self) {
        *self = Self::new(self.thresholds);
    }

    /// Skips a sample without a usable tilt (a jolt), and keeps the heading.
    pub fn hold(&mut self) -> Heading {
        self.agreed = 0;
        self.candidate = self.heading;
        self.start = None;
        self.heading
    }

    /// Processes a sample in which gravity is on the palm's side.
    /// The first such sample counts as a jolt.
    /// From the second such sample on, the hand counts as turned over, and its tilts are ignored.
    pub fn turned_over(&mut self) -> Heading {
        let samples = self.turned_over.saturating_add(1);
        if samples >= DEBOUNCE_SAMPLES {
            self.disarm();
        }
        self.turned_over = samples;
        self.hold()
    }

    /// Adds the tilt of one sample and returns the new heading.
    #[inline(never)]
    pub fn step(&mut self, tilt: Tilt) -> Heading {
        self.turned_over = 0;
        let swings = [self.swings[0].step(tilt.pitch_mrad), self.swings[1].step(tilt.roll_mrad)];
        let wanted = self.wanted(tilt);
        // A command is valid only once it has started.
        let settled = if wanted.is_command() && wanted != self.heading { Heading::Between } else { wanted };
        if settled == self.heading {
            self.agreed = 0;
        } else {
            self.agreed = if settled == self.candidate { self.agreed.saturating_add(1) } else { 1 };
            if self.agreed >= DEBOUNCE_SAMPLES {
                self.heading = settled;
                self.agreed = 0;
            }
        }
        self.candidate = settled;
        self.armed |= self.heading == Heading::Neutral;
        if self.is_meant(wanted, tilt) && swings == [false; 2] {
            self.heading = wanted;
            self.start = None;
        }
        self.heading
    }

    /// Returns whether the tilt of this command is intended.
    fn is_meant(&mut self, wanted: Heading, tilt: Tilt) -> bool {
        if wanted == self.heading {
            self.start = None;
            return false;
        }
        // A start survives a short dip below its threshold, as a running command does.
        let going = self.start.filter(|&(heading, _)| {
            heading == wanted
                || (!wanted.is_command() && tilt.along(heading) >= self.thresholds.end_mrad as i16)
        });
        let begun = || wanted.is_command().then(|| (wanted, Start::new(tilt.along(wanted))));
        self.start = going.or_else(begun);
        let Some((heading, start)) = &mut self.start else { return false };
        start.step(tilt.along(*heading), self.thresholds.start_mrad) && *heading == wanted
    }

    /// Returns the heading that this tilt alone requests, given the current heading.
    fn wanted(&self, tilt: Tilt) -> Heading {
        let (pitch, roll) = (tilt.pitch_mrad, tilt.roll_mrad);
        let (pitch_size, roll_size) = (pitch.unsigned_abs(), roll.unsigned_abs());
        let limits = self.thresholds;
        // A running command has an advantage of (start - end) over another command.
        // Two tilts of almost equal size therefore do not make the base alternate between driving and turning.
        let lead = limits.start_mrad - limits.end_mrad;
        let kept = match self.heading {
            Heading::Forward => Some((pitch, roll_size)),
            Heading::Backward => Some((-pitch, roll_size)),
            Heading::Left => Some((roll, pitch_size)),
            Heading::Right => Some((-roll, pitch_size)),
            Heading::Neutral | Heading::Between => None,
        };
        if let Some((own, other)) = kept
            && own >= limits.end_mrad as i16
            && (other <= limits.start_mrad || other <= own.unsigned_abs() + lead)
        {
            return self.heading;
        }
        if pitch_size.max(roll_size) > limits.start_mrad && self.armed {
            return match (pitch_size >= roll_size, pitch > 0, roll > 0) {
                (true, true, _) => Heading::Forward,
                (true, false, _) => Heading::Backward,
                (false, _, true) => Heading::Left,
                (false, _, false) => Heading::Right,
            };
        }
        if pitch_size.max(roll_size) <= limits.neutral_mrad { Heading::Neutral } else { Heading::Between }
    }
}

/// Computes √(a² + b²), rounded down. The two numbers have at most 15 bits, so the sum of squares fits.
fn root_of_squares(a: i16, b: i16) -> u16 {
    let square = |v: i16| u32::from(v.unsigned_abs()) * u32::from(v.unsigned_abs());
    let mut rest = square(a) + square(b);
    // The root is computed digit by digit, because the 8-bit board has no division.
    let mut root: u32 = 0;
    let mut bit: u32 = 1 << 30;
    while bit != 0 {
        if rest >= root + bit {
            rest -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
        bit >>= 2;
    }
    root as u16
}

/// Computes atan(y / x) in milliradians for x ≥ 0 by CORDIC; 0 for x = y = 0.
fn atan_mrad(y: i16, x: u16) -> i16 {
    /// Values of atan(2⁻ⁱ) in sixteenths of a milliradian.
    const STEPS: [i16; 14] = [12566, 7418, 3920, 1990, 999, 500, 250, 125, 62, 31, 16, 8, 4, 2];
    // Three i16 give a length below 2^16, and CORDIC scales the length by 1.65, so 2^17 · 2^13 fits.
    const FRACTION_BITS: u32 = 13;
    if x == 0 && y == 0 {
        return 0;
    }
    let mut x = i32::from(x) << FRACTION_BITS;
    let mut y = i32::from(y) << FRACTION_BITS;
    let mut angle: i16 = 0;
    for (i, step) in STEPS.iter().enumerate() {
        let (dx, dy) = (x >> i, y >> i);
        if y >= 0 {
            x += dy;
            y -= dx;
            angle += step;
        } else {
            x -= dy;
            y += dx;
            angle -= step;
        }
    }
    (angle + if angle >= 0 { 8 } else { -8 }) / 16
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    fn degrees(d: f64) -> i16 {
        (d.to_radians() * 1000.0).round() as i16
    }

    fn tilt(pitch: f64, roll: f64) -> Tilt {
        Tilt { pitch_mrad: degrees(pitch), roll_mrad: degrees(roll) }
    }

    fn detector_at_neutral() -> TiltDetector {
        let mut detector = TiltDetector::new(TiltThresholds::DEFAULT);
        detector.step(tilt(0.0, 0.0));
        assert_eq!(detector.step(tilt(0.0, 0.0)), Heading::Neutral);
        detector
    }

    fn run(detector: &mut TiltDetector, pitch: f64, roll: f64, samples: usize) -> Heading {
        (0..samples).fold(Heading::Between, |_, _| detector.step(tilt(pitch, roll)))
    }

    #[test]
    fn angles_follow_the_definition_within_a_milliradian() {
        let mut worst: f64 = 0.0;
        for length in [400.0, 819.2, 1300.0, 9000.0, 32000.0_f64] {
            for p in -90..=90 {
                for r in (-180..=180).step_by(3) {
                    let (p, r) = (f64::from(p).to_radians(), f64::from(r).to_radians());
                    let a = Acceleration {
                        x: (length * p.sin()).round() as i16,
                        y: (length * p.cos() * r.sin()).round() as i16,
                        z: (length * p.cos() * r.cos()).round() as i16,
                    };
                    let (x, y, z) = (f64::from(a.x), f64::from(a.y), f64::from(a.z));
                    let got = Tilt::of(a);
                    let pitch = x.atan2((y * y + z * z).sqrt()) * 1000.0;
                    let roll = y.atan2((x * x + z * z).sqrt()) * 1000.0;
                    worst = worst.max((pitch - f64::from(got.pitch_mrad)).abs());
                    // In a short vector, one unit of the rounded root is over a milliradian of roll.
                    // The same holds for a pitch near 90 degrees.
                    if (x * x + z * z).sqrt() > 400.0 || y == 0.0 {
                        worst = worst.max((roll - f64::from(got.roll_mrad)).abs());
                    }
                }
            }
        }
        std::println!("worst error {worst:.2} mrad");
        assert!(worst <= 3.0, "worst {worst}");
    }

    #[test]
    fn extreme_and_empty_vectors_have_defined_angles() {
        let at = |x, y, z| Tilt::of(Acceleration { x, y, z });
        assert_eq!(at(0, 0, 0), Tilt::default());
        assert_eq!(at(1, 0, 0).pitch_mrad, 1571);
        assert_eq!(at(i16::MIN, 0, 0).pitch_mrad, -1571);
        assert_eq!(at(i16::MAX, i16::MAX, i16::MAX).pitch_mrad, 615);
        assert_eq!(at(i16::MIN, i16::MIN, i16::MIN).roll_mrad, -615);
    }

    #[test]
    fn forward_is_a_positive_pitch_and_left_a_positive_roll() {
        // The hand is tipped forward by 30°, so the wrist end (+x) points up.
        let forward = Tilt::of(Acceleration { x: 410, y: 0, z: 709 });
        assert!((forward.pitch_mrad - 524).abs() <= 1 && forward.roll_mrad == 0);
        // The hand is tipped to the left, so the right edge (+y) points up.
        let left = Tilt::of(Acceleration { x: 0, y: 410, z: 709 });
        assert!((left.roll_mrad - 524).abs() <= 1 && left.pitch_mrad == 0);
        for (pitch, roll, heading) in [
            (16.0, 0.0, Heading::Forward),
            (-16.0, 0.0, Heading::Backward),
            (0.0, 16.0, Heading::Left),
            (0.0, -16.0, Heading::Right),
        ] {
            assert_eq!(run(&mut detector_at_neutral(), pitch, roll, 10), heading);
        }
    }

    #[test]
    fn a_command_starts_beyond_15_degrees_and_ends_below_12() {
        let mut d = detector_at_neutral();
        assert_eq!(run(&mut d, 14.9, 0.0, 50), Heading::Between);
        assert_eq!(run(&mut d, 15.1, 0.0, 10), Heading::Forward);
        assert_eq!(run(&mut d, 12.1, 0.0, 50), Heading::Forward);
        assert_eq!(run(&mut d, 11.9, 0.0, 2), Heading::Between);
        assert_eq!(run(&mut d, 14.9, 0.0, 50), Heading::Between);
    }

    #[test]
    fn one_sample_alone_changes_nothing() {
        let mut d = detector_at_neutral();
        for _ in 0..20 {
            assert_eq!(d.step(tilt(40.0, 0.0)), Heading::Neutral);
            assert_eq!(d.step(tilt(0.0, 0.0)), Heading::Neutral);
        }
        // A hand that has just oscillated must come to rest before it can start a command.
        assert_eq!(run(&mut d, 20.0, 0.0, 40), Heading::Between);
        assert_eq!(run(&mut d, 20.0, 0.0, 20), Heading::Forward);
        for _ in 0..20 {
            assert_eq!(d.step(tilt(0.0, 0.0)), Heading::Forward);
            assert_eq!(d.step(tilt(20.0, 0.0)), Heading::Forward);
        }
    }

    #[test]
    fn samples_that_ask_for_different_headings_do_not_add_up() {
        let mut d = detector_at_neutral();
        for _ in 0..20 {
            assert!(!d.step(tilt(20.0, 0.0)).is_command());
            assert!(!d.step(tilt(0.0, 20.0)).is_command());
        }
    }

    #[test]
    fn the_larger_tilt_wins_and_keeps_its_lead() {
        let mut d = detector_at_neutral();
        assert_eq!(run(&mut d, 20.0, 18.0, 10), Heading::Forward);
        assert_eq!(run(&mut d, 20.0, 22.9, 50), Heading::Forward);
        assert_eq!(run(&mut d, 20.0, 23.2, 10), Heading::Left);
        assert_eq!(run(&mut d, 20.0, 18.0, 50), Heading::Left);
        let mut d = detector_at_neutral();
        assert_eq!(run(&mut d, -17.0, -25.0, 10), Heading::Right);
    }

    #[test]
    fn a_reversal_needs_no_neutral_and_ends_the_old_command_at_once() {
        let mut d = detector_at_neutral();
        assert_eq!(run(&mut d, 30.0, 0.0, 10), Heading::Forward);
        assert_eq!(run(&mut d, -30.0, 0.0, 1), Heading::Forward);
        assert_eq!(run(&mut d, -30.0, 0.0, 1), Heading::Between);
        assert_eq!(run(&mut d, -30.0, 0.0, 8), Heading::Backward);
    }

    #[test]
    fn a_hand_turned_over_is_not_neutral_ends_a_command_and_needs_neutral_afterwards() {
        let mut d = TiltDetector::new(TiltThresholds::DEFAULT);
        for _ in 0..100 {
            assert_eq!(d.turned_over(), Heading::Between);
        }
        let mut d = detector_at_neutral();
        run(&mut d, 30.0, 0.0, 10);
        assert_eq!(d.turned_over(), Heading::Forward, "one sample is a jolt");
        assert_eq!(d.turned_over(), Heading::Between);
        assert_eq!(run(&mut d, 30.0, 0.0, 100), Heading::Between);
        run(&mut d, 0.0, 0.0, 2);
        assert_eq!(run(&mut d, 30.0, 0.0, 10), Heading::Forward);
    }

    #[test]
    fn neutral_needs_both_tilts_within_5_degrees() {
        let mut d = detector_at_neutral();
        assert_eq!(run(&mut d, 4.9, -4.9, 2), Heading::Neutral);
        assert_eq!(run(&mut d, 4.0, 5.1, 2), Heading::Between);
        assert_eq!(run(&mut d, -5.1, 0.0, 2), Heading::Between);
    }

    #[test]
    fn no_command_before_the_hand_was_neutral() {
        let mut d = TiltDetector::new(TiltThresholds::DEFAULT);
        assert_eq!(run(&mut d, 30.0, 0.0, 100), Heading::Between);
        assert_eq!(run(&mut d, 0.0, 0.0, 1), Heading::Between);
        assert_eq!(run(&mut d, 30.0, 0.0, 100), Heading::Between);
        run(&mut d, 0.0, 0.0, 2);
        assert_eq!(run(&mut d, 30.0, 0.0, 10), Heading::Forward);
        d.disarm();
        assert_eq!(run(&mut d, 30.0, 0.0, 100), Heading::Between);
    }

    #[test]
    fn thresholds_that_could_trap_a_hand_are_unsound() {
        let with = |neutral_mrad, end_mrad, start_mrad| {
            TiltThresholds { neutral_mrad, end_mrad, start_mrad }.are_sound()
        };
        assert!(TiltThresholds::DEFAULT.are_sound());
        assert!(!with(0, 209, 262));
        assert!(!with(209, 209, 262));
        assert!(!with(87, 262, 262));
        assert!(!with(87, 300, 262));
        assert!(!with(87, 209, u16::MAX));
    }
}
