//! The parts of robot and scene, and the nearest pair of them.

/// A part of the robot or of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The arm's fixed base (0) or the link of a joint, counted from 1.
    Link(usize),
    /// The body of the base.
    Base,
    /// The tool on the flange, except for fingers.
    Tool,
    /// The fingers of a gripper.
    Fingers,
    /// What the gripper holds.
    Held,
    /// A box of the scene.
    Box(usize),
    /// A standing object of the scene.
    Object(usize),
    /// The ground under the robot.
    Floor,
}

/// The closest pair of parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Distance between the two bodies in m; negative if they overlap.
    pub distance_m: f64,
    /// Which.
    pub parts: (Part, Part),
}

impl Clearance {
    pub(super) const NOTHING: Clearance =
        Clearance { distance_m: f64::INFINITY, parts: (Part::Floor, Part::Floor) };

    pub(super) fn tighten(&mut self, distance_m: f64, one: Part, two: Part) {
        if distance_m < self.distance_m {
            *self = Clearance { distance_m, parts: (one, two) };
        }
    }
}
