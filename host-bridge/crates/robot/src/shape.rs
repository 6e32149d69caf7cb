//! Distances between the shapes of robot and scene, which are capsules, upright boxes and the floor.
//!
//! The two pairs of shapes that occur have exact solutions that need no iteration.
//! A distance takes some tens of nanoseconds, and the result is equal on every machine.
//! A general collision library (parry3d) would add some 30 crates for two functions.
//! Instead, `tests/mujoco/check.py` compares these functions with an independent engine.

use glam::DVec3;
use serde::Serialize;

use crate::pose::Pose;

/// A point or a direction in metres.
pub type Point = DVec3;

/// The set of points closer than `radius_m` to the line from `a_m` to `b_m`.
/// For a sphere, both ends are equal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Capsule {
    /// One end of the centre line.
    pub a_m: Point,
    /// The other end.
    pub b_m: Point,
    /// Radius around the centre line.
    pub radius_m: f64,
}

/// An upright box, rotated only about the vertical.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UprightBox {
    /// Its middle.
    pub center_m: Point,
    /// Half of the box's length, width and height.
    pub half_m: Point,
    /// Turned to the left.
    pub yaw_rad: f64,
}

/// An upright box with the sine and cosine of its heading, which take longer to compute than a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetBox {
    center_m: Point,
    half_m: Point,
    turn: (f64, f64),
}

impl From<&UprightBox> for SetBox {
    fn from(upright: &UprightBox) -> Self {
        SetBox { center_m: upright.center_m, half_m: upright.half_m, turn: upright.yaw_rad.sin_cos() }
    }
}

impl SetBox {
    /// Converts a point to the box's coordinates, relative to its centre and sides.
    pub fn inside(&self, point: Point) -> Point {
        let DVec3 { x, y, z } = point - self.center_m;
        let (s, c) = self.turn;
        DVec3::new(c * x + s * y, c * y - s * x, z)
    }

    /// Distance from a point to the box in m; 0 inside.
    pub fn distance_to_point_m(&self, point: Point) -> f64 {
        outside_m(self.inside(point), self.half_m)
    }

    /// Distance to a capsule in m; negative if they overlap (by at most the radius).
    pub fn distance_to_capsule_m(&self, capsule: &Capsule) -> f64 {
        let (a, b) = (self.inside(capsule.a_m), self.inside(capsule.b_m));
        segment_to_box_m(a, b, self.half_m) - capsule.radius_m
    }
}

impl Capsule {
    /// Converts a capsule in the coordinates of `frame` to the outer coordinates.
    #[must_use]
    pub fn seen_from(&self, frame: &Pose) -> Capsule {
        Capsule { a_m: frame.at(self.a_m), b_m: frame.at(self.b_m), ..*self }
    }

    /// Distance between the surfaces in m; negative if they overlap (down to the centre lines).
    pub fn distance_m(&self, other: &Capsule) -> f64 {
        segments_m(self.a_m, self.b_m, other.a_m, other.b_m) - self.radius_m - other.radius_m
    }

    /// Distance to a box in m; negative if they overlap (by at most the radius).
    pub fn distance_to_box_m(&self, other: &UprightBox) -> f64 {
        SetBox::from(other).distance_to_capsule_m(self)
    }

    /// Height of the lowest point in m.
    pub fn lowest_m(&self) -> f64 {
        self.a_m.z.min(self.b_m.z) - self.radius_m
    }

    /// Returns the middle of the centre line, and the radius in m of the sphere that encloses the capsule.
    pub fn bounds_m(&self) -> (Point, f64) {
        let half = 0.5 * (self.b_m - self.a_m);
        (self.a_m + half, half.length() + self.radius_m)
    }
}

impl UprightBox {
    /// Converts a point to the box's coordinates, relative to its centre and sides.
    pub fn inside(&self, point: Point) -> Point {
        SetBox::from(self).inside(point)
    }

    /// Distance from a point to the box in m; 0 inside.
    pub fn distance_to_point_m(&self, point: Point) -> f64 {
        SetBox::from(self).distance_to_point_m(point)
    }

    /// Distance between two upright boxes in m; 0 if they overlap.
    pub fn distance_m(&self, other: &UprightBox) -> f64 {
        let gap = (self.center_m.z - other.center_m.z).abs() - self.half_m.z - other.half_m.z;
        let flat = if self.overlaps_from_above(other) {
            0.0
        } else {
            // The nearest points of two separate convex outlines include a corner of one of them.
            let one = self.corners().into_iter().map(|corner| other.flat_distance_m(corner));
            let two = other.corners().into_iter().map(|corner| self.flat_distance_m(corner));
            one.chain(two).fold(f64::INFINITY, f64::min)
        };
        flat.hypot(gap.max(0.0))
    }

    fn flat_distance_m(&self, [x, y]: [f64; 2]) -> f64 {
        self.distance_to_point_m(DVec3::new(x, y, self.center_m.z))
    }

    fn corners(&self) -> [[f64; 2]; 4] {
        let (s, c) = self.yaw_rad.sin_cos();
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(u, v)| {
            let (x, y) = (u * self.half_m[0], v * self.half_m[1]);
            [self.center_m[0] + c * x - s * y, self.center_m[1] + s * x + c * y]
        })
    }

    /// Separating axes: two rectangles overlap unless one is entirely beyond a side of the other.
    fn overlaps_from_above(&self, other: &UprightBox) -> bool {
        let separates = |one: &UprightBox, two: &UprightBox| {
            let seen = two.corners().map(|[x, y]| one.inside(DVec3::new(x, y, one.center_m.z)));
            (0..2).any(|axis| {
                seen.iter().all(|p| p[axis] > one.half_m[axis])
                    || seen.iter().all(|p| p[axis] < -one.half_m[axis])
            })
        };
        !separates(self, other) && !separates(other, self)
    }
}

/// Shortest distance between two line segments (Ericson, Real-Time Collision Detection, 5.1.9).
fn segments_m(p1: Point, q1: Point, p2: Point, q2: Point) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.length_squared(), d2.length_squared(), d2.dot(r));
    let c = d1.dot(r);
    let (s, t) = if a <= 0.0 && e <= 0.0 {
        (0.0, 0.0)
    } else if a <= 0.0 {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else if e <= 0.0 {
        ((-c / a).clamp(0.0, 1.0), 0.0)
    } else {
        let b = d1.dot(d2);
        let crossed = a * e - b * b;
        // Parallel lines have a constant distance, so any start is valid.
        let s = if crossed > 1e-12 * a * e { ((b * f - c * e) / crossed).clamp(0.0, 1.0) } else { 0.0 };
        let t = (b * s + f) / e;
        if t < 0.0 {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else if t > 1.0 {
            (((b - c) / a).clamp(0.0, 1.0), 1.0)
        } else {
            (s, t)
        }
    };
    (p1 + d1 * s).distance(p2 + d2 * t)
}

fn outside_m(point: Point, half: Point) -> f64 {
    (point.abs() - half).max(DVec3::ZERO).length()
}

/// Returns the distance from a segment to a box around the origin.
/// Along the segment, the squared distance is convex and consists of parabolas.
/// The parabolas meet at the planes of the box's sides.
/// The slope of the squared distance is piecewise linear, so its zero can be found exactly.
fn segment_to_box_m(a: Point, b: Point, half: Point) -> f64 {
    let d = b - a;
    let slope = |t: f64| {
        let x = a + d * t;
        (x - x.max(-half).min(half)).dot(d)
    };
    if slope(0.0) >= 0.0 {
        return outside_m(a, half);
    }
    if slope(1.0) <= 0.0 {
        return outside_m(b, half);
    }
    let (mut low, mut high) = (0.0, 1.0);
    for k in 0..3 {
        for side in [-half[k], half[k]] {
            let t = (side - a[k]) / d[k];
            // NaN and infinity (segments parallel to the side) fail this comparison.
            if t > low && t < high {
                if slope(t) < 0.0 { low = t } else { high = t }
            }
        }
    }
    let (at_low, at_high) = (slope(low), slope(high));
    let t = if at_high > at_low { low - at_low * (high - low) / (at_high - at_low) } else { high };
    outside_m(a + d * t, half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from)
    }

    /// Finds the minimum of a convex function by repeatedly shrinking the interval.
    fn least(f: impl Fn(f64) -> f64) -> f64 {
        let (mut low, mut high) = (0.0_f64, 1.0_f64);
        for _ in 0..100 {
            let (one, two) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if f(one) < f(two) { high = two } else { low = one }
        }
        f(0.5 * (low + high))
    }

    proptest! {
        #[test]
        fn capsules_are_as_far_apart_as_a_search_finds(a in point(), b in point(), c in point(), d in point()) {
            let one = Capsule { a_m: a, b_m: b, radius_m: 0.1 };
            let two = Capsule { a_m: c, b_m: d, radius_m: 0.2 };
            let searched = least(|s| {
                let p = a + (b - a) * s;
                least(|t| p.distance(c + (d - c) * t))
            });
            prop_assert!((one.distance_m(&two) + 0.3 - searched).abs() < 1e-7);
            prop_assert!((one.distance_m(&two) - two.distance_m(&one)).abs() < 1e-12);
        }

        #[test]
        fn a_capsule_is_as_far_from_a_box_as_a_search_finds(
            a in point(), b in point(), center_m in point(), half_m in prop::array::uniform3(0.01..0.5_f64).prop_map(DVec3::from),
            yaw_rad in -4.0..4.0_f64,
        ) {
            let shape = UprightBox { center_m, half_m, yaw_rad };
            let capsule = Capsule { a_m: a, b_m: b, radius_m: 0.1 };
            let searched = least(|t| shape.distance_to_point_m(a + (b - a) * t));
            prop_assert!((capsule.distance_to_box_m(&shape) + 0.1 - searched).abs() < 1e-7);
        }

        #[test]
        fn boxes_are_as_far_apart_as_a_search_finds(
            one in (point(), prop::array::uniform3(0.05..0.5_f64).prop_map(DVec3::from), -4.0..4.0_f64),
            two in (point(), prop::array::uniform3(0.05..0.5_f64).prop_map(DVec3::from), -4.0..4.0_f64),
        ) {
            let [one, two] =
                [one, two].map(|(center_m, half_m, yaw_rad)| UprightBox { center_m, half_m, yaw_rad });
            // The outline of the first box, edge by edge, at the height closest to the second box.
            let z = two.center_m[2].clamp(one.center_m[2] - one.half_m[2], one.center_m[2] + one.half_m[2]);
            let corners = one.corners();
            let outline = (0..4).map(|i| {
                let ([x, y], [u, v]) = (corners[i], corners[(i + 1) % 4]);
                least(|t| two.distance_to_point_m(DVec3::new(x + t * (u - x), y + t * (v - y), z)))
            });
            let mut searched = outline.fold(f64::INFINITY, f64::min);
            if one.overlaps_from_above(&two) {
                let gap = (one.center_m[2] - two.center_m[2]).abs() - one.half_m[2] - two.half_m[2];
                searched = gap.max(0.0);
            }
            prop_assert!((one.distance_m(&two) - searched).abs() < 1e-6);
        }
    }

    #[test]
    fn shapes_that_overlap_have_no_distance_left() {
        let shape = UprightBox { center_m: DVec3::splat(0.0), half_m: DVec3::splat(0.5), yaw_rad: 0.3 };
        let through =
            Capsule { a_m: DVec3::new(-1.0, 0.0, 0.0), b_m: DVec3::new(1.0, 0.1, 0.0), radius_m: 0.1 };
        assert_eq!(through.distance_to_box_m(&shape), -0.1);
        let cross =
            UprightBox { center_m: DVec3::splat(0.0), half_m: DVec3::new(2.0, 0.1, 0.1), yaw_rad: 1.0 };
        assert_eq!(shape.distance_m(&cross), 0.0);
        let above =
            UprightBox { center_m: DVec3::new(0.0, 0.0, 2.0), half_m: DVec3::splat(0.5), yaw_rad: 0.0 };
        assert_eq!(shape.distance_m(&above), 1.0);
    }
}
