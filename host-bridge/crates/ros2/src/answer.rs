//! What comes back from an action.

/// What an action server says about a goal.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// It will be carried out.
    Accepted,
    /// It will not.
    Rejected,
    /// How far it is, in seconds of the trajectory.
    Progress(f64),
    /// The pose was reached.
    Succeeded,
    /// It was cancelled or aborted; the text says why.
    Ended(String),
}
