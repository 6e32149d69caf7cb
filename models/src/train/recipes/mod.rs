//! The recipes, a file each. A new one is a file here and its line in [`ALL`].

pub mod aligned;
mod log_power;
mod paper;
mod per_axis;

pub use aligned::{ALIGNED, Aligned};
pub use log_power::LOG_POWER;
pub use paper::PAPER;
pub use per_axis::PerAxis;

use super::Recipe;

/// All recipes, as the command line offers them.
pub static ALL: [&dyn Recipe; 3] = [&ALIGNED, &LOG_POWER, &PAPER];
