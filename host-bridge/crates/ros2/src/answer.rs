//! The reports that an action server sends back.

/// The report of an action server about a goal.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// The goal was accepted.
    Accepted,
    /// It will not.
    Rejected,
    /// Progress of the goal in seconds of the trajectory.
    Progress(f64),
    /// The pose was reached.
    Succeeded,
    /// The goal was cancelled or aborted, for the reason in the text.
    Ended(String),
}
