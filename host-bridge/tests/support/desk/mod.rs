//! A simulated desk for tests. Boards run behind pseudo-terminals, and the program runs as a user starts it.
//! Boards and programs share a simulated time.
//!
//! - [`time`] is the simulated time, which advances only while the test waits,
//!   and only when all boards and programs are ready;
//! - [`station`] manages one board and its port, and provides the actions of a test;
//! - [`port`] is the pseudo-terminal;
//! - [`program`] starts programs and reads their output.

pub mod port;
pub mod program;
pub mod station;
pub mod time;
