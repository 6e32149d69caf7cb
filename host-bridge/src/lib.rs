//! The laptop side of the two-hand interface.
//!
//! ```text
//! hand → samples → features/tilt → event → frame → wire → frame → intent → limits → robot
//!        └──────────── hands ──────────┘   └──── link ────┘  └ safety, intent ┘  └ sim ┘
//! ```
//!
//! Everything here but `links`, `talk`, `web`, `foxglove` and `ros2::node` is sans-IO: bytes, events and the time go in,
//! actions come out. Ports and clocks live in `links`, sockets in `web`,
//! `foxglove` and `ros2::node`; files and terminals only the binary knows.
//! Whoever wants to look on hangs on the tap in `observe`.

pub mod adc;
pub mod arm;
pub mod base;
pub mod bridge;
pub mod capture;
pub mod config;
pub mod demo;
pub mod describe;
pub mod foxglove;
pub mod hands;
pub mod intent;
#[cfg(feature = "mcap")]
pub mod journal;
pub mod keyboard;
pub mod latency;
pub mod link;
pub mod links;
pub mod live;
pub mod observe;
pub mod plan;
pub mod robot;
pub mod ros2;
pub mod safety;
pub mod scene;
pub mod script;
pub mod session;
pub mod sim;
pub mod survey;
pub mod talk;
pub mod topics;
pub mod upload;
pub mod web;
pub mod wire;
