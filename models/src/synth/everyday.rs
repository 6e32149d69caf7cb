//! Everyday movement of a person who makes no gesture: sitting down and standing up, a cup, a keyboard, talking, a lift.
//!
//! `models daily simulated` compares these movements with those of real people.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::path::{Kind, Smooth};
use super::pose::BodyPose;
use super::wearer::normal;

/// Start and duration in seconds, and the displacement.
pub(super) type Move = (f64, f64, BodyPose);

/// Walking with arms that swing.
pub(super) struct Stroll {
    step_hz: f64,
    phase: f64,
    bob_m: f64,
    swing_rad: f64,
    arm_m: f64,
    wander: Smooth,
}

impl Stroll {
    pub(super) fn new(rng: &mut ChaCha8Rng) -> Self {
        Self {
            step_hz: rng.random_range(1.5..2.1),
            phase: rng.random_range(0.0..std::f64::consts::TAU),
            bob_m: rng.random_range(0.01..0.03),
            swing_rad: rng.random_range(0.1..0.45),
            arm_m: rng.random_range(0.5..0.65),
            wander: Smooth::new(rng, 0.1, 0.5, 0.3),
        }
    }

    pub(super) fn add(&self, t: f64, size: f64, pose: &mut BodyPose) {
        let step = std::f64::consts::TAU * self.step_hz * t + self.phase + self.wander.at(t);
        // The body rises with each step, and the heel adds a harmonic. The arm swings once in two steps.
        pose.carried_m[2] += size * self.bob_m * (step.sin() + 0.3 * (2.0 * step + 0.8).sin());
        pose.carried_m[0] += size * 0.4 * self.bob_m * (step + 1.0).sin();
        let arm = size * self.swing_rad * (step / 2.0).sin();
        pose.carried_m[0] += self.arm_m * arm.sin();
        pose.carried_m[2] += self.arm_m * (1.0 - arm.cos());
        pose.posture_rad[1] -= arm;
    }
}

/// A ride in a lift, up or down.
pub(super) struct Lift {
    start_s: f64,
    stop_s: f64,
    ramp_s: f64,
    speed_m_s: f64,
}

impl Lift {
    pub(super) fn new(rng: &mut ChaCha8Rng, seconds: f64) -> Self {
        let ramp_s = rng.random_range(1.3..2.5f64).min(seconds / 3.0);
        let start_s = rng.random_range(0.0..1.0f64).min(seconds / 4.0);
        let sense = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let stop_s = (seconds - ramp_s).max(start_s);
        Self { start_s, stop_s, ramp_s, speed_m_s: sense * rng.random_range(0.8..2.0) }
    }

    pub(super) fn add(&self, t: f64, pose: &mut BodyPose) {
        pose.carried_m[2] += self.speed_m_s * (self.way(t - self.start_s) - self.way(t - self.stop_s));
    }

    /// The way at speed 1 since the lift began to move: the integral of [`super::path::minimum_jerk`], and then a straight line.
    fn way(&self, t: f64) -> f64 {
        let part = (t / self.ramp_s).clamp(0.0, 1.0);
        let begun = part.powi(4) * (2.5 - 3.0 * part + part * part);
        self.ramp_s * begun + (t - self.ramp_s).max(0.0)
    }
}

/// Stands up and sits down again, several times if the time suffices.
pub(super) fn sit_and_stand(rng: &mut ChaCha8Rng, seconds: f64) -> Vec<Move> {
    let rise_m = rng.random_range(0.3..0.5);
    let lean_m = rng.random_range(0.15..0.35);
    // Between the thigh or the armrest and the side of the body.
    let to_side = BodyPose {
        position_m: [normal(rng, 0.1, 0.25), normal(rng, 0.06, 0.15), -rng.random_range(0.05..0.3)],
        posture_rad: [normal(rng, 0.5, 1.2), rng.random_range(0.2..1.4), normal(rng, 0.4, 0.9)],
        ..BodyPose::default()
    };
    let mut list = Vec::new();
    let mut t = rng.random_range(0.2..1.5);
    loop {
        let [up_s, down_s] = [0; 2].map(|_| rng.random_range(1.0..2.0));
        let between_s = rng.random_range(0.5..4.0);
        if t + up_s + between_s + down_s > seconds {
            return list;
        }
        for (start_s, length_s, sense) in [(t, up_s, 1.0), (t + up_s + between_s, down_s, -1.0)] {
            let lean = BodyPose {
                carried_m: [lean_m, 0.0, -0.3 * lean_m],
                posture_rad: [0.0, rng.random_range(0.0..0.4), 0.0],
                ..BodyPose::default()
            };
            let rise = BodyPose { carried_m: [0.0, 0.0, sense * rise_m], ..BodyPose::default() };
            // The trunk leans forward, the body rises or sinks, and the trunk straightens.
            list.push((start_s, 0.5 * length_s, lean));
            list.push((start_s + 0.5 * length_s, 0.5 * length_s, lean.times(-1.0)));
            list.push((start_s + 0.2 * length_s, 0.7 * length_s, rise));
            list.push((
                start_s + rng.random_range(0.1..0.4) * length_s,
                0.6 * length_s,
                to_side.times(sense),
            ));
        }
        t += up_s + between_s + down_s + rng.random_range(0.5..4.0);
    }
}

/// Reaches for a cup, drinks, puts it back and returns, if the time suffices.
pub(super) fn cup(rng: &mut ChaCha8Rng, seconds: f64) -> Vec<Move> {
    let mut list = Vec::new();
    let mut t = rng.random_range(0.2..1.0);
    loop {
        let side_m = normal(rng, 0.1, 0.25);
        let at_cup = BodyPose {
            position_m: [rng.random_range(0.2..0.45), side_m, rng.random_range(0.0..0.2)],
            posture_rad: [normal(rng, 0.4, 0.9), normal(rng, 0.2, 0.5), normal(rng, 0.3, 0.6)],
            ..BodyPose::default()
        };
        let at_mouth = BodyPose {
            position_m: [rng.random_range(0.0..0.15), 0.5 * side_m, rng.random_range(0.25..0.4)],
            posture_rad: [normal(rng, 0.4, 0.9), -rng.random_range(0.3..0.9), normal(rng, 0.3, 0.6)],
            ..BodyPose::default()
        };
        let mut tilted = at_mouth;
        tilted.posture_rad[0] += normal(rng, 0.4, 0.8);
        tilted.posture_rad[1] -= rng.random_range(0.2..0.7);
        let mut now = BodyPose::default();
        let mut one = Vec::new();
        for place in [at_cup, at_mouth, tilted, at_mouth, at_cup, BodyPose::default()] {
            let length_s = rng.random_range(0.5..1.2);
            one.push((t, length_s, place.plus(now.times(-1.0))));
            t += length_s + rng.random_range(0.1..0.8);
            now = place;
        }
        if t > seconds {
            return list;
        }
        list.append(&mut one);
        t += rng.random_range(0.5..3.0);
    }
}

/// Types: the hand taps in bursts.
pub(super) fn keys(rng: &mut ChaCha8Rng) -> Kind {
    let hz = rng.random_range(3.0..6.5);
    let angular = std::f64::consts::TAU * hz;
    let reach_m = rng.random_range(-1.5f64..0.3).exp() / (angular * angular);
    let turn_rad = rng.random_range(-3.0f64..-0.7).exp() / angular;
    let mut along = |size: f64, axes: [f64; 3]| {
        axes.map(|share| {
            (share * normal(rng, size, 2.0 * size), rng.random_range(0.0..std::f64::consts::TAU))
        })
    };
    let (position, posture) = (along(reach_m, [0.3, 0.5, 1.0]), along(turn_rad, [0.7, 1.0, 0.5]));
    // No two strokes of a key have the same interval.
    let (hurry, bursts) = (Smooth::new(rng, 0.5, 2.5, 1.2), Smooth::new(rng, 0.1, 0.6, 0.8));
    Kind::Shake { hz, hurry, bursts, position, posture }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::{IdleKind, Motion, Segment, Wearer, session};

    /// For each wearer, the largest deviation of the acceleration's magnitude from gravity, and the largest turn rate.
    fn felt(kind: IdleKind, seconds: f64) -> Vec<(f64, f64)> {
        let one = |index: u32| {
            let script = [Segment::new(Motion::Idle(kind), seconds)];
            let recording = session(&Wearer::training(3, index), 0, &script);
            let norm = |values: &[f32]| values.iter().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
            recording.samples().fold((0.0f64, 0.0f64), |(force, turn), sample| {
                (force.max((norm(&sample[..3]) - 9.81).abs()), turn.max(norm(&sample[3..6])))
            })
        };
        (1..=20).map(one).collect()
    }

    fn median(mut values: Vec<f64>) -> f64 {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    }

    #[test]
    fn a_lift_pushes_and_hardly_turns_and_standing_up_does_both() {
        let of = |kind| {
            let (force, turn): (Vec<f64>, Vec<f64>) = felt(kind, 20.0).into_iter().unzip();
            (median(force), median(turn))
        };
        let (still, lift, stand) = (of(IdleKind::Still), of(IdleKind::Lift), of(IdleKind::SitAndStand));
        assert!(lift.0 > still.0 + 0.3 && lift.0 < 4.0, "{lift:?} {still:?}");
        assert!(lift.1 < still.1 + 3.0, "{lift:?} {still:?}");
        assert!(stand.0 > 1.5 && stand.1 > 40.0, "{stand:?}");
    }

    #[test]
    fn who_stands_up_sits_down_again_and_the_cup_is_put_back() {
        use rand::SeedableRng;
        for seed in 0..50 {
            let rng = &mut ChaCha8Rng::seed_from_u64(seed);
            for list in [sit_and_stand(rng, 20.0), cup(rng, 20.0)] {
                assert!(!list.is_empty());
                let end = list.iter().fold(BodyPose::default(), |sum, (_, _, by)| sum.plus(*by));
                let all = [end.position_m, end.carried_m].concat();
                assert!(all.iter().all(|value| value.abs() < 1e-9), "{seed}: {end:?}");
                assert!(list.iter().all(|(start, length, _)| *start >= 0.0 && start + length <= 20.0));
            }
        }
    }

    #[test]
    fn a_lift_stops_with_the_speed_zero() {
        use rand::SeedableRng;
        for (seed, seconds) in [(1, 5.0), (2, 20.0), (3, 1.0)] {
            let lift = Lift::new(&mut ChaCha8Rng::seed_from_u64(seed), seconds);
            let height = |t: f64| {
                let mut pose = BodyPose::default();
                lift.add(t, &mut pose);
                pose.carried_m[2]
            };
            assert_eq!(height(0.0), 0.0);
            assert!((height(seconds) - height(seconds - 1e-4)).abs() < 1e-8);
            assert!((height(seconds) - height(seconds + 100.0)).abs() < 1e-9);
        }
    }
}
