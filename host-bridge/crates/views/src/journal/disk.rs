//! Writes a session's file, on a thread of its own.

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

/// Messages that may wait for the disk: over ten seconds of a live session.
const QUEUE: usize = 8192;
/// What waits in memory is written this often.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);
/// Or when it is as large as this.
const CHUNK_BYTES: u64 = 1 << 20;
/// How long to wait for the file's end.
const POLL: Duration = Duration::from_millis(50);

/// What happens while the disk is slower than the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// The session waits: for recordings that are played, where nothing real moves.
    Wait,
    /// Messages are dropped and counted: nothing delays a robot.
    Drop,
}

/// How a file ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Messages that are in it, on the disk.
    pub messages: u64,
    /// Its length.
    pub bytes: u64,
    /// Messages that were dropped.
    pub lost: u64,
    /// Why it ends early, if it does.
    pub problem: Option<String>,
}

/// What the session's side and the writer's side both know.
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
    /// Creates the file and starts its thread; also gives the observer that fills it.
    ///
    /// # Errors
    /// The file cannot be created or written, or is there already: said before anything moves.
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
        // The lock shows whoever finds the file without its end that it is being written. Not every disk can do this.
        let _ = storage.try_lock();
        Disk::with_storage(storage, file, metadata, origin, when_full).map_err(|error| about(&error))
    }

    /// As `create`, with a storage of your own.
    ///
    /// # Errors
    /// It cannot be written.
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

    /// Why no more is written, if that is so. Reported once; what is written so far stays.
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

    /// [`Disk::take_problem`] has given its answer.
    pub fn is_told(&self) -> bool {
        self.told
    }

    fn sentence(&self, problem: &str) -> String {
        format!("{}: {problem}; the session goes on, the file ends here", self.file.display())
    }

    /// Writes what waits, and the file's end. First let the observer go ([`host_core::observe::Tap::clear`]): it
    /// holds the last steps back.
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

/// What went wrong; in the disk's own words if the disk failed.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

type FileWriter<S> = Writer<NoSeek<Sink<S>>>;

/// Header, metadata and all channels, on the disk.
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
    /// Of these, on the disk.
    kept: u64,
    /// Roughly how many bytes are not on the disk yet.
    waiting: u64,
}

impl<S: Storage> Work<S> {
    /// Writes until nobody fills the queue any more, or the disk fails. Messages written, length of the file.
    fn run(mut self, queue: &Receiver<Entry>) -> (u64, u64) {
        let written = self.write_all(queue).and_then(|()| self.writer.finish().map(drop));
        // Also after a failure: the file then has its end already.
        let sink = self.writer.into_inner().into_inner();
        let good = sink.length();
        let closed = sink.finish();
        let length = closed.as_ref().map_or(good, |(_, length)| *length);
        // What waited in memory when the disk failed is not in the file.
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
            // Counts through all topics, and wraps.
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

/// The observer of a session that is written.
pub type Recorder = Teller<Queue>;

/// What waits for the disk.
#[derive(Debug)]
pub struct Queue {
    sender: Option<SyncSender<Entry>>,
    shared: Arc<Shared>,
    when_full: WhenFull,
    origin: Origin,
    time_ms: u64,
    /// Dropped since the last message that was not.
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
        // First the note that some are missing, where they would have been.
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
            // The last message, if there is room for it.
            self.try_send(self.origin.lost(self.time_ms, self.missing));
        }
    }
}
