//! Everything a board computes: samples and time in, values out. No pins, no wire, no std, no heap.
//!
//! All arithmetic is `f32` or integer in a fixed order, so that a laptop and a Cortex-M4F agree bit for bit.
#![no_std]

#[cfg(any(test, feature = "build"))]
extern crate std;

pub mod aligned;
pub mod decision;
pub mod features;
pub mod fft;
pub mod flex;
pub mod left;
pub mod left_calibration;
pub mod left_faults;
pub mod left_guided;
pub mod mlp;
pub mod moments;
pub mod movement;
pub mod powers;
pub mod recipe;
pub mod right;
pub mod sliding;
pub mod slow;
pub mod softmax;
pub mod tilt;
pub mod tilt_start;
