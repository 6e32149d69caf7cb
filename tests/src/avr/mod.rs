//! Emulates the left board: simavr executes the users' image instruction by instruction.
//!
//! - [`nano`] is the board: pin voltages, serial bytes in and out, EEPROM, power cuts;
//! - [`image`] finds and builds the image and reads its size;
//! - [`recorded`] applies a recording of a hand to the board's pins;
//! - [`wearer`] is a hand with its sensors: poses, tremor, bends, and the data sheets' tolerances;
//! - [`session`] is a wearer with a running board, for calibration, movement and decoded states.

pub mod image;
pub mod nano;
pub mod recorded;
pub mod session;
pub mod street;
pub mod trials;
pub mod wearer;
pub mod workers;
