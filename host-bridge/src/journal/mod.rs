//! Sessions in files (feature `mcap`): their initial conditions, and replays that compare results.
//!
//! * [`setup`]: the initial conditions of a session, stored as the file's metadata,
//! * [`mod@replay`]: sends a file's bytes and keys through the engine.
//!   Every resulting message must equal the message in the file.

pub mod replay;
pub mod setup;

pub use host_views::journal::{Disk, Kept, METADATA, Recorder, WhenFull, disk, index, records, sink};
pub use replay::{Replay, ReplayError, replay};
pub use setup::{SceneText, Setup, SetupError};
