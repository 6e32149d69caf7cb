//! One file per verb: its options and what it does.

pub mod demo;
pub mod replay;
