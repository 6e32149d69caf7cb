//! What a gripper is asked for, and how that ended.

/// A width to go to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Between the fingers, in m.
    pub opening_m: f64,
    /// The largest force in N; `None` = the gripper's own.
    pub effort_n: Option<f64>,
    /// Width of the scene's object between the fingers, if known. For robots that cannot feel: a simulated gripper
    /// stalls on it.
    pub between_m: Option<f64>,
}

/// How a grip ended.
#[derive(Clone, Debug, PartialEq)]
pub enum GripEnd {
    /// The fingers are as far apart as asked.
    Reached,
    /// They were stopped before that by something between them.
    Stalled,
    /// It was abandoned for a stop.
    Halted,
    /// It did not work; the text says why.
    Failed(String),
}
