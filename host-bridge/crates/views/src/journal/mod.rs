//! Sessions on disk (feature `mcap`): everything that came in, in its order, and everything that followed.
//!
//! ```text
//! Tap ──► Recorder ══ bounded queue ══► Disk (own thread) ──► FILE.mcap
//! ```
//!
//! * [`disk`]: the writer, which never keeps a session waiting that moves a real robot,
//! * [`sink`]: the file on the disk, which is whole after every write,
//! * [`index`]: what a killed recording lacks, written on the next start,
//! * [`records`]: what a file holds, however damaged it is.
//!
//! What is written is what [`host_topics`] makes of a session. The file's profile is `ros2`, its messages are CDR. Times
//! of day are the session's clock plus the time of day at its start; messages that a replay needs carry the session's own
//! milliseconds, too.

pub mod disk;
pub mod index;
pub mod records;
pub mod sink;

pub use disk::{Disk, Kept, Recorder, WhenFull};

/// Name of the metadata that say how the session started.
pub const METADATA: &str = "bimanual";
