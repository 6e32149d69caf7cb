//! The wire between the two boards and the laptop.
#![no_std]
#![forbid(unsafe_code)]

pub mod frame;
pub mod message;
