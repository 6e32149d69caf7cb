//! Motion planning for the arm: what is in the way, a path around it, and how fast to follow it.
//!
//! ```text
//! pose ─► planner ─► straight? ─► rrt + shortcuts ─► via home ─► refusal
//!            │            └──────── collision ◄─ shape, scene, arm::model
//!            └─► trajectory: a path in time, within the limits
//! guard: at run time, keeps base and arm where both can still stop before they touch anything
//! ```
//!
//! * [`collision`]: robot and scene, and how near they are,
//! * [`rrt`]: the search for a way; [`mod@line`]: straight lines of the flange,
//! * [`planner`]: all of it in turn, and [`purse`]: how much one motion may cost,
//! * [`guard`]: allows only motion from which one can still stop.

pub mod collision;
pub mod guard;
pub mod line;
pub mod planner;
pub mod purse;
pub mod rrt;

pub use collision::{Placement, World};
pub use planner::{Case, Kind, Plan, Planner, Refusal};
pub use purse::Purse;
