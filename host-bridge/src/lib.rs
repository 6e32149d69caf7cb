//! The laptop's part of the two-hand interface: the configuration, the demo and recorded sessions.
//! This crate also contains the code that connects all crates.
//!
//! ```text
//! hand → samples → features/tilt → event → frame → wire → frame → intent → limits → director → robot
//!        └─────────── host-links ───────────┘    └──── host-core ────┘   └ host-arm ┘  └ host-sim, host-ros2 ┘
//! ```
//!
//! Each part is a crate in `crates/`, so that the compiler enforces the permitted dependencies (docs/ARCHITECTURE.md).
//! This crate re-exports their modules.

#[cfg(feature = "urdf")]
pub mod arm_file;
pub mod config;
pub mod control;
pub mod demo;
pub mod ending;
#[cfg(feature = "mcap")]
pub mod export;
#[cfg(feature = "mcap")]
pub mod journal;
pub mod profile;
pub mod robots;
pub mod script;
pub mod taught;
pub mod teach;
pub mod wearer;

pub use host_arm::{self as arm, plan, scene};
pub use host_core::{
    bridge, describe, doubt, engine, episodes, intent, jog, latency, link, observe, one_handed, safety,
    session, source, tilt, worn,
};
pub use host_links::{capture, hands, keyboard, links, showing, survey, talk, upload, wire};
pub use host_robot as robot;
pub use host_robot::base;
pub use host_ros2 as ros2;
pub use host_sim as sim;
pub use host_topics as topics;
pub use host_views::{foxglove, view, web};
pub use models::adc;
