//! Everything a board computes.
#![no_std]
