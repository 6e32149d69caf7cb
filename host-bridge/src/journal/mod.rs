//! Sessions from disk (feature `mcap`): how one started, and a replay that is compared with it.
//!
//! * [`setup`]: what a session started with, as the file's metadata,
//! * [`mod@replay`]: bytes and keys of a file through the engine again; every message that follows from them must be the
//!   one in the file, bit for bit.

pub mod replay;
pub mod setup;

pub use host_views::journal::{Disk, Kept, METADATA, Recorder, WhenFull, disk, index, records, sink};
pub use replay::{Replay, ReplayError, replay};
pub use setup::{SceneText, Setup, SetupError};
