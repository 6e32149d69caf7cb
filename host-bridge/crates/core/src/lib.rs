//! The path from bytes to decisions: links, safety, intents, the bridge and the engine.
//! The crate is sans-IO: its inputs are bytes, events and the time, and its outputs are actions.
//! The crate does not depend on files, sockets, clocks, arms or robots, except for [`host_robot::Door`].

mod almost;
pub mod bridge;
pub mod describe;
pub mod doubt;
pub mod engine;
pub mod episodes;
pub mod feel;
pub mod intent;
pub mod jog;
pub mod latency;
pub mod link;
pub mod observe;
pub mod one_handed;
pub mod safety;
pub mod session;
pub mod source;
pub mod tilt;
pub mod worn;
