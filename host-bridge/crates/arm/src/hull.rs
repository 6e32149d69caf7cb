//! Convex hulls of meshes, and capsules that enclose them (feature `urdf`).
//!
//! Quickhull (Barber, Dobkin and Huhdanpaa 1996) computes the hull.
//! Before this, each point is moved by less than [`JOGGLE`] times the extent of all points.
//! After the move, no three points lie on a line, and no four points lie in a plane.
//! The error of this move is much smaller than [`SPARE_M`], by which every capsule is thicker than necessary.
//!
//! One capsule around a box, or around a link that is thick on one side, would be too thick.
//! A hull is therefore cut by planes as long as each cut reduces the protrusion.
//! Each capsule encloses one convex piece.

use std::collections::BTreeMap;

use host_robot::shape::{Capsule, Point};
use host_robot::{DVec3, Random};

/// Capsules are thicker than necessary by this much.
const SPARE_M: f64 = 0.0002;
/// Points are moved by at most this fraction of their extent.
const JOGGLE: f64 = 1e-5;
/// Maximum number of capsules per mesh.
const PIECES_MAX: usize = 12;
/// Capsules that protrude from the hull by no more than this are good enough.
const OUT_MAX_M: f64 = 0.004;
/// A cut must reduce the protrusion to less than this fraction.
/// The first value is for two pieces, the second for four.
const WORTH: [(usize, f64); 2] = [(2, 0.9), (4, 0.75)];

/// Returns capsules that enclose the convex hull of the points, and none if there are no points.
pub fn capsules(points: &[Point]) -> Vec<Capsule> {
    if points.is_empty() {
        return Vec::new();
    }
    let whole = Hull::around(points);
    let mut open = vec![Piece::new(&whole.points, &whole.planes)];
    let mut done = Vec::new();
    while let Some(worst) = (0..open.len()).max_by(|a, b| open[*a].out_m.total_cmp(&open[*b].out_m)) {
        let piece = open.swap_remove(worst);
        let room = PIECES_MAX - open.len() - done.len();
        match piece.cut(&whole.planes, room) {
            Some(parts) => open.extend(parts),
            None => done.push(piece.capsule),
        }
    }
    let mut found = done;
    // The capsules enclose the given points, in spite of all rounding errors.
    for point in points {
        let out_m = |capsule: &Capsule| from_line_m(*point, capsule) - capsule.radius_m;
        let nearest = found.iter_mut().min_by(|a, b| out_m(a).total_cmp(&out_m(b)));
        if let Some(capsule) = nearest {
            capsule.radius_m = capsule.radius_m.max(from_line_m(*point, capsule));
        }
    }
    for capsule in &mut found {
        capsule.radius_m += SPARE_M;
    }
    found
}

/// Returns the corners of the convex hull of some points.
pub fn corners(points: &[Point]) -> Vec<Point> {
    if points.is_empty() { Vec::new() } else { Hull::around(points).points }
}

/// A plane, given by its outward direction and its distance from the origin.
type Plane = (DVec3, f64);

/// A part of a hull, with the capsule around it.
struct Piece {
    points: Vec<Point>,
    capsule: Capsule,
    /// The distance by which the capsule protrudes from the complete hull.
    out_m: f64,
}

impl Piece {
    fn new(points: &[Point], planes: &[Plane]) -> Self {
        let capsule = fitted(points, planes);
        Piece { points: points.to_vec(), capsule, out_m: out_m(&capsule, planes) }
    }

    /// Returns the piece's parts, if a cut reduces the protrusion.
    /// A cut uses one plane, or two planes that cross.
    fn cut(&self, planes: &[Plane], room: usize) -> Option<Vec<Piece>> {
        if self.out_m <= OUT_MAX_M || room < 2 {
            return None;
        }
        let hull = Hull::around(&self.points);
        let along = (self.capsule.b_m - self.capsule.a_m).normalize_or_zero();
        let mut ways: Vec<Vec<Plane>> = Vec::new();
        for normal in [DVec3::X, DVec3::Y, DVec3::Z, along].into_iter().filter(|n| *n != DVec3::ZERO) {
            let (low, high) = range(&hull.points, normal);
            ways.extend([0.2, 0.35, 0.5, 0.65, 0.8].map(|share| vec![(normal, low + share * (high - low))]));
        }
        if room >= 4 {
            let half = |normal: DVec3| {
                let (low, high) = range(&hull.points, normal);
                (normal, 0.5 * (low + high))
            };
            let crosses = [(DVec3::X, DVec3::Y), (DVec3::Y, DVec3::Z), (DVec3::X, DVec3::Z)];
            ways.extend(crosses.map(|(one, two)| vec![half(one), half(two)]));
        }
        let mut best: Option<(f64, Vec<Vec<Point>>)> = None;
        for way in ways {
            let mut parts = vec![hull.points.clone()];
            for (normal, at) in &way {
                let halves = parts.iter().flat_map(|part| {
                    let part = Hull::around(part);
                    [part.side(*normal, *at), part.side(-*normal, -*at)]
                });
                parts = halves.collect();
            }
            if parts.iter().any(|part| part.len() < 4) {
                continue;
            }
            let worst_m = parts.iter().map(|part| out_m(&begun(part, planes), planes)).fold(0.0, f64::max);
            // Each additional capsule increases the cost by a few percent.
            let cost = worst_m * (1.0 + 0.05 * parts.len() as f64);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, parts));
            }
        }
        let (_, parts) = best?;
        let worth = WORTH.iter().find(|(count, _)| *count == parts.len()).map_or(1.0, |(_, share)| *share);
        let pieces: Vec<Piece> = parts.iter().map(|part| Piece::new(part, planes)).collect();
        let worst_m = pieces.iter().map(|piece| piece.out_m).fold(0.0, f64::max);
        (worst_m < worth * self.out_m).then_some(pieces)
    }
}

/// Returns the distance by which a capsule protrudes from a hull.
/// The distance is measured perpendicular to the hull's planes.
fn out_m(capsule: &Capsule, planes: &[Plane]) -> f64 {
    let beyond =
        |(normal, at): &Plane| normal.dot(capsule.a_m).max(normal.dot(capsule.b_m)) + capsule.radius_m - at;
    planes.iter().map(beyond).fold(0.0, f64::max)
}

fn range(points: &[Point], direction: DVec3) -> (f64, f64) {
    let along = points.iter().map(|point| point.dot(direction));
    along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
}

fn from_line_m(point: Point, line: &Capsule) -> f64 {
    let way = line.b_m - line.a_m;
    let length = way.length_squared();
    let share = if length > 0.0 { ((point - line.a_m).dot(way) / length).clamp(0.0, 1.0) } else { 0.0 };
    point.distance(line.a_m + way * share)
}

/// Returns the capsule around a line that encloses all points.
fn around_line(points: &[Point], a_m: Point, b_m: Point) -> Capsule {
    let line = Capsule { a_m, b_m, radius_m: 0.0 };
    let radius_m = points.iter().map(|point| from_line_m(*point, &line)).fold(0.0, f64::max);
    Capsule { radius_m, ..line }
}

/// Returns the capsule that protrudes least, chosen from a few directions.
/// Each candidate encloses all points.
fn begun(points: &[Point], planes: &[Plane]) -> Capsule {
    let first = points.first().copied().unwrap_or_default();
    let furthest = |from: Point| {
        let by_distance =
            |a: &&Point, b: &&Point| from.distance_squared(**a).total_cmp(&from.distance_squared(**b));
        points.iter().max_by(by_distance).copied().unwrap_or(from)
    };
    let one = furthest(first);
    let longest = (furthest(one) - one).normalize_or_zero();
    let directions = [DVec3::X, DVec3::Y, DVec3::Z, longest];
    let of = |along: DVec3| {
        let (side, other) = along.any_orthonormal_pair();
        let middle = |direction: DVec3| {
            let (low, high) = range(points, direction);
            direction * (0.5 * (low + high))
        };
        let foot = middle(side) + middle(other);
        let square = |point: &Point| (*point - foot - along * point.dot(along)).length_squared();
        let radius_2 = points.iter().map(square).fold(0.0, f64::max);
        // Each end lies as far inside as the round ends allow.
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for point in points {
            let (at, cap) = (point.dot(along), (radius_2 - square(point)).max(0.0).sqrt());
            (low, high) = (low.min(at + cap), high.max(at - cap));
        }
        if low > high {
            (low, high) = (0.5 * (low + high), 0.5 * (low + high));
        }
        around_line(points, foot + along * low, foot + along * high)
    };
    let tried = directions.into_iter().filter(|along| along.length_squared() > 0.5).map(of);
    let smallest = tried.min_by(|a, b| cost(a, planes).total_cmp(&cost(b, planes)));
    smallest.unwrap_or(Capsule { a_m: first, b_m: first, radius_m: 0.0 })
}

/// Returns the protrusion plus a small term for the size, so that the smaller of two equal capsules wins.
fn cost(capsule: &Capsule, planes: &[Plane]) -> f64 {
    out_m(capsule, planes) + 0.05 * (capsule.radius_m + 0.5 * capsule.a_m.distance(capsule.b_m))
}

/// Returns the best capsule after moving its ends in ever smaller steps.
fn fitted(points: &[Point], planes: &[Plane]) -> Capsule {
    let mut best = begun(points, planes);
    let mut least = cost(&best, planes);
    let mut step_m = 0.25 * best.radius_m;
    while step_m > 2e-4 {
        let mut moved = false;
        for direction in DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]) {
            for (one, other) in [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)] {
                let by = direction * step_m;
                let tried = around_line(points, best.a_m + by * one, best.b_m + by * other);
                let costs = cost(&tried, planes);
                if costs < 0.9995 * least {
                    (best, least, moved) = (tried, costs, true);
                }
            }
        }
        if !moved {
            step_m *= 0.5;
        }
    }
    best
}

/// A convex hull.
struct Hull {
    points: Vec<Point>,
    /// Each edge connects two points, given by their numbers.
    edges: Vec<(usize, usize)>,
    planes: Vec<Plane>,
}

impl Hull {
    /// Computes the hull of these points. If that fails, the result is an upright box around the points.
    fn around(points: &[Point]) -> Hull {
        let mut points = points.to_vec();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
        points.dedup();
        Quickhull::new(&points).and_then(|hull| hull.finish(&points)).unwrap_or_else(|| Hull::boxed(&points))
    }

    fn boxed(points: &[Point]) -> Hull {
        let least = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
        let most = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
        let corner =
            |k: usize| DVec3::from([0, 1, 2].map(|i| if k >> i & 1 == 1 { most[i] } else { least[i] }));
        let edges = (0..8).flat_map(|k: usize| [1, 2, 4].map(|bit| (k, k ^ bit))).filter(|(a, b)| a < b);
        let planes =
            DVec3::AXES.into_iter().flat_map(|axis| [(axis, most.dot(axis)), (-axis, -least.dot(axis))]);
        Hull { points: (0..8).map(corner).collect(), edges: edges.collect(), planes: planes.collect() }
    }

    /// Returns the hull's part on the far side of a plane.
    fn side(&self, normal: DVec3, at: f64) -> Vec<Point> {
        let beyond = |i: usize| self.points[i].dot(normal) - at;
        let mut part: Vec<Point> =
            (0..self.points.len()).filter(|i| beyond(*i) >= 0.0).map(|i| self.points[i]).collect();
        for &(one, two) in &self.edges {
            let (from, to) = (beyond(one), beyond(two));
            if (from < 0.0) != (to < 0.0) {
                part.push(self.points[one].lerp(self.points[two], from / (from - to)));
            }
        }
        part
    }
}

struct Face {
    corners: [usize; 3],
    /// The neighbouring face across each edge. The edges lead from one corner to the next.
    beside: [usize; 3],
    normal: DVec3,
    at: f64,
    /// Points that lie beyond the face.
    outside: Vec<usize>,
    is_gone: bool,
}

struct Quickhull {
    points: Vec<Point>,
    faces: Vec<Face>,
}

impl Quickhull {
    /// Chooses the first four points. Returns `None` if all points lie in a plane.
    fn new(given: &[Point]) -> Option<Self> {
        let extent = given.iter().copied().reduce(DVec3::max)? - given.iter().copied().reduce(DVec3::min)?;
        let by = JOGGLE * extent.max_element();
        let mut random = Random::new(7);
        let mut joggled = |point: &Point| *point + DVec3::from([0; 3].map(|_| random.between(-by, by)));
        let points: Vec<Point> = given.iter().map(&mut joggled).collect();
        let best = |far: &dyn Fn(Point) -> f64| {
            (0..points.len()).max_by(|a, b| far(points[*a]).total_cmp(&far(points[*b])))
        };
        let a = best(&|p| -p.x)?;
        let b = best(&|p| p.distance(points[a]))?;
        let line = (points[b] - points[a]).normalize_or_zero();
        let c = best(&|p| (p - points[a]).cross(line).length())?;
        let normal = line.cross(points[c] - points[a]).normalize_or_zero();
        let height = |p: Point| (p - points[a]).dot(normal);
        let d = best(&|p| height(p).abs())?;
        if height(points[d]).abs() <= 10.0 * by {
            return None;
        }
        // Seen from outside, the corners of each face run counter-clockwise.
        let (b, c) = if height(points[d]) > 0.0 { (c, b) } else { (b, c) };
        let mut hull = Quickhull { points, faces: Vec::new() };
        for (corners, beside) in
            [([a, b, c], [1, 2, 3]), ([b, a, d], [0, 3, 2]), ([c, b, d], [0, 1, 3]), ([a, c, d], [0, 2, 1])]
        {
            hull.add(corners, beside)?;
        }
        for i in 0..hull.points.len() {
            hull.give(i, 0);
        }
        Some(hull)
    }

    fn add(&mut self, corners: [usize; 3], beside: [usize; 3]) -> Option<usize> {
        let [a, b, c] = corners.map(|corner| self.points[corner]);
        let normal = (b - a).cross(c - a).try_normalize()?;
        self.faces.push(Face {
            corners,
            beside,
            normal,
            at: normal.dot(a),
            outside: Vec::new(),
            is_gone: false,
        });
        Some(self.faces.len() - 1)
    }

    fn beyond(&self, face: usize, point: usize) -> f64 {
        self.faces[face].normal.dot(self.points[point]) - self.faces[face].at
    }

    /// Assigns a point to the first face beyond which it lies. The search begins at the face `from`.
    /// A point inside is discarded.
    fn give(&mut self, point: usize, from: usize) {
        let sees = (from..self.faces.len()).find(|face| self.beyond(*face, point) > 1e-12);
        if let Some(face) = sees {
            self.faces[face].outside.push(point);
        }
    }

    fn finish(mut self, given: &[Point]) -> Option<Hull> {
        let mut next = 0;
        while next < self.faces.len() {
            if self.faces[next].is_gone || self.faces[next].outside.is_empty() {
                next += 1;
                continue;
            }
            self.reach_out(next)?;
        }
        let mut numbers: BTreeMap<usize, usize> = BTreeMap::new();
        let mut hull = Hull { points: Vec::new(), edges: Vec::new(), planes: Vec::new() };
        for face in self.faces.iter().filter(|face| !face.is_gone) {
            let corners = face.corners.map(|corner| {
                *numbers.entry(corner).or_insert_with(|| {
                    hull.points.push(given[corner]);
                    hull.points.len() - 1
                })
            });
            let edges = (0..3).map(|i| (corners[i], corners[(i + 1) % 3]));
            hull.edges.extend(edges.filter(|(one, two)| one < two));
            hull.planes.push((face.normal, face.at));
        }
        Some(hull)
    }

    /// The point that is furthest beyond a face becomes a corner of the hull.
    /// A result of `None` means that rounding errors prevent this step.
    fn reach_out(&mut self, face: usize) -> Option<()> {
        let far = |a: &&usize, b: &&usize| self.beyond(face, **a).total_cmp(&self.beyond(face, **b));
        let point = *self.faces[face].outside.iter().max_by(far)?;
        let (mut seen, mut rim) = (vec![face], Vec::new());
        self.faces[face].is_gone = true;
        let mut looked = 0;
        while let Some(&here) = seen.get(looked) {
            looked += 1;
            for i in 0..3 {
                let across = self.faces[here].beside[i];
                if self.faces[across].is_gone {
                    continue;
                }
                if self.beyond(across, point) > 0.0 {
                    self.faces[across].is_gone = true;
                    seen.push(across);
                } else {
                    let corners = self.faces[here].corners;
                    rim.push((corners[i], corners[(i + 1) % 3], across));
                }
            }
        }
        let first = self.faces.len();
        let (mut begins, mut ends) = (BTreeMap::new(), BTreeMap::new());
        for &(from, to, across) in &rim {
            let new = self.add([from, to, point], [across, usize::MAX, usize::MAX])?;
            let edge = (0..3).find(|i| self.faces[across].corners[*i] == to)?;
            self.faces[across].beside[edge] = new;
            if begins.insert(from, new).is_some() || ends.insert(to, new).is_some() {
                return None;
            }
        }
        for (new, &(from, to, _)) in (first..).zip(&rim) {
            self.faces[new].beside[1] = *begins.get(&to)?;
            self.faces[new].beside[2] = *ends.get(&from)?;
        }
        for gone in seen {
            for other in std::mem::take(&mut self.faces[gone].outside) {
                if other != point {
                    self.give(other, first);
                }
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from_all_m(found: &[Capsule], point: Point) -> f64 {
        found.iter().map(|c| from_line_m(point, c) - c.radius_m).fold(f64::INFINITY, f64::min)
    }

    /// Returns the corners, and the same number of random points between them.
    fn dense(corners: &[Point], random: &mut Random) -> Vec<Point> {
        let mut points = corners.to_vec();
        for _ in 0..3000 {
            let mut weights: Vec<f64> = corners.iter().map(|_| random.between(0.0, 1.0).powi(4)).collect();
            let sum: f64 = weights.iter().sum();
            weights.iter_mut().for_each(|weight| *weight /= sum);
            points.push(corners.iter().zip(&weights).map(|(corner, weight)| *corner * *weight).sum());
        }
        points
    }

    /// A link that is thick at its joint and thin at its tip.
    fn club() -> Vec<Point> {
        let ring = |z: f64, radius: f64| {
            (0..24).map(move |k| {
                let (s, c) = (f64::from(k) * std::f64::consts::TAU / 24.0).sin_cos();
                DVec3::new(radius * c, radius * s, z)
            })
        };
        [(0.0, 0.14), (0.1, 0.14), (0.6, 0.03)].into_iter().flat_map(|(z, radius)| ring(z, radius)).collect()
    }

    #[test]
    fn a_cubes_hull_is_its_corners_and_its_edges_enclose_it() {
        let mut random = Random::new(1);
        let corners: Vec<Point> =
            (0..8).map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2))).collect();
        let hull = Hull::around(&dense(&corners, &mut random));
        assert_eq!(hull.points.len(), 8, "{:?}", hull.points);
        // A cube has twelve edges, and a diagonal on each of its six faces.
        assert_eq!(hull.edges.len(), 18);
        let half = hull.side(DVec3::X, 0.5);
        assert!(half.len() >= 8 && half.iter().all(|point| point.x >= 0.5 - 1e-12));
    }

    #[test]
    fn a_ball_of_points_keeps_all_of_its_surface_and_none_of_its_inside() {
        let mut random = Random::new(2);
        let mut on: Vec<Point> =
            (0..500).map(|_| DVec3::from([0; 3].map(|_| random.between(-1.0, 1.0))).normalize()).collect();
        let inside: Vec<Point> = on.iter().map(|point| *point * 0.9).collect();
        on.extend(inside);
        let hull = Hull::around(&on);
        assert_eq!(hull.points.len(), 500);
        // Euler's formula: a closed surface of triangles with n corners has 3n - 6 edges.
        assert_eq!(hull.edges.len(), 3 * 500 - 6);
    }

    #[test]
    fn capsules_hold_every_point_and_all_that_lies_between_them() {
        let mut random = Random::new(3);
        let cube: Vec<Point> = (0..8)
            .map(|k| 0.2 * DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)))
            .collect();
        let flat: Vec<Point> = cube.iter().map(|corner| DVec3::new(corner.x, corner.y, 0.1)).collect();
        let line = vec![DVec3::ZERO, DVec3::X, 0.5 * DVec3::X];
        let random_cloud: Vec<Point> = (0..60)
            .map(|_| {
                DVec3::new(random.between(-0.3, 0.3), random.between(-0.05, 0.05), random.between(0.0, 0.1))
            })
            .collect();
        for (name, corners) in
            [("cube", cube), ("flat", flat), ("line", line), ("club", club()), ("cloud", random_cloud)]
        {
            let found = capsules(&corners);
            assert!((1..=PIECES_MAX).contains(&found.len()), "{name}");
            let furthest = dense(&corners, &mut random)
                .iter()
                .map(|p| from_all_m(&found, *p))
                .fold(f64::NEG_INFINITY, f64::max);
            println!("{name}: {} capsules, outermost {:.2} mm", found.len(), 1000.0 * furthest);
            assert!(furthest <= 0.0, "{name}: {furthest}");
        }
        assert!(capsules(&[]).is_empty());
        let one = capsules(&[DVec3::X; 5]);
        assert_eq!((one.len(), one[0].a_m.distance(DVec3::X) < 1e-9), (1, true));
    }

    #[test]
    fn a_club_becomes_several_capsules_of_which_far_less_stands_out_than_of_one() {
        let points = club();
        let hull = Hull::around(&points);
        let one_m = out_m(&fitted(&points, &hull.planes), &hull.planes);
        let found = capsules(&points);
        let several_m = found.iter().map(|capsule| out_m(capsule, &hull.planes)).fold(0.0, f64::max);
        println!(
            "one stands out by {:.1} mm, {} by {:.1} mm",
            1000.0 * one_m,
            found.len(),
            1000.0 * several_m
        );
        assert!(several_m < 0.7 * one_m);
    }

    #[test]
    fn a_tube_with_round_ends_becomes_the_capsule_that_it_is() {
        let mut random = Random::new(5);
        let mut points = Vec::new();
        for _ in 0..800 {
            let direction = DVec3::from([0; 3].map(|_| random.between(-1.0, 1.0))).normalize();
            points.push(0.05 * direction + DVec3::new(0.0, 0.02, if direction.z > 0.0 { 0.4 } else { 0.1 }));
        }
        let [found] = capsules(&points)[..] else { panic!("one is enough") };
        assert!((found.radius_m - 0.05).abs() < 0.002, "{found:?}");
        assert!((found.a_m.distance(found.b_m) - 0.3).abs() < 0.004, "{found:?}");
    }
}
