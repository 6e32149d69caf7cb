//! Measures distances with the exact hulls of the links, if their capsules are too near each other.
//!
//! Capsules enclose the hulls and can be compared quickly, so they are compared first.
//! Capsules and hulls both give a lower bound of the distance, so the larger bound may be used.

use crate::model::SerialArm;
use crate::solid::Solid;
use host_robot::shape::Capsule;
use host_robot::{JOINTS, Pose};

/// If two capsules are at least this far apart, their hulls are not compared.
pub(super) const NEAR_M: f64 = 0.03;

/// The lower bound of the distance if one of the parts has no hulls.
const UNKNOWN: f64 = f64::NEG_INFINITY;

/// The shapes of the tool, the fingers and the held object, in the flange's frame.
#[derive(Clone, Debug, Default)]
pub(super) struct OnFlange {
    /// The capsules, each with the number of its link.
    pub capsules: Vec<(usize, Capsule)>,
    /// The same shapes as solids, one list for each of the three parts. The lists are empty for an arm without hulls.
    solids: [Vec<Solid>; 3],
}

impl OnFlange {
    /// Creates the shapes from capsules with their link numbers. The tool is link `first`.
    pub fn new(capsules: Vec<(usize, Capsule)>, first: usize, arm: &SerialArm) -> Self {
        let mut on_flange = OnFlange { capsules, ..OnFlange::default() };
        if arm.joints.iter().any(|joint| !joint.solids.is_empty()) {
            for (link, capsule) in &on_flange.capsules {
                on_flange.solids[link - first].push(Solid::of(capsule));
            }
        }
        on_flange
    }
}

/// The hulls of an arm with these link poses.
#[derive(Clone, Copy)]
pub(super) struct Hulls<'a> {
    pub arm: &'a SerialArm,
    pub on_flange: &'a OnFlange,
    /// The frames of the links, followed by the flange's frame.
    pub poses: &'a [Pose; JOINTS + 1],
}

impl Hulls<'_> {
    fn of(&self, link: usize) -> (&[Solid], Pose) {
        let joints = &self.arm.joints;
        match link.checked_sub(1) {
            None => (&self.arm.foot_solids, Pose::IDENTITY),
            Some(i) if i < joints.len() => (&joints[i].solids, self.poses[i]),
            Some(i) => {
                (self.on_flange.solids.get(i - joints.len()).map_or(&[], Vec::as_slice), self.poses[JOINTS])
            }
        }
    }

    /// Returns a lower bound of the distance between two parts, but at most `enough_m`.
    pub fn pair_m(&self, one: usize, two: usize, enough_m: f64) -> f64 {
        let ((one, here), (two, there)) = (self.of(one), self.of(two));
        if one.is_empty() || two.is_empty() {
            return UNKNOWN;
        }
        let mut nearest_m = enough_m;
        for a in one {
            for b in two {
                nearest_m = nearest_m.min(a.apart_at_m(&here, b, &there, nearest_m));
            }
        }
        nearest_m
    }

    /// Returns a lower bound of the distance between a part and a body in the arm's frame, but at most `enough_m`.
    pub fn part_from_m(&self, link: usize, body: &Solid, enough_m: f64) -> f64 {
        let (solids, here) = self.of(link);
        if solids.is_empty() {
            return UNKNOWN;
        }
        let apart =
            |nearest_m: f64, a: &Solid| nearest_m.min(a.apart_at_m(&here, body, &Pose::IDENTITY, nearest_m));
        solids.iter().fold(enough_m, apart)
    }
}

/// Returns the distance between the capsules of two parts, but at most `within_m`.
/// The shapes must be in the order of their link numbers.
pub(super) fn capsules_m(shapes: &[(usize, Capsule)], one: usize, two: usize, within_m: f64) -> f64 {
    let of = |wanted: usize| {
        let start = shapes.partition_point(|(link, _)| *link < wanted);
        &shapes[start..shapes.partition_point(|(link, _)| *link <= wanted)]
    };
    let mut nearest_m = within_m;
    for (_, a) in of(one) {
        let (a_m, a_reach_m) = a.bounds_m();
        for (_, b) in of(two) {
            let (b_m, b_reach_m) = b.bounds_m();
            // If the bounding spheres are further apart than this, the exact distance cannot be smaller.
            if a_m.distance(b_m) - a_reach_m - b_reach_m < nearest_m {
                nearest_m = nearest_m.min(a.distance_m(b));
            }
        }
    }
    nearest_m
}
