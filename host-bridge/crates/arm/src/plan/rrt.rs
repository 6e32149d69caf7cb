//! RRT-Connect (Kuffner and LaValle 2000) grows two trees, one from each end of the path.
//! The trees grow towards random configurations and towards each other until they meet.
//! Then shortcuts follow.

use crate::plan::collision::{Surroundings, between};
use host_robot::Random;
use host_robot::{JOINTS, Joints};

/// Maximum distance that a step of a tree sweeps.
const STEP_M: f64 = 0.35;

/// Finding the nearest of so many nodes takes about as long as a check.
/// Without this cost, a search that finds no path would spend most of its time in its own trees.
const NODES_PER_CHECK: usize = 256;

/// Number of attempted shortcuts between two random points of the path.
const SHORTCUT_TRIES: usize = 40;

/// Search range of continuous joints beyond both ends of the path.
const BEYOND_RAD: f64 = 2.0;

/// Settings of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// Distance to keep.
    pub margin_m: f64,
    /// Maximum number of checks.
    pub checks_max: u64,
    /// Equal seeds give equal paths.
    pub seed: u64,
}

/// A tree of configurations, each with the index of its parent.
struct Tree(Vec<(Joints, usize)>);

enum Grown {
    Trapped,
    Advanced(usize),
    Reached(usize),
}

/// Returns a path between two clear configurations, including both; `None` if none was found within the budget.
pub fn connect(
    around: &Surroundings<'_>,
    from_rad: &Joints,
    to_rad: &Joints,
    search: &Search,
) -> Option<Vec<Joints>> {
    let stop_at = around.checks() + search.checks_max;
    let mut random = Random::new(search.seed);
    let mut trees = [Tree(vec![(*from_rad, 0)]), Tree(vec![(*to_rad, 0)])];
    let mut growing = 0;
    while around.checks() < stop_at && !around.is_spent() {
        let aim = sample(around, from_rad, to_rad, &mut random);
        if let Grown::Advanced(new) | Grown::Reached(new) = trees[growing].grow(&aim, around, search) {
            let meet = trees[growing].0[new].0;
            let other = &mut trees[1 - growing];
            let met = loop {
                match other.grow(&meet, around, search) {
                    Grown::Trapped => break None,
                    Grown::Advanced(_) => {}
                    Grown::Reached(node) => break Some(node),
                }
            };
            if let Some(met) = met {
                let mut one = trees[growing].back_from(new);
                let two = trees[1 - growing].back_from(met);
                one.reverse();
                // The meeting point is the end of both branches.
                one.extend(&two[1..]);
                if growing == 1 {
                    one.reverse();
                }
                return Some(one);
            }
        }
        growing = 1 - growing;
    }
    None
}

fn sample(around: &Surroundings<'_>, from_rad: &Joints, to_rad: &Joints, random: &mut Random) -> Joints {
    let mut joints_rad = *from_rad;
    for (i, joint) in around.world().arm().joints.iter().enumerate() {
        let (low, high) = joint
            .limit_rad
            .unwrap_or((from_rad[i].min(to_rad[i]) - BEYOND_RAD, from_rad[i].max(to_rad[i]) + BEYOND_RAD));
        joints_rad[i] = random.between(low, high);
    }
    joints_rad
}

impl Tree {
    /// One step from the nearest node towards a configuration.
    fn grow(&mut self, aim: &Joints, around: &Surroundings<'_>, search: &Search) -> Grown {
        around.pay((self.0.len() / NODES_PER_CHECK) as u64);
        let lever = around.world().lever_m();
        let apart =
            |joints: &Joints| -> f64 { (0..JOINTS).map(|i| (lever[i] * (aim[i] - joints[i])).powi(2)).sum() };
        let distances = self.0.iter().map(|(joints, _)| apart(joints)).enumerate();
        let Some((nearest, _)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) else { return Grown::Trapped };
        let here = self.0[nearest].0;
        let sweep_m = around.sweep_m(&here, aim);
        let (next, reached) =
            if sweep_m <= STEP_M { (*aim, true) } else { (between(&here, aim, STEP_M / sweep_m), false) };
        if !around.way_is_clear(&here, &next, search.margin_m) {
            return Grown::Trapped;
        }
        self.0.push((next, nearest));
        let new = self.0.len() - 1;
        if reached { Grown::Reached(new) } else { Grown::Advanced(new) }
    }

    /// Returns the path from a node to the root.
    fn back_from(&self, mut node: usize) -> Vec<Joints> {
        let mut path = vec![self.0[node].0];
        while node != 0 {
            node = self.0[node].1;
            path.push(self.0[node].0);
        }
        path
    }
}

/// Removes detours from a path. The result is as clear as before.
pub fn shorten(around: &Surroundings<'_>, mut path: Vec<Joints>, search: &Search) -> Vec<Joints> {
    let mut random = Random::new(search.seed ^ 0x5A5A);
    drop_corners(around, &mut path, search);
    for _ in 0..SHORTCUT_TRIES {
        if path.len() < 3 {
            break;
        }
        // Selects two points on different segments of the path.
        let one = random.below(path.len() - 1);
        let two = random.below(path.len() - 1);
        let (first, last) = (one.min(two), one.max(two));
        let a = between(&path[first], &path[first + 1], random.between(0.0, 1.0));
        let b = between(&path[last], &path[last + 1], random.between(0.0, 1.0));
        if first == last || !around.way_is_clear(&a, &b, search.margin_m) {
            continue;
        }
        path.splice(first + 1..=last, [a, b]);
    }
    drop_corners(around, &mut path, search);
    path
}

/// Removes each corner that is not necessary.
fn drop_corners(around: &Surroundings<'_>, path: &mut Vec<Joints>, search: &Search) {
    let mut start = 0;
    while start + 2 < path.len() {
        let farthest = (start + 2..path.len())
            .rev()
            .find(|&end| around.way_is_clear(&path[start], &path[end], search.margin_m));
        if let Some(end) = farthest {
            path.drain(start + 1..end);
        }
        start += 1;
    }
}
