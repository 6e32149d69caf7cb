//! A rounded convex body, and a check whether two such bodies are apart.

use host_robot::shape::{Capsule, Point};
use host_robot::{DVec3, Pose};

/// Maximum number of steps in the search for a plane between two bodies.
const STEPS: usize = 80;
/// The search ends when the plane is within this distance of the best possible plane, in m.
const GOOD_M: f64 = 2e-4;

/// The convex hull of some points, enlarged by a radius.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// The points.
    pub points_m: Vec<Point>,
    /// The radius by which the hull of the points is enlarged.
    pub radius_m: f64,
}

impl Solid {
    /// A capsule is one.
    pub fn of(capsule: &Capsule) -> Self {
        Solid { points_m: vec![capsule.a_m, capsule.b_m], radius_m: capsule.radius_m }
    }

    /// Returns the same body in the coordinates outside its frame.
    #[must_use]
    pub fn seen_from(&self, frame: &Pose) -> Solid {
        Solid { points_m: self.points_m.iter().map(|point| frame.at(*point)).collect(), ..*self }
    }

    /// Returns a lower bound of the distance between two bodies; a result of 0 or less proves nothing.
    ///
    /// The method is Frank and Wolfe's (1956; pairwise steps by Lacoste-Julien and Jaggi 2015).
    /// The search approaches the nearest points of two convex bodies.
    /// Each direction that occurs in this search may give a separating plane.
    /// The returned distance is the one that the best of these planes proves.
    pub fn apart_m(&self, other: &Solid) -> f64 {
        let (Some(first), Some(second)) = (self.points_m.first(), other.points_m.first()) else {
            return f64::INFINITY;
        };
        let mut way = *first - *second;
        let mut proven_m = f64::NEG_INFINITY;
        // Differences of corners, and the weight of each in the current point.
        let mut parts = vec![(way, 1.0)];
        for _ in 0..STEPS {
            let Some(direction) = way.try_normalize() else { break };
            let nearest = lowest(&self.points_m, direction) - lowest(&other.points_m, -direction);
            proven_m = proven_m.max(nearest.dot(direction));
            if way.length() - proven_m < GOOD_M {
                break;
            }
            let by = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
            let along = parts.iter().map(|(part, _)| part.dot(direction)).enumerate();
            let Some((furthest, _)) = along.max_by(by) else { break };
            let (from, share) = parts[furthest];
            // Moves as much weight as useful from the furthest corner to the nearest corner.
            let step = nearest - from;
            let length = step.length_squared();
            if length == 0.0 {
                break;
            }
            let moved = (-way.dot(step) / length).clamp(0.0, share);
            way += step * moved;
            parts[furthest].1 -= moved;
            match parts.iter_mut().find(|(part, _)| *part == nearest) {
                Some((_, share)) => *share += moved,
                None => parts.push((nearest, moved)),
            }
            parts.retain(|(_, share)| *share > 0.0);
        }
        proven_m - self.radius_m - other.radius_m
    }
}

fn lowest(points: &[Point], direction: DVec3) -> Point {
    let by = |a: &&Point, b: &&Point| a.dot(direction).total_cmp(&b.dot(direction));
    points.iter().min_by(by).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::Random;

    #[test]
    fn what_is_proven_of_capsules_is_their_distance_and_never_more() {
        let mut random = Random::new(21);
        let (mut worst_m, mut seen) = (0.0_f64, 0);
        for _ in 0..2000 {
            let mut point = || DVec3::from([0; 3].map(|_| random.between(-0.5, 0.5)));
            let one = Capsule { a_m: point(), b_m: point(), radius_m: 0.05 };
            let two = Capsule { a_m: point(), b_m: point(), radius_m: 0.03 };
            let (exact_m, proven_m) = (one.distance_m(&two), Solid::of(&one).apart_m(&Solid::of(&two)));
            assert!(proven_m <= exact_m + 1e-9, "{proven_m} {exact_m}");
            if exact_m > 0.005 {
                worst_m = worst_m.max(exact_m - proven_m);
                seen += 1;
            }
        }
        println!("{seen} pairs, at most {:.2} mm short", 1000.0 * worst_m);
        assert!(seen > 500 && worst_m < 0.005);
    }

    #[test]
    fn boxes_that_touch_are_never_said_to_be_apart_and_others_are() {
        let cube = |at: DVec3| {
            let corner = |k: usize| at + DVec3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2) as f64);
            Solid { points_m: (0..8).map(corner).collect(), radius_m: 0.0 }
        };
        let here = cube(DVec3::ZERO);
        for at in [DVec3::ZERO, DVec3::new(0.5, 0.5, 0.5), DVec3::new(1.0, 0.3, 0.0)] {
            assert!(here.apart_m(&cube(at)) <= 1e-9);
        }
        assert!((here.apart_m(&cube(DVec3::new(1.02, 0.4, -0.3))) - 0.02).abs() < 1e-3);
    }
}
