//! Motion planning for the arm: what is in the way, a way around it, and how fast to take it.
//!
//! ```text
//! pose ─► planner ─► straight? ─► rrt + shortcuts ─► via home ─► refusal
//!            │            └──────── collision ◄─ shape, scene, arm::model
//!            └─► trajectory: a path in time, within the limits
//!
//! ```
//!
//! * [`shape`]: distances of capsules and boxes,
//! * [`collision`]: robot and scene, and how near they are,
//! * [`rrt`]: the search for a way,
//! * [`trajectory`]: motion along it,
//! * [`planner`]: all of it in turn,
//! * [`random`]: seeded numbers.

pub mod collision;
pub mod planner;
pub mod random;
pub mod rrt;
pub mod shape;
pub mod trajectory;

pub use collision::{Placement, World};
pub use planner::{Kind, Plan, Planner, Refusal};
pub use trajectory::Trajectory;
