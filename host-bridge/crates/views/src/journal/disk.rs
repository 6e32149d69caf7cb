//! Writes a session's file in a separate thread.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};

use super::METADATA;
use super::sink::{Sink, Storage};
use host_topics::{ENCODING, Entry, Origin, Outlet, SCHEMA_ENCODING, Teller, Topic};

/// Maximum number of messages that wait for the disk: over ten seconds of a live session.
const QUEUE: usize = 8192;
/// Interval at which messages in memory are written.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);
/// If the messages in memory exceed this size, they are written earlier.
const CHUNK_BYTES: u64 = 1 << 20;
/// Maximum time to wait until writing has finished.
const POLL: Duration = Duration::from_millis(50);

/// The behaviour if the disk is slower than the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// The session waits. This choice is for played recordings, where no real robot moves.
    Wait,
    /// Messages are dropped and counted, so that nothing delays a robot.
    Drop,
}

/// The result of closing a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Number of messages in the file on the disk.
    pub messages: u64,
    /// Its length.
    pub bytes: u64,
    /// Messages that were dropped.
    pub lost: u64,
    /// The reason, if the file ends too early.
    pub problem: Option<String>,
}

/// Data shared by the session and the writer.
#[derive(Debug, Default)]
struct Shared {
    closing: AtomicBool,
    lost: AtomicU64,
    problem: Mutex<Option<String>>,
}

impl Shared {
    fn problem(&self) -> Option<String> {
        self.problem.lock().map_or(None, |problem| problem.clone())
    }
}

/// A file being written.
#[derive(Debug)]
pub struct Disk {
    file: PathBuf,
    thread: Option<JoinHandle<(u64, u64)>>,
    shared: Arc<Shared>,
    told: bool,
}

impl Disk {
    /// Creates the file and starts its thread. Also returns the observer that fills it.
    ///
    /// # Errors
    /// Fails if the file cannot be created or written, or already exists.
    /// The error is reported before the robot moves.
    pub fn create(
        file: &Path,
        metadata: BTreeMap<String, String>,
        origin: Origin,
        when_full: WhenFull,
    ) -> Result<(Disk, Recorder), String> {
        let about = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
        let storage = File::create_new(file).map_err(|error| match error.kind() {
            ErrorKind::AlreadyExists => about(&"there is a file of this name; choose another"),
            _ => about(&error),
        })?;
        // The lock shows other programs that the unfinished file is being written. Some disks do not support locks.
        let _ = storage.try_lock();
        Disk::with_storage(storage, file, metadata, origin, when_full).map_err(|error| about(&error))
    }

    /// Like `create`, with a custom storage.
    ///
    /// # Errors
    /// Fails if the storage cannot be written.
    pub fn with_storage<S: Storage + Send + 'static>(
        storage: S,
        file: &Path,
        metadata: BTreeMap<String, String>,
        origin: Origin,
        when_full: WhenFull,
    ) -> Result<(Disk, Recorder), String> {
        let begun = begin(storage, metadata);
        let (writer, channels) = begun.map_err(|error| reason(&error))?;
        let (sender, waiting) = sync_channel(QUEUE);
        let shared = Arc::new(Shared::default());
        let queue =
            Queue { sender: Some(sender), shared: shared.clone(), when_full, origin, time_ms: 0, missing: 0 };
        let recorder = Teller::new(origin, queue);
        let theirs = shared.clone();
        let work = move || {
            Work { writer, channels, origin, shared: theirs, messages: 0, kept: 0, waiting: 0 }.run(&waiting)
        };
        let thread = std::thread::Builder::new().name("session file".to_owned()).spawn(work);
        let thread = Some(thread.map_err(|error| error.to_string())?);
        Ok((Disk { file: file.to_owned(), thread, shared, told: false }, recorder))
    }

    /// Returns the reason why writing has stopped, but only on the first call after that.
    /// The data written so far is preserved.
    pub fn take_problem(&mut self) -> Option<String> {
        if self.told {
            return None;
        }
        let problem = self.shared.problem()?;
        self.told = true;
        Some(self.sentence(&problem))
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Returns whether [`Disk::take_problem`] has reported a problem.
    pub fn is_told(&self) -> bool {
        self.told
    }

    fn sentence(&self, problem: &str) -> String {
        format!("{}: {problem}; the session goes on, the file ends here", self.file.display())
    }

    /// Writes all remaining messages and the end of the file.
    /// First drop the observer ([`host_core::observe::Tap::clear`]), which still holds the last steps.
    pub fn close(mut self) -> Kept {
        self.end()
    }

    fn end(&mut self) -> Kept {
        self.shared.closing.store(true, Ordering::Relaxed);
        let (messages, bytes) = self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        let problem = self.shared.problem().map(|problem| self.sentence(&problem));
        Kept { messages, bytes, lost: self.shared.lost.load(Ordering::Relaxed), problem }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        if self.thread.is_some() {
            self.end();
        }
    }
}

/// Explains an error, using the disk's own message if the disk failed.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

type FileWriter<S> = Writer<NoSeek<Sink<S>>>;

/// Writes header, metadata and all channels to the disk.
fn begin<S: Storage>(
    storage: S,
    metadata: BTreeMap<String, String>,
) -> Result<(FileWriter<S>, Vec<u16>), McapError> {
    let options = WriteOptions::new()
        .profile("ros2")
        .library(concat!("bimanual ", env!("CARGO_PKG_VERSION")))
        .chunk_size(Some(CHUNK_BYTES))
        .compression(None)
        .disable_seeking(true);
    let mut writer = options.create(NoSeek::new(Sink::new(storage)))?;
    writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata })?;
    let qos = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
    let mut channels = Vec::new();
    for topic in Topic::ALL {
        let schema = writer.add_schema(&topic.kind(), SCHEMA_ENCODING, topic.schema().as_bytes())?;
        channels.push(writer.add_channel(schema, topic.name(), ENCODING, &qos)?);
    }
    writer.flush()?;
    Ok((writer, channels))
}

struct Work<S: Storage> {
    writer: FileWriter<S>,
    channels: Vec<u16>,
    origin: Origin,
    shared: Arc<Shared>,
    messages: u64,
    /// Number of these bytes that are on the disk.
    kept: u64,
    /// Approximate number of bytes that are not on the disk yet.
    waiting: u64,
}

impl<S: Storage> Work<S> {
    /// Writes until the queue is closed or the disk fails.
    /// Returns the number of messages and the file's length.
    fn run(mut self, queue: &Receiver<Entry>) -> (u64, u64) {
        let written = self.write_all(queue).and_then(|()| self.writer.finish().map(drop));
        // After a failure, the file already has its end.
        let sink = self.writer.into_inner().into_inner();
        let good = sink.length();
        let closed = sink.finish();
        let length = closed.as_ref().map_or(good, |(_, length)| *length);
        // Messages that were in memory when the disk failed are not in the file.
        let messages = if written.is_ok() && closed.is_ok() { self.messages } else { self.kept };
        let problem = written.map_err(|error| reason(&error)).err();
        if let Some(problem) = problem.or(closed.err().map(|error| error.to_string()))
            && let Ok(mut place) = self.shared.problem.lock()
        {
            *place = Some(problem);
        }
        (messages, length)
    }

    fn write_all(&mut self, queue: &Receiver<Entry>) -> Result<(), McapError> {
        let mut flushed = Instant::now();
        loop {
            match queue.recv_timeout(POLL) {
                Ok(entry) => self.write(&entry)?,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) if self.shared.closing.load(Ordering::Relaxed) => {
                    return Ok(());
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
            if flushed.elapsed() >= FLUSH_INTERVAL || self.waiting >= CHUNK_BYTES {
                self.writer.flush()?;
                self.kept = self.messages;
                self.waiting = 0;
                flushed = Instant::now();
            }
        }
    }

    fn write(&mut self, entry: &Entry) -> Result<(), McapError> {
        let time = self.origin.at(entry.time_ms);
        let header = MessageHeader {
            channel_id: self.channels[entry.topic as usize],
            // A sequence number for the messages of all topics. It wraps.
            sequence: self.messages as u32,
            log_time: time,
            publish_time: time,
        };
        self.writer.write_to_known_channel(&header, &entry.data)?;
        self.messages += 1;
        self.waiting += entry.data.len() as u64;
        Ok(())
    }
}

/// The observer of a session that is written to disk.
pub type Recorder = Teller<Queue>;

/// The queue of messages for the disk.
#[derive(Debug)]
pub struct Queue {
    sender: Option<SyncSender<Entry>>,
    shared: Arc<Shared>,
    when_full: WhenFull,
    origin: Origin,
    time_ms: u64,
    /// Number of messages dropped since the last accepted message.
    missing: u64,
}

impl Queue {
    fn try_send(&mut self, entry: Entry) -> bool {
        match self.sender.as_ref().map(|sender| sender.try_send(entry)) {
            Some(Err(TrySendError::Full(_))) => false,
            Some(Err(TrySendError::Disconnected(_))) => {
                self.sender = None;
                true
            }
            Some(Ok(())) | None => true,
        }
    }
}

impl Outlet for Queue {
    fn put(&mut self, entry: Entry) {
        self.time_ms = entry.time_ms;
        if self.when_full == WhenFull::Wait {
            if self.sender.as_ref().is_some_and(|sender| sender.send(entry).is_err()) {
                self.sender = None;
            }
            return;
        }
        // The note about missing messages takes the place of these messages, before the next message.
        if self.missing > 0 && self.try_send(self.origin.lost(entry.time_ms, self.missing)) {
            self.missing = 0;
        }
        if self.missing > 0 || !self.try_send(entry) {
            self.missing += 1;
            self.shared.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        if self.missing > 0 {
            // Adds a last note if there is room.
            self.try_send(self.origin.lost(self.time_ms, self.missing));
        }
    }
}
