//! Rounded convex bodies, and a lower bound of the distance between two of them.

use host_robot::shape::{Capsule, Point, UprightBox};
use host_robot::{DVec3, Pose};

/// Maximum number of steps in the search for a plane that separates two bodies.
const STEPS: usize = 40;
/// The search ends when the proven distance is within this distance (in m) of the best possible result.
const GOOD_M: f64 = 1e-4;
/// A simplified body may be larger than the original by this distance in m.
const SPARE_M: f64 = 0.0005;

/// The convex hull of some points, enlarged by a radius.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// The points whose hull is the core of the body.
    pub points_m: Vec<Point>,
    /// The radius by which the hull of the points is enlarged.
    pub radius_m: f64,
}

/// Bounds of the distance between the hulls of two point sets.
struct Gap {
    /// A separating plane proves that the hulls are at least this far apart. It is 0 or less without such a plane.
    proven_m: f64,
    /// The hulls contain two points that are this far apart.
    most_m: f64,
}

impl Solid {
    /// Converts a capsule to a solid.
    pub fn of(capsule: &Capsule) -> Self {
        Solid { points_m: vec![capsule.a_m, capsule.b_m], radius_m: capsule.radius_m }
    }

    /// Converts an upright box to a solid.
    pub fn of_box(upright: &UprightBox) -> Self {
        let (s, c) = upright.yaw_rad.sin_cos();
        let sign = |k: usize, bit: usize| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let corner = |k: usize| {
            let DVec3 { x, y, z } = upright.half_m * DVec3::new(sign(k, 0), sign(k, 1), sign(k, 2));
            upright.center_m + DVec3::new(c * x - s * y, s * x + c * y, z)
        };
        Solid { points_m: (0..8).map(corner).collect(), radius_m: 0.0 }
    }

    /// Creates a body with few points that encloses all given points. It exceeds their hull by at most 0.5 mm.
    ///
    /// In each step, it adds the point that is furthest from the hull of the chosen points.
    /// As the hull grows, distances to the hull only shrink. An earlier distance is therefore an upper bound,
    /// and most distances need not be measured again.
    pub fn around(points_m: &[Point]) -> Self {
        let Some(first) = points_m.first() else { return Solid { points_m: Vec::new(), radius_m: 0.0 } };
        let mut chosen = Solid { points_m: vec![*first], radius_m: 0.0 };
        let mut open: Vec<(f64, Point)> = points_m.iter().map(|point| (f64::INFINITY, *point)).collect();
        while let Some(furthest) = (0..open.len()).max_by(|a, b| open[*a].0.total_cmp(&open[*b].0)) {
            let (known_m, point) = open.swap_remove(furthest);
            let from_m = gap(&[point], &Pose::IDENTITY, &chosen.points_m, &Pose::IDENTITY, f64::INFINITY);
            let from_m = from_m.most_m.min(known_m);
            if from_m <= SPARE_M {
                chosen.radius_m = chosen.radius_m.max(from_m);
            } else if open.iter().all(|(other_m, _)| *other_m <= from_m) {
                chosen.points_m.push(point);
            } else {
                open.push((from_m, point));
            }
        }
        chosen
    }

    /// Converts the body from its own frame to the frame outside.
    #[must_use]
    pub fn seen_from(&self, frame: &Pose) -> Solid {
        Solid { points_m: self.points_m.iter().map(|point| frame.at(*point)).collect(), ..*self }
    }

    /// Returns a lower bound of the distance between two bodies in their frames.
    /// A result of 0 or less proves nothing.
    /// The search ends early when it has proven a distance of `enough_m`.
    pub fn apart_at_m(&self, here: &Pose, other: &Solid, there: &Pose, enough_m: f64) -> f64 {
        let radii_m = self.radius_m + other.radius_m;
        gap(&self.points_m, here, &other.points_m, there, enough_m + radii_m).proven_m - radii_m
    }
}

/// Estimates the distance between two convex hulls by the method of Gilbert, Johnson and Keerthi (1988).
/// The method approaches the nearest points of two convex bodies step by step.
/// The direction of each step may give a plane that separates the bodies.
/// The best plane gives the proven distance, so rounding can make this distance too small, but not too large.
fn gap(one: &[Point], here: &Pose, two: &[Point], there: &Pose, enough_m: f64) -> Gap {
    let (Some(first), Some(second)) = (one.first(), two.first()) else {
        return Gap { proven_m: f64::INFINITY, most_m: f64::INFINITY };
    };
    let (into_one, into_two) = (here.rotation.transpose(), there.rotation.transpose());
    let mut way = here.at(*first) - there.at(*second);
    // One to four differences of corners. In their hull, `way` is the point that is nearest to the origin.
    let mut corners = [way; 4];
    let mut count = 1;
    let mut proven_m = f64::NEG_INFINITY;
    for _ in 0..STEPS {
        let Some(direction) = way.try_normalize() else { break };
        let nearest =
            here.at(lowest(one, into_one * direction)) - there.at(lowest(two, into_two * -direction));
        proven_m = proven_m.max(nearest.dot(direction));
        if proven_m >= enough_m || way.length() - proven_m < GOOD_M || corners[..count].contains(&nearest) {
            break;
        }
        corners[count] = nearest;
        let (next, kept) = nearest_of(&corners[..=count]);
        // Every step leads nearer to the origin, except through rounding errors.
        if next.length_squared() >= way.length_squared() {
            break;
        }
        way = next;
        let before = corners;
        let kept = (0..=count).filter(|i| kept >> i & 1 == 1);
        count = kept.enumerate().map(|(to, from)| corners[to] = before[from]).count();
        // If all four corners are needed, the origin is inside their hull, so the bodies overlap.
        if count == corners.len() {
            break;
        }
    }
    Gap { proven_m, most_m: way.length() }
}

/// Finds the point that is nearest to the origin in the hull of up to four points.
/// Also returns, as bits, the smallest set of given points whose hull contains the nearest point.
/// This function assumes that the set includes the last given point.
fn nearest_of(points: &[DVec3]) -> (DVec3, usize) {
    let last = points.len() - 1;
    let mut best = (points[last], 1 << last);
    for others in 1..1_usize << last {
        let set = others | 1 << last;
        let mut members = (0..=last).filter(|i| set >> i & 1 == 1).map(|i| points[i]);
        let found = match (members.next(), members.next(), members.next(), members.next()) {
            (Some(a), Some(b), None, None) => on_line(a, b),
            (Some(a), Some(b), Some(c), None) => on_triangle(a, b, c),
            (Some(a), Some(b), Some(c), Some(d)) => is_between(a, b, c, d).then_some(DVec3::ZERO),
            _ => None,
        };
        if let Some(point) = found
            && point.length_squared() < best.0.length_squared()
        {
            best = (point, set);
        }
    }
    best
}

/// Returns the foot of the perpendicular from the origin to a line, if the foot is between the two points.
fn on_line(a: DVec3, b: DVec3) -> Option<DVec3> {
    let way = b - a;
    let share = -a.dot(way) / way.length_squared();
    (share > 0.0 && share < 1.0).then(|| a + share * way)
}

fn on_triangle(a: DVec3, b: DVec3, c: DVec3) -> Option<DVec3> {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (-a.dot(ab), -a.dot(ac));
    let (g11, g12, g22) = (ab.length_squared(), ab.dot(ac), ac.length_squared());
    let scale = g11 * g22 - g12 * g12;
    let (u, v) = ((d1 * g22 - d2 * g12) / scale, (d2 * g11 - d1 * g12) / scale);
    (u > 0.0 && v > 0.0 && u + v < 1.0).then(|| a + u * ab + v * ac)
}

/// Returns whether the origin is inside the tetrahedron.
/// If so, the origin and the opposite corner are on the same side of each face.
fn is_between(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> bool {
    let inside = |p: DVec3, q: DVec3, r: DVec3, opposite: DVec3| {
        let normal = (q - p).cross(r - p);
        normal.dot(-p) * normal.dot(opposite - p) > 0.0
    };
    inside(a, b, c, d) && inside(a, b, d, c) && inside(a, c, d, b) && inside(b, c, d, a)
}

fn lowest(points: &[Point], direction: DVec3) -> Point {
    let mut best = (f64::INFINITY, DVec3::ZERO);
    for point in points {
        let along = point.dot(direction);
        if along < best.0 {
            best = (along, *point);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::{DMat3, Random};

    impl Solid {
        /// Returns the proven distance between two bodies in the same frame.
        fn apart_m(&self, other: &Solid) -> f64 {
            self.apart_at_m(&Pose::IDENTITY, other, &Pose::IDENTITY, f64::INFINITY)
        }
    }

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

    fn turned(random: &mut Random) -> Pose {
        let mut number = || random.between(-1.5, 1.5);
        let rotation = DMat3::from_rotation_z(number()) * DMat3::from_rotation_x(number());
        Pose { position_m: DVec3::new(number(), number(), number()) * 0.2, rotation }
    }

    /// The distance between two boxes, found by projections, is never below the proven distance,
    /// and the proven distance is at most 0.5 mm below it.
    #[test]
    fn in_frames_of_their_own_no_two_points_are_nearer_than_is_proven() {
        let mut random = Random::new(4);
        let half_m = [DVec3::new(0.1, 0.2, 0.05), DVec3::new(0.15, 0.05, 0.1)];
        let upright = half_m.map(|half_m| UprightBox { center_m: DVec3::ZERO, half_m, yaw_rad: 0.0 });
        let solids = upright.map(|upright| Solid::of_box(&upright));
        let (mut apart, mut overlap) = (0, 0);
        for _ in 0..300 {
            let poses = [turned(&mut random), turned(&mut random)];
            let proven_m = solids[0].apart_at_m(&poses[0], &solids[1], &poses[1], f64::INFINITY);
            // Repeated projection from one box to the other, and back, converges to the nearest points of the two boxes.
            let clamp = |i: usize, point: DVec3| {
                let local = poses[i].rotation.transpose() * (point - poses[i].position_m);
                poses[i].at(local.clamp(-half_m[i], half_m[i]))
            };
            let mut point = poses[0].position_m;
            for _ in 0..3000 {
                point = clamp(0, clamp(1, point));
            }
            let reached_m = point.distance(clamp(1, point));
            assert!(proven_m <= reached_m + 1e-9, "{proven_m} {reached_m}");
            if reached_m > 0.002 {
                assert!(proven_m > reached_m - 0.0005, "{proven_m} {reached_m}");
                apart += 1;
            } else {
                overlap += 1;
            }
        }
        assert!(apart > 100 && overlap > 20, "{apart} {overlap}");
    }

    #[test]
    fn a_body_of_fewer_points_holds_all_points_and_is_larger_by_half_a_millimetre_at_most() {
        let mut random = Random::new(6);
        let points: Vec<Point> = (0..2000)
            .map(|_| 0.1 * DVec3::from([0; 3].map(|_| random.between(-1.0, 1.0))).normalize())
            .collect();
        let simple = Solid::around(&points);
        println!("{} of {} points, {:.2} mm", simple.points_m.len(), points.len(), 1000.0 * simple.radius_m);
        assert!(simple.points_m.len() < 1000 && simple.radius_m <= 0.0005, "{}", simple.points_m.len());
        for point in &points {
            let point = Solid { points_m: vec![*point], radius_m: 0.0 };
            assert!(simple.apart_m(&point) <= 1e-9);
        }
        assert!(simple.points_m.iter().all(|point| points.contains(point)));
        assert!(Solid::around(&[]).points_m.is_empty());
    }
}
