//! Everything a board computes.
#![no_std]
pub mod flex;
pub mod left;
pub mod left_calibration;
pub mod left_faults;
pub mod tilt;
