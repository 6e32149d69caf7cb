//! Tools on the flange, as data: a gripper, a camera, a payload.
//!
//! ```toml
//! [[tool]]                    # several entries form one tool together
//! name = "2f-85"              # a bundled tool (Robotiq); any other tool has shapes
//!
//! [[tool]]
//! name = "camera"
//! shapes = [{ a_m = [0, -0.06, 0.01], b_m = [0, -0.06, 0.03], radius_m = 0.03 }]
//! # point_m = [0, 0, 0.14]    # the reference point of poses; without it, the flange is used
//! # opening_m = 0.085         # for a gripper: the maximum opening along the flange's x axis
//! # fingers = […]             # its fingers on the side of +x, as in tools/bundled.toml
//! ```

use host_robot::DVec3;
use host_robot::shape::{Capsule, Point};
use serde::{Deserialize, Serialize};

const BUNDLED: &str = include_str!("../tools/bundled.toml");

/// A line with round ends, in the flange's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolShape {
    /// One end.
    pub a_m: Point,
    /// The other.
    pub b_m: Point,
    /// Thickness.
    pub radius_m: f64,
}

/// A part of the finger on the side of +x; the other finger is its mirror image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerShape {
    /// One end of the capsule when the gripper is open.
    pub a_m: Point,
    /// The other.
    pub b_m: Point,
    /// One end of the capsule when the gripper is closed.
    pub closed_a_m: Point,
    /// The other.
    pub closed_b_m: Point,
    /// Thickness.
    pub radius_m: f64,
}

/// A finger at an unknown position has one capsule per this distance.
const WAY_M: f64 = 0.015;

impl FingerShape {
    /// Returns the capsule for a gripper that is closed by this fraction.
    fn at(&self, shut: f64) -> Capsule {
        Capsule {
            a_m: self.a_m.lerp(self.closed_a_m, shut),
            b_m: self.b_m.lerp(self.closed_b_m, shut),
            radius_m: self.radius_m,
        }
    }

    /// Returns capsules for all positions of the finger.
    /// No point is further than half a step from its place in one of these capsules.
    fn wherever(&self) -> impl Iterator<Item = Capsule> {
        let way_m = self.a_m.distance(self.closed_a_m).max(self.b_m.distance(self.closed_b_m));
        let steps = (way_m / WAY_M).ceil().max(1.0);
        let radius_m = self.radius_m + 0.5 * way_m / steps;
        (0..=steps as u32).map(move |k| Capsule { radius_m, ..self.at(f64::from(k) / steps) })
    }
}

/// A tool as written in a file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolTable {
    /// Name of a bundled tool, or of your own.
    pub name: String,
    /// Shapes of the parts that do not move.
    #[serde(default)]
    pub shapes: Vec<ToolShape>,
    /// What opens and shuts.
    #[serde(default)]
    pub fingers: Vec<FingerShape>,
    /// The reference point of poses, between the fingertips.
    pub point_m: Option<Point>,
    /// Widest opening of a gripper.
    pub opening_m: Option<f64>,
}

/// A gripper's fingers.
#[derive(Clone, Debug, PartialEq)]
pub struct Hand {
    /// The widest opening.
    pub widest_m: f64,
    /// On the side of +x.
    fingers: Vec<FingerShape>,
}

/// All tools of an arm, combined.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tool {
    name: String,
    shapes: Vec<Capsule>,
    hand: Option<Hand>,
    point_m: Point,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bundled {
    tool: Vec<ToolTable>,
}

impl Tool {
    /// Combines several tables.
    ///
    /// # Errors
    /// Returns the name of the invalid tool, with the reason.
    pub fn new(tables: &[ToolTable]) -> Result<Self, String> {
        let Bundled { tool: bundled } =
            toml::from_str(BUNDLED).unwrap_or_else(|error| panic!("tools/bundled.toml: {error}"));
        let mut all = Tool::default();
        for table in tables {
            let name = &table.name;
            let bare = ToolTable { name: name.clone(), ..ToolTable::default() };
            let known = bundled.iter().find(|tool| tool.name == *name).filter(|_| *table == bare);
            if known.is_none() && *table == bare {
                let names: Vec<&str> = bundled.iter().map(|tool| tool.name.as_str()).collect();
                return Err(format!(
                    "tool '{name}' is not bundled and has no shapes; bundled are: {}; or give it shapes",
                    names.join(", ")
                ));
            }
            all.add(known.unwrap_or(table))?;
        }
        Ok(all)
    }

    fn add(&mut self, table: &ToolTable) -> Result<(), String> {
        let name = &table.name;
        let is_length = |m: f64| m.is_finite() && m > 0.0;
        let ends = table.shapes.iter().flat_map(|s| [s.a_m, s.b_m]);
        let finger_ends = table.fingers.iter().flat_map(|f| [f.a_m, f.b_m, f.closed_a_m, f.closed_b_m]);
        let radii = table.shapes.iter().map(|s| s.radius_m).chain(table.fingers.iter().map(|f| f.radius_m));
        // Real tools are shorter, so this is probably a typing error.
        let within = |point: Point| point.is_finite() && point.length() <= 2.0;
        if !ends.chain(finger_ends).chain(table.point_m).all(within) || !radii.clone().all(is_length) {
            return Err(format!(
                "tool '{name}': shapes, fingers and point_m are metres from the flange, at most 2, and radii are above 0"
            ));
        }
        self.shapes.extend(table.shapes.iter().map(|s| Capsule {
            a_m: s.a_m,
            b_m: s.b_m,
            radius_m: s.radius_m,
        }));
        if let Some(widest_m) = table.opening_m {
            if !is_length(widest_m) || widest_m > 1.0 {
                return Err(format!("tool '{name}': opening_m = {widest_m}: must lie between 0 and 1"));
            }
            if self.hand.is_some() {
                return Err(format!("tool '{name}': only one tool may be a gripper (opening_m)"));
            }
            self.hand = Some(Hand { widest_m, fingers: table.fingers.clone() });
        } else if !table.fingers.is_empty() {
            return Err(format!("tool '{name}': fingers without opening_m, the widest opening"));
        }
        if let Some(point_m) = table.point_m {
            self.point_m = point_m;
        }
        if !self.name.is_empty() {
            self.name += " and ";
        }
        self.name += name;
        Ok(())
    }

    /// Name for users; empty without a tool.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns whether there is no tool.
    pub fn is_none(&self) -> bool {
        self.name.is_empty()
    }

    /// Returns the tool as a gripper, or `None` for any other tool.
    pub fn hand(&self) -> Option<&Hand> {
        self.hand.as_ref()
    }

    /// Returns the reference point of poses, relative to the flange.
    pub fn point_m(&self) -> Point {
        self.point_m
    }

    /// Returns the tool's shapes in the flange's frame at this finger distance; `None` covers all positions.
    pub fn shapes(&self, opening_m: Option<f64>) -> Vec<Capsule> {
        [self.fixed(), &self.fingers(opening_m)].concat()
    }

    /// The parts of the tool that do not move.
    pub fn fixed(&self) -> &[Capsule] {
        &self.shapes
    }

    /// Returns the shapes of the fingers; `None` covers all positions from open to closed.
    pub fn fingers(&self, opening_m: Option<f64>) -> Vec<Capsule> {
        let mut shapes = Vec::new();
        let Some(hand) = &self.hand else { return shapes };
        let mirror = DVec3::new(-1.0, 1.0, 1.0);
        let mut both = |capsule: Capsule| {
            shapes.push(capsule);
            shapes.push(Capsule { a_m: capsule.a_m * mirror, b_m: capsule.b_m * mirror, ..capsule });
        };
        for finger in &hand.fingers {
            match opening_m {
                Some(opening_m) => both(finger.at((1.0 - opening_m / hand.widest_m).clamp(0.0, 1.0))),
                None => finger.wherever().for_each(&mut both),
            }
        }
        shapes
    }

    /// Returns the maximum distance of the tool's parts from the flange.
    pub fn reach_m(&self) -> f64 {
        let reach = |c: &Capsule| c.a_m.length().max(c.b_m.length()) + c.radius_m;
        self.shapes(None).iter().map(reach).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> ToolTable {
        ToolTable { name: name.to_owned(), ..ToolTable::default() }
    }

    #[test]
    fn the_bundled_gripper_opens_85_mm_and_its_fingers_part_and_meet() {
        let tool = Tool::new(&[named("2f-85")]).unwrap();
        assert_eq!(tool.hand().unwrap().widest_m, 0.085);
        let widest = |opening_m| tool.shapes(Some(opening_m)).iter().map(|c| c.a_m.x).fold(0.0, f64::max);
        assert!(widest(0.085) > 0.06 && widest(0.0) < 0.056);
        assert_eq!(tool.shapes(Some(0.05)).len(), 10);
        assert!((0.16..0.19).contains(&tool.reach_m()), "{}", tool.reach_m());
    }

    #[test]
    fn fingers_of_which_nobody_knows_are_enclosed_wherever_they_are() {
        let tool = Tool::new(&[named("2f-85")]).unwrap();
        let wherever = tool.fingers(None);
        let inside = |point_m: Point, radius_m: f64| {
            let ball = Capsule { a_m: point_m, b_m: point_m, radius_m: 0.0 };
            // Distances inside the shape are negative.
            wherever.iter().any(|shape| ball.distance_m(shape) <= -radius_m + 1e-12)
        };
        for k in 0..=200 {
            for finger in tool.fingers(Some(0.085 * f64::from(k) / 200.0)) {
                for along in 0..=10 {
                    let point_m = finger.a_m.lerp(finger.b_m, f64::from(along) / 10.0);
                    assert!(inside(point_m, finger.radius_m), "{k}: {finger:?}");
                }
            }
        }
        assert!(!inside(DVec3::new(0.0, 0.05, 0.12), 0.0), "not everything is");
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let shape = ToolShape { a_m: DVec3::ZERO, b_m: DVec3::Z, radius_m: -1.0 };
        let own = ToolTable { shapes: vec![shape], ..named("lamp") };
        for (tables, told) in [
            (vec![named("hand")], "'hand' is not bundled"),
            (vec![own], "'lamp': shapes"),
            (vec![ToolTable { opening_m: Some(0.1), ..named("a") }, named("2f-85")], "only one tool"),
        ] {
            let error = Tool::new(&tables).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
