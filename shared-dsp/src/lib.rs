//! All signal processing of the boards, without pins, wire protocol, std or heap.
//!
//! All arithmetic uses `f32` or integers in a fixed order, so that a laptop and a Cortex-M4F agree bit for bit.
#![no_std]

#[cfg(any(test, feature = "build"))]
extern crate std;

pub mod left;
pub mod right;
