//! Motion along a path of several straight ways in joint space, at constant accelerations.
//!
//! Between two corners the speed is constant; around a corner it changes evenly from one way's to the
//! next's (a parabolic blend, Kunz and Stilman 2011), so the arm need not stop there. Speeds within a
//! blend lie between those of the ways, and the blend lasts as long as the slowest joint needs: position,
//! speed and acceleration keep their limits exactly, at every instant and not only at samples. On one
//! way alone the joint with the least speed in hand sets the pace: v = min(vᵢ/|Δqᵢ|), a = min(aᵢ/|Δqᵢ|), and
//! the duration is 1/v + v/a, or 2/√a where v² > a, as MoveIt's time-optimal profile has it
//! (`shared/reference/robotics.md`).

use crate::arm::gen3::{JOINTS, Joints};
use crate::arm::profile::{JointLimits, Sample};

/// A stretch of constant acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    start_s: f64,
    duration_s: f64,
    from_rad: Joints,
    velocity_rad_s: Joints,
    acceleration_rad_s2: Joints,
}

/// A motion from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    pieces: Vec<Piece>,
    /// Where it ends, exactly.
    to_rad: Joints,
    duration_s: f64,
}

/// Position, speed and acceleration at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// In rad.
    pub joints_rad: Joints,
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// In rad/s².
    pub acceleration_rad_s2: Joints,
}

fn scaled(a: &Joints, factor: f64) -> Joints {
    a.map(|x| x * factor)
}

fn minus(a: &Joints, b: &Joints) -> Joints {
    std::array::from_fn(|i| a[i] - b[i])
}

fn plus(a: &Joints, b: &Joints, factor: f64) -> Joints {
    std::array::from_fn(|i| a[i] + factor * b[i])
}

/// Time that a change of speed takes at least.
fn ramp_s(change_rad_s: &Joints, limits: &JointLimits) -> f64 {
    (0..JOINTS).map(|i| change_rad_s[i].abs() / limits.acceleration_rad_s2[i]).fold(0.0, f64::max)
}

impl Trajectory {
    /// Through all points of a path in turn, stopping at the corners for which `stops` says so. Corners
    /// without a stop are cut a little. `stops` counts from the first corner after the start.
    pub fn through(path_rad: &[Joints], stops: &[bool], limits: &JointLimits) -> Self {
        let mut trajectory = Trajectory {
            pieces: Vec::new(),
            to_rad: path_rad.last().copied().unwrap_or_default(),
            duration_s: 0.0,
        };
        let mut start = 0;
        for end in 1..path_rad.len() {
            if end + 1 == path_rad.len() || stops.get(end - 1).copied().unwrap_or(false) {
                trajectory.append_blended(&path_rad[start..=end], limits);
                start = end;
            }
        }
        trajectory
    }

    /// One motion after the other; the second starts where the first ends.
    #[must_use]
    pub fn then(mut self, next: &Trajectory) -> Self {
        let start_s = self.duration_s;
        self.pieces.extend(next.pieces.iter().map(|p| Piece { start_s: p.start_s + start_s, ..*p }));
        Trajectory { pieces: self.pieces, to_rad: next.to_rad, duration_s: start_s + next.duration_s }
    }

    /// Brakes from a speed as fast as the limits allow, all joints together, straight on.
    pub fn braking(from: Sample, limits: &JointLimits) -> Self {
        let duration_s = ramp_s(&from.velocity_rad_s, limits);
        if duration_s == 0.0 {
            return Trajectory { pieces: Vec::new(), to_rad: from.joints_rad, duration_s };
        }
        let acceleration_rad_s2 = scaled(&from.velocity_rad_s, -1.0 / duration_s);
        Trajectory {
            pieces: vec![Piece {
                start_s: 0.0,
                duration_s,
                from_rad: from.joints_rad,
                velocity_rad_s: from.velocity_rad_s,
                acceleration_rad_s2,
            }],
            to_rad: plus(&from.joints_rad, &from.velocity_rad_s, 0.5 * duration_s),
            duration_s,
        }
    }

    fn append_blended(&mut self, path_rad: &[Joints], limits: &JointLimits) {
        let points: Vec<Joints> = path_rad.iter().copied().fold(Vec::new(), |mut points, point| {
            if points.last() != Some(&point) {
                points.push(point);
            }
            points
        });
        let ways: Vec<Joints> = points.windows(2).map(|two| minus(&two[1], &two[0])).collect();
        if ways.is_empty() {
            return;
        }
        let speeds = fastest_speeds(&ways, limits);
        let velocities: Vec<Joints> = ways.iter().zip(&speeds).map(|(way, s)| scaled(way, *s)).collect();
        let blends_s = blend_times_s(&velocities, limits);
        let rest = [0.0; JOINTS];
        for (k, point) in points.iter().enumerate() {
            let before = if k == 0 { &rest } else { &velocities[k - 1] };
            let after = velocities.get(k).unwrap_or(&rest);
            let blend_s = blends_s[k];
            if blend_s > 0.0 {
                // A blend is centred on its corner; at either end, where one speed is zero, the other
                // way's half of it is where the arm rests, and it takes that long more.
                let from_rad = plus(point, before, -0.5 * blend_s);
                self.push(from_rad, *before, scaled(&minus(after, before), 1.0 / blend_s), blend_s);
            }
            if let Some(speed) = speeds.get(k) {
                let cruise_s = 1.0 / speed - 0.5 * (blend_s + blends_s[k + 1]);
                self.push(plus(point, after, 0.5 * blend_s), *after, rest, cruise_s);
            }
        }
    }

    fn push(
        &mut self,
        from_rad: Joints,
        velocity_rad_s: Joints,
        acceleration_rad_s2: Joints,
        duration_s: f64,
    ) {
        if duration_s > 0.0 {
            let start_s = self.duration_s;
            self.pieces.push(Piece { start_s, duration_s, from_rad, velocity_rad_s, acceleration_rad_s2 });
            self.duration_s += duration_s;
        }
    }

    /// Seconds until rest.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Where it ends.
    pub fn goal_rad(&self) -> Joints {
        self.to_rad
    }

    /// Everything, `time_s` after the start; at the goal and at rest from the end on.
    pub fn motion(&self, time_s: f64) -> Motion {
        let rest = [0.0; JOINTS];
        let next = self.pieces.partition_point(|piece| piece.start_s <= time_s);
        match self.pieces.get(next.saturating_sub(1)) {
            Some(piece) if time_s < self.duration_s => {
                let t = (time_s - piece.start_s).clamp(0.0, piece.duration_s);
                let a = &piece.acceleration_rad_s2;
                Motion {
                    joints_rad: plus(&plus(&piece.from_rad, &piece.velocity_rad_s, t), a, 0.5 * t * t),
                    velocity_rad_s: plus(&piece.velocity_rad_s, a, t),
                    acceleration_rad_s2: *a,
                }
            }
            _ => Motion { joints_rad: self.to_rad, velocity_rad_s: rest, acceleration_rad_s2: rest },
        }
    }

    /// Position and speed, `time_s` after the start.
    pub fn sample(&self, time_s: f64) -> Sample {
        let Motion { joints_rad, velocity_rad_s, .. } = self.motion(time_s);
        Sample { joints_rad, velocity_rad_s }
    }

    /// When the acceleration changes, and the end. In between, positions and speeds at both ends say all.
    pub fn knots_s(&self) -> Vec<f64> {
        let starts = self.pieces.iter().map(|piece| piece.start_s).filter(|&start_s| start_s > 0.0);
        starts.chain([self.duration_s]).collect()
    }

    /// Start and end of the stretches in which the arm leaves the path's straight ways.
    pub fn corners_s(&self) -> Vec<(f64, f64)> {
        let cuts = self.pieces.iter().filter(|piece| {
            let v = &piece.velocity_rad_s;
            let end = plus(v, &piece.acceleration_rad_s2, piece.duration_s);
            // Ramps from and to rest keep to their way.
            let moves = |v: &Joints| v.iter().any(|v| v.abs() > 1e-9);
            piece.acceleration_rad_s2 != [0.0; JOINTS] && moves(v) && moves(&end)
        });
        cuts.map(|piece| (piece.start_s, piece.start_s + piece.duration_s)).collect()
    }
}

fn blend_times_s(velocities: &[Joints], limits: &JointLimits) -> Vec<f64> {
    let rest = [0.0; JOINTS];
    (0..=velocities.len())
        .map(|k| {
            let before = if k == 0 { &rest } else { &velocities[k - 1] };
            ramp_s(&minus(velocities.get(k).unwrap_or(&rest), before), limits)
        })
        .collect()
}

/// Speeds in ways per second, as fast as the limits of the joints and of the blends allow.
fn fastest_speeds(ways: &[Joints], limits: &JointLimits) -> Vec<f64> {
    let most = |way: &Joints| {
        let slowest = (0..JOINTS).map(|i| way[i].abs() / limits.velocity_rad_s[i]).fold(0.0, f64::max);
        1.0 / slowest
    };
    let most: Vec<f64> = ways.iter().map(most).collect();
    // Blends must not reach into each other.
    let fits = |speeds: &[f64]| {
        let velocities: Vec<Joints> = ways.iter().zip(speeds).map(|(way, s)| scaled(way, *s)).collect();
        let blends_s = blend_times_s(&velocities, limits);
        speeds.iter().zip(blends_s.windows(2)).all(|(s, b)| 1.0 / s >= 0.5 * (b[0] + b[1]))
    };
    if fits(&most) {
        return most;
    }
    if let [way] = ways {
        // A single way too short for full speed: exactly the triangle.
        let acceleration =
            (0..JOINTS).map(|i| way[i].abs() / limits.acceleration_rad_s2[i]).fold(0.0, f64::max);
        // One step below, lest the rounded ramps be a hair longer than the way.
        return vec![(1.0 / acceleration).sqrt() * (1.0 - 1e-12)];
    }
    // All slowed alike until they fit (a slower motion always does), then each as fast as the others let it.
    let mut speeds = most.clone();
    let slowed = |factor: f64| most.iter().map(|s| s * factor).collect::<Vec<_>>();
    let factor = bisect(|factor| fits(&slowed(factor)));
    speeds.copy_from_slice(&slowed(factor));
    for _ in 0..4 {
        for k in 0..speeds.len() {
            let now = speeds[k];
            let with = |share: f64| {
                let mut tried = speeds.clone();
                tried[k] = now + share * (most[k] - now);
                tried
            };
            let share = if fits(&with(1.0)) { 1.0 } else { bisect(|share| fits(&with(share))) };
            speeds = with(share);
        }
    }
    speeds
}

/// The greatest share that was found to fit; 0 fits.
fn bisect(fits: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if fits(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::gen3::HOME;
    use proptest::prelude::*;

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(-2.0..2.0_f64)
    }

    #[test]
    #[allow(clippy::approx_constant)] // 3.14 is what Kinova's file says
    fn kinovas_own_poses_take_the_times_of_moveit() {
        // Figures of shared/reference/robotics.md, from MoveIt at scaling 0.1 and 0.05.
        let limits = JointLimits::paper();
        let retract = [0.0, -0.35, 3.14, -2.54, 0.0, -0.87, 1.57];
        let up = Trajectory::through(&[[0.0; JOINTS], HOME], &[], &limits).duration_s();
        let back = Trajectory::through(&[HOME, retract], &[], &limits).duration_s();
        assert!((up - 22.81).abs() < 0.01, "{up}");
        assert!((back - 15.26).abs() < 0.01, "{back}");
    }

    #[test]
    fn a_short_move_never_reaches_full_speed() {
        let mut to = HOME;
        to[0] += 0.01;
        let duration = Trajectory::through(&[HOME, to], &[], &JointLimits::paper()).duration_s();
        assert!((duration - 2.0 * (0.01_f64 / 0.43).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn equal_ends_take_no_time() {
        let limits = JointLimits::paper();
        let still = Trajectory::through(&[HOME, HOME], &[], &limits);
        assert_eq!((still.duration_s(), still.sample(1.0).joints_rad), (0.0, HOME));
        let braked = Trajectory::braking(still.sample(0.0), &limits);
        assert_eq!((braked.duration_s(), braked.goal_rad()), (0.0, HOME));
    }

    proptest! {
        #[test]
        fn one_way_takes_as_long_as_the_formula_says_and_keeps_to_the_line(
            from in joints(), to in joints(), share in 0.001..1.0_f64,
        ) {
            let limits = JointLimits::paper();
            let way = scaled(&minus(&to, &from), share);
            let to = plus(&from, &way, 1.0);
            let least = |limit: &Joints| {
                (0..JOINTS).map(|i| limit[i] / way[i].abs()).fold(f64::INFINITY, f64::min)
            };
            let (v, a) = (least(&limits.velocity_rad_s), least(&limits.acceleration_rad_s2));
            let expected_s = if v * v > a { 2.0 / a.sqrt() } else { 1.0 / v + v / a };
            let motion = Trajectory::through(&[from, to], &[], &limits);
            prop_assert!((motion.duration_s() - expected_s).abs() < 1e-9);
            let mut gone = 0.0;
            for k in 0..=50 {
                let now = motion.sample(f64::from(k) / 50.0 * expected_s);
                let shares: Joints =
                    std::array::from_fn(|i| (now.joints_rad[i] - from[i]) / (to[i] - from[i]));
                for i in 0..JOINTS {
                    prop_assert!((shares[i] - shares[0]).abs() * (to[i] - from[i]).abs() < 1e-9);
                }
                prop_assert!(shares[0] >= gone - 1e-12 && shares[0] <= 1.0 + 1e-12, "never turns back");
                gone = shares[0];
            }
            prop_assert_eq!(motion.sample(motion.duration_s()).joints_rad, to);
        }

        #[test]
        fn limits_hold_at_every_sample_and_while_braking(
            path in prop::collection::vec(joints(), 2..7), short in 0.01..1.0_f64,
            stops in prop::array::uniform5(any::<bool>()), when in 0.0..1.0_f64,
        ) {
            let limits = JointLimits::paper();
            let path: Vec<Joints> = path.iter().map(|joints| scaled(joints, short)).collect();
            let plan = Trajectory::through(&path, &stops, &limits);
            let stopping = Trajectory::through(&path, &[true; 5], &limits);
            prop_assert!(plan.duration_s().is_finite() && stopping.duration_s() > 0.0);
            let halt_s = when * plan.duration_s();
            let halting = Trajectory::braking(plan.sample(halt_s), &limits);
            prop_assert!(halting.duration_s() <= 0.1397 / 0.43);
            for (motion, end_s) in [(&plan, plan.duration_s()), (&halting, halting.duration_s())] {
                let dt_s = 0.01;
                let mut before = motion.motion(0.0);
                let mut time_s = 0.0;
                while time_s < end_s + dt_s {
                    time_s += dt_s;
                    let now = motion.motion(time_s);
                    for i in 0..JOINTS {
                        let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
                        prop_assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
                        prop_assert!(now.acceleration_rad_s2[i].abs() <= a * (1.0 + 1e-9));
                        let change = (now.velocity_rad_s[i] - before.velocity_rad_s[i]).abs();
                        prop_assert!(change <= a * dt_s * (1.0 + 1e-6) + 1e-9);
                        let step = (now.joints_rad[i] - before.joints_rad[i]).abs();
                        prop_assert!(step <= v * dt_s * (1.0 + 1e-6) + 1e-9);
                    }
                    before = now;
                }
                prop_assert_eq!(before.joints_rad, motion.goal_rad());
                prop_assert_eq!(before.velocity_rad_s, [0.0; JOINTS]);
            }
            prop_assert_eq!(plan.goal_rad(), *path.last().unwrap());
        }
    }
}
