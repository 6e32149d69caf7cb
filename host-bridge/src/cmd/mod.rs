//! The commands. Each command has one file with its options and its implementation.

#[cfg(all(feature = "ros2", feature = "urdf"))]
pub mod arm;
pub mod calibrate;
pub mod demo;
pub mod doctor;
pub mod export;
pub mod keep;
mod lines;
pub mod list;
pub mod ports;
pub mod record;
pub mod replay;
pub mod ros2;
pub mod run;
pub mod screen;
pub mod send_model;
pub mod teach;
pub mod update;
pub mod web;
