//! The words that boards, wire and laptop share: each is one type, and it is here.
//!
//! `shared-dsp` computes them without knowing the wire; `shared-proto` sends them without knowing what they are computed
//! from; the laptop acts on them. With the feature `serde` they cross the wire, each as its number in the list, and are
//! lower-case texts in files.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod hand;
pub mod health;
mod label;
mod tilt;

pub use hand::{Hand, PerHand};
pub use label::is_rest;
pub use tilt::{Heading, TiltThresholds};
