//! The recipes, one per file. A new recipe needs a file here and an entry in [`ALL`].

pub mod aligned;
mod log_power;
mod paper;
mod per_axis;

pub use aligned::{ALIGNED, Aligned};
pub use log_power::LOG_POWER;
pub use paper::PAPER;
pub use per_axis::PerAxis;

use super::Recipe;

/// All recipes that the command line offers.
pub static ALL: [&dyn Recipe; 3] = [&ALIGNED, &LOG_POWER, &PAPER];
