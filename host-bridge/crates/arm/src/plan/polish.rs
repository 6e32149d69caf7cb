//! Moves the corners of a path so that the motion takes less time.
//!
//! Candidates are compared by an estimate of the time of their motion, which costs no check.
//! Only a quicker candidate is checked.

use crate::plan::collision::{Surroundings, between};
use host_robot::{JOINTS, JointLimits, Joints, Random};
use std::ops::Range;

/// Maximum number of candidates each time.
const TRIES_MAX: usize = 6000;
/// A candidate must be quicker by this share, because its check costs time.
const WORTH: f64 = 0.003;
/// In the middle of a blend, a new path keeps this much more distance, because only the finished path's blends are checked.
const ROOM_M: f64 = 0.01;
/// Greatest and least displacement of a joint.
const FAR_RAD: f64 = 1.0;
const NEAR_RAD: f64 = 0.01;

/// A path whose corners are being moved.
#[derive(Clone, Debug)]
pub struct Polish<'a> {
    around: &'a Surroundings<'a>,
    limits: &'a JointLimits,
    margin_m: f64,
    corners_max: usize,
    random: Random,
    path_rad: Vec<Joints>,
    time_s: f64,
    /// The change that was useful last. It is tried again.
    useful: Option<Shift>,
}

/// Displaces one corner.
#[derive(Clone, Copy, Debug)]
struct Shift {
    corner: usize,
    by_rad: Joints,
}

/// A changed path.
struct Candidate {
    path_rad: Vec<Joints>,
    /// The corners that are new.
    new: Range<usize>,
    /// The change, if it can be repeated.
    shift: Option<Shift>,
}

impl<'a> Polish<'a> {
    /// Begins with a clear path. New corners are added only up to `corners_max`.
    pub fn new(
        around: &'a Surroundings<'a>,
        path_rad: Vec<Joints>,
        limits: &'a JointLimits,
        margin_m: f64,
        seed: u64,
        corners_max: usize,
    ) -> Self {
        let time_s = estimated_s(&path_rad, limits);
        let random = Random::new(seed ^ 0x0090_1154);
        Polish { around, limits, margin_m, corners_max, random, path_rad, time_s, useful: None }
    }

    /// The changed path, which is as clear as the first one and has the same ends.
    pub fn into_path_rad(self) -> Vec<Joints> {
        self.path_rad
    }

    /// The estimated time of the path's motion without stops. It never rises.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Tries to save time with at most about this many checks. A motion of `good_s` is good enough.
    pub fn improve(&mut self, checks: u64, good_s: f64) {
        let stop_at = self.around.checks() + checks;
        for _ in 0..TRIES_MAX {
            let is_done = self.path_rad.len() < 3 || self.time_s <= good_s;
            if is_done || self.around.checks() >= stop_at || self.around.is_spent() {
                break;
            }
            let candidate = self.candidate();
            let time_s = estimated_s(&candidate.path_rad, self.limits);
            self.useful = None;
            if time_s <= (1.0 - WORTH) * self.time_s && self.is_clear(&candidate) {
                (self.path_rad, self.time_s, self.useful) = (candidate.path_rad, time_s, candidate.shift);
            }
        }
    }

    fn candidate(&mut self) -> Candidate {
        let (path, random) = (&self.path_rad, &mut self.random);
        let mut path_rad = path.clone();
        let shifted = |corner: usize, to_rad: Joints| {
            let by_rad = std::array::from_fn(|i| to_rad[i] - path[corner][i]);
            let mut path_rad = path.clone();
            path_rad[corner] = to_rad;
            Candidate { path_rad, new: corner..corner + 1, shift: Some(Shift { corner, by_rad }) }
        };
        if let Some(Shift { corner, by_rad }) = self.useful {
            return shifted(corner, std::array::from_fn(|i| path[corner][i] + by_rad[i]));
        }
        let corner = 1 + random.below(path.len() - 2);
        match random.below(16) {
            0 => {
                path_rad.remove(corner);
                Candidate { path_rad, new: corner..corner, shift: None }
            }
            1 if path.len() - 2 < self.corners_max => {
                // A new corner on one of the segments, somewhat displaced.
                let corner = 1 + random.below(path.len() - 1);
                let on = between(&path[corner - 1], &path[corner], random.between(0.1, 0.9));
                path_rad.insert(corner, displaced(&on, random));
                Candidate { path_rad, new: corner..corner + 1, shift: None }
            }
            2..=6 => {
                // Some joints nearer to the straight line between the neighbouring corners.
                let on = between(&path[corner - 1], &path[corner + 1], random.between(0.0, 1.0));
                let share = random.between(0.0, 1.0);
                let joints = random.bits();
                let pull =
                    |i: usize| if joints >> i & 1 == 1 { share * (on[i] - path[corner][i]) } else { 0.0 };
                shifted(corner, std::array::from_fn(|i| path[corner][i] + pull(i)))
            }
            7 | 8 if corner + 2 < path.len() => {
                // Two corners together.
                let moved = displaced(&path[corner], random);
                path_rad[corner + 1] =
                    std::array::from_fn(|i| path[corner + 1][i] + moved[i] - path[corner][i]);
                path_rad[corner] = moved;
                Candidate { path_rad, new: corner..corner + 2, shift: None }
            }
            _ => shifted(corner, displaced(&path[corner], random)),
        }
    }

    /// Only the segments at new corners are new.
    fn is_clear(&self, candidate: &Candidate) -> bool {
        let Candidate { path_rad, new, .. } = candidate;
        let within = |joints: &Joints| self.around.world().arm().check(joints).is_ok();
        let has_room = |corner: usize| {
            self.around
                .is_clear(&cut_rad(&path_rad[corner - 1..=corner + 1], self.limits), self.margin_m + ROOM_M)
        };
        path_rad[new.clone()].iter().all(within)
            && new.clone().all(has_room)
            && path_rad[new.start - 1..=new.end]
                .windows(2)
                .all(|two| self.around.way_is_clear(&two[0], &two[1], self.margin_m))
    }
}

/// The duration of a change of speed.
fn change_s(before: &Joints, after: &Joints, limits: &JointLimits) -> f64 {
    let of = |i: usize| (after[i] - before[i]).abs() / limits.acceleration_rad_s2[i];
    (0..JOINTS).map(of).fold(0.0, f64::max)
}

/// The time of a segment at the full speed of its slowest joint, and the speeds. Without a way, nothing moves.
fn segment(from: &Joints, to: &Joints, limits: &JointLimits) -> (f64, Joints) {
    let time_s = (0..JOINTS).map(|i| (to[i] - from[i]).abs() / limits.velocity_rad_s[i]).fold(0.0, f64::max);
    (time_s, if time_s > 0.0 { std::array::from_fn(|i| (to[i] - from[i]) / time_s) } else { [0.0; JOINTS] })
}

/// The middle of the blend at the second of three points, at full speed.
fn cut_rad(path_rad: &[Joints], limits: &JointLimits) -> Joints {
    let (_, before) = segment(&path_rad[0], &path_rad[1], limits);
    let (_, after) = segment(&path_rad[1], &path_rad[2], limits);
    let eighth_s = 0.125 * change_s(&before, &after, limits);
    std::array::from_fn(|i| path_rad[1][i] + eighth_s * (after[i] - before[i]))
}

/// Estimates the time of a motion through these corners without stops.
///
/// Each segment takes as long as its slowest joint at full speed, and the changes of speed at its ends are centred on the ends.
/// If they do not fit into the segment, a lower speed is assumed, with which they fit.
fn estimated_s(path: &[Joints], limits: &JointLimits) -> f64 {
    let rest = [0.0; JOINTS];
    // The previous segment's time, its speeds, and the change of speed at its start.
    let mut last = (0.0, rest, 0.0);
    let mut total_s = 0.0;
    let mut close = |last: (f64, Joints, f64), change_s: f64| {
        let (time_s, _, before_s) = last;
        let changes_s = 0.5 * (before_s + change_s);
        total_s += if changes_s > time_s { (time_s * changes_s).sqrt() } else { time_s };
    };
    let (mut first_s, mut last_s) = (None, 0.0);
    for two in path.windows(2) {
        let (time_s, speeds) = segment(&two[0], &two[1], limits);
        if time_s <= 0.0 {
            continue;
        }
        let change_s = change_s(&last.1, &speeds, limits);
        if first_s.is_some() {
            close(last, change_s);
        }
        first_s.get_or_insert(change_s);
        last = (time_s, speeds, change_s);
    }
    if first_s.is_some() {
        last_s = change_s(&last.1, &rest, limits);
        close(last, last_s);
    }
    // At both ends, the arm rests in half of the change of speed.
    total_s + 0.5 * (first_s.unwrap_or(0.0) + last_s)
}

/// Displaces some joints by a random distance of random size.
fn displaced(joints_rad: &Joints, random: &mut Random) -> Joints {
    let size = NEAR_RAD * (FAR_RAD / NEAR_RAD).powf(random.between(0.0, 1.0));
    let joints = random.bits();
    let mut moved = *joints_rad;
    for (i, joint) in moved.iter_mut().enumerate().take(JOINTS) {
        if joints >> i & 1 == 1 {
            *joint += size * random.between(-1.0, 1.0);
        }
    }
    moved
}
