//! Motion planning for the arm: what is in the way, a way around it, and how fast to take it.
//!
//! ```text
//! pose ─► planner ─► straight? ─► rrt + shortcuts ─► via home ─► refusal
//!            │            └──────── collision ◄─ shape, scene, arm::model
//!            └─► trajectory: a path in time, within the limits
//! guard: at run time, keeps base and arm where both can still stop before they touch anything
//! ```
//!
//! * [`shape`]: distances of capsules and boxes,
//! * [`collision`]: robot and scene, and how near they are,
//! * [`rrt`]: the search for a way,
//! * [`trajectory`]: motion along it,
//! * [`planner`]: all of it in turn,
//! * [`guard`]: allows only motion from which one can still stop,
//! * [`random`]: seeded numbers.

pub mod collision;
pub mod guard;
pub mod planner;
pub mod random;
pub mod rrt;
pub mod shape;
pub mod trajectory;

pub use collision::{Placement, World};
pub use planner::{Kind, Plan, Planner, Refusal};
pub use trajectory::Trajectory;
