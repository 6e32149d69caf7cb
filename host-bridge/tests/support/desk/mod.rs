//! A simulated desk for tests: boards behind pseudo-terminals, the program as a user runs it,
//! and a common simulated time.
//!
//! - [`time`] is the simulated time, which advances only while the test waits and after all boards
//!   and programs are ready;
//! - [`station`] manages one board and its port, and provides the actions of a test;
//! - [`port`] is the pseudo-terminal;
//! - [`program`] starts programs and reads their output.

pub mod port;
pub mod program;
pub mod station;
pub mod time;
