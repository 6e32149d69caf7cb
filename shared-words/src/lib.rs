//! Types that boards, wire and laptop share.
//!
//! `shared-dsp` computes these types without depending on the wire.
//! `shared-proto` sends these types without depending on the computation.
//! The laptop acts on the results.
//! With the feature `serde`, the types become numbers on the wire and lower-case texts in files.
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
