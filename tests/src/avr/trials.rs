//! Trials with many wearers. Each worker process runs the trials of one wearer.

use std::cell::RefCell;
use std::rc::Rc;

use fastrand::Rng;
use serde::{Deserialize, Serialize};
use shared_proto::message::{
    AckResult, CalibrationStep, Heading, HostMessage, LeftState, Mode, TiltThresholds,
};

use super::image;
use super::session::{BLANK, LeftRig, Seen};
use super::wearer::{Fault, Hand, Sensors, Tremor, Wearer, uniform};

/// How a wearer's sensors and neutral pose are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Parts {
    /// Sensors are drawn uniformly from the complete range of the tolerances.
    /// The neutral pose is within 10° of level.
    Drawn,
    /// The worst case, in which every tilt looks largest.
    /// The sensitivity is 10 % too high, and neutral is 10° off level.
    Loudest,
}

/// One wearer's trials.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Job {
    /// Seed of all random values.
    pub seed: u64,
    /// How the parts are chosen.
    pub parts: Parts,
    /// Number of trials (tilts per direction, or bends per finger), or seconds of tremor.
    pub count: u32,
}

/// Maximum time, counted from the start of a movement that lasts up to 220 ms.
/// The maximum time includes a tolerance of 80 ms, and 130 ms for distinguishing an intended tilt from a swing.
pub const IN_TIME_MS: f64 = 430.0;

/// The results of one wearer's tilts.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Tilts {
    /// Number of trials.
    pub trials: u32,
    /// Number of tilts that gave the correct command within [`IN_TIME_MS`], and no other command within 2 s.
    pub right: u32,
    /// Number of tilts that gave the opposite command at any time.
    pub reversed: u32,
    /// Results by the intended direction, in the order of [`DIRECTIONS`].
    pub by_direction: [Direction; 4],
    /// Descriptions of errors for users.
    pub notes: Vec<String>,
}

/// The results of the tilts in one direction.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Direction {
    /// Number of trials in which each command came first, in the order of [`DIRECTIONS`]; the last entry is "none".
    pub first: [u32; 5],
    /// Time from the start of the movement to the command's frame in ms, for correct tilts.
    pub latencies_ms: Vec<f64>,
}

/// The results of one wearer's bends.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct BendCounts {
    /// Number of bends of index and middle finger.
    pub bends: [u32; 2],
    /// Number of bends that the finger's counter counted exactly once.
    pub once: [u32; 2],
    /// Number of counts that no bend caused.
    pub excess: u32,
    /// Number of stop flags that the board set although the hand was not closed.
    pub stops: u32,
}

/// The results of a session with tremor or tilts only.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Quiet {
    /// Number of states with a command.
    pub commands: u32,
    /// Number of counted bends.
    pub bends: u32,
    /// Number of healthy states.
    pub states: u32,
}

/// Creates a calibrated wearer in the neutral pose.
fn wear(job: Job, tremor_deg: f64, hz: std::ops::Range<f64>) -> (LeftRig, Rc<RefCell<Hand>>, Rng) {
    let mut rng = Rng::with_seed(job.seed);
    let (sensors, off_level) = match job.parts {
        Parts::Drawn => {
            let (size, towards) =
                (uniform(&mut rng, 0.0..10.0f64.to_radians()), uniform(&mut rng, 0.0..std::f64::consts::TAU));
            (Sensors::drawn(&mut rng), (size * towards.cos(), size * towards.sin()))
        }
        Parts::Loudest => {
            let mut sensors = Sensors::drawn(&mut rng);
            sensors.sensitivity = [1.1; 3];
            (sensors, if rng.bool() { (10f64.to_radians(), 0.0) } else { (0.0, -10f64.to_radians()) })
        }
    };
    let calm = Tremor::drawn(&mut rng, 1f64.to_radians(), 4.0..12.0);
    let (wearer, hand) = Wearer::new(sensors.clone(), off_level, Some(calm), rng.fork());
    let mut session = LeftRig::new(&image::path(), &BLANK, Box::new(wearer));
    session.run_ms(300.0);
    assert_eq!(session.calibrate(CalibrationStep::Neutral), AckResult::Ok, "neutral, seed {}", job.seed);
    assert_eq!(session.calibrate(CalibrationStep::Rest), AckResult::Ok, "rest, seed {}", job.seed);
    let now_s = session.now_ms() / 1000.0;
    for finger in 0..2 {
        hand.borrow_mut().bend(finger, 1.0, now_s, 0.2);
    }
    session.run_ms(300.0);
    assert_eq!(session.calibrate(CalibrationStep::Bend), AckResult::Ok, "bend, seed {}", job.seed);
    let now_s = session.now_ms() / 1000.0;
    for finger in 0..2 {
        hand.borrow_mut().bend(finger, 0.0, now_s, 0.2);
    }
    session.run_ms(1000.0);
    // From here on, the wearer has the tremor of the trials and the same sensors as before.
    let tremor = Tremor::drawn(&mut rng, tremor_deg.to_radians(), hz);
    let (wearer, hand) = Wearer::new(sensors, off_level, Some(tremor), rng.fork());
    session.nano.set_voltages(Box::new(wearer));
    session.run_ms(500.0);
    (session, hand, rng)
}

/// Returns the commands that a tilt causes.
pub const DIRECTIONS: [Heading; 4] = [Heading::Forward, Heading::Backward, Heading::Left, Heading::Right];

fn opposite(heading: Heading) -> Heading {
    match heading {
        Heading::Forward => Heading::Backward,
        Heading::Backward => Heading::Forward,
        Heading::Left => Heading::Right,
        Heading::Right => Heading::Left,
        other => other,
    }
}

/// Performs the paper's trials: `count` tilts per direction, 16° to 45°, up to 8° off axis.
pub fn tilts(job: Job) -> Tilts {
    let (mut session, hand, mut rng) = wear(job, 1.0, 4.0..12.0);
    let mut result = Tilts::default();
    let mut order: Vec<Heading> = (0..job.count).flat_map(|_| DIRECTIONS).collect();
    rng.shuffle(&mut order);
    for wanted in order {
        session.run_ms(uniform(&mut rng, 300.0..500.0));
        let angle_deg = uniform(&mut rng, 16.0..45.0);
        let (angle, off) = (angle_deg.to_radians(), uniform(&mut rng, -8.0..8.0f64).to_radians());
        let (pitch, roll) = match wanted {
            Heading::Forward => (angle, off),
            Heading::Backward => (-angle, off),
            Heading::Left => (off, angle),
            _ => (off, -angle),
        };
        let start_ms = session.now_ms();
        let lasts_s = uniform(&mut rng, 0.10..0.22);
        hand.borrow_mut().tilt(pitch, roll, start_ms / 1000.0, lasts_s);
        let states = session.states(2000.0);
        let first = states.iter().find(|(_, s)| s.heading == wanted).map(|(t, _)| t - start_ms);
        let others: Vec<Heading> =
            states.iter().map(|(_, s)| s.heading).filter(|&h| h.is_command() && h != wanted).collect();
        let place = |heading| DIRECTIONS.iter().position(|&direction| direction == heading);
        let command = states.iter().map(|(_, s)| s.heading).find(|heading| heading.is_command());
        let direction = &mut result.by_direction[place(wanted).expect("one of the four was meant")];
        direction.first[command.and_then(place).unwrap_or(DIRECTIONS.len())] += 1;
        result.trials += 1;
        result.reversed += u32::from(others.contains(&opposite(wanted)));
        match first {
            Some(latency_ms) if latency_ms <= IN_TIME_MS && others.is_empty() => {
                result.right += 1;
                direction.latencies_ms.push(latency_ms);
            }
            _ => result.notes.push(format!(
                "seed {}: {wanted:?} by {angle_deg:.1}°, off axis {:.1}°: first after {first:?} ms, others {others:?}",
                job.seed,
                off.to_degrees(),
            )),
        }
        hand.borrow_mut().tilt(0.0, 0.0, session.now_ms() / 1000.0, 0.2);
        session.run_ms(300.0);
    }
    result
}

/// Performs `count` seconds of tremor up to 11° about neutral.
pub fn tremor(job: Job) -> Quiet {
    let (mut session, _hand, _) = wear(job, 11.0, 0.5..12.0);
    quiet(session.states(f64::from(job.count) * 1000.0))
}

/// Performs `count` seconds of tilting to and fro with straight fingers.
pub fn tilting(job: Job) -> Quiet {
    let (mut session, hand, mut rng) = wear(job, 1.0, 4.0..12.0);
    let mut states = Vec::new();
    let end = session.now_ms() + f64::from(job.count) * 1000.0;
    while session.now_ms() < end {
        let mut angle = || uniform(&mut rng, -45.0..45.0f64).to_radians();
        let (pitch, roll) = (angle(), angle());
        let lasts_s = uniform(&mut rng, 0.1..0.5);
        hand.borrow_mut().tilt(pitch, roll, session.now_ms() / 1000.0, lasts_s);
        // Straight fingers move slightly with the hand, by up to 12 % of a bend.
        for finger in 0..2 {
            let depth = uniform(&mut rng, -0.05..0.12);
            hand.borrow_mut().bend(finger, depth, session.now_ms() / 1000.0, lasts_s);
        }
        states.extend(session.states(uniform(&mut rng, 300.0..900.0)));
    }
    quiet(states)
}

fn quiet(states: Vec<(f64, LeftState)>) -> Quiet {
    let bends = |s: &LeftState| u32::from(s.index_bends) + u32::from(s.middle_bends);
    let first = states.first().map_or(0, |(_, s)| bends(s));
    Quiet {
        commands: states.iter().filter(|(_, s)| s.heading.is_command()).count() as u32,
        bends: states.last().map_or(0, |(_, s)| bends(s)) - first,
        states: states.iter().filter(|(_, s)| s.health == 0).count() as u32,
    }
}

/// Performs `count` bends per finger, with varying depth and speed.
pub fn bends(job: Job) -> BendCounts {
    let (mut session, hand, mut rng) = wear(job, 1.0, 4.0..12.0);
    let mut result = BendCounts::default();
    let mut order: Vec<usize> = (0..job.count).flat_map(|_| [0, 1]).collect();
    rng.shuffle(&mut order);
    let mut before = [0u8; 2];
    for finger in order {
        let mut draw = |range| uniform(&mut rng, range);
        // A calibrated bend is 1. The other finger also moves by up to 15 %, as real fingers do.
        let (depth, along) = (draw(0.6..1.2), draw(0.0..0.15));
        let (closes_s, held_s, opens_s, rest_s) =
            (draw(0.06..0.4), draw(0.03..0.8), draw(0.06..0.4), draw(0.12..0.5));
        let start_s = session.now_ms() / 1000.0;
        hand.borrow_mut().bend(finger, depth, start_s, closes_s);
        hand.borrow_mut().bend(1 - finger, along, start_s, closes_s);
        session.run_ms((closes_s + held_s) * 1000.0);
        let opens_at_s = session.now_ms() / 1000.0;
        for finger in 0..2 {
            let rests_at = uniform(&mut rng, -0.03..0.05);
            hand.borrow_mut().bend(finger, rests_at, opens_at_s, opens_s);
        }
        let mut after = before;
        let rest = session.run_ms((opens_s + rest_s) * 1000.0);
        for (_, seen) in rest {
            if let Seen::Left(state) = seen {
                after = [state.index_bends, state.middle_bends];
                result.stops += u32::from(state.stop);
            }
        }
        let counted = [0, 1].map(|f: usize| after[f].wrapping_sub(before[f]));
        result.bends[finger] += 1;
        result.once[finger] += u32::from(counted[finger] == 1 && counted[1 - finger] == 0);
        result.excess += u32::from(counted[finger].saturating_sub(1)) + u32::from(counted[1 - finger]);
        before = after;
    }
    result
}

/// Returns two stack sizes in bytes: the RAM that was never used, and the deepest stack.
/// The program fills the RAM with a pattern at its start.
/// The session contains all requests, a flood, faults and a calibration.
pub fn stack() -> (usize, usize) {
    const PAINT: u8 = 0xC5; // of `firmware-nano-avr/src/stack.rs`
    let job = Job { seed: 1, parts: Parts::Drawn, count: 1 };
    let (mut session, hand, mut rng) = wear(job, 1.0, 4.0..12.0);
    session.send(&HostMessage::HelloRequest);
    session.send(&HostMessage::Ping { id: u32::MAX });
    session.send(&HostMessage::SetMode { request: 900, mode: Mode::Record });
    session.run_ms(100.0);
    session.send(&HostMessage::SetMode { request: 901, mode: Mode::Classify });
    let thresholds = TiltThresholds { neutral_mrad: 87, end_mrad: 209, start_mrad: 262 };
    session.send(&HostMessage::SetThresholds { request: 902, thresholds });
    session.run_ms(300.0);
    let mut flood: Vec<u8> = (0..4000).map(|_| rng.u8(..)).collect();
    flood.push(0);
    session.nano.send(&flood);
    session.run_ms(500.0);
    hand.borrow_mut().fault = Some(Fault::Open(0));
    session.run_ms(500.0);
    hand.borrow_mut().fault = None;
    let now_s = session.now_ms() / 1000.0;
    hand.borrow_mut().tilt(0.5, 0.1, now_s + 1.0, 0.2);
    hand.borrow_mut().bend(0, 1.0, now_s + 1.0, 0.2);
    session.run_ms(2500.0);
    assert_eq!(session.calibrate(CalibrationStep::Reset), AckResult::Ok);
    session.run_ms(1500.0);
    let end = image::static_end();
    let unused = session.nano.painted(end, PAINT);
    (unused, 0x900 - end - unused)
}
