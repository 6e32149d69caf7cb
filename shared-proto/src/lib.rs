//! The wire between the two boards and the laptop.
#![no_std]
pub mod message;
