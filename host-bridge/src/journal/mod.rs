//! Sessions on disk (feature `mcap`): everything that came in, in its order, and everything that followed.
//!
//! ```text
//! Tap ──► Recorder ══ bounded queue ══► Disk (own thread) ──► FILE.mcap ──► Replay: the same again, compared
//! ```
//!
//! * [`setup`]: what a session started with, as the file's metadata,
//! * [`disk`]: the writer, which never keeps a session waiting that moves a real robot,
//! * [`sink`]: the file on the disk, which is whole after every write,
//! * [`mod@replay`]: bytes and keys of a file through a bridge and a robot again; every message that follows from
//!   them must be the one in the file, bit for bit.
//!
//! What is written is what [`crate::topics`] makes of a session. The file's profile is `ros2`, its messages are CDR. Times of day are the session's clock plus the time of day
//! at its start; messages that a replay needs carry the session's own milliseconds, too.

pub mod disk;
pub mod replay;
pub mod setup;
pub mod sink;

pub use disk::{Disk, Kept, Recorder, WhenFull};
pub use replay::{Replay, ReplayError, replay};
pub use setup::{SceneText, Setup, SetupError};

/// Name of the metadata that holds the [`Setup`].
pub const METADATA: &str = "bimanual";
