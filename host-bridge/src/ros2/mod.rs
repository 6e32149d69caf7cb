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
pub mod clocks;
pub mod config;
#[cfg(feature = "ros2")]
mod device;
pub mod diagnostics;
#[cfg(feature = "ros2")]
mod follow;
pub mod hashes;
#[cfg(feature = "ros2")]
mod joined;
pub mod message;
#[cfg(feature = "ros2")]
pub mod node;
pub mod robot;
pub mod vendor;
#[cfg(feature = "ros2")]
mod watch;

pub use clocks::Stamp;
pub use config::{ArmInterface, Ros2Config};
pub use robot::{Counts, Output, RosRobot};
