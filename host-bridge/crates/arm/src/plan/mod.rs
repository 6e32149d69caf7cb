//! Motion planning for the arm: obstacles, paths around them, and speeds.
//!
//! ```text
//! pose ─► planner ─► straight? ─► rrt + shortcuts ─► via home ─► refusal
//!            │            └──────── collision ◄─ shape, scene, arm::model
//!            └─► trajectory: a path in time, within the limits
//! guard: at run time, keeps base and arm in states from which both can stop before they touch anything
//! ```
//!
//! * [`collision`]: distances between robot and scene (`hulls` measures parts that are near each other exactly),
//! * `ways`: whether the straight way between two configurations is clear,
//! * [`rrt`]: the search for a path; [`mod@line`]: straight lines of the flange,
//! * `polish`: quicker corners of a path,
//! * [`planner`]: all methods in sequence; [`purse`]: the budget of one motion,
//! * [`guard`]: permits only motion from which the robot can still stop,
//! * [`reach`]: the speed of the robot's outermost point while the base moves.

mod clearance;
pub mod collision;
pub mod guard;
mod hulls;
pub mod line;
pub mod planner;
mod polish;
pub mod purse;
pub mod reach;
pub mod rrt;
mod ways;

pub use collision::{Placement, World};
pub use planner::{Case, Kind, Plan, Planner, Refusal};
pub use purse::Purse;
