//! The links' exact hulls, for parts whose capsules are too near each other.
//!
//! Capsules enclose the hulls and are quickly compared, so they are looked at first.
//! Both results are lower bounds of the distance, and so is the larger one.

use crate::model::SerialArm;
use crate::solid::Solid;
use host_robot::shape::Capsule;
use host_robot::{JOINTS, Pose};

/// Where the capsules are this far apart, the hulls are not looked at.
pub(super) const NEAR_M: f64 = 0.03;

/// What the hulls do not say.
const UNKNOWN: f64 = f64::NEG_INFINITY;

/// Shapes of tool, fingers and held object in the flange's frame.
#[derive(Clone, Debug, Default)]
pub(super) struct OnFlange {
    /// With their numbers among the links.
    pub capsules: Vec<(usize, Capsule)>,
    /// The same as solids, in the order of the three parts; empty for an arm of which no hulls are known.
    solids: [Vec<Solid>; 3],
}

impl OnFlange {
    /// Capsules with their numbers; the tool's is `first`.
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

/// The hulls of one configuration.
#[derive(Clone, Copy)]
pub(super) struct Hulls<'a> {
    pub arm: &'a SerialArm,
    pub on_flange: &'a OnFlange,
    /// The links' frames and the flange's.
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

    /// The proven distance of two parts, or anything beyond `enough_m`.
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

    /// The proven distance of a part from a body in the arm's frame, or anything beyond `enough_m`.
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

/// The distance of two parts, of which the shapes stand in the order of their numbers; or anything beyond `within_m`.
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
            // Balls around both are further apart already.
            if a_m.distance(b_m) - a_reach_m - b_reach_m < nearest_m {
                nearest_m = nearest_m.min(a.distance_m(b));
            }
        }
    }
    nearest_m
}
