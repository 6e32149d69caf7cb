//! Measures distances with the exact hulls of the links, if their capsules are too near each other.
//!
//! Capsules enclose the hulls and can be compared quickly, so they are compared first.
//! Capsules and hulls both give a lower bound of the distance, so the larger bound may be used.

use crate::model::SerialArm;
use crate::solid::Solid;
use host_robot::shape::{Capsule, Point};
use host_robot::{JOINTS, Pose};

/// If two capsules are at least this far apart, their hulls are not compared.
pub(super) const NEAR_M: f64 = 0.03;

/// Maximum number of parts: the foot, the links, the tool, its fingers, and a held object.
pub(super) const LINKS: usize = JOINTS + 4;

/// Number of capsules that most arms have at most.
const USUAL: usize = 32;

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

    /// Returns whether a part has hulls.
    pub fn has(&self, link: usize) -> bool {
        !self.of(link).0.is_empty()
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

/// The capsules of all parts with their bounding spheres, in the order of their link numbers.
pub(super) struct Shapes {
    capsules: Vec<Bounded>,
    /// The number of capsules before each link.
    before: [usize; LINKS + 1],
}

/// A capsule in its bounding sphere.
pub(super) struct Bounded {
    pub capsule: Capsule,
    pub middle_m: Point,
    pub reach_m: f64,
}

impl Shapes {
    /// Collects capsules with their link numbers. The numbers must be in ascending order.
    pub fn new(of: impl Iterator<Item = (usize, Capsule)>) -> Self {
        let mut shapes = Shapes { capsules: Vec::with_capacity(USUAL), before: [0; LINKS + 1] };
        for (link, capsule) in of {
            let (middle_m, reach_m) = capsule.bounds_m();
            shapes.capsules.push(Bounded { capsule, middle_m, reach_m });
            shapes.before[link + 1] += 1;
        }
        for link in 0..LINKS {
            shapes.before[link + 1] += shapes.before[link];
        }
        shapes
    }

    /// Returns the capsules of one link.
    pub fn of(&self, link: usize) -> &[Bounded] {
        &self.capsules[self.before[link]..self.before[link + 1]]
    }

    /// Returns all capsules with their link numbers.
    pub fn all(&self) -> impl Iterator<Item = (usize, &Capsule)> {
        (0..LINKS).flat_map(|link| self.of(link).iter().map(move |bounded| (link, &bounded.capsule)))
    }

    /// Returns the distance between the capsules of two links, but at most `within_m`.
    pub fn pair_m(&self, one: usize, two: usize, within_m: f64) -> f64 {
        let mut nearest_m = within_m;
        for a in self.of(one) {
            for b in self.of(two) {
                // If the bounding spheres are further apart than this, the exact distance cannot be smaller.
                if a.middle_m.distance(b.middle_m) - a.reach_m - b.reach_m < nearest_m {
                    nearest_m = nearest_m.min(a.capsule.distance_m(&b.capsule));
                }
            }
        }
        nearest_m
    }
}
