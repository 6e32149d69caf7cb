//! ROS 2: the bridge as one more node on the graph, with nothing to install or source.
//!
//! ```text
//! bridge ─► RosRobot (what to send when) ─► node (DDS) ─► /cmd_vel, arm controller, /diagnostics
//!               ▲                             │
//!               └── joint states, answers ────┘
//! ```
//! Everything but `node` is sans-IO and always built, so that its rules are tested and a configuration
//! file reads the same everywhere. `node` needs the feature `ros2`. How to use it: `docs/ros2.md`.

pub mod advice;
pub mod arm;
pub mod config;
pub mod diagnostics;
pub mod message;
#[cfg(feature = "ros2")]
pub mod node;
pub mod robot;

pub use config::{ArmInterface, Middleware, Ros2Config};
pub use robot::{Counts, Output, RosRobot};
