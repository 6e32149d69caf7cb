//! Everything a board computes: samples and time in, values out. No pins, no wire, no std, no heap.
//!
//! All arithmetic is `f32` or integer in a fixed order, so that a laptop and a Cortex-M4F agree bit for bit.
#![no_std]

#[cfg(any(test, feature = "build"))]
extern crate std;

pub mod left;
pub mod right;
