//! The laptop side of the two-hand interface.
//!
//! ```text
//! hand → samples → features/tilt → event → frame → wire → frame → intent → limits → robot
//!        └──────────── hands ──────────┘   └──── link ────┘  └ safety, intent ┘  └ sim ┘
//! ```
//!
//! Everything here is sans-IO: bytes, events and the time go in, actions come out. Only the binary
//! knows files, terminals and clocks.

pub mod adc;
pub mod arm;
pub mod base;
pub mod bridge;
pub mod hands;
pub mod intent;
pub mod latency;
pub mod link;
pub mod plan;
pub mod robot;
pub mod safety;
pub mod scene;
pub mod script;
pub mod session;
pub mod sim;
pub mod wire;
