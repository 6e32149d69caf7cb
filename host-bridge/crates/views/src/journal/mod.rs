//! Sessions on disk (feature `mcap`): all inputs in their order, and all results.
//!
//! ```text
//! Tap ──► Recorder ══ bounded queue ══► Disk (own thread) ──► FILE.mcap
//! ```
//!
//! * [`disk`]: the writer, which never delays a session that moves a real robot,
//! * [`sink`]: the file on the disk, which is valid after every write,
//! * [`index`]: adds the index to a killed recording at the next start,
//! * [`records`]: reads the contents of a file, even if it is damaged.
//!
//! [`host_topics`] creates the messages of a session. The file has the profile `ros2`, and its messages are CDR.
//! Times of day are the session's clock plus the time of day at the start of the session.
//! Messages that a replay needs also contain the session's own time in milliseconds.

pub mod disk;
pub mod index;
pub mod records;
pub mod sink;

pub use disk::{Disk, Kept, Recorder, WhenFull};

/// Name of the metadata that describe the start of the session.
pub const METADATA: &str = "bimanual";
