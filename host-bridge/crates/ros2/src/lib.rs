//! ROS 2: the bridge as a node on the graph, without a ROS installation.
//!
//! ```text
//! director ─► RosRobot (what to send when) ─► node (DDS or Zenoh) ─► /cmd_vel, arm controller
//!                 ▲                             │
//!                 └── joint states, odometry, answers
//! ```
//! Everything except `node` and `driver` is sans-IO and always built.
//! These modules are therefore tested in every build, and every build accepts the same configuration files.
//! `node` and `driver` need the feature `ros2`. `docs/ros2.md` describes the usage.

#[cfg(feature = "ros2")]
mod action;
pub mod advice;
pub mod angles;
pub mod answer;
pub mod arm;
pub mod clocks;
pub mod config;
#[cfg(feature = "ros2")]
mod dds;
pub mod description;
#[cfg(feature = "ros2")]
mod device;
pub mod doubts;
#[cfg(feature = "ros2")]
pub mod driver;
pub mod estop;
#[cfg(feature = "ros2")]
mod follow;
#[cfg(feature = "ros2")]
mod grip;
pub mod gripper;
pub mod hashes;
#[cfg(feature = "ros2")]
pub mod joined;
#[cfg(feature = "ros2")]
pub mod look;
#[cfg(feature = "ros2")]
pub mod node;
mod points;
#[cfg(feature = "ros2")]
pub mod publisher;
pub mod robot;
pub mod sightings;
mod strays;
pub mod stream;
#[cfg(feature = "ros2")]
pub mod transport;
pub mod vendor;
#[cfg(feature = "ros2")]
mod watch;
#[cfg(feature = "zenoh")]
mod zenoh;
pub mod zenoh_keys;

pub use clocks::Stamp;
pub use config::{ArmInterface, Ros2Config, Stamped};
pub use robot::{Counts, Output, RosRobot};
