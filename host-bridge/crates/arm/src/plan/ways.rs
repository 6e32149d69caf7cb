//! Decides whether the straight way between two configurations is clear.
//!
//! The check of one configuration answers for a stretch around it, because it knows how far each part moves there.
//! A turn moves a point by at most the angle times the point's distance from the axis.
//! The joints beyond this axis change that distance by at most what they move the point.
//! Two links move relative to each other only by the joints between them.
//! Only pairs that could come too near on the stretch are measured exactly.

use std::collections::VecDeque;

use super::clearance::Part;
use super::collision::{Near, Surroundings, between};
use super::hulls::{Bounded, Hulls, LINKS, NEAR_M, Shapes};
use host_robot::shape::{Capsule, SetBox};
use host_robot::{JOINTS, Joints, Pose};

/// This share of the margin is proven everywhere on a clear way.
const PROVEN: f64 = 0.5;

/// What a check finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// At this configuration, something is nearer than the margin.
    Blocked,
    /// The configuration is clear, but the stretch around it may not be.
    Open,
    /// The configuration and the stretch around it are clear.
    Clear,
}

/// How far the parts move at most, on either side of a configuration.
/// `0[link][joint]`: the shapes of a link, by this joint and all joints after it.
struct Moves([[f64; JOINTS + 1]; LINKS]);

impl Moves {
    /// On each side, the joints turn (or slide) by at most `turns_rad`.
    fn new(
        around: &Surroundings<'_>,
        poses: &[Pose; JOINTS + 1],
        shapes: &Shapes,
        turns_rad: &Joints,
    ) -> Self {
        let mut moves = [[0.0; JOINTS + 1]; LINKS];
        if turns_rad.iter().all(|turn| *turn == 0.0) {
            return Moves(moves);
        }
        let (arm, lever_m) = (around.world().arm(), around.world().lever_m());
        let axes: [_; JOINTS] = std::array::from_fn(|i| {
            arm.joints.get(i).map_or(Default::default(), |joint| poses[i].rotation * joint.axis)
        });
        for (link, moves) in moves.iter_mut().enumerate() {
            let mut way_m = 0.0;
            for i in (0..link.min(arm.joints.len())).rev() {
                if arm.joints[i].slides {
                    way_m += turns_rad[i];
                } else if turns_rad[i] > 0.0 {
                    let from_axis_m = |point| axes[i].cross(point - poses[i].position_m).length();
                    let reaches_m = shapes.of(link).iter().map(|Bounded { capsule, .. }| {
                        from_axis_m(capsule.a_m).max(from_axis_m(capsule.b_m)) + capsule.radius_m
                    });
                    way_m += turns_rad[i] * (reaches_m.fold(0.0, f64::max) + way_m).min(lever_m[i]);
                }
                moves[i] = way_m;
            }
        }
        Moves(moves)
    }

    /// Of a link, relative to the base.
    fn of_m(&self, link: usize) -> f64 {
        self.0[link][0]
    }

    /// Of a link, relative to another one that is nearer to the base.
    fn between_m(&self, one: usize, two: usize) -> f64 {
        self.0[two][one]
    }
}

impl Surroundings<'_> {
    /// Returns whether a configuration keeps the margin.
    pub fn is_clear(&self, joints_rad: &Joints, margin_m: f64) -> bool {
        self.look(joints_rad, &[0.0; JOINTS], margin_m) == Found::Clear
    }

    /// Returns whether a straight line in joint space keeps half the margin everywhere.
    /// The full margin applies at checked configurations.
    /// If no checks remain, the line does not count as clear.
    pub fn way_is_clear(&self, from_rad: &Joints, to_rad: &Joints, margin_m: f64) -> bool {
        if self.is_spent() || !self.is_clear(to_rad, margin_m) {
            return false;
        }
        // The longest stretches come first, because they find most obstacles.
        let mut stretches = VecDeque::from([(0.0, 1.0)]);
        while let Some((start, end)) = stretches.pop_front() {
            if self.is_spent() {
                return false;
            }
            let middle = 0.5 * (start + end);
            let turns_rad = std::array::from_fn(|i| 0.5 * (end - start) * (to_rad[i] - from_rad[i]).abs());
            match self.look(&between(from_rad, to_rad, middle), &turns_rad, margin_m) {
                Found::Blocked => return false,
                Found::Open => stretches.extend([(start, middle), (middle, end)]),
                Found::Clear => {}
            }
        }
        true
    }

    /// Checks a configuration and the stretch around it, on which the joints turn by at most `turns_rad` to each side.
    fn look(&self, joints_rad: &Joints, turns_rad: &Joints, margin_m: f64) -> Found {
        self.pay(1);
        let world = self.world();
        let poses = world.arm().link_poses(joints_rad);
        let shapes = world.shapes(&poses, &self.on_flange);
        let hulls = Hulls { arm: world.arm(), on_flange: &self.on_flange, poses: &poses };
        let moves = Moves::new(self, &poses, &shapes, turns_rad);
        let enough_m = |moves_m: f64| margin_m.max(PROVEN * margin_m + moves_m);
        let mut look = Look { margin_m, is_open: false, near: Vec::new() };
        // The outer links are usually the first to touch anything.
        for link in (0..world.tool_link() + 3).rev() {
            let (part, capsules) = (world.part(link), shapes.of(link));
            let exact = |pair: Near| hulls.has(link).then_some(pair);
            let enough_m = enough_m(moves.of_m(link));
            let least = |of: &dyn Fn(&Capsule) -> f64| {
                capsules.iter().map(|shape| of(&shape.capsule)).fold(enough_m, f64::min)
            };
            for (i, ((other, _), obstacle)) in self.boxes.iter().zip(&self.set_boxes).enumerate() {
                let distance_m = self.allowed_m(obstacle_m(capsules, obstacle, enough_m), part, *other);
                if !look.judge(distance_m, enough_m, exact(Near::Box(link, i))) {
                    return Found::Blocked;
                }
            }
            // The arm's fixed base and first link never come closer to the mobile base or to the floor.
            if link >= 2 {
                let floor_m = least(&|capsule| capsule.lowest_m() - self.floor_m);
                let base_m = obstacle_m(capsules, &self.base, enough_m);
                if !look.judge(self.allowed_m(floor_m, part, Part::Floor), enough_m, None)
                    || !look.judge(base_m, enough_m, exact(Near::Base(link)))
                {
                    return Found::Blocked;
                }
            }
        }
        for &(one, two) in &world.pairs {
            let enough_m = enough_m(moves.between_m(one, two));
            let exact = (hulls.has(one) && hulls.has(two)).then_some(Near::Links(one, two));
            if !look.judge(shapes.pair_m(one, two, enough_m), enough_m, exact) {
                return Found::Blocked;
            }
        }
        for (capsules_m, enough_m, pair) in std::mem::take(&mut look.near) {
            let (exact_m, one, two) = self.exact_m(&hulls, &pair, enough_m);
            let distance_m = self.allowed_m(capsules_m.max(exact_m), one, two);
            if !look.judge(distance_m, enough_m, None) {
                return Found::Blocked;
            }
        }
        if look.is_open { Found::Open } else { Found::Clear }
    }
}

/// Returns the distance from the capsules of a part to a box, but at most `within_m`.
fn obstacle_m(capsules: &[Bounded], obstacle: &SetBox, within_m: f64) -> f64 {
    let mut nearest_m = within_m;
    for shape in capsules {
        if obstacle.distance_to_point_m(shape.middle_m) - shape.reach_m < nearest_m {
            nearest_m = nearest_m.min(obstacle.distance_to_capsule_m(&shape.capsule));
        }
    }
    nearest_m
}

/// What a check has found so far.
struct Look {
    margin_m: f64,
    /// Some pair could come too near on the stretch.
    is_open: bool,
    /// Pairs whose capsules are too near each other, with the distance of the capsules and the distance that is enough.
    /// Their hulls are compared at the end.
    near: Vec<(f64, f64, Near)>,
}

impl Look {
    /// Returns false if the distance of a pair is less than the margin.
    fn judge(&mut self, distance_m: f64, enough_m: f64, exact: Option<Near>) -> bool {
        if distance_m >= enough_m {
            return true;
        }
        if let Some(pair) = exact
            && distance_m < NEAR_M
        {
            self.near.push((distance_m, enough_m, pair));
            return true;
        }
        self.is_open = true;
        distance_m >= self.margin_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SerialArm;
    use crate::plan::collision::{Placement, World};
    use crate::scene::Scene;
    use host_robot::{DMat3, DVec3, Random};

    /// The capsule ends of a link, seen from another link's frame.
    fn ends_m(world: &World, joints_rad: &Joints, link: usize, from: Option<usize>) -> Vec<DVec3> {
        let poses = world.arm().link_poses(joints_rad);
        let shapes = world.shapes(&poses, &world.on_flange(world.start()));
        let seen = |point: DVec3| match from {
            None => point,
            Some(joint) => poses[joint].rotation.transpose() * (point - poses[joint].position_m),
        };
        shapes.of(link).iter().flat_map(|shape| [seen(shape.capsule.a_m), seen(shape.capsule.b_m)]).collect()
    }

    #[test]
    fn no_part_moves_further_than_is_said_neither_in_the_room_nor_seen_from_another_link() {
        let mut sliding = SerialArm::gen3();
        let third = &mut sliding.joints[2];
        (third.slides, third.limit_rad, third.origin_rotation) = (true, Some((-0.3, 0.3)), DMat3::IDENTITY);
        for arm in [SerialArm::gen3(), sliding] {
            let scene =
                Scene::parse("[[tool]]\nname = \"2f-85\"\n[[tool]]\nname = \"gen3-vision\"\n").unwrap();
            let world = World::new(arm, scene);
            let around = world.around(Placement::default());
            let count = world.arm().joints.len();
            let (mut random, mut used) = (Random::new(5), 0.0_f64);
            for _ in 0..300 {
                let turns_rad: Joints = std::array::from_fn(|_| random.between(0.0, 0.4).powi(2));
                let middle: Joints = std::array::from_fn(|i| {
                    let (low, high) =
                        world.arm().joints.get(i).and_then(|j| j.limit_rad).unwrap_or((-3.0, 3.0));
                    random.between(low, high)
                });
                let poses = world.arm().link_poses(&middle);
                let shapes = world.shapes(&poses, &around.on_flange);
                let moves = Moves::new(&around, &poses, &shapes, &turns_rad);
                // The ends of the turns move points furthest.
                let moved: Joints = std::array::from_fn(|i| {
                    middle[i] + turns_rad[i] * [-1.0, 1.0, random.between(-1.0, 1.0)][random.below(3)]
                });
                for two in 1..count + 3 {
                    for one in 0..two.min(count) {
                        let from = one.checked_sub(1);
                        let said_m = moves.between_m(one, two);
                        let (here, there) =
                            (ends_m(&world, &middle, two, from), ends_m(&world, &moved, two, from));
                        for (a, b) in here.iter().zip(&there) {
                            assert!(
                                a.distance(*b) <= said_m + 1e-12,
                                "{one} {two}: {} {said_m}",
                                a.distance(*b)
                            );
                            used = used.max(a.distance(*b) / said_m.max(1e-9));
                        }
                    }
                    assert_eq!(moves.of_m(two), moves.between_m(0, two));
                }
            }
            // The bound is not loose, so a bound that is too small would be noticed.
            println!("a point moves {:.0} % of what is said, at most", 100.0 * used);
            assert!(used > 0.9, "{used}");
        }
    }

    #[test]
    fn a_configuration_is_clear_exactly_if_its_clearance_is_the_margin() {
        let scene = "[[box]]\nname = \"post\"\ncenter_m = [0.55, 0.0, 0.8]\nsize_m = [0.1, 0.1, 0.8]";
        let world = World::new(SerialArm::gen3(), Scene::parse(scene).unwrap());
        let around = world.around(Placement::default());
        let (mut random, mut clear) = (Random::new(9), 0);
        for _ in 0..2000 {
            let joints_rad: Joints = std::array::from_fn(|_| random.between(-2.0, 2.0));
            let margin_m = random.between(0.001, 0.2);
            let is_clear = around.is_clear(&joints_rad, margin_m);
            assert_eq!(is_clear, around.arm_clearance(&joints_rad).distance_m >= margin_m);
            clear += usize::from(is_clear);
        }
        assert!((200..1800).contains(&clear), "{clear}");
    }
}
