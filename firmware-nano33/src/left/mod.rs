//! What the left hand's image has in place of gestures: tilts, bends and a calibration.

pub mod board;
pub mod control;
pub mod hand;
mod memory;
