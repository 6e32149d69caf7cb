//! From bytes to decisions: links, safety, intents, the bridge and the one engine. Sans-IO: bytes, events and the time
//! go in, actions come out. Knows no files, sockets, clocks, arms or robots, but [`host_robot::Door`].

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
pub mod safety;
pub mod session;
pub mod source;
pub mod tilt;
