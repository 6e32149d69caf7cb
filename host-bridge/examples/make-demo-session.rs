//! Generates the bundled demo session: `sessions/demo/{right.csv,left.csv,session.toml}`. The output is reproducible.
//!
//! ```text
//! cargo run --release -p host-bridge --example make-demo-session [FOLDER]
//! ```
//! Both hands are simulated.
//! The right hand is a demo wearer of `models synth`, whose data are never used for training.
//! The left hand is generated here.
//! The left hand has an ADXL335 with offsets, gains and noise, a tremor, and two flex sensors of different sensitivity.
//!
//! The script below is a list of planned actions.
//! The expected final pose of the base is calculated from this list without the simulator, as speed times duration.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt::Write as _;
use std::path::Path;

use host_bridge::adc::AdcRecording;
use host_bridge::base::{Odometry, Twist};
use host_bridge::robot::Random;
use models::synth::{Motion, Segment, Wearer, session};
use shared_dsp::left::calibration::{CAPTURE_SAMPLES, Calibration, CaptureStep};
use shared_dsp::left::{AdcCounts, LeftHand};
use shared_words::TiltThresholds;

/// Number of the demo wearer for the right hand, and number of the recording.
const WEARER: u32 = 1;
const TAKE: u64 = 0;
/// Seed of the left hand's noise and tremor.
const SEED: u64 = 20_261_122;
/// Length of both recordings.
const LENGTH_S: f64 = 84.0;

/// Gestures of the right hand with start time, duration and motion. The second up-down releases the stop.
const RIGHT: [(f64, f64, Motion); 7] = [
    (3.0, 3.2, Motion::UpDown),
    (8.8, 3.2, Motion::ToFro),
    (19.2, 3.2, Motion::UpDown),
    (24.6, 3.2, Motion::LeftRight),
    (38.0, 3.2, Motion::Rectangle),
    (51.8, 3.2, Motion::RectangleFlat),
    (66.4, 3.2, Motion::Circle),
];

/// Actions of the left hand, with times in s.
#[derive(Clone, Copy)]
enum Act {
    /// A tilt (pitch, roll in degrees) between two times.
    Tilt(f64, f64, [f64; 2]),
    /// A finger is bent once (0 index, 1 middle).
    Bend(f64, usize),
    /// Both fingers are bent between two times, which stops the robot.
    Fist(f64, f64),
}

const FORWARD: [f64; 2] = [26.0, 2.0];
const BACKWARD: [f64; 2] = [-24.0, -1.0];
const LEFT: [f64; 2] = [2.0, 27.0];
const RIGHT_TILT: [f64; 2] = [-1.0, -25.0];
/// Duration of a quarter turn at 0.5 rad/s and at 0.478 rad/s.
const QUARTER_S: f64 = FRAC_PI_2 / 0.5;
const SLOW_QUARTER_S: f64 = FRAC_PI_2 / 0.478_296_9;
const FIST_S: f64 = 17.0;

fn left_script() -> Vec<Act> {
    let mut acts = vec![
        Act::Tilt(4.0, 8.0, FORWARD),
        Act::Tilt(9.0, 9.0 + QUARTER_S, LEFT),
        Act::Tilt(15.5, 17.6, FORWARD),
        Act::Fist(FIST_S, 17.9),
        Act::Tilt(26.0, 26.0 + QUARTER_S, RIGHT_TILT),
        Act::Tilt(30.5, 32.5, BACKWARD),
        Act::Tilt(39.0, 41.0, FORWARD),
        Act::Tilt(47.5, 47.5 + SLOW_QUARTER_S, LEFT),
        Act::Tilt(52.5, 55.5, FORWARD),
        Act::Tilt(57.5, 59.5, BACKWARD),
        Act::Tilt(61.5, 61.5 + SLOW_QUARTER_S, RIGHT_TILT),
    ];
    acts.extend((0..4).map(|i| Act::Bend(13.0 + 0.55 * f64::from(i), 0)));
    acts.extend((0..8).map(|i| Act::Bend(33.5 + 0.55 * f64::from(i), 0)));
    acts.extend((0..7).map(|i| Act::Bend(42.5 + 0.6 * f64::from(i), 1)));
    acts
}

/// Calculates the final pose of the base and the final cap.
/// The contribution of each command is its speed (at the current cap) multiplied by its duration.
fn plan(acts: &[Act]) -> (Odometry, f64) {
    // Delay from the start of closing the fingers to the stop.
    // The delay consists of half the closing time, 20 ms of debouncing and 300 ms of holding.
    const STOP_DELAY_S: f64 = 0.4;
    let mut place = Odometry::default();
    let mut ordered = acts.to_vec();
    ordered.sort_by(|a, b| start_s(a).total_cmp(&start_s(b)));
    let mut cap: f64 = 0.5;
    for act in ordered {
        match act {
            Act::Bend(_, finger) => cap = (cap * [1.1, 0.9][finger]).clamp(0.05, 1.0),
            Act::Fist(..) => cap = 0.5,
            Act::Tilt(from_s, to_s, [pitch, roll]) => {
                let to_s =
                    if from_s < FIST_S { to_s.min(FIST_S + STOP_DELAY_S - TILT_S / 2.0) } else { to_s };
                let sign = |angle: f64| if angle.abs() > 15.0 { angle.signum() * cap } else { 0.0 };
                place.advance(Twist { linear_m_s: sign(pitch), angular_rad_s: sign(roll) }, to_s - from_s);
            }
        }
    }
    (place, cap)
}

fn start_s(act: &Act) -> f64 {
    match act {
        Act::Tilt(from_s, ..) | Act::Bend(from_s, _) | Act::Fist(from_s, _) => *from_s,
    }
}

/// Duration of a change from one tilt to another.
const TILT_S: f64 = 0.35;
/// Duration of bending a finger, and duration of the bent phase.
const FINGER_S: f64 = 0.12;
const HELD_S: f64 = 0.2;

/// Smooth transition from 0 to 1, without a jerk at either end.
fn smooth(share: f64) -> f64 {
    let t = share.clamp(0.0, 1.0);
    t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
}

/// Rises at `from_s` and falls at `to_s`; each transition takes at most `ramp_s`.
fn hump(time_s: f64, from_s: f64, to_s: f64, ramp_s: f64) -> f64 {
    smooth((time_s - from_s) / ramp_s) - smooth((time_s - to_s) / ramp_s)
}

/// The simulated left hand and its sensors.
struct LeftWearer {
    random: Random,
    /// Slow drift of pitch and roll, in degrees.
    wander: [f64; 2],
}

impl LeftWearer {
    /// Actual pitch and roll of this wearer's hand, in degrees, when the wearer considers the hand level.
    const POSE: [f64; 2] = [4.0, -3.0];
    /// Errors of the accelerometer: offsets in counts, and gain factors.
    const OFFSET: [f64; 3] = [14.0, -11.0, 9.0];
    const GAIN: [f64; 3] = [1.02, 0.985, 1.01];
    /// Counts of the flex dividers with straight and with bent fingers.
    const REST: [f64; 2] = [689.0, 716.0];
    const BEND: [f64; 2] = [545.0, 521.0];

    /// Returns the conversions at one time, for a tilt in degrees and finger bends from 0 to 1.
    fn sample(&mut self, time_s: f64, tilt: [f64; 2], fingers: [f64; 2]) -> [u16; 5] {
        let mut angle = [0.0; 2];
        for axis in 0..2 {
            self.wander[axis] += -0.01 * self.wander[axis] + 0.07 * self.normal();
            let tremor =
                0.5 * (TAU * [8.7, 9.6][axis] * time_s).sin() * (0.7 + 0.3 * (TAU * 0.31 * time_s).sin());
            let degrees = Self::POSE[axis] + tilt[axis] + self.wander[axis] + tremor;
            angle[axis] = degrees.to_radians();
        }
        let [pitch, roll] = angle;
        let gravity = [pitch.sin(), pitch.cos() * roll.sin(), pitch.cos() * roll.cos()];
        let mut counts = [0; 5];
        for axis in 0..3 {
            let value = 512.0 + Self::OFFSET[axis] + 102.4 * Self::GAIN[axis] * gravity[axis];
            counts[axis] = self.convert(value, 0.6);
        }
        for finger in 0..2 {
            // A bent finger also moves the neighbouring finger a little.
            let bent = fingers[finger].max(0.08 * fingers[1 - finger]);
            let value = Self::REST[finger] + bent * (Self::BEND[finger] - Self::REST[finger]);
            counts[3 + finger] = self.convert(value, 0.8);
        }
        counts
    }

    /// Returns a normally distributed random number with mean 0 and standard deviation 1.
    fn normal(&mut self) -> f64 {
        let mut uniform = || self.random.between(0.0, 1.0);
        (-2.0 * (1.0 - uniform()).ln()).sqrt() * (TAU * uniform()).cos()
    }

    fn convert(&mut self, value: f64, noise: f64) -> u16 {
        (value + noise * self.normal()).round().clamp(0.0, 1023.0) as u16
    }
}

/// Measures the neutral pose, the straight fingers and the bends, as the board's calibration does.
fn calibrate(wearer: &mut LeftWearer) -> Calibration {
    let mut hand = LeftHand::new(None, TiltThresholds::DEFAULT, 0);
    let mut time_ms = 0;
    for (step, finger) in [(CaptureStep::Neutral, 0.0), (CaptureStep::Rest, 0.0), (CaptureStep::Bend, 1.0)] {
        assert!(hand.start_capture(step));
        for _ in 0..CAPTURE_SAMPLES {
            time_ms += 10;
            let counts = wearer.sample(f64::from(time_ms) / 1000.0, [0.0; 2], [finger; 2]);
            hand.step(AdcCounts::from_ten_bit(counts), time_ms);
        }
        let captured = hand.take_captured().expect("the step is over");
        hand.set_calibration(Some(captured.expect("the simulated hand holds still")));
    }
    *hand.calibration()
}

fn left_recording(wearer: &mut LeftWearer, acts: &[Act]) -> AdcRecording {
    let mut samples = Vec::new();
    for n in 0..(LENGTH_S * 100.0) as u64 {
        let time_s = n as f64 / 100.0;
        let (mut tilt, mut fingers) = ([0.0; 2], [0.0; 2]);
        for act in acts {
            match *act {
                Act::Tilt(from_s, to_s, goal) => {
                    let share = hump(time_s, from_s, to_s, TILT_S);
                    tilt[0] += share * goal[0];
                    tilt[1] += share * goal[1];
                }
                Act::Bend(at_s, finger) => {
                    fingers[finger] += hump(time_s, at_s, at_s + FINGER_S + HELD_S, FINGER_S);
                }
                Act::Fist(from_s, to_s) => {
                    // A person never closes both fingers at exactly the same time.
                    fingers[0] += hump(time_s, from_s, to_s, FINGER_S);
                    fingers[1] += hump(time_s, from_s + 0.03, to_s + 0.02, FINGER_S);
                }
            }
        }
        samples.push((n * 10, AdcCounts::from_ten_bit(wearer.sample(time_s, tilt, fingers))));
    }
    AdcRecording { samples }
}

fn right_script() -> Vec<Segment> {
    let mut script = Vec::new();
    let mut time_s = 0.0;
    for (onset_s, seconds, motion) in RIGHT {
        script.push(Segment::new(Motion::IDLE, onset_s - time_s));
        script.push(Segment::new(motion, seconds));
        time_s = onset_s + seconds;
    }
    script.push(Segment::new(Motion::IDLE, LENGTH_S - time_s));
    script
}

fn session_toml(calibration: Calibration, acts: &[Act]) -> String {
    let (place, cap) = plan(acts);
    let gestures: Vec<_> = RIGHT.iter().map(|(_, _, motion)| motion.label()).collect();
    let mut text = String::from(
        "# Made by `cargo run --release -p host-bridge --example make-demo-session`; do not edit.\n",
    );
    let Calibration { zero, rest, bend } = calibration;
    let _ = write!(
        text,
        "title = \"two simulated hands, nobody's recordings\"\n\n\
         # What the left hand's EEPROM holds: sums of eight 10-bit conversions.\n\
         [calibration]\nzero = {zero:?}\nrest = {rest:?}\nbend = {bend:?}\n\n\
         [expect]\n\
         # Every gesture event in order; the second up-down releases the stop.\n\
         gestures = {gestures:?}\n\
         poses = [\"home\", \"pick-up\", \"place\", \"place-top-right\", \"place-bottom-right\", \"random-top\"]\n\
         stops = 1\ncap = {cap:.4}\n\n\
         # Speed times time of each scripted command.\n\
         [expect.base]\nx_m = {:.3}\ny_m = {:.3}\nheading_rad = {:.4}\nwithin_m = 0.15\nwithin_rad = 0.1\n",
        place.x_m, place.y_m, place.heading_rad
    );
    text
}

/// Returns the names and contents of the three files.
pub fn files() -> [(&'static str, String); 3] {
    let acts = left_script();
    let mut wearer = LeftWearer { random: Random::new(SEED), wander: [0.0; 2] };
    let calibration = calibrate(&mut wearer);
    let left = left_recording(&mut wearer, &acts);
    let right = session(&Wearer::demo(WEARER), TAKE, &right_script());
    [
        ("left.csv", left.to_csv()),
        ("right.csv", right.to_csv()),
        ("session.toml", session_toml(calibration, &acts)),
    ]
}

fn main() -> std::io::Result<()> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/sessions/demo");
    let folder = std::env::args().nth(1).unwrap_or_else(|| default.to_owned());
    std::fs::create_dir_all(&folder)?;
    for (name, content) in files() {
        let file = Path::new(&folder).join(name);
        std::fs::write(&file, content)?;
        println!("{}", file.display());
    }
    Ok(())
}
