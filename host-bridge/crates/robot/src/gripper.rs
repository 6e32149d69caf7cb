//! Commands of a gripper and their results.

/// A width to go to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Distance between the fingers, in m.
    pub opening_m: f64,
    /// Maximum force in N; `None` means the gripper's default.
    pub effort_n: Option<f64>,
    /// Width of the object between the fingers in the scene, if known.
    /// Robots without touch sensors need this width: a simulated gripper stalls at it.
    pub between_m: Option<f64>,
}

/// The result of a gripper command.
#[derive(Clone, Debug, PartialEq)]
pub enum GripEnd {
    /// The fingers have reached the requested width.
    Reached,
    /// An object between the fingers stopped them earlier.
    Stalled,
    /// The grip was abandoned because of a stop.
    Halted,
    /// The grip failed, for the reason in the text.
    Failed(String),
}
