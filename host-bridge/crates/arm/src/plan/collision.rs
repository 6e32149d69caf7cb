//! Computes distances between the robot's parts, and to the surroundings.
//!
//! Checks of the path between two configurations are exact; they are not sampled ([`Surroundings::way_is_clear`]).

use std::cell::Cell;

use crate::model::SerialArm;
pub use crate::plan::clearance::{Clearance, Part};
use crate::plan::hulls::{Hulls, NEAR_M, OnFlange, Shapes};
use crate::plan::purse::Purse;
use crate::scene::{NamedBox, Scene};
use crate::solid::Solid;
use crate::things::{Shop, Things, Touch};
use crate::tool::Tool;
use host_robot::shape::{Capsule, SetBox, UprightBox};
use host_robot::{DMat3, DVec3, JOINTS, Joints, Pose};
use host_robot::{Odometry, Random};

/// Maximum overlap with a support, because the shapes around a held object are 6 mm too large.
const SINKS_M: f64 = 0.010;

/// Links that are two joints apart, and never closer than this distance, are not checked.
const APART_M: f64 = 0.004;

/// Where the base stands in the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Forward of the scene's origin.
    pub x_m: f64,
    /// Left of it.
    pub y_m: f64,
    /// Turned to the left.
    pub heading_rad: f64,
}

impl From<Odometry> for Placement {
    fn from(odometry: Odometry) -> Self {
        Placement { x_m: odometry.x_m, y_m: odometry.y_m, heading_rad: odometry.heading_rad }
    }
}

/// Robot and scene: everything that can collide.
#[derive(Clone, Debug)]
pub struct World {
    arm: SerialArm,
    scene: Scene,
    lever_m: Joints,
    tool: Tool,
    /// Pairs of links that can touch. Tool, fingers and held object follow the last link.
    pub(super) pairs: Vec<(usize, usize)>,
    start: Things,
    notes: Vec<String>,
}

impl World {
    /// Places an arm in a scene.
    pub fn new(arm: SerialArm, scene: Scene) -> Self {
        let links = arm.joints.len() + 1;
        let tool = scene.tool();
        // The bound covers any object that could be held, so it does not change while an object is held.
        let held_m = if tool.hand().is_none() {
            0.0
        } else {
            scene.objects.iter().map(|o| o.reach_m()).fold(0.0, f64::max)
        };
        let held_m = if held_m > 0.0 { held_m + tool.reach_m() } else { 0.0 };
        let lever_m = arm.lever_with_m(tool.reach_m().max(held_m));
        let mut world = World {
            lever_m,
            tool,
            arm,
            scene,
            pairs: Vec::new(),
            start: Things::default(),
            notes: Vec::new(),
        };
        world.start = world.shop().at_start();
        // Adjacent links share a joint and always touch; the joint's limits keep them from colliding.
        let pairs = (0..links).flat_map(|one| (one + 2..links).map(move |two| (one, two)));
        let pairs = pairs.filter(|&(one, two)| !world.arm.is_telescope(one, two));
        world.pairs = pairs.filter(|&(one, two)| two > one + 2 || world.can_touch(one, two)).collect();
        if !world.tool.is_none() {
            // The tool and a held object have the same neighbours as the last link.
            let last = links - 1;
            let near = |one: usize| {
                one + 2 < last || (one + 2 == last && [0, 1].iter().any(|k| world.can_touch(one, links + k)))
            };
            let pairs: Vec<_> = (0..last).filter(|&one| near(one)).collect();
            world.pairs.extend(pairs.iter().flat_map(|&one| [0, 1, 2].map(|k| (one, links + k))));
        }
        world.drop_pairs_that_always_touch();
        world
    }

    /// Some links touch in any configuration, because the arm's axes meet in a wrist.
    /// Checking such pairs would refuse every motion.
    /// As in MoveIt's setup, such pairs are ignored.
    fn drop_pairs_that_always_touch(&mut self) {
        const BENT: usize = 400;
        let mut random = Random::new(25);
        let on_flange = self.on_flange(&self.start);
        let mut always = self.pairs.clone();
        for _ in 0..BENT {
            // A pair that is clear once can collide. Usually, few configurations clear all such pairs.
            if always.is_empty() {
                return;
            }
            let mut joints_rad = [0.0; JOINTS];
            for (angle, joint) in joints_rad.iter_mut().zip(&self.arm.joints) {
                let pi = std::f64::consts::PI;
                let (low, high) = joint.limit_rad.unwrap_or((-pi, pi));
                *angle = random.between(low, high);
            }
            always.retain(|&(one, two)| self.touch(&joints_rad, &on_flange, one, two));
        }
        if always.is_empty() {
            return;
        }
        let names: Vec<String> = always
            .iter()
            .map(|&(one, two)| format!("{} and {}", self.name(self.part(one)), self.name(self.part(two))))
            .collect();
        self.notes
            .push(format!("not held apart, for they touch however the arm is bent: {}", names.join(", ")));
        self.pairs.retain(|pair| !always.contains(pair));
    }

    /// Returns objects, boxes and tool, for gripping.
    pub fn shop(&self) -> Shop<'_> {
        Shop { objects: &self.scene.objects, boxes: &self.scene.boxes, tool: &self.tool }
    }

    /// What is on the flange.
    pub fn tool(&self) -> &Tool {
        &self.tool
    }

    /// Returns notes about everything that is ignored, for users.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the tool and the objects as the scene defines them.
    pub fn start(&self) -> &Things {
        &self.start
    }

    /// Returns whether two links that are two joints apart can touch within the limits of those joints.
    /// As in MoveIt's setup, pairs that never touch are ignored.
    /// The constant proximity of such pairs would hide everything else.
    fn can_touch(&self, link: usize, other: usize) -> bool {
        const STEPS: usize = 48;
        let range = |joint: usize| {
            let pi = std::f64::consts::PI;
            let (low, high) = self.arm.joints[joint].limit_rad.unwrap_or((-pi, pi));
            (0..=STEPS).map(move |k| low + (high - low) * k as f64 / STEPS as f64)
        };
        // Fingers at any possible position.
        let on_flange = self.on_flange(&Things { opening_m: None, ..self.start.clone() });
        range(link).any(|first| {
            range(link + 1).any(|second| {
                let mut joints_rad = [0.0; JOINTS];
                (joints_rad[link], joints_rad[link + 1]) = (first, second);
                self.touch(&joints_rad, &on_flange, link, other)
            })
        })
    }

    /// Returns whether two parts touch: their capsules touch, and their hulls do not prove a gap between them.
    fn touch(&self, joints_rad: &Joints, on_flange: &OnFlange, one: usize, two: usize) -> bool {
        let poses = self.arm.link_poses(joints_rad);
        let shapes = self.shapes(&poses, on_flange);
        shapes.pair_m(one, two, f64::INFINITY) <= 0.0
            && Hulls { arm: &self.arm, on_flange, poses: &poses }.pair_m(one, two, APART_M) < APART_M
    }

    /// The arm.
    pub fn arm(&self) -> &SerialArm {
        &self.arm
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the maximum displacement of any point of the arm per radian of each joint, in m.
    pub fn lever_m(&self) -> &Joints {
        &self.lever_m
    }

    /// Name of a part, for people.
    pub fn name(&self, part: Part) -> &str {
        match part {
            Part::Link(0) => "the arm's foot",
            Part::Link(link) => self.arm.joints.get(link - 1).map_or("the arm", |joint| &joint.name),
            Part::Base => "the base",
            Part::Tool => self.tool.name(),
            Part::Fingers => "the gripper's fingers",
            Part::Held => "what it holds",
            Part::Box(i) => &self.scene.boxes[i].name,
            Part::Object(i) => &self.scene.objects[i].name,
            Part::Floor => "the floor",
        }
    }

    /// Returns the arm's surroundings with the base at this placement, and tool and objects as in the scene.
    pub fn around(&self, placement: Placement) -> Surroundings<'_> {
        self.around_with(placement, &self.start)
    }

    /// Like [`Self::around`], but with the current tool and objects.
    pub fn around_with<'w>(&'w self, placement: Placement, things: &'w Things) -> Surroundings<'w> {
        let mount_m = self.scene.base.mount_m;
        let from_world = DMat3::from_rotation_z(-placement.heading_rad);
        let here = DVec3::new(placement.x_m, placement.y_m, 0.0);
        let fixed = self.scene.boxes.iter().map(NamedBox::shape).enumerate();
        let fixed = fixed.map(|(i, shape)| (Part::Box(i), shape));
        let standing = self.shop().standing(things).into_iter().map(|(i, shape)| (Part::Object(i), shape));
        let boxes: Vec<_> = fixed
            .chain(standing)
            .map(|(part, b)| {
                let center_m = from_world * (b.center_m - here) - mount_m;
                (part, UprightBox { center_m, half_m: b.half_m, yaw_rad: b.yaw_rad - placement.heading_rad })
            })
            .collect();
        let mut body = self.scene.base.body();
        body.center_m -= mount_m;
        let floor_m = -mount_m.z;
        Surroundings {
            world: self,
            touch: &things.touch,
            on_flange: self.on_flange(things),
            solids: boxes.iter().map(|(_, shape)| Solid::of_box(shape)).collect(),
            set_boxes: boxes.iter().map(|(_, shape)| SetBox::from(shape)).collect(),
            boxes,
            base_solid: Solid::of_box(&body),
            base: SetBox::from(&body),
            body,
            floor_m,
            checks: Cell::new(0),
            purse: None,
        }
    }

    /// Returns the tool's number among the links; fingers and held object follow.
    pub(super) fn tool_link(&self) -> usize {
        self.arm.joints.len() + 1
    }

    pub(super) fn part(&self, link: usize) -> Part {
        match link.checked_sub(self.tool_link()) {
            None => Part::Link(link),
            Some(0) => Part::Tool,
            Some(1) => Part::Fingers,
            Some(_) => Part::Held,
        }
    }

    /// Returns the numbered shapes of tool, fingers and held object in the flange's frame.
    pub(super) fn on_flange(&self, things: &Things) -> OnFlange {
        if self.tool.is_none() {
            return OnFlange::default();
        }
        let link = self.tool_link();
        let fixed = self.tool.fixed().iter().map(|c| (link, *c));
        let fingers = self.tool.fingers(things.opening_m).into_iter().map(|c| (link + 1, c));
        let held = self.shop().held_shapes(things).into_iter().map(|c| (link + 2, c));
        OnFlange::new(fixed.chain(fingers).chain(held).collect(), link, &self.arm)
    }

    /// Returns the shapes of base, links, tool and held object in the arm's frame.
    pub(super) fn shapes(&self, poses: &[Pose; JOINTS + 1], on_flange: &OnFlange) -> Shapes {
        let foot = self.arm.foot.iter().map(|shape| (0, *shape));
        let joints = self.arm.joints.iter().zip(poses).enumerate();
        let links = joints.flat_map(|(i, (joint, pose))| {
            joint.shapes.iter().map(move |shape| (i + 1, shape.seen_from(pose)))
        });
        let flange = &poses[JOINTS];
        let on_flange = on_flange.capsules.iter().map(|(link, shape)| (*link, shape.seen_from(flange)));
        Shapes::new(foot.chain(links).chain(on_flange))
    }
}

/// Two parts whose hulls are compared.
pub(super) enum Near {
    /// A link and the base.
    Base(usize),
    /// A link and an obstacle.
    Box(usize, usize),
    /// Two links.
    Links(usize, usize),
}

/// The scene from the arm's point of view at one placement. This type also counts the checks.
#[derive(Clone, Debug)]
pub struct Surroundings<'w> {
    world: &'w World,
    touch: &'w Touch,
    pub(super) on_flange: OnFlange,
    pub(super) boxes: Vec<(Part, UprightBox)>,
    /// The same boxes, prepared for many distances.
    pub(super) set_boxes: Vec<SetBox>,
    /// The boxes as solids, for measuring their distances from hulls.
    solids: Vec<Solid>,
    body: UprightBox,
    pub(super) base: SetBox,
    base_solid: Solid,
    pub(super) floor_m: f64,
    checks: Cell<u64>,
    purse: Option<&'w Purse>,
}

impl<'w> Surroundings<'w> {
    /// Subtracts each check from this purse. When the purse is empty, every path counts as blocked.
    #[must_use]
    pub fn paid_from(self, purse: &'w Purse) -> Self {
        Surroundings { purse: Some(purse), ..self }
    }

    /// Returns whether there are no checks left.
    pub fn is_spent(&self) -> bool {
        self.purse.is_some_and(Purse::is_empty)
    }

    /// Returns the underlying world.
    pub fn world(&self) -> &World {
        self.world
    }

    /// Returns the number of complete checks of a configuration.
    pub fn checks(&self) -> u64 {
        self.checks.get()
    }

    /// Counts checks, and pays for them.
    pub(super) fn pay(&self, checks: u64) {
        self.checks.set(self.checks.get() + checks);
        if let Some(purse) = self.purse {
            purse.spend(checks);
        }
    }

    /// Returns the arm's closest distance to itself, the base, the boxes and the floor.
    pub fn arm_clearance(&self, joints_rad: &Joints) -> Clearance {
        let (own, boxes) = self.arm_clearances(joints_rad);
        if own.distance_m < boxes.distance_m { own } else { boxes }
    }

    /// Returns two separate distances.
    /// The first is to the robot itself and the floor, and is independent of the base.
    /// The second is to the boxes.
    pub fn arm_clearances(&self, joints_rad: &Joints) -> (Clearance, Clearance) {
        self.pay(1);
        let world = self.world;
        let poses = world.arm.link_poses(joints_rad);
        let shapes = world.shapes(&poses, &self.on_flange);
        let hulls = Hulls { arm: &world.arm, on_flange: &self.on_flange, poses: &poses };
        let (mut own, mut boxes) = (Clearance::NOTHING, Clearance::NOTHING);
        // Pairs with hulls whose capsules are near each other. Their hulls are compared at the end.
        let (mut near_own, mut near_boxes) = (Vec::new(), Vec::new());
        for link in 0..world.tool_link() + 3 {
            let (part, capsules) = (world.part(link), shapes.of(link));
            let is_exact = hulls.has(link);
            // The arm's fixed base and first link never come closer to the mobile base or to the floor.
            if link >= 2 {
                let least = |of: &dyn Fn(&Capsule) -> f64| {
                    capsules.iter().map(|shape| of(&shape.capsule)).fold(f64::INFINITY, f64::min)
                };
                let base_m = least(&|capsule| self.base.distance_to_capsule_m(capsule));
                if is_exact && base_m < NEAR_M {
                    near_own.push((base_m, Near::Base(link)));
                } else {
                    own.tighten(base_m, part, Part::Base);
                }
                let floor_m = least(&|capsule| capsule.lowest_m() - self.floor_m);
                own.tighten(self.allowed_m(floor_m, part, Part::Floor), part, Part::Floor);
            }
            for (i, ((other, _), obstacle)) in self.boxes.iter().zip(&self.set_boxes).enumerate() {
                let mut distance_m = boxes.distance_m;
                for shape in capsules {
                    if obstacle.distance_to_point_m(shape.middle_m) - shape.reach_m < distance_m {
                        distance_m = distance_m.min(obstacle.distance_to_capsule_m(&shape.capsule));
                    }
                }
                // Hulls are further apart than capsules, so pairs that may touch are left out here already.
                if distance_m >= boxes.distance_m || self.allowed_m(distance_m, part, *other).is_infinite() {
                    continue;
                }
                if is_exact && distance_m < NEAR_M {
                    near_boxes.push((distance_m, Near::Box(link, i)));
                } else {
                    boxes.tighten(distance_m, part, *other);
                }
            }
        }
        for &(one, two) in &world.pairs {
            let distance_m = shapes.pair_m(one, two, own.distance_m);
            if distance_m < own.distance_m.min(NEAR_M) && hulls.has(one) && hulls.has(two) {
                near_own.push((distance_m, Near::Links(one, two)));
            } else {
                own.tighten(distance_m, world.part(one), world.part(two));
            }
        }
        self.compare_hulls(&hulls, near_own, &mut own);
        self.compare_hulls(&hulls, near_boxes, &mut boxes);
        (own, boxes)
    }

    /// Compares the hulls of pairs once each, in the order of the distances between their capsules.
    /// The comparison ends when even the capsules are further apart than the nearest pair.
    fn compare_hulls(&self, hulls: &Hulls<'_>, mut near: Vec<(f64, Near)>, nearest: &mut Clearance) {
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (capsules_m, pair) in near {
            let enough_m = nearest.distance_m;
            if capsules_m >= enough_m {
                return;
            }
            let (exact_m, one, two) = self.exact_m(hulls, &pair, enough_m);
            nearest.tighten(self.allowed_m(capsules_m.max(exact_m), one, two), one, two);
        }
    }

    /// Returns a lower bound of the distance between the hulls of a pair, but at most `enough_m`, and the two parts.
    pub(super) fn exact_m(&self, hulls: &Hulls<'_>, pair: &Near, enough_m: f64) -> (f64, Part, Part) {
        let (exact_m, one, two) = match *pair {
            Near::Base(link) => (hulls.part_from_m(link, &self.base_solid, enough_m), link, Part::Base),
            Near::Box(link, i) => (hulls.part_from_m(link, &self.solids[i], enough_m), link, self.boxes[i].0),
            Near::Links(one, two) => (hulls.pair_m(one, two, enough_m), one, self.world.part(two)),
        };
        (exact_m, self.world.part(one), two)
    }

    /// Returns the distance, or infinity if the two parts may touch.
    /// On the straight path to or from an object, the fingers may touch the object.
    /// A held object may touch its support, but must not sink into it.
    pub(super) fn allowed_m(&self, distance_m: f64, part: Part, other: Part) -> f64 {
        let touch = self.touch;
        let allowed = match (part, other) {
            (Part::Fingers, Part::Object(i)) => touch.object == Some(i),
            (Part::Held, Part::Box(i)) => touch.boxes.contains(&i) && distance_m >= -SINKS_M,
            (Part::Held, Part::Floor) => touch.floor && distance_m >= -SINKS_M,
            _ => false,
        };
        if allowed { f64::INFINITY } else { distance_m }
    }

    /// Returns the base's closest distance to the boxes.
    pub fn base_clearance(&self) -> Clearance {
        let mut nearest = Clearance::NOTHING;
        for (part, obstacle) in &self.boxes {
            nearest.tighten(self.body.distance_m(obstacle), Part::Base, *part);
        }
        nearest
    }

    /// Returns the maximum displacement of any point of the arm between two configurations.
    pub fn sweep_m(&self, from_rad: &Joints, to_rad: &Joints) -> f64 {
        (0..JOINTS).map(|i| (to_rad[i] - from_rad[i]).abs() * self.world.lever_m[i]).sum()
    }
}

/// Returns a point on the straight line between two configurations.
pub fn between(from_rad: &Joints, to_rad: &Joints, share: f64) -> Joints {
    std::array::from_fn(|i| from_rad[i] + share * (to_rad[i] - from_rad[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3::HOME;
    use crate::motions::Motions;
    use host_robot::joints;

    fn world(scene: &str) -> World {
        World::new(SerialArm::gen3(), Scene::parse(scene).unwrap())
    }

    #[test]
    fn the_named_poses_are_clear_of_the_robot_itself() {
        let world = world("");
        let around = world.around(Placement::default());
        let motions = Motions::paper();
        for (name, joints) in motions.poses() {
            let nearest = around.arm_clearance(joints);
            println!("{:.3} m {:?}", nearest.distance_m, nearest.parts);
            assert!(nearest.distance_m > 0.02, "{name}: {nearest:?} {joints:?}");
        }
    }

    #[test]
    fn of_the_gen3_no_link_can_touch_the_next_but_one() {
        let world = world("");
        assert!(world.pairs.iter().all(|(one, two)| two - one >= 3), "{:?}", world.pairs);
        assert_eq!(world.pairs.len(), 15);
    }

    #[test]
    fn a_folded_arm_meets_itself_and_a_bowing_one_the_base() {
        let world = world("");
        let around = world.around(Placement::default());
        let folded = around.arm_clearance(&joints([0.0, 0.0, 0.0, 2.5, 0.0, 1.6, 0.0]));
        assert!(
            folded.distance_m < 0.0 && matches!(folded.parts, (Part::Link(_), Part::Link(_))),
            "{folded:?}"
        );
        let bowing = around.arm_clearance(&joints([1.57, 2.2, 0.0, 0.5]));
        assert!(bowing.distance_m < 0.0, "{bowing:?}");
        assert!(matches!(bowing.parts, (Part::Link(_), Part::Base | Part::Floor)), "{bowing:?}");
    }

    #[test]
    fn boxes_stay_where_they_are_when_the_base_moves() {
        let world = world("[[box]]\nname = \"post\"\ncenter_m = [2.0, 0.5, 0.5]\nsize_m = [0.2, 0.2, 1.0]");
        // Half of the base's length is 0.3 m, so the distance straight ahead is 2.0 - 0.1 - 0.3.
        let at = |x_m, y_m, heading_rad| {
            world.around(Placement { x_m, y_m, heading_rad }).base_clearance().distance_m
        };
        assert!((at(1.0, 0.5, 0.0) - 0.6).abs() < 1e-12);
        assert!((at(2.0, -0.5, std::f64::consts::FRAC_PI_2) - 0.6).abs() < 1e-12);
        assert_eq!(at(2.0, 0.5, 0.7), 0.0);
        let nearest = world.around(Placement { x_m: 1.3, y_m: 0.5, heading_rad: 0.0 });
        let reaching = nearest.arm_clearance(&joints([0.0, 1.57]));
        assert!(reaching.distance_m < 0.0 && reaching.parts.1 == Part::Box(0), "{reaching:?}");
        assert_eq!(world.name(reaching.parts.1), "post");
    }

    #[test]
    fn a_clear_way_is_clear_wherever_one_looks() {
        let world = world("[[box]]\nname = \"post\"\ncenter_m = [0.55, 0.0, 0.8]\nsize_m = [0.1, 0.1, 0.8]");
        let around = world.around(Placement::default());
        let (mut random, mut clear, mut blocked) = (Random::new(7), 0, 0);
        for _ in 0..300 {
            let mut pick = || -> Joints { std::array::from_fn(|i| HOME[i] + random.between(-1.0, 1.0)) };
            let (from, to) = (pick(), pick());
            if world.arm().check(&from).and(world.arm().check(&to)).is_err() {
                continue;
            }
            if around.arm_clearance(&from).distance_m < 0.01 {
                continue;
            }
            let least = (0..=400)
                .map(|k| around.arm_clearance(&between(&from, &to, f64::from(k) / 400.0)).distance_m)
                .fold(f64::INFINITY, f64::min);
            if around.way_is_clear(&from, &to, 0.01) {
                assert!(least >= 0.005, "{least}");
                clear += 1;
            } else {
                assert!(least < 0.0101, "{least}");
                blocked += 1;
            }
        }
        assert!(clear > 20 && blocked > 20, "{clear} {blocked}");
    }
}
