//! Moves the corners of a path so that the motion takes less time.
//!
//! Candidates are compared by an estimate of the time of their motion, which costs no check.
//! Only a quicker candidate is checked.

use crate::plan::collision::{Surroundings, between};
use crate::plan::rrt::Search;
use host_robot::{JOINTS, JointLimits, Joints, Random};

/// Maximum number of candidates.
const TRIES_MAX: usize = 4000;
/// A candidate must be quicker by this share, because its check costs time.
const WORTH: f64 = 0.003;
/// A changed corner keeps this much more distance than the path, because the motion cuts it.
const ROOM_M: f64 = 0.01;
/// Greatest and least displacement of a joint.
const FAR_RAD: f64 = 1.0;
const NEAR_RAD: f64 = 0.01;

/// Returns a path between the same ends that is as clear, and whose motion without stops takes no more time.
pub fn polish(
    around: &Surroundings<'_>,
    path_rad: &[Joints],
    limits: &JointLimits,
    search: &Search,
    corners_max: usize,
) -> Vec<Joints> {
    let mut random = Random::new(search.seed ^ 0x0090_1154);
    let mut path = path_rad.to_vec();
    let time_s = |path: &[Joints]| estimated_s(path, limits);
    let mut best_s = time_s(&path);
    let stop_at = around.checks() + search.checks_max;
    for _ in 0..TRIES_MAX {
        if path.len() < 3 || around.checks() >= stop_at || around.is_spent() {
            break;
        }
        let mut corner = 1 + random.below(path.len() - 2);
        let mut candidate = path.clone();
        match random.below(8) {
            0 => {
                candidate.remove(corner);
            }
            1 if path.len() - 2 < corners_max => {
                // A new corner on one of the segments, somewhat displaced.
                corner = 1 + random.below(path.len() - 1);
                let on = between(&path[corner - 1], &path[corner], random.between(0.1, 0.9));
                candidate.insert(corner, displaced(&on, &mut random));
            }
            2..=4 => {
                // Some joints nearer to the straight line between the neighbouring corners.
                let on = between(&path[corner - 1], &path[corner + 1], random.between(0.0, 1.0));
                let share = random.between(0.0, 1.0);
                let joints = random.bits();
                candidate[corner] = std::array::from_fn(|i| {
                    let pull = if joints >> i & 1 == 1 { share } else { 0.0 };
                    path[corner][i] + pull * (on[i] - path[corner][i])
                });
            }
            _ => candidate[corner] = displaced(&path[corner], &mut random),
        }
        let candidate_s = time_s(&candidate);
        if candidate_s > (1.0 - WORTH) * best_s {
            continue;
        }
        // Only the segments at the changed corner are new.
        let last = (corner + 1).min(candidate.len() - 1);
        let is_clear = candidate[corner - 1..=last]
            .windows(2)
            .all(|two| around.way_is_clear(&two[0], &two[1], search.margin_m));
        let has_room = |joints: &Joints| around.arm_clearance(joints).distance_m >= search.margin_m + ROOM_M;
        let within = |joints: &Joints| around.world().arm().check(joints).is_ok();
        if is_clear && candidate[corner..last].iter().all(|joints| within(joints) && has_room(joints)) {
            (path, best_s) = (candidate, candidate_s);
        }
    }
    path
}

/// Estimates the time of a motion through these corners without stops.
///
/// Each segment takes as long as its slowest joint at full speed, and the changes of speed at its ends are centred on the ends.
/// If they do not fit into the segment, a lower speed is assumed, with which they fit.
fn estimated_s(path: &[Joints], limits: &JointLimits) -> f64 {
    let rest = [0.0; JOINTS];
    let change_s = |before: &Joints, after: &Joints| {
        let of = |i: usize| (after[i] - before[i]).abs() / limits.acceleration_rad_s2[i];
        (0..JOINTS).map(of).fold(0.0, f64::max)
    };
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
        let time_s =
            (0..JOINTS).map(|i| (two[1][i] - two[0][i]).abs() / limits.velocity_rad_s[i]).fold(0.0, f64::max);
        if time_s <= 0.0 {
            continue;
        }
        let speeds = std::array::from_fn(|i| (two[1][i] - two[0][i]) / time_s);
        let change_s = change_s(&last.1, &speeds);
        if first_s.is_some() {
            close(last, change_s);
        }
        first_s.get_or_insert(change_s);
        last = (time_s, speeds, change_s);
    }
    if first_s.is_some() {
        last_s = change_s(&last.1, &rest);
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
