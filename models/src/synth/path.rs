//! Computes hand paths: converts a script of motions to positions and postures over time.
//!
//! Positions are in the wearer's frame, relative to the resting point: x forward, y left, z up.
//! Postures are roll, pitch, yaw.
//! Every motion is a smooth function of time with an envelope that is flat at both ends (minimum jerk).
//! The complete path therefore has no jumps in acceleration.

use std::f64::consts::TAU;
use std::ops::Range;

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::everyday::{Lift, Move, Stroll, cup, keys, sit_and_stand};
use super::pose::{BodyPose, rotation};
use super::wearer::{Wearer, normal};
use crate::RATE_HZ;

/// Number of path points per recorded sample. It is larger than 1 so that derivatives are smooth.
pub(super) const OVERSAMPLING: usize = 4;
/// Time between path points in s.
pub(super) const STEP_S: f64 = 1.0 / (RATE_HZ * OVERSAMPLING as f64);

/// The motion of the hand in one segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Motion {
    /// No gesture.
    Idle(IdleKind),
    /// Strokes along the vertical.
    UpDown,
    /// Strokes forward and back.
    ToFro,
    /// Strokes from one side to the other and back.
    LeftRight,
    /// A vertical rectangle in front of the wearer.
    Rectangle,
    /// A horizontal rectangle, as on a table.
    RectangleFlat,
    /// A vertical circle in front of the wearer.
    Circle,
}

/// Movements without a gesture, all labelled `idle`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum IdleKind {
    /// The hand is held as still as a hand can be.
    Still,
    /// Small restless movement.
    Fidget,
    /// Reaching for objects, which is a series of single strokes to other positions, with pauses.
    Reach,
    /// Walking with the hand held still.
    Walk,
    /// Turning the hand over and back.
    Turn,
    /// Moving and turning in all directions at any speed with few pauses, such as gesticulating or handling objects.
    Scatter,
    /// Bursts of to-and-fro movement faster than any gesture, such as shaking a bottle, brushing, scratching or hammering.
    Shake,
    /// Walking with arms that swing.
    Stroll,
    /// Standing up from a chair and sitting down again.
    SitAndStand,
    /// Reaching for a cup, drinking and putting it back.
    Cup,
    /// Typing on a keyboard.
    Type,
    /// Gesticulating while talking.
    Talk,
    /// Riding a lift.
    Lift,
}

impl IdleKind {
    /// The movements of a wearer between gestures.
    pub const ALL: [Self; 5] = [Self::Still, Self::Fidget, Self::Reach, Self::Walk, Self::Turn];
    /// All kinds of movement of a wearer who makes no gestures.
    pub const EVERY: [Self; 7] =
        [Self::Still, Self::Fidget, Self::Reach, Self::Walk, Self::Turn, Self::Scatter, Self::Shake];
    /// Everyday movement. Models do not learn it, and the demonstration does not contain it.
    pub const EVERYDAY: [Self; 6] =
        [Self::Stroll, Self::SitAndStand, Self::Cup, Self::Type, Self::Talk, Self::Lift];
}

impl Motion {
    /// The hand held still.
    pub const IDLE: Self = Self::Idle(IdleKind::Still);
    /// The six gestures in the order of the paper.
    pub const GESTURES: [Self; 6] =
        [Self::UpDown, Self::ToFro, Self::LeftRight, Self::Rectangle, Self::RectangleFlat, Self::Circle];

    /// The canonical label.
    pub fn label(self) -> &'static str {
        match self {
            Self::Idle(_) => "idle",
            Self::UpDown => "up-down",
            Self::ToFro => "to-fro",
            Self::LeftRight => "left-right",
            Self::Rectangle => "rectangle",
            Self::RectangleFlat => "rectangle-flat",
            Self::Circle => "circle",
        }
    }
}

/// One part of a script.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// What is done.
    pub motion: Motion,
    /// Duration of the visible part in seconds.
    pub seconds: f64,
    /// Duration of the complete motion and start of the segment in it, both in seconds.
    whole_s: f64,
    from_s: f64,
}

impl Segment {
    /// A complete motion, which begins and ends at rest.
    pub fn new(motion: Motion, seconds: f64) -> Self {
        Self { motion, seconds, whole_s: seconds, from_s: 0.0 }
    }

    /// The part of a motion of `whole_s` seconds that starts at `from_s` and lasts `seconds`.
    pub fn cut(motion: Motion, whole_s: f64, from_s: f64, seconds: f64) -> Self {
        Self { motion, seconds, whole_s, from_s }
    }
}

/// Returns the complete path in steps of [`STEP_S`], with one additional point at each end for the derivatives.
pub(super) fn track(wearer: &Wearer, rng: &mut ChaCha8Rng, script: &[Segment]) -> Vec<BodyPose> {
    let mut parts = Vec::with_capacity(script.len());
    let mut end_s = 0.0;
    for segment in script {
        let start_s = end_s - segment.from_s;
        parts.push((start_s, end_s, Player::new(wearer, rng, segment)));
        end_s += segment.seconds;
    }
    // An idle hand may rest in any posture, but a hand that makes gestures uses its normal posture.
    let gestures = script.iter().any(|segment| !matches!(segment.motion, Motion::Idle(_)));
    let rest = if gestures {
        wearer.posture_rad
    } else {
        [normal(rng, 0.5, 1.6), normal(rng, 0.5, 1.3), wearer.posture_rad[2]]
    };
    let sway: [Smooth; 3] = [0; 3].map(|_| Smooth::new(rng, 0.05, 0.4, 0.02));
    let shake: [Smooth; 3] =
        [0; 3].map(|_| Smooth::new(rng, wearer.tremor_hz * 0.9, wearer.tremor_hz * 1.1, wearer.tremor_rad));
    let heave: [Smooth; 3] = [0; 3].map(|_| Smooth::new(rng, 0.1, 0.6, 0.002));

    let count = (end_s * RATE_HZ).round() as usize * OVERSAMPLING + 2;
    (0..count)
        .map(|n| {
            let t = (n as f64 - 1.0) * STEP_S;
            let mut pose = BodyPose::default();
            for (start_s, shown_s, player) in &parts {
                // The part before the cut is omitted; a complete motion is at rest there anyway.
                if t >= *shown_s - 2.0 * STEP_S {
                    player.add(t - start_s, &mut pose);
                }
            }
            let [x, y, z] = pose.position_m;
            // The hand swings on an arm: a move to the left causes a yaw to the left, and a move up causes an upward pitch.
            // This pitch is a negative rotation about the y axis, which points left.
            let swing = wearer.coupling / wearer.arm_m;
            let turn = [0.15 * swing * y, -swing * (z + 0.2 * x), swing * y];
            for axis in 0..3 {
                pose.posture_rad[axis] += rest[axis] + turn[axis] + sway[axis].at(t) + shake[axis].at(t);
                pose.position_m[axis] += heave[axis].at(t) + 0.03 * shake[axis].at(t + 0.03);
                pose.position_m[axis] += pose.carried_m[axis];
            }
            pose
        })
        .collect()
}

/// A smooth random function of time, which is the sum of several sines with random frequencies and phases.
pub(super) struct Smooth([(f64, f64, f64); 5]);

impl Smooth {
    /// The frequencies are between `low_hz` and `high_hz`, and the function has a standard deviation of `rms`.
    pub(super) fn new(rng: &mut ChaCha8Rng, low_hz: f64, high_hz: f64, rms: f64) -> Self {
        let size = rms * (2.0f64 / 5.0).sqrt();
        Self([0; 5].map(|_| (rng.random_range(low_hz..high_hz), rng.random_range(0.0..TAU), size)))
    }

    pub(super) fn at(&self, t: f64) -> f64 {
        self.0.iter().map(|(hz, phase, size)| size * (TAU * hz * t + phase).sin()).sum()
    }
}

/// A transition from 0 to 1 whose speed and acceleration are zero at both ends.
pub(super) fn minimum_jerk(part: f64) -> f64 {
    let p = part.clamp(0.0, 1.0);
    p * p * p * (10.0 + p * (6.0 * p - 15.0))
}

/// The motion of one segment, with all its random values.
struct Player {
    whole_s: f64,
    onset_s: f64,
    kind: Kind,
}

#[expect(clippy::large_enum_variant, reason = "a handful per recording")]
pub(super) enum Kind {
    Rest,
    Periodic(Box<Periodic>),
    /// Restless position and posture.
    Restless {
        position: [Smooth; 3],
        posture: [Smooth; 3],
    },
    /// Single moves, each with time, duration and displacement.
    Moves(Vec<Move>),
    Walk {
        step_hz: f64,
        phase: f64,
        bob_m: f64,
        sway_m: f64,
        nod_rad: f64,
        wander: Smooth,
    },
    Shake {
        hz: f64,
        hurry: Smooth,
        /// The hand shakes while this function is above 0.
        bursts: Smooth,
        /// Amplitude and phase of the shaking along each axis.
        position: [(f64, f64); 3],
        posture: [(f64, f64); 3],
    },
    Stroll(Stroll),
    Lift(Lift),
}

pub(super) struct Periodic {
    shape: Shape,
    hz: f64,
    start: f64,
    sense: f64,
    /// Half of the size along the first and the second axis of the shape.
    size_m: [f64; 2],
    /// The columns are the first and the second axis of the shape, and its normal.
    frame: [[f64; 3]; 3],
    slop: [(f64, f64); 3],
    second: (f64, f64),
    corner: f64,
    hurry: Smooth,
    growth: Smooth,
}

#[derive(Clone, Copy)]
enum Shape {
    Stroke,
    Circle,
    Rectangle,
}

impl Player {
    fn new(wearer: &Wearer, rng: &mut ChaCha8Rng, segment: &Segment) -> Self {
        let onset_s = (wearer.onset_s * rng.random_range(0.8..1.25)).min(segment.whole_s / 2.0);
        let kind = match segment.motion {
            Motion::Idle(kind) => idle(rng, kind, segment.whole_s),
            gesture => Kind::Periodic(Box::new(Periodic::new(wearer, rng, gesture))),
        };
        Self { whole_s: segment.whole_s, onset_s, kind }
    }

    fn envelope(&self, t: f64) -> f64 {
        minimum_jerk(t / self.onset_s) * minimum_jerk((self.whole_s - t) / self.onset_s)
    }

    /// Adds the motion at `t` seconds after its start.
    fn add(&self, t: f64, pose: &mut BodyPose) {
        let size = self.envelope(t);
        match &self.kind {
            Kind::Rest => {}
            Kind::Periodic(periodic) => {
                if size > 0.0 {
                    let at = periodic.at(t);
                    for (position, offset) in pose.position_m.iter_mut().zip(at) {
                        *position += size * offset;
                    }
                }
            }
            Kind::Restless { position, posture } => {
                for axis in 0..3 {
                    pose.position_m[axis] += size * position[axis].at(t);
                    pose.posture_rad[axis] += size * posture[axis].at(t);
                }
            }
            Kind::Moves(moves) => {
                for (start_s, length_s, by) in moves {
                    let part = minimum_jerk((t - start_s) / length_s);
                    *pose = pose.plus(by.times(part));
                }
            }
            Kind::Walk { step_hz, phase, bob_m, sway_m, nod_rad, wander } => {
                let step = TAU * step_hz * t + phase + wander.at(t);
                pose.position_m[2] += size * bob_m * step.sin();
                pose.position_m[0] += size * 0.4 * bob_m * (step + 1.0).sin();
                pose.position_m[1] += size * sway_m * (step / 2.0).sin();
                pose.posture_rad[1] += size * nod_rad * (step + 0.5).sin();
                pose.posture_rad[0] += size * nod_rad * (step / 2.0 + 0.7).sin();
            }
            Kind::Stroll(stroll) => stroll.add(t, size, pose),
            Kind::Lift(lift) => lift.add(t, pose),
            Kind::Shake { hz, hurry, bursts, position, posture } => {
                let angle = TAU * hz * t + hurry.at(t);
                let size = size * minimum_jerk(0.5 + bursts.at(t));
                for axis in 0..3 {
                    let (reach_m, turn_rad) = (position[axis], posture[axis]);
                    pose.position_m[axis] += size * reach_m.0 * (angle + reach_m.1).sin();
                    pose.posture_rad[axis] += size * turn_rad.0 * (angle + turn_rad.1).sin();
                }
            }
        }
    }
}

fn idle(rng: &mut ChaCha8Rng, kind: IdleKind, seconds: f64) -> Kind {
    match kind {
        IdleKind::Still => Kind::Rest,
        IdleKind::Stroll => Kind::Stroll(Stroll::new(rng)),
        IdleKind::SitAndStand => Kind::Moves(sit_and_stand(rng, seconds)),
        IdleKind::Cup => Kind::Moves(cup(rng, seconds)),
        IdleKind::Type => keys(rng),
        IdleKind::Talk => {
            let (reach_m, turn_rad) = (rng.random_range(0.03..0.15), rng.random_range(0.15..0.6));
            moves(rng, seconds, reach_m, turn_rad, 0.3..0.8, 0.0..1.4)
        }
        IdleKind::Lift => Kind::Lift(Lift::new(rng, seconds)),
        IdleKind::Fidget => {
            let size_m = rng.random_range(0.004..0.02);
            let turn_rad = rng.random_range(0.03..0.25);
            Kind::Restless {
                position: [0; 3].map(|_| Smooth::new(rng, 0.3, 1.8, size_m)),
                posture: [0; 3].map(|_| Smooth::new(rng, 0.2, 1.5, turn_rad)),
            }
        }
        IdleKind::Reach => moves(rng, seconds, 0.25, 0.4, 0.45..1.1, 0.7..2.5),
        IdleKind::Turn => moves(rng, seconds, 0.03, 1.1, 0.45..1.1, 0.7..2.5),
        IdleKind::Scatter => {
            let (reach_m, turn_rad) = (rng.random_range(0.03..0.3), rng.random_range(0.1..1.6));
            moves(rng, seconds, reach_m, turn_rad, 0.3..1.0, 0.0..0.6)
        }
        IdleKind::Walk => Kind::Walk {
            step_hz: rng.random_range(1.5..2.2),
            phase: rng.random_range(0.0..TAU),
            bob_m: rng.random_range(0.008..0.025),
            sway_m: rng.random_range(0.01..0.035),
            nod_rad: rng.random_range(0.02..0.15),
            wander: Smooth::new(rng, 0.1, 0.5, 0.3),
        },
        IdleKind::Shake => {
            // The frequency of shaking is higher than that of gestures, which have up to 5 Hz.
            let hz = rng.random_range(5.5f64.ln()..9.0f64.ln()).exp();
            // The limits apply to force and rotation, not to amplitude: 1 to 15 m/s² and 0.3 to 5 rad/s.
            let reach_m = rng.random_range(0.0f64..2.7).exp() / (TAU * hz).powi(2);
            let turn_rad = rng.random_range(-1.2f64..1.6).exp() / (TAU * hz);
            // The movement is almost along one line.
            let mut along = |size: f64| {
                let phase = rng.random_range(0.0..TAU);
                [0; 3].map(|_| (normal(rng, 0.6 * size, size), phase + normal(rng, 0.3, 0.9)))
            };
            let (position, posture) = (along(reach_m), along(turn_rad));
            Kind::Shake {
                hz,
                hurry: Smooth::new(rng, 0.1, 0.8, 0.8),
                bursts: Smooth::new(rng, 0.05, 0.4, 0.8),
                position,
                posture,
            }
        }
    }
}

/// Moves to positions near the resting point, and pauses between them.
fn moves(
    rng: &mut ChaCha8Rng,
    seconds: f64,
    reach_m: f64,
    turn_rad: f64,
    lengths_s: Range<f64>,
    pauses_s: Range<f64>,
) -> Kind {
    const PAUSE_S: f64 = 0.5;
    let mut list = Vec::new();
    let mut now = BodyPose::default();
    let mut t = rng.random_range(0.0..1.5);
    loop {
        let length_s = rng.random_range(lengths_s.clone());
        let mut place = BodyPose {
            position_m: [0; 3].map(|_| normal(rng, reach_m * 0.6, reach_m)),
            posture_rad: [0; 3].map(|_| normal(rng, turn_rad * 0.6, turn_rad)),
            ..BodyPose::default()
        };
        // The last move returns before the next motion starts, and a short pause follows this move.
        let last = t + length_s > seconds - 1.2 - PAUSE_S;
        if last {
            place = BodyPose::default();
            t = t.min(seconds - PAUSE_S - length_s).max(0.0);
        }
        let by = place.plus(now.times(-1.0));
        list.push((t, length_s, by));
        if last {
            return Kind::Moves(list);
        }
        now = place;
        t += length_s + rng.random_range(pauses_s.clone());
    }
}

impl Periodic {
    fn new(wearer: &Wearer, rng: &mut ChaCha8Rng, gesture: Motion) -> Self {
        let (shape, hz, first, second) = match gesture {
            Motion::ToFro => (Shape::Stroke, wearer.stroke_hz, 0, 1),
            Motion::LeftRight => (Shape::Stroke, wearer.stroke_hz, 1, 2),
            Motion::Rectangle => (Shape::Rectangle, wearer.rectangle_hz, 1, 2),
            Motion::RectangleFlat => (Shape::Rectangle, wearer.rectangle_hz, 1, 0),
            Motion::Circle => (Shape::Circle, wearer.circle_hz, 1, 2),
            Motion::UpDown | Motion::Idle(_) => (Shape::Stroke, wearer.stroke_hz, 2, 0),
        };
        let hz = hz * normal(rng, 0.08, 0.2).exp();
        let speed_m_s = wearer.speed_m_s * normal(rng, 0.1, 0.25).exp();
        let half_m = match shape {
            Shape::Stroke | Shape::Circle => speed_m_s / (TAU * hz),
            // The peak speed on a side (minimum jerk) is 1.875 times the mean speed,
            // and a turn has four sides.
            Shape::Rectangle => 0.5 * speed_m_s * (1.0 - wearer.corner) / (1.875 * 4.0 * hz),
        }
        .min(0.35);
        let aspect = match shape {
            Shape::Stroke => 0.0,
            Shape::Circle => wearer.aspect.max(0.75) * normal(rng, 0.06, 0.12).exp(),
            Shape::Rectangle => wearer.aspect * normal(rng, 0.08, 0.15).exp(),
        };
        let mut tilt: [f64; 3] = std::array::from_fn(|axis| wearer.tilt_rad[axis] + normal(rng, 0.05, 0.12));
        if gesture == Motion::Circle {
            tilt[1] += wearer.circle_rad[0];
            tilt[2] += wearer.circle_rad[1];
        }
        let turn = rotation(tilt);
        let third = 3 - first - second;
        let column = |axis: usize| std::array::from_fn(|row| turn[row][axis]);
        Self {
            shape,
            hz,
            start: rng.random_range(0.0..TAU),
            sense: if rng.random_bool(wearer.clockwise) { 1.0 } else { -1.0 },
            size_m: [half_m, half_m * aspect],
            frame: [column(first), column(second), column(third)],
            slop: [0; 3].map(|_| (half_m * normal(rng, wearer.slop, 0.3), rng.random_range(0.0..TAU))),
            second: (normal(rng, 0.05, 0.12), rng.random_range(0.0..TAU)),
            corner: wearer.corner,
            hurry: Smooth::new(rng, 0.05, 0.4, 1.5 * wearer.wander),
            growth: Smooth::new(rng, 0.05, 0.5, wearer.wander),
        }
    }

    fn at(&self, t: f64) -> [f64; 3] {
        let phase = self.start + TAU * self.hz * t + self.hurry.at(t);
        let grown = 1.0 + self.growth.at(t).clamp(-0.45, 0.45);
        let (u, v) = match self.shape {
            Shape::Stroke => (phase.cos() + self.second.0 * (2.0 * phase + self.second.1).cos(), 0.0),
            Shape::Circle => (phase.cos(), self.sense * phase.sin()),
            Shape::Rectangle => {
                let (u, v) = rectangle(phase / TAU, self.corner);
                (u, self.sense * v)
            }
        };
        let across = |n: usize| self.slop[n].0 * (phase + self.slop[n].1).cos();
        let local = [self.size_m[0] * u + across(0), self.size_m[1] * v + across(1), across(2)];
        std::array::from_fn(|row| grown * (0..3).map(|n| self.frame[n][row] * local[n]).sum::<f64>())
    }
}

/// Goes from corner to corner of the square ±1. A turn from 0 to 1 goes around once, and rests for `corner` of each side.
fn rectangle(turn: f64, corner: f64) -> (f64, f64) {
    let along = turn.rem_euclid(1.0) * 4.0;
    let side = along.floor();
    let part = 2.0 * minimum_jerk((along - side) / (1.0 - corner)) - 1.0;
    match side as u8 {
        0 => (part, -1.0),
        1 => (1.0, part),
        2 => (-part, 1.0),
        _ => (-1.0, -part),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::wearer::Draws;

    #[test]
    fn a_rectangle_goes_once_around_through_its_four_corners() {
        for (turn, corner) in
            [(0.0, (-1.0, -1.0)), (0.25, (1.0, -1.0)), (0.5, (1.0, 1.0)), (0.75, (-1.0, 1.0))]
        {
            let (u, v) = rectangle(turn, 0.2);
            assert!((u - corner.0).abs() < 1e-9 && (v - corner.1).abs() < 1e-9, "{turn}: {u} {v}");
        }
        let (u, v) = rectangle(0.999_999, 0.2);
        assert!((u + 1.0).abs() < 1e-3 && (v + 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_gesture_starts_and_ends_at_rest() {
        let wearer = Wearer::training(1, 1);
        let script = [
            Segment::new(Motion::IDLE, 1.0),
            Segment::new(Motion::LeftRight, 3.0),
            Segment::new(Motion::IDLE, 1.0),
        ];
        let track = track(&wearer, &mut wearer.rng(Draws::Take(0)), &script);
        let speed = |n: usize| (track[n + 1].position_m[1] - track[n].position_m[1]).abs() / STEP_S;
        let per_s = RATE_HZ as usize * OVERSAMPLING;
        for n in [per_s / 2, per_s, 4 * per_s, 4 * per_s + per_s / 2] {
            assert!(speed(n) < 0.05, "{n}: {} m/s", speed(n));
        }
        let fastest = (per_s..4 * per_s).map(speed).fold(0.0, f64::max);
        assert!(fastest > 0.4, "{fastest} m/s");
    }

    #[test]
    fn acceleration_has_no_jumps() {
        for motion in Motion::GESTURES {
            let wearer = Wearer::training(2, 9);
            let script = [Segment::new(Motion::IDLE, 1.0), Segment::new(motion, 4.0)];
            let track = track(&wearer, &mut wearer.rng(Draws::Take(0)), &script);
            let z = |n: usize| track[n].position_m;
            let acceleration =
                |n: usize, a: usize| (z(n + 1)[a] - 2.0 * z(n)[a] + z(n - 1)[a]) / (STEP_S * STEP_S);
            for axis in 0..3 {
                for n in 1..track.len() - 3 {
                    let jump = acceleration(n + 1, axis) - acceleration(n, axis);
                    assert!(jump.abs() < 8.0, "{motion:?} axis {axis} at {n}: {jump} m/s²");
                }
            }
        }
    }
}
