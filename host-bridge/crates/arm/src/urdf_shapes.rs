//! Reads the shapes of the links in a URDF arm's chain, and of all links that are fixed to the chain.

use crate::solid::Solid;
use host_robot::shape::Capsule;
use host_robot::{DMat3, DVec3, Pose};
use urdf_rs::{Collision, Geometry, Joint, JointType, Robot};

/// Reads shapes of links, and records the shapes that were not read.
pub struct Shapes<'r> {
    robot: &'r Robot,
    chain: &'r [&'r Joint],
    /// Radius of the lines and balls that replace meshes.
    radius_m: f64,
    seen: Vec<&'r str>,
    /// Links whose meshes were not read.
    meshes: Vec<&'r str>,
    /// Joints outside the chain that can move independently.
    moving: Vec<&'r str>,
}

impl<'r> Shapes<'r> {
    /// Creates a reader for this robot, whose arm is this chain.
    pub fn new(robot: &'r Robot, chain: &'r [&'r Joint], radius_m: f64) -> Self {
        Shapes { robot, chain, radius_m, seen: Vec::new(), meshes: Vec::new(), moving: Vec::new() }
    }

    fn collisions(&self, link: &str) -> &'r [Collision] {
        self.robot.links.iter().find(|known| known.name == link).map_or(&[], |known| &known.collision)
    }

    /// Returns whether the link has its own shapes and all these shapes were read.
    pub fn are_whole(&self, link: &str) -> bool {
        let own = self.collisions(link);
        !own.is_empty() && !own.iter().any(is_mesh)
    }

    /// Returns the shapes of a link in the chain at this frame, and of all links that are fixed to this link.
    /// If the link `moves`, a line along the chain always replaces its meshes.
    pub fn of(&mut self, link: &'r str, here: &Pose, moves: bool) -> (Vec<Capsule>, Vec<Solid>) {
        let mut found = Found::default();
        self.collect(link, here, moves, &mut found);
        (found.capsules, found.solids)
    }

    fn collect(&mut self, link: &'r str, here: &Pose, has_line: bool, found: &mut Found) {
        // An invalid file may connect links in a loop.
        if self.seen.contains(&link) {
            return;
        }
        self.seen.push(link);
        let own = self.collisions(link);
        own.iter().for_each(|collision| found.enclose(collision, here));
        let unread = own.iter().any(is_mesh);
        if unread {
            self.meshes.push(link);
        }
        let robot = self.robot;
        let mut lines = 0;
        for joint in robot.joints.iter().filter(|joint| joint.parent.link == link) {
            let next = at(here, joint);
            if unread && !has_line {
                lines += 1;
                found.line(Capsule { a_m: here.position_m, b_m: next.position_m, radius_m: self.radius_m });
            }
            if self.chain.iter().any(|known| known.name == joint.name) {
                continue;
            }
            if joint.joint_type == JointType::Fixed {
                self.collect(&joint.child.link, &next, false, found);
            } else {
                self.moving.push(&joint.name);
            }
        }
        if unread && !has_line && lines == 0 {
            let ball = |mesh: &Collision| {
                let at_m = here.at(DVec3::from(mesh.origin.xyz.0));
                Capsule { a_m: at_m, b_m: at_m, radius_m: self.radius_m }
            };
            own.iter().filter(|collision| is_mesh(collision)).map(ball).for_each(|ball| found.line(ball));
        }
    }

    /// Returns notes about everything that was not read, for users.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if !self.meshes.is_empty() {
            notes.push(format!(
                "the meshes of {} are not read: lines from joint to joint stand for them, and balls at ends, {:.0} mm thick all \
                 around (link_radius_m)",
                self.meshes.join(", "),
                1000.0 * self.radius_m
            ));
        }
        if !self.moving.is_empty() {
            notes.push(format!(
                "what {} moves beside the arm is not counted; describe what is on the flange as [[tool]]",
                self.moving.join(", ")
            ));
        }
        notes
    }
}

/// Returns the frame of a joint's child before the joint turns.
pub fn at(parent: &Pose, joint: &Joint) -> Pose {
    parent.then(DVec3::from(joint.origin.xyz.0), rotation(joint.origin.rpy.0))
}

/// A mesh that was not read.
fn is_mesh(collision: &Collision) -> bool {
    matches!(&collision.geometry, Geometry::Mesh { filename, .. } if hull_points(filename).is_none())
}

/// Corners of a mesh's hull. They replace the file name of the mesh.
pub const HULL: &str = "hull:";

/// Writes the corners of a hull as text, in the form that the URDF then contains.
pub fn hull_name(points: &[DVec3]) -> String {
    let corners: Vec<String> = points.iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)).collect();
    format!("{HULL}{}", corners.join(","))
}

/// Reads the corners; returns `None` unless all of them are finite numbers.
pub fn hull_points(name: &str) -> Option<Vec<DVec3>> {
    let corner = |text: &str| {
        let mut numbers = text.split(' ').map(|word| word.parse::<f64>().ok().filter(|n| n.is_finite()));
        let point = DVec3::new(numbers.next()??, numbers.next()??, numbers.next()??);
        numbers.next().is_none().then_some(point)
    };
    name.strip_prefix(HULL)?.split(',').map(corner).collect()
}

/// The shapes of one link.
#[derive(Default)]
struct Found {
    capsules: Vec<Capsule>,
    solids: Vec<Solid>,
}

impl Found {
    fn line(&mut self, capsule: Capsule) {
        self.capsules.push(capsule);
        self.solids.push(Solid::of(&capsule));
    }

    fn enclose(&mut self, collision: &Collision, here: &Pose) {
        let pose = here.then(collision.origin.xyz.0.into(), rotation(collision.origin.rpy.0));
        if let Geometry::Mesh { filename, .. } = &collision.geometry {
            if let Some(points) = hull_points(filename) {
                self.capsules.extend(crate::hull::capsules(&points).iter().map(|c| c.seen_from(&pose)));
                self.solids.push(Solid::around(&points).seen_from(&pose));
            }
            return;
        }
        let Some(capsule) = enclosing(collision, &pose) else { return };
        self.capsules.push(capsule);
        self.solids.push(match &collision.geometry {
            Geometry::Box { size } => {
                let half = 0.5 * DVec3::from(size.0);
                let sign = |k: usize, bit: usize| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
                let corner = |k: usize| pose.at(half * DVec3::new(sign(k, 0), sign(k, 1), sign(k, 2)));
                Solid { points_m: (0..8).map(corner).collect(), radius_m: 0.0 }
            }
            _ => Solid::of(&capsule),
        });
    }
}

fn enclosing(collision: &Collision, pose: &Pose) -> Option<Capsule> {
    let (half, radius_m) = match &collision.geometry {
        Geometry::Sphere { radius } => (DVec3::ZERO, *radius),
        // A capsule as long as the cylinder, with additional round ends.
        Geometry::Cylinder { radius, length } | Geometry::Capsule { radius, length } => {
            (0.5 * *length * DVec3::Z, *radius)
        }
        Geometry::Box { size } => {
            let half = 0.5 * DVec3::from(size.0);
            let line = DVec3::AXES[half.max_position()] * half.max_element();
            (line, (half - line).length())
        }
        Geometry::Mesh { .. } => return None,
    };
    Some(Capsule { a_m: pose.at(-half), b_m: pose.at(half), radius_m })
}

/// Roll about x, then pitch about y, then yaw about z, all about the fixed axes.
fn rotation([roll, pitch, yaw]: [f64; 3]) -> DMat3 {
    DMat3::from_rotation_z(yaw) * DMat3::from_rotation_y(pitch) * DMat3::from_rotation_x(roll)
}
