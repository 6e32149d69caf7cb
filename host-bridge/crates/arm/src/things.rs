//! Objects of a scene that can be gripped.
//! The module knows their positions, the object between the fingers, and the held object.
//!
//! ```toml
//! [[object]]
//! name = "cup"
//! at_m = [0.7, 0.0, 0.55]     # the middle of its underside, from the robot's start on the floor
//! height_m = 0.1
//! radius_m = 0.03             # round; or size_m = [0.05, 0.04] for a box, with yaw_rad
//! ```

use host_robot::shape::{Capsule, Point, UprightBox};
use host_robot::{DMat3, DVec3, Pose, SceneObject};
use serde::Deserialize;

use crate::plan::Placement;
use crate::scene::NamedBox;
use crate::tool::Tool;

/// Radius of the rods around a held object's edges.
const ROD_M: f64 = 0.006;
/// Maximum distance of an object's centre from the tool's point along the fingers.
const PAD_M: f64 = 0.02;
/// Boxes whose top is within this distance of an object's underside support it.
const CARRIES_M: f64 = 0.02;

/// An object as written in a file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectTable {
    /// Name of the object, which must differ from the names of other objects and boxes.
    pub name: String,
    /// Centre of the object's bottom face.
    pub at_m: Point,
    /// Upwards.
    pub height_m: f64,
    /// Radius of a round object.
    pub radius_m: Option<f64>,
    /// Length and width of a box.
    pub size_m: Option<[f64; 2]>,
    /// Turned to the left.
    #[serde(default)]
    pub yaw_rad: f64,
}

impl ObjectTable {
    /// Checks that all values are valid.
    ///
    /// # Errors
    /// Returns a text that names the object and the valid values.
    pub fn check(&self) -> Result<(), String> {
        let is_length = |m: f64| m.is_finite() && m > 0.0 && m <= 2.0;
        let sound = match (self.radius_m, self.size_m) {
            (Some(radius_m), None) => is_length(radius_m),
            (None, Some(size_m)) => size_m.into_iter().all(is_length),
            _ => false,
        };
        if sound && is_length(self.height_m) && self.at_m.is_finite() && self.yaw_rad.is_finite() {
            return Ok(());
        }
        Err(format!(
            "object '{}' needs at_m, height_m, and either radius_m or size_m = [length, width], each between 0 and 2 m",
            self.name
        ))
    }

    /// Half of the object's length and width.
    fn half_m(&self) -> [f64; 2] {
        self.size_m.map_or([self.radius_m.unwrap_or_default(); 2], |size| size.map(|m| 0.5 * m))
    }

    /// Returns the initial pose of the object.
    fn start(&self) -> Pose {
        Pose { position_m: self.at_m, rotation: DMat3::from_rotation_z(self.yaw_rad) }
    }

    /// Returns the object's width along a direction in its own frame.
    fn width_m(&self, along: DVec3) -> f64 {
        let upward = self.height_m * along.z.abs();
        match self.size_m {
            Some([length, width]) => length * along.x.abs() + width * along.y.abs() + upward,
            None => 2.0 * self.half_m()[0] * along.x.hypot(along.y) + upward,
        }
    }

    /// Returns the maximum distance between two of the object's points, because a gripper may hold it anywhere.
    pub fn reach_m(&self) -> f64 {
        let [length, width] = self.half_m();
        DVec3::new(2.0 * length, 2.0 * width, self.height_m).length() + ROD_M
    }

    /// Returns capsules that enclose the object in its own frame: rods along its edges, and its interior.
    fn shapes(&self) -> Vec<Capsule> {
        let [length, width] = self.half_m();
        let rods = |x: f64, y: f64| Capsule {
            a_m: DVec3::new(x, y, 0.0),
            b_m: DVec3::new(x, y, self.height_m),
            radius_m: ROD_M,
        };
        let mut shapes: Vec<Capsule> = match self.radius_m {
            Some(radius_m) => (0..8)
                .map(|k| {
                    let (y, x) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
                    rods(radius_m * x, radius_m * y)
                })
                .collect(),
            None => [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
                .map(|(x, y)| rods(x * length, y * width))
                .to_vec(),
        };
        let within = length.min(width).min(0.5 * self.height_m);
        let (a, b) = (DVec3::Z * within, DVec3::Z * (self.height_m - within));
        shapes.push(Capsule { a_m: a, b_m: b, radius_m: length.min(width) });
        shapes
    }

    /// Returns the object in the form that pictures show.
    pub fn picture(&self, at: Pose) -> SceneObject {
        SceneObject {
            name: self.name.clone(),
            height_m: self.height_m,
            radius_m: self.radius_m,
            half_m: self.half_m(),
            pose: at,
        }
    }

    /// Returns the upright bounding box of the object at its current position.
    fn standing(&self, at: &Pose) -> UprightBox {
        let [length, width] = self.half_m();
        let ahead = at.rotation.x_axis;
        UprightBox {
            center_m: at.position_m + 0.5 * self.height_m * DVec3::Z,
            half_m: DVec3::new(length, width, 0.5 * self.height_m),
            yaw_rad: ahead.y.atan2(ahead.x),
        }
    }
}

/// Where an object is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObjectPose {
    /// The object stands at this pose, relative to the scene's origin.
    Stands(Pose),
    /// The gripper holds the object at this pose, relative to the flange.
    Held(Pose),
}

impl ObjectPose {
    /// Returns the object's pose relative to the scene's origin. `flange` is the pose of the flange.
    pub fn pose(&self, flange: &Pose) -> Pose {
        match self {
            ObjectPose::Stands(at) => *at,
            ObjectPose::Held(on_flange) => flange.then(on_flange.position_m, on_flange.rotation),
        }
    }
}

/// The permitted contacts of a hand that moves straight to an object or away from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Touch {
    /// The tool may touch this object.
    pub object: Option<usize>,
    /// The held object may touch these boxes, which support it.
    pub boxes: Vec<usize>,
    /// The held object may touch the floor.
    pub floor: bool,
}

/// The current state of the tool and the scene's objects.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Things {
    /// Distance between the fingers. If it is `None`, all positions of the fingers are checked.
    pub opening_m: Option<f64>,
    /// One entry per object of the scene.
    pub poses: Vec<ObjectPose>,
    /// The contacts that are permitted now.
    pub touch: Touch,
}

impl Things {
    /// Returns the held object and its pose relative to the flange.
    pub fn held(&self) -> Option<(usize, Pose)> {
        self.poses.iter().enumerate().find_map(|(i, pose)| match pose {
            ObjectPose::Held(at) => Some((i, *at)),
            ObjectPose::Stands(_) => None,
        })
    }
}

/// A scene's information about its objects.
#[derive(Clone, Copy, Debug)]
pub struct Shop<'a> {
    /// The objects.
    pub objects: &'a [ObjectTable],
    /// Boxes that may support the objects.
    pub boxes: &'a [NamedBox],
    /// Who grips.
    pub tool: &'a Tool,
}

impl Shop<'_> {
    /// Returns the initial state of the scene, with an open gripper.
    pub fn at_start(&self) -> Things {
        Things {
            opening_m: self.tool.hand().map(|hand| hand.widest_m),
            poses: self.objects.iter().map(|object| ObjectPose::Stands(object.start())).collect(),
            touch: Touch::default(),
        }
    }

    /// Returns the object between the fingers and its width there, with the flange at this pose in the scene.
    pub fn between(&self, things: &Things, flange: &Pose) -> Option<(usize, f64)> {
        let apart_m = things.opening_m.unwrap_or(self.tool.hand()?.widest_m);
        let point_m = flange.at(self.tool.point_m());
        let (across, along) = (flange.rotation.x_axis, flange.rotation.y_axis);
        let fits = |(i, pose): (usize, &ObjectPose)| {
            let ObjectPose::Stands(at) = pose else { return None };
            let object = &self.objects[i];
            let own = at.rotation.transpose();
            let width_m = object.width_m(own * across);
            // The part of the object that is closest to the point between the fingertips.
            let height_m = (point_m - at.position_m).z.clamp(0.0, object.height_m);
            let off = point_m - (at.position_m + height_m * DVec3::Z);
            let inside = off.dot(across).abs() + 0.5 * width_m <= 0.5 * apart_m + 1e-3
                && off.dot(along).abs() <= 0.5 * object.width_m(own * along)
                && off.dot(flange.rotation.z_axis).abs() <= PAD_M;
            inside.then_some((i, width_m))
        };
        things.poses.iter().enumerate().find_map(fits)
    }

    /// Returns the permitted contacts with the object, and for a held object also the contacts with its support.
    pub fn touching(&self, things: &Things, flange: &Pose) -> Touch {
        let Some((object, on_flange)) = things.held() else {
            let object = self.between(things, flange).map(|(i, _)| i);
            return Touch { object, ..Touch::default() };
        };
        let at_m = ObjectPose::Held(on_flange).pose(flange).position_m;
        let carries = |i: &usize| {
            let shape = self.boxes[*i].shape();
            let top_m = shape.center_m.z + shape.half_m.z;
            (at_m.z - top_m).abs() <= CARRIES_M && is_above(&shape, at_m)
        };
        Touch {
            object: Some(object),
            boxes: (0..self.boxes.len()).filter(carries).collect(),
            floor: at_m.z.abs() <= CARRIES_M,
        }
    }

    /// Updates the objects after a grip to a width. Returns a message for users.
    pub fn gripped(&self, things: &mut Things, flange: &Pose, opening_m: f64) -> Option<String> {
        // If the finger distance is unknown, the width of the held object is used.
        let held_m = things
            .held()
            .map(|(i, on_flange)| self.objects[i].width_m(on_flange.rotation.transpose() * DVec3::X));
        let closing = opening_m < things.opening_m.or(held_m).unwrap_or(f64::INFINITY);
        if closing && things.held().is_none() {
            let found = self.between(things, flange).filter(|(_, width_m)| *width_m >= opening_m - 1e-4);
            let Some((i, width_m)) = found else {
                things.opening_m = Some(opening_m);
                return None;
            };
            let ObjectPose::Stands(at) = things.poses[i] else { return None };
            // Closing fingers push the object to their centre.
            let across = flange.rotation.x_axis;
            let off = (flange.at(self.tool.point_m()) - at.position_m).dot(across);
            let inverse = flange.rotation.transpose();
            let on_flange = Pose {
                position_m: inverse * (at.position_m + off * across - flange.position_m),
                rotation: inverse * at.rotation,
            };
            things.poses[i] = ObjectPose::Held(on_flange);
            things.opening_m = Some(width_m);
            return Some(format!("has {} ({:.0} mm)", self.objects[i].name, 1000.0 * width_m));
        }
        let said = if closing { None } else { self.let_go_of(things, flange) };
        things.opening_m = Some(opening_m);
        said
    }

    /// Releases the held object at any finger distance: it falls upright onto whatever is below it.
    /// Returns a message for users.
    pub fn let_go_of(&self, things: &mut Things, flange: &Pose) -> Option<String> {
        let (i, on_flange) = things.held()?;
        let at = ObjectPose::Held(on_flange).pose(flange);
        let below = |shape: &UprightBox| {
            let top_m = shape.center_m.z + shape.half_m.z;
            (is_above(shape, at.position_m) && top_m <= at.position_m.z + CARRIES_M).then_some(top_m)
        };
        let tops = self.boxes.iter().filter_map(|b| Some((below(&b.shape())?, b.name.as_str())));
        let (top_m, on) = tops.fold((0.0, "the floor"), |best, top| if top.0 > best.0 { top } else { best });
        let ahead = at.rotation.x_axis;
        let standing = Pose {
            position_m: DVec3::new(at.position_m.x, at.position_m.y, top_m),
            rotation: DMat3::from_rotation_z(ahead.y.atan2(ahead.x)),
        };
        things.poses[i] = ObjectPose::Stands(standing);
        let name = &self.objects[i].name;
        let fall_m = at.position_m.z - top_m;
        Some(if fall_m > CARRIES_M {
            format!("let {name} fall {fall_m:.2} m onto {on}")
        } else {
            format!("put {name} down on {on}")
        })
    }

    /// Returns the shapes of the held object in the flange's frame.
    pub fn held_shapes(&self, things: &Things) -> Vec<Capsule> {
        let Some((i, at)) = things.held() else { return Vec::new() };
        self.objects[i].shapes().iter().map(|shape| shape.seen_from(&at)).collect()
    }

    /// Returns numbered boxes around the standing objects.
    pub fn standing(&self, things: &Things) -> Vec<(usize, UprightBox)> {
        let standing = |(i, pose): (usize, &ObjectPose)| match pose {
            ObjectPose::Stands(at) => Some((i, self.objects[i].standing(at))),
            ObjectPose::Held(_) => None,
        };
        things.poses.iter().enumerate().filter_map(standing).collect()
    }
}

/// Converts a pose from the arm's base frame to the scene's.
pub fn in_scene(placement: Placement, mount_m: Point, on_arm: &Pose) -> Pose {
    let base = Pose {
        position_m: DVec3::new(placement.x_m, placement.y_m, 0.0),
        rotation: DMat3::from_rotation_z(placement.heading_rad),
    };
    base.then(mount_m, DMat3::IDENTITY).then(on_arm.position_m, on_arm.rotation)
}

/// Converts a pose from the scene's frame to the frame at the point on the floor between the wheels.
pub fn on_base(placement: Placement, in_scene: &Pose) -> Pose {
    let turn = DMat3::from_rotation_z(-placement.heading_rad);
    let from_m = in_scene.position_m - DVec3::new(placement.x_m, placement.y_m, 0.0);
    Pose { position_m: turn * from_m, rotation: turn * in_scene.rotation }
}

fn is_above(shape: &UprightBox, point_m: Point) -> bool {
    let off = shape.inside(point_m);
    off.x.abs() <= shape.half_m.x && off.y.abs() <= shape.half_m.y
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::tool::ToolTable;

    const SCENE: &str = r#"
        [[box]]
        name = "table"
        center_m = [1.0, 0.0, 0.25]
        size_m = [0.6, 0.6, 0.5]
        [[object]]
        name = "cup"
        at_m = [1.0, 0.0, 0.5]
        height_m = 0.1
        radius_m = 0.03
    "#;

    /// The tool points down at this position, with its fingers along x.
    fn above(point_m: DVec3, tool: &Tool) -> Pose {
        let rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Pose { position_m: point_m - rotation * tool.point_m(), rotation }
    }

    #[test]
    fn a_cup_is_gripped_carried_and_put_down_on_what_is_below() {
        let scene = Scene::parse(SCENE).unwrap();
        let tool = Tool::new(&[ToolTable { name: "2f-85".to_owned(), ..ToolTable::default() }]).unwrap();
        let shop = Shop { objects: &scene.objects, boxes: &scene.boxes, tool: &tool };
        let mut things = shop.at_start();
        let off_middle = above(DVec3::new(1.005, 0.0, 0.56), &tool);
        assert_eq!(shop.between(&things, &off_middle).map(|(i, _)| i), Some(0));
        assert_eq!(shop.touching(&things, &off_middle).object, Some(0));
        assert_eq!(shop.gripped(&mut things, &off_middle, 0.0).unwrap(), "has cup (60 mm)");
        assert!((things.opening_m.unwrap() - 0.06).abs() < 1e-12);
        let touch = shop.touching(&things, &off_middle);
        assert_eq!((touch.boxes, touch.floor), (vec![0], false));
        // The gripper closes further, but already holds the object.
        assert_eq!(shop.gripped(&mut things, &off_middle, 0.0), None);
        let beside = above(DVec3::new(0.2, 0.1, 0.36), &tool);
        assert_eq!(shop.gripped(&mut things, &beside, 0.085).unwrap(), "let cup fall 0.30 m onto the floor");
        let ObjectPose::Stands(at) = things.poses[0] else { panic!("{things:?}") };
        assert!(at.position_m.abs_diff_eq(DVec3::new(0.2, 0.1, 0.0), 1e-9), "pushed to the middle: {at:?}");
    }

    #[test]
    fn nothing_is_gripped_where_nothing_is_or_what_is_too_wide() {
        let scene = Scene::parse(&SCENE.replace("radius_m = 0.03", "radius_m = 0.045")).unwrap();
        let tool = Tool::new(&[ToolTable { name: "2f-85".to_owned(), ..ToolTable::default() }]).unwrap();
        let shop = Shop { objects: &scene.objects, boxes: &scene.boxes, tool: &tool };
        let mut things = shop.at_start();
        assert_eq!(shop.between(&things, &above(DVec3::new(1.0, 0.0, 0.55), &tool)), None);
        let high = above(DVec3::new(1.0, 0.0, 0.7), &tool);
        assert_eq!(shop.gripped(&mut things, &high, 0.0), None);
        assert_eq!(things.opening_m, Some(0.0));
    }
}
