//! A desk for tests: boards behind pseudo-terminals, the program as a user runs it, and one time for all of them.
//!
//! - [`time`] is that time; it goes on only while the test waits, and only when boards and programs have got there;
//! - [`station`] keeps one board, its port, and what a test does to it;
//! - [`port`] is the pseudo-terminal;
//! - [`program`] runs what a user types and reads what comes out.

pub mod port;
pub mod program;
pub mod station;
pub mod time;
