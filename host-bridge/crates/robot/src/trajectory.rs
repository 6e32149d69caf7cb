//! Motion along several straight segments in joint space, with constant accelerations or constant jerks.
//!
//! Between two corners, the speed is constant. Around a corner, it changes to the speed of the next segment.
//! The change of speed is a parabolic blend (Kunz and Stilman 2011) and needs no stop.
//! Speeds within a blend lie between those of the two segments.
//! The slowest joint determines the blend's duration.
//! Position, speed and acceleration therefore respect their limits at every instant, not only at samples.
//! On a single segment, the slowest joint determines v = min(vᵢ/|Δqᵢ|) and a = min(aᵢ/|Δqᵢ|).
//! The duration is 1/v + v/a, or 2/√a if v² > a, as in MoveIt's time-optimal profile.
//!
//! With a jerk limit, the acceleration of each change of speed rises, stays constant and falls, equally for all joints.
//! Such a ramp covers the same distance as a uniform change of the same duration.
//! Blends therefore remain centred on their corners, and all statements above hold.
//! On one segment, the result is the S-curve of seven phases, which is optimal (Biagiotti and Melchiorri 2008, 3.4).

use crate::{JOINTS, JointLimits, Joints, Motion};

/// A part with constant jerk (which may be zero).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    start_s: f64,
    duration_s: f64,
    from: Motion,
    jerk_rad_s3: Joints,
}

impl Piece {
    /// The arm moves, and no joint changes its speed.
    fn is_even(&self) -> bool {
        let is_zero = |of: &Joints| of.iter().all(|x| *x == 0.0);
        is_zero(&self.from.acceleration_rad_s2)
            && is_zero(&self.jerk_rad_s3)
            && !is_zero(&self.from.velocity_rad_s)
    }

    /// Returns the same path at a fraction of the speed.
    fn at_pace(&self, share: f64, start_s: f64) -> Self {
        Piece {
            start_s,
            duration_s: self.duration_s / share,
            from: Motion {
                joints_rad: self.from.joints_rad,
                velocity_rad_s: scaled(&self.from.velocity_rad_s, share),
                acceleration_rad_s2: scaled(&self.from.acceleration_rad_s2, share * share),
            },
            jerk_rad_s3: scaled(&self.jerk_rad_s3, share * share * share),
        }
    }

    /// Returns the motion at `time_s` after the piece's start.
    fn at(&self, time_s: f64) -> Motion {
        let t = time_s.clamp(0.0, self.duration_s);
        let (from, jerk) = (&self.from, &self.jerk_rad_s3);
        let even =
            plus(&plus(&from.joints_rad, &from.velocity_rad_s, t), &from.acceleration_rad_s2, 0.5 * t * t);
        Motion {
            joints_rad: plus(&even, jerk, t * t * t / 6.0),
            velocity_rad_s: plus(
                &plus(&from.velocity_rad_s, &from.acceleration_rad_s2, t),
                jerk,
                0.5 * t * t,
            ),
            acceleration_rad_s2: plus(&from.acceleration_rad_s2, jerk, t),
        }
    }
}

/// The times of a motion after its speed was changed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeMap {
    at_s: f64,
    /// The unchanged motion needs this time for the way on which the ramp takes `ramp_s`.
    covered_s: f64,
    ramp_s: f64,
    factor: f64,
}

impl TimeMap {
    /// Returns the time of an instant that the unchanged motion reaches at `then_s`.
    /// Instants within the ramp are not mapped exactly.
    pub fn now_s(&self, then_s: f64) -> f64 {
        if then_s <= self.at_s {
            return then_s;
        }
        self.at_s + self.ramp_s + (then_s - self.at_s - self.covered_s) / self.factor
    }
}

/// A motion with a changed speed, and its times.
#[derive(Clone, Debug, PartialEq)]
pub struct Paced {
    /// The motion.
    pub trajectory: Trajectory,
    /// Its times.
    pub map: TimeMap,
}

/// A motion that ends at rest. The motion starts at rest, or (while braking) at speed.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    pieces: Vec<Piece>,
    /// Start and end of each blend.
    corners_s: Vec<(f64, f64)>,
    /// The exact end position.
    to_rad: Joints,
    duration_s: f64,
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

/// Returns the largest value relative to the joints' limits.
fn most(of: &Joints, limits: &Joints) -> f64 {
    (0..JOINTS).map(|i| of[i].abs() / limits[i]).fold(0.0, f64::max)
}

/// A change of speed whose acceleration rises, stays constant, and falls, symmetrically in time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ramp {
    duration_s: f64,
    /// Duration of the rise and of the fall; 0 if the acceleration jumps.
    rise_s: f64,
}

/// Returns the quickest change of speed that is equal for all joints.
fn ramp(change_rad_s: &Joints, limits: &JointLimits) -> Ramp {
    let even_s = most(change_rad_s, &limits.acceleration_rad_s2);
    let jerk_s2 = most(change_rad_s, &limits.jerk_rad_s3);
    if jerk_s2 == 0.0 {
        Ramp { duration_s: even_s, rise_s: 0.0 }
    } else if even_s * even_s >= jerk_s2 {
        Ramp { duration_s: even_s + jerk_s2 / even_s, rise_s: jerk_s2 / even_s }
    } else {
        // The maximum acceleration is not reached.
        Ramp { duration_s: 2.0 * jerk_s2.sqrt(), rise_s: jerk_s2.sqrt() }
    }
}

impl Trajectory {
    /// Creates a trajectory on which nothing moves.
    pub fn at_rest(to_rad: Joints) -> Self {
        Trajectory { pieces: Vec::new(), corners_s: Vec::new(), to_rad, duration_s: 0.0 }
    }

    /// Creates a trajectory through all points of a path.
    /// The arm stops at the corners that `stops` selects, and slightly cuts the others.
    /// The first entry of `stops` is for the first corner after the start.
    pub fn through(path_rad: &[Joints], stops: &[bool], limits: &JointLimits) -> Self {
        let mut trajectory = Trajectory::at_rest(path_rad.last().copied().unwrap_or_default());
        let mut start = 0;
        for end in 1..path_rad.len() {
            if end + 1 == path_rad.len() || stops.get(end - 1).copied().unwrap_or(false) {
                trajectory.append_blended(&path_rad[start..=end], limits);
                start = end;
            }
        }
        trajectory
    }

    /// Appends a motion that starts at the end of this one.
    #[must_use]
    pub fn then(mut self, next: &Trajectory) -> Self {
        let after_s = self.duration_s;
        self.pieces.extend(next.pieces.iter().map(|p| Piece { start_s: p.start_s + after_s, ..*p }));
        self.corners_s.extend(next.corners_s.iter().map(|(start, end)| (start + after_s, end + after_s)));
        Trajectory { to_rad: next.to_rad, duration_s: after_s + next.duration_s, ..self }
    }

    /// Returns this motion up to `at_s`.
    /// From then on, the arm changes to the given acceleration within `for_s` seconds.
    /// The jerk is constant (or unlimited). Finally, the arm brakes.
    /// Parts that end over `keep_s` before `at_s` are removed.
    #[must_use]
    pub fn continued(
        &self,
        at_s: f64,
        acceleration_rad_s2: &Joints,
        for_s: f64,
        limits: &JointLimits,
        keep_s: f64,
    ) -> Self {
        let mut from = self.motion(at_s);
        let mut next = Trajectory::at_rest(from.joints_rad);
        let is_kept =
            |piece: &&Piece| piece.start_s < at_s && piece.start_s + piece.duration_s > at_s - keep_s;
        next.pieces = self.pieces.iter().filter(is_kept).copied().collect();
        if let Some(last) = next.pieces.last_mut() {
            last.duration_s = last.duration_s.min(at_s - last.start_s);
        }
        next.duration_s = at_s.min(self.duration_s);
        // The arm may have been at rest for a while by then.
        next.push(Motion::at_rest(self.to_rad), [0.0; JOINTS], at_s - next.duration_s);
        next.duration_s = at_s;
        let change = minus(acceleration_rad_s2, &from.acceleration_rad_s2);
        let jerk_rad_s3 = if limits.jerk_rad_s3.iter().all(|jerk| jerk.is_finite()) {
            scaled(&change, 1.0 / for_s)
        } else {
            from.acceleration_rad_s2 = *acceleration_rad_s2;
            [0.0; JOINTS]
        };
        let here = next.push(from, jerk_rad_s3, for_s);
        next.then(&Trajectory::braking(here, limits))
    }

    /// Returns the same path at a fraction of the speed.
    /// Accelerations scale with the square of the fraction, so a fraction of at most 1 keeps all limits.
    #[must_use]
    pub fn at_pace(&self, share: f64) -> Self {
        let pieces = self.pieces.iter().map(|piece| piece.at_pace(share, piece.start_s / share)).collect();
        let corners_s =
            self.corners_s.iter().map(|(start_s, end_s)| (start_s / share, end_s / share)).collect();
        Trajectory { pieces, corners_s, to_rad: self.to_rad, duration_s: self.duration_s / share }
    }

    /// Changes the speed by this factor from `at_s` on, on the same path, as quickly as the limits allow.
    ///
    /// The change is a further ramp, and everything after it is scaled as in [`Trajectory::at_pace`].
    /// The result is `None` if the speed is not constant at `at_s`, or not for long enough.
    pub fn paced(&self, at_s: f64, factor: f64, limits: &JointLimits) -> Option<Paced> {
        let k = self.pieces.iter().position(|piece| {
            at_s >= piece.start_s && at_s < piece.start_s + piece.duration_s && piece.is_even()
        })?;
        let even = &self.pieces[k];
        let before = even.from.velocity_rad_s;
        let after = scaled(&before, factor);
        let ramp = ramp(&minus(&after, &before), limits);
        let covered_s = 0.5 * (1.0 + factor) * ramp.duration_s;
        let left_s = even.start_s + even.duration_s - at_s - covered_s;
        if !(factor > 0.0 && left_s > 0.0) {
            return None;
        }
        let here = even.at(at_s - even.start_s);
        let mut next = Trajectory::at_rest(self.to_rad);
        next.pieces = self.pieces[..k].to_vec();
        next.pieces.push(Piece { duration_s: at_s - even.start_s, ..*even });
        next.duration_s = at_s;
        next.push_change(here.joints_rad, &before, &after, ramp);
        let map = TimeMap { at_s, covered_s, ramp_s: ramp.duration_s, factor };
        let from = even.at(at_s - even.start_s + covered_s);
        let rest = Piece { start_s: 0.0, duration_s: left_s, from, ..*even };
        next.pieces.push(rest.at_pace(factor, next.duration_s));
        next.pieces.extend(self.pieces[k + 1..].iter().map(|p| p.at_pace(factor, map.now_s(p.start_s))));
        next.corners_s = self.corners_s.iter().map(|&(a, b)| (map.now_s(a), map.now_s(b))).collect();
        next.duration_s = map.now_s(self.duration_s);
        Some(Paced { trajectory: next, map })
    }

    /// Brakes from motion as fast as the limits allow, with all joints together, in a straight line.
    ///
    /// With a jerk limit, the current acceleration must first be reduced.
    /// On a straight segment, the change takes the minimum time.
    /// Within a blend, speed and acceleration have different directions.
    /// There, the acceleration of all joints is reduced to zero before braking begins.
    pub fn braking(from: Motion, limits: &JointLimits) -> Self {
        let mut trajectory = Trajectory::at_rest(from.joints_rad);
        let release_s = most(&from.acceleration_rad_s2, &limits.jerk_rad_s3);
        if release_s > 0.0 && trajectory.brake_on_the_line(from, limits) {
            return trajectory;
        }
        let mut here = from;
        if release_s > 0.0 {
            here = trajectory.push(here, scaled(&from.acceleration_rad_s2, -1.0 / release_s), release_s);
        }
        let ramp = ramp(&here.velocity_rad_s, limits);
        trajectory.to_rad = plus(&here.joints_rad, &here.velocity_rad_s, 0.5 * ramp.duration_s);
        trajectory.push_change(here.joints_rad, &here.velocity_rad_s, &[0.0; JOINTS], ramp);
        trajectory
    }

    /// Brakes in minimum time if the acceleration is parallel to the motion.
    /// Otherwise, the function returns false and changes nothing.
    fn brake_on_the_line(&mut self, from: Motion, limits: &JointLimits) -> bool {
        let (speed, acceleration) = (&from.velocity_rad_s, &from.acceleration_rad_s2);
        let dot = |a: &Joints, b: &Joints| -> f64 { (0..JOINTS).map(|i| a[i] * b[i]).sum() };
        // All values are relative to the current speed: speed 1, acceleration `gain`, limits `most_gain` and `jerk`.
        let gain = dot(acceleration, speed) / dot(speed, speed);
        let off = minus(acceleration, &scaled(speed, gain));
        if !gain.is_finite() || most(&off, &limits.acceleration_rad_s2) > 1e-9 {
            return false;
        }
        let most_gain = 1.0 / most(speed, &limits.acceleration_rad_s2);
        let jerk = 1.0 / most(speed, &limits.jerk_rad_s3);
        // The speed changes by this amount while the acceleration returns to zero.
        let released = 0.5 * gain * gain / jerk;
        if gain < 0.0 && released > 1.0 - 1e-9 {
            // This case is the end of a ramp to rest. If the loss exceeded the speed, the joints would reverse.
            if released < 1.0 + 1e-6 {
                let duration_s = -2.0 / gain;
                self.to_rad = self.push(from, scaled(acceleration, -1.0 / duration_s), duration_s).joints_rad;
            }
            return released < 1.0 + 1e-6;
        }
        let least = (jerk + 0.5 * gain * gain).sqrt().min(most_gain).max(-gain);
        let hold_s = (1.0 + released - least * least / jerk) / least;
        let here = self.push(from, scaled(speed, -jerk), (gain + least) / jerk);
        let here = Motion { acceleration_rad_s2: scaled(speed, -least), ..here };
        let here = self.push(here, [0.0; JOINTS], hold_s);
        self.to_rad = self.push(here, scaled(speed, jerk), least / jerk).joints_rad;
        true
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
        let blends = blends(&velocities, limits);
        let rest = [0.0; JOINTS];
        for (k, point) in points.iter().enumerate() {
            let before = if k == 0 { &rest } else { &velocities[k - 1] };
            let after = velocities.get(k).unwrap_or(&rest);
            let blend_s = blends[k].duration_s;
            if blend_s > 0.0 {
                // A blend is centred on its corner.
                // At the start and at the end, one of the two speeds is zero.
                // The arm therefore rests in that half of the blend.
                // The motion takes longer by this time.
                let start_s = self.duration_s;
                self.push_change(plus(point, before, -0.5 * blend_s), before, after, blends[k]);
                if k > 0 && k < ways.len() {
                    self.corners_s.push((start_s, self.duration_s));
                }
            }
            if let Some(speed) = speeds.get(k) {
                let cruise_s = 1.0 / speed - 0.5 * (blend_s + blends[k + 1].duration_s);
                let joints_rad = plus(point, after, 0.5 * blend_s);
                self.push(Motion { velocity_rad_s: *after, ..Motion::at_rest(joints_rad) }, rest, cruise_s);
            }
        }
    }

    /// Appends a change from one speed to another.
    fn push_change(&mut self, from_rad: Joints, before: &Joints, after: &Joints, ramp: Ramp) {
        let Ramp { duration_s, rise_s } = ramp;
        if duration_s <= 0.0 {
            return;
        }
        let greatest = scaled(&minus(after, before), 1.0 / (duration_s - rise_s));
        let mut here = Motion { velocity_rad_s: *before, ..Motion::at_rest(from_rad) };
        if rise_s > 0.0 {
            here = self.push(here, scaled(&greatest, 1.0 / rise_s), rise_s);
        }
        here.acceleration_rad_s2 = greatest;
        here = self.push(here, [0.0; JOINTS], duration_s - 2.0 * rise_s);
        if rise_s > 0.0 {
            self.push(here, scaled(&greatest, -1.0 / rise_s), rise_s);
        }
    }

    /// Appends a piece and returns the state at its end.
    fn push(&mut self, from: Motion, jerk_rad_s3: Joints, duration_s: f64) -> Motion {
        if duration_s <= 0.0 {
            return from;
        }
        let piece = Piece { start_s: self.duration_s, duration_s, from, jerk_rad_s3 };
        self.pieces.push(piece);
        self.duration_s += duration_s;
        piece.at(duration_s)
    }

    /// Returns the time until rest in s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Where it ends.
    pub fn goal_rad(&self) -> Joints {
        self.to_rad
    }

    /// Returns the motion at `time_s` after the start. After the end, the arm rests at the goal.
    pub fn motion(&self, time_s: f64) -> Motion {
        let next = self.pieces.partition_point(|piece| piece.start_s <= time_s);
        match self.pieces.get(next.saturating_sub(1)) {
            Some(piece) if time_s < self.duration_s => piece.at(time_s - piece.start_s),
            _ => Motion::at_rest(self.to_rad),
        }
    }

    /// Returns the maximum speed of each joint between two instants, in either direction.
    pub fn fastest_rad_s(&self, start_s: f64, end_s: f64) -> Joints {
        let mut fastest = [0.0_f64; JOINTS];
        for piece in &self.pieces {
            let (start, end) = (start_s - piece.start_s, end_s - piece.start_s);
            if start > piece.duration_s || end < 0.0 {
                continue;
            }
            let (first, last) = (piece.at(start), piece.at(end));
            for (i, fastest) in fastest.iter_mut().enumerate() {
                let mut speed = first.velocity_rad_s[i].abs().max(last.velocity_rad_s[i].abs());
                let jerk = piece.jerk_rad_s3[i];
                if first.acceleration_rad_s2[i] * last.acceleration_rad_s2[i] < 0.0 {
                    // At the extremum, the acceleration is zero; the change from the first instant is a²/2j.
                    let a = first.acceleration_rad_s2[i];
                    speed = speed.max((first.velocity_rad_s[i] - 0.5 * a * a / jerk).abs());
                }
                *fastest = fastest.max(speed);
            }
        }
        fastest
    }

    /// Returns the times at which jerk or acceleration changes, and the end.
    pub fn knots_s(&self) -> Vec<f64> {
        let starts = self.pieces.iter().map(|piece| piece.start_s).filter(|&start_s| start_s > 0.0);
        starts.chain([self.duration_s]).collect()
    }

    /// Returns start and end of each time interval in which the arm leaves the straight segments.
    pub fn corners_s(&self) -> Vec<(f64, f64)> {
        self.corners_s.clone()
    }
}

fn blends(velocities: &[Joints], limits: &JointLimits) -> Vec<Ramp> {
    let rest = [0.0; JOINTS];
    (0..=velocities.len())
        .map(|k| {
            let before = if k == 0 { &rest } else { &velocities[k - 1] };
            ramp(&minus(velocities.get(k).unwrap_or(&rest), before), limits)
        })
        .collect()
}

/// Returns the maximum speeds, in segments per second, that respect the limits of joints and blends.
fn fastest_speeds(ways: &[Joints], limits: &JointLimits) -> Vec<f64> {
    let top: Vec<f64> = ways.iter().map(|way| 1.0 / most(way, &limits.velocity_rad_s)).collect();
    // Blends must not overlap.
    let fits = |speeds: &[f64]| {
        let velocities: Vec<Joints> = ways.iter().zip(speeds).map(|(way, s)| scaled(way, *s)).collect();
        let blends = blends(&velocities, limits);
        speeds
            .iter()
            .zip(blends.windows(2))
            .all(|(s, b)| 1.0 / s >= 0.5 * (b[0].duration_s + b[1].duration_s))
    };
    if fits(&top) {
        return top;
    }
    if let [way] = ways {
        // A single segment may be too short for full speed, so it has one ramp up and one ramp down.
        // The speed is slightly reduced, so that rounded ramps are not longer than the segment.
        return vec![top_of_two_ramps(way, limits) * (1.0 - 1e-12)];
    }
    // All speeds are reduced until the blends fit. Then each speed is increased as much as the others allow.
    let slowed = |factor: f64| top.iter().map(|s| s * factor).collect::<Vec<_>>();
    let mut speeds = slowed(bisect(|factor| fits(&slowed(factor))));
    for _ in 0..4 {
        for k in 0..speeds.len() {
            let now = speeds[k];
            let with = |share: f64| {
                let mut tried = speeds.clone();
                tried[k] = now + share * (top[k] - now);
                tried
            };
            let share = if fits(&with(1.0)) { 1.0 } else { bisect(|share| fits(&with(share))) };
            speeds = with(share);
        }
    }
    speeds
}

/// Returns the speed, in segments per second, at which a ramp up and a ramp down fill the segment.
/// At this speed, the ramp's time equals the reciprocal of the speed.
fn top_of_two_ramps(way: &Joints, limits: &JointLimits) -> f64 {
    let acceleration = most(way, &limits.acceleration_rad_s2);
    let jerk = most(way, &limits.jerk_rad_s3);
    let rise_s = jerk / acceleration;
    let speed = 2.0 / (rise_s + (rise_s * rise_s + 4.0 * acceleration).sqrt());
    if speed * acceleration * acceleration >= jerk { speed } else { (0.25 / jerk).cbrt() }
}

/// Returns the largest fraction that fits; 0 always fits.
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
    use crate::gen3::{HOME, paper_limits};
    use proptest::prelude::*;

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform8(-2.0..2.0_f64)
    }

    #[test]
    #[allow(clippy::approx_constant)] // Kinova's file has 3.14, too.
    fn kinovas_own_poses_take_the_times_of_moveit() {
        // These figures are from MoveIt's time parameterisation at scaling 0.1 and 0.05.
        let limits = paper_limits();
        let retract = crate::joints([0.0, -0.35, 3.14, -2.54, 0.0, -0.87, 1.57]);
        let up = Trajectory::through(&[[0.0; JOINTS], HOME], &[], &limits).duration_s();
        let back = Trajectory::through(&[HOME, retract], &[], &limits).duration_s();
        assert!((up - 22.81).abs() < 0.01, "{up}");
        assert!((back - 15.26).abs() < 0.01, "{back}");
    }

    #[test]
    fn a_short_move_never_reaches_full_speed() {
        let mut to = HOME;
        to[0] += 0.01;
        let duration = Trajectory::through(&[HOME, to], &[], &paper_limits()).duration_s();
        assert!((duration - 2.0 * (0.01_f64 / 0.43).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn equal_ends_take_no_time() {
        let limits = paper_limits();
        let still = Trajectory::through(&[HOME, HOME], &[], &limits);
        assert_eq!((still.duration_s(), still.motion(1.0).joints_rad), (0.0, HOME));
        let braked = Trajectory::braking(still.motion(0.0), &limits);
        assert_eq!((braked.duration_s(), braked.goal_rad()), (0.0, HOME));
    }

    /// Checks that all joints have the same progress at any time.
    /// No joint may move back by more than `slack`.
    fn keeps_to_the_line(
        motion: &Trajectory,
        duration_s: f64,
        (from, to): (&Joints, &Joints),
        slack: f64,
    ) -> Result<(), TestCaseError> {
        // A joint that stays where it is has no progress of its own, so the one that moves furthest is the measure.
        let way = |i: usize| to[i] - from[i];
        let furthest = (0..JOINTS).max_by(|&a, &b| way(a).abs().total_cmp(&way(b).abs())).unwrap_or(0);
        prop_assume!(way(furthest) != 0.0);
        let mut gone = 0.0;
        for k in 0..=50 {
            let now = motion.motion(f64::from(k) / 50.0 * duration_s);
            let share = (now.joints_rad[furthest] - from[furthest]) / way(furthest);
            for (i, joint_rad) in now.joints_rad.iter().enumerate() {
                prop_assert!((joint_rad - from[i] - share * way(i)).abs() < 1e-9);
            }
            prop_assert!(share >= gone - slack && share <= 1.0 + slack, "never turns back");
            gone = share;
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn one_way_takes_as_long_as_the_formula_says_and_keeps_to_the_line(
            from in joints(), to in joints(), share in 0.001..1.0_f64,
        ) {
            let limits = paper_limits();
            let way = scaled(&minus(&to, &from), share);
            let to = plus(&from, &way, 1.0);
            let least = |limit: &Joints| {
                (0..JOINTS).map(|i| limit[i] / way[i].abs()).fold(f64::INFINITY, f64::min)
            };
            let (v, a) = (least(&limits.velocity_rad_s), least(&limits.acceleration_rad_s2));
            let expected_s = if v * v > a { 2.0 / a.sqrt() } else { 1.0 / v + v / a };
            let motion = Trajectory::through(&[from, to], &[], &limits);
            prop_assert!((motion.duration_s() - expected_s).abs() < 1e-9);
            keeps_to_the_line(&motion, expected_s, (&from, &to), 1e-12)?;
            prop_assert_eq!(motion.motion(motion.duration_s()).joints_rad, to);
        }

        #[test]
        fn one_way_with_limited_jerk_is_the_textbooks_s_curve(
            from in joints(), to in joints(), share in 0.0001..1.0_f64, jerk in 0.5..500.0_f64,
            scaling in 0.02..1.0_f64,
        ) {
            let mut limits = paper_limits().with_jerk(jerk);
            limits.acceleration_rad_s2 = scaled(&limits.acceleration_rad_s2, scaling / 0.05);
            let way = scaled(&minus(&to, &from), share);
            let to = plus(&from, &way, 1.0);
            let least = |limit: &Joints| {
                (0..JOINTS).map(|i| limit[i] / way[i].abs()).fold(f64::INFINITY, f64::min)
            };
            let (v, a, j) =
                (least(&limits.velocity_rad_s), least(&limits.acceleration_rad_s2), least(&limits.jerk_rad_s3));
            // The values are from Biagiotti and Melchiorri 2008, section 3.4.
            // The motion covers a distance of 1 from rest to rest.
            let ramp_s = if v * j < a * a { 2.0 * (v / j).sqrt() } else { a / j + v / a };
            let expected_s = if 1.0 / v >= ramp_s {
                1.0 / v + ramp_s
            } else if 1.0 >= 2.0 * a.powi(3) / (j * j) {
                2.0 * (0.5 * a / j + (0.25 * (a / j).powi(2) + 1.0 / a).sqrt())
            } else {
                4.0 * (0.5 / j).cbrt()
            };
            let motion = Trajectory::through(&[from, to], &[], &limits);
            prop_assert!((motion.duration_s() - expected_s).abs() < 1e-9 * expected_s, "{} {expected_s}", motion.duration_s());
            let even = Trajectory::through(&[from, to], &[], &limits.with_jerk(f64::INFINITY));
            prop_assert!(even.duration_s() <= motion.duration_s() + 1e-9);
            keeps_to_the_line(&motion, expected_s, (&from, &to), 1e-9)?;
            prop_assert_eq!(motion.motion(motion.duration_s()), Motion::at_rest(to));
        }

        #[test]
        fn limits_hold_at_every_sample_and_while_braking(
            path in prop::collection::vec(joints(), 2..7), short in 0.01..1.0_f64,
            stops in prop::array::uniform5(any::<bool>()), when in 0.0..1.0_f64,
            jerk in prop_oneof![Just(f64::INFINITY), 0.5..100.0_f64],
        ) {
            let limits = paper_limits().with_jerk(jerk);
            let path: Vec<Joints> = path.iter().map(|joints| scaled(joints, short)).collect();
            let plan = Trajectory::through(&path, &stops, &limits);
            let stopping = Trajectory::through(&path, &[true; 5], &limits);
            prop_assert!(plan.duration_s().is_finite() && stopping.duration_s() > 0.0);
            let halt_s = when * plan.duration_s();
            let halted = plan.motion(halt_s);
            let halting = Trajectory::braking(halted, &limits);
            // This bound covers two reductions and two build-ups of an acceleration.
            // It also covers the braking in between.
            let rise_s = 0.43 / jerk;
            let even_s = 0.1397 / 0.43;
            prop_assert!(halting.duration_s() <= (even_s + 3.0 * rise_s).max(2.0 * (0.15 / jerk).sqrt() + 3.0 * rise_s));
            prop_assert!((0..JOINTS).all(|i| (halting.motion(0.0).joints_rad[i] - halted.joints_rad[i]).abs() < 1e-12));
            for (motion, end_s) in [(&plan, plan.duration_s()), (&halting, halting.duration_s())] {
                let dt_s = 0.01;
                let fastest = motion.fastest_rad_s(0.0, end_s);
                let mut before = motion.motion(0.0);
                let mut time_s = 0.0;
                while time_s < end_s + dt_s {
                    time_s += dt_s;
                    let now = motion.motion(time_s);
                    for i in 0..JOINTS {
                        let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
                        prop_assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
                        prop_assert!(now.acceleration_rad_s2[i].abs() <= a * (1.0 + 1e-6));
                        let change = (now.acceleration_rad_s2[i] - before.acceleration_rad_s2[i]).abs();
                        prop_assert!(change <= jerk * dt_s * (1.0 + 1e-5) + 1e-9, "{change} {jerk}");
                        let change = (now.velocity_rad_s[i] - before.velocity_rad_s[i]).abs();
                        prop_assert!(change <= a * dt_s * (1.0 + 1e-6) + 1e-9);
                        let step = (now.joints_rad[i] - before.joints_rad[i]).abs();
                        prop_assert!(step <= v * dt_s * (1.0 + 1e-6) + 1e-9);
                    }
                    let slower = now.velocity_rad_s.iter().zip(fastest).all(|(v, most)| v.abs() <= most + 1e-12);
                    prop_assert!(slower, "{now:?} {fastest:?}");
                    before = now;
                }
                prop_assert_eq!(before, Motion::at_rest(motion.goal_rad()));
            }
            prop_assert_eq!(plan.goal_rad(), *path.last().unwrap());
        }

        #[test]
        fn braking_on_a_straight_way_stays_on_it_and_stops_before_its_end(
            from in joints(), to in joints(), when in 0.0..1.0_f64, jerk in 0.5..100.0_f64,
        ) {
            let limits = paper_limits().with_jerk(jerk);
            let plan = Trajectory::through(&[from, to], &[], &limits);
            let halt_s = when * plan.duration_s();
            let halting = Trajectory::braking(plan.motion(halt_s), &limits);
            prop_assert!(halting.duration_s() <= plan.duration_s() - halt_s + 1e-6, "nothing stops quicker");
            for k in 0..=20 {
                let now = halting.motion(f64::from(k) / 20.0 * halting.duration_s());
                let shares: Joints =
                    std::array::from_fn(|i| (now.joints_rad[i] - from[i]) / (to[i] - from[i]));
                for i in 0..JOINTS {
                    prop_assert!((shares[i] - shares[0]).abs() * (to[i] - from[i]).abs() < 1e-7);
                }
                prop_assert!(shares[0] <= 1.0 + 1e-7);
            }
        }

        #[test]
        fn a_change_of_pace_keeps_the_path_the_limits_and_the_end_and_nothing_jumps(
            path in prop::collection::vec(joints(), 2..6), short in 0.05..1.0_f64,
            changes in prop::collection::vec((0.0..1.0_f64, 0.1..1.0_f64), 1..6),
            stops in prop::array::uniform5(any::<bool>()),
            jerk in prop_oneof![Just(f64::INFINITY), 0.5..100.0_f64],
        ) {
            let limits = paper_limits().with_jerk(jerk);
            let path: Vec<Joints> = path.iter().map(|joints| scaled(joints, short)).collect();
            let plan = Trajectory::through(&path, &stops, &limits);
            let (mut now, mut pace, mut from_s) = (plan.clone(), 1.0, 0.0);
            for (when, wanted) in changes {
                let at_s = from_s + when * (now.duration_s() - from_s);
                let Some(Paced { trajectory, map }) = now.paced(at_s, wanted / pace, &limits) else { continue };
                for k in 0..=20 {
                    let same_s = at_s * f64::from(k) / 20.0;
                    let off = minus(&trajectory.motion(same_s).joints_rad, &now.motion(same_s).joints_rad);
                    prop_assert!(most(&off, &[1.0; JOINTS]) < 1e-12, "until then it is the same");
                    let late_s = map.now_s(now.duration_s()) - map.now_s(at_s + map.covered_s);
                    let then_s = at_s + map.covered_s
                        + (now.duration_s() - at_s - map.covered_s) * f64::from(k) / 20.0;
                    prop_assert!(late_s > 0.0);
                    let here = trajectory.motion(map.now_s(then_s)).joints_rad;
                    prop_assert!(most(&minus(&here, &now.motion(then_s).joints_rad), &[1.0; JOINTS]) < 1e-9);
                }
                (now, pace, from_s) = (trajectory, wanted, at_s);
            }
            prop_assert_eq!(now.goal_rad(), plan.goal_rad());
            prop_assert_eq!(now.motion(now.duration_s()), Motion::at_rest(plan.goal_rad()));
            let dt_s = 0.01;
            let mut before = now.motion(0.0);
            let mut time_s = 0.0;
            while time_s < now.duration_s() + dt_s {
                time_s += dt_s;
                let here = now.motion(time_s);
                for i in 0..JOINTS {
                    let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
                    prop_assert!(here.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
                    prop_assert!(here.acceleration_rad_s2[i].abs() <= a * (1.0 + 1e-6));
                    let change = (here.acceleration_rad_s2[i] - before.acceleration_rad_s2[i]).abs();
                    prop_assert!(change <= jerk * dt_s * (1.0 + 1e-5) + 1e-9, "{change} {jerk}");
                    let change = (here.velocity_rad_s[i] - before.velocity_rad_s[i]).abs();
                    prop_assert!(change <= a * dt_s * (1.0 + 1e-6) + 1e-9);
                    let step = (here.joints_rad[i] - before.joints_rad[i]).abs();
                    prop_assert!(step <= v * dt_s * (1.0 + 1e-6) + 1e-9);
                }
                before = here;
            }
        }
    }

    #[test]
    fn at_half_pace_a_motion_takes_twice_as_long_and_a_change_waits_for_an_even_stretch() {
        let limits = paper_limits();
        let mut to = HOME;
        to[0] += 0.8;
        let plan = Trajectory::through(&[HOME, to], &[], &limits);
        let half = plan.at_pace(0.5);
        assert!((half.duration_s() - 2.0 * plan.duration_s()).abs() < 1e-12);
        assert_eq!(half.motion(4.0).joints_rad, plan.motion(2.0).joints_rad);
        assert_eq!(half.motion(4.0).velocity_rad_s[0], 0.5 * plan.motion(2.0).velocity_rad_s[0]);
        // The arm speeds up for 0.325 s, and slows down for as long.
        for at_s in [0.1, 0.3, plan.duration_s() - 0.1, plan.duration_s() + 1.0] {
            assert_eq!(plan.paced(at_s, 0.9, &limits), None, "{at_s}");
        }
        let Paced { trajectory, .. } = plan.paced(2.0, 0.5, &limits).unwrap();
        // Half of 0.1396 rad/s is lost at 0.43 rad/s², in 0.162 s.
        assert!((trajectory.motion(2.17).velocity_rad_s[0] - 0.5 * 0.13963).abs() < 1e-9);
        let left_s = plan.duration_s() - 2.0 - 0.75 * 0.13963 / 0.86;
        assert!((trajectory.duration_s() - (2.0 + 0.13963 / 0.86 + 2.0 * left_s)).abs() < 1e-9);
    }
}
