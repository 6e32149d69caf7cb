//! Serves a running session to Foxglove and other viewers with the same WebSocket protocol.
//! The topics and types are those of [`host_topics::Topic`], as in a session file.
//!
//! ```text
//! session loop ─► Teller ─► Feed ══ a bounded queue per viewer ══► a thread per viewer ─► Foxglove
//! ```
//!
//! * `protocol`: the protocol's messages, without sockets,
//! * `viewer`: the connection of one viewer.
//!
//! Viewers are passive and cannot move or stop anything.
//! The rules for host, origin and token are those of the page ([`crate::web::gate`]), with two differences.
//! Programs other than browsers need no origin, and Foxglove's own pages ([`ORIGINS`]) are allowed.
//! The session never waits for a viewer. Messages that do not fit in its queue are dropped, counted and reported.
//!
//! The `foxglove` crate would add 131 crates and an asynchronous runtime to replace these 300 lines.
//! The page already uses `tungstenite`.

mod protocol;
mod viewer;

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::web::gate::Gate;
use crate::web::server::{Bound, Name, Seat, Server};
use crate::web::{WebError, WebOptions, client, http};
use host_topics::{Entry, Origin, Outlet, Teller, Topic};

/// The default port of Foxglove's viewers.
pub const DEFAULT_PORT: u16 = 8765;

/// The origins of Foxglove in a browser and of its desktop application, which loads its pages from files.
pub const ORIGINS: [&str; 2] = ["https://app.foxglove.dev", "file://"];

/// Maximum number of messages that wait for a viewer: about five seconds of all topics.
const QUEUE: usize = 4096;

/// Time for viewers to receive the remaining messages at the end of a session.
const FAREWELL: Duration = Duration::from_millis(500);

const NAME: Name = Name { what: "the session for Foxglove", option: "--foxglove" };

/// The address of the server, and its access rules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoxgloveOptions {
    /// Address, port and token, as for the page.
    pub server: WebOptions,
    /// Additional allowed origins, in the form that browsers send: `http://localhost:8080`.
    pub origins: Vec<String>,
}

impl Default for FoxgloveOptions {
    fn default() -> Self {
        let server = WebOptions { address: Ipv4Addr::LOCALHOST.into(), port: DEFAULT_PORT, token: None };
        FoxgloveOptions { server, origins: Vec::new() }
    }
}

/// Data shared by session, server and viewers.
struct Shared {
    gate: Gate,
    origins: Vec<String>,
    /// Distinguishes sessions after a reconnect.
    session: u64,
    lines: Mutex<Vec<QueueEnd>>,
    over: AtomicBool,
    viewers: AtomicUsize,
}

/// The end of a viewer's queue that the session uses.
struct QueueEnd {
    sender: SyncSender<Arc<Entry>>,
    seen: Arc<Seen>,
}

/// Data shared by both ends of a queue.
#[derive(Default)]
struct Seen {
    /// A bit for each topic that the viewer has subscribed to.
    wanted: AtomicU32,
    /// Number of messages that did not fit in the viewer's queue.
    lost: AtomicU64,
}

impl Seen {
    fn wants(&self, topic: Topic) -> bool {
        self.wanted.load(Ordering::Relaxed) & 1 << topic as u32 != 0
    }
}

/// Removes viewers that have disconnected, with or without a subscription.
/// No other owner of their data remains.
fn forget_gone(lines: &mut Vec<QueueEnd>) {
    lines.retain(|line| Arc::strong_count(&line.seen) > 1);
}

impl Shared {
    /// Adds a viewer, and returns its side of the queue.
    fn join(&self, seen: &Arc<Seen>) -> Receiver<Arc<Entry>> {
        let (sender, queue) = sync_channel(QUEUE);
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        forget_gone(&mut lines);
        lines.push(QueueEnd { sender, seen: seen.clone() });
        queue
    }
}

/// The output of a session to all viewers.
pub struct Feed(Arc<Shared>);

impl Outlet for Feed {
    fn put(&mut self, entry: Entry) {
        let mut lines = self.0.lines.lock().unwrap_or_else(PoisonError::into_inner);
        forget_gone(&mut lines);
        if lines.iter().all(|line| !line.seen.wants(entry.topic)) {
            return;
        }
        let entry = Arc::new(entry);
        lines.retain(|line| {
            if !line.seen.wants(entry.topic) {
                return true;
            }
            match line.sender.try_send(entry.clone()) {
                Ok(()) => true,
                Err(TrySendError::Full(_)) => {
                    line.seen.lost.fetch_add(1, Ordering::Relaxed);
                    true
                }
                Err(TrySendError::Disconnected(_)) => false,
            }
        });
    }
}

/// A running server. Dropping it closes the port.
pub struct Foxglove {
    shared: Arc<Shared>,
    server: Server,
    origin: Origin,
}

impl Foxglove {
    /// Opens the port and serves it in a separate thread. The session's clock is zero at `origin`.
    ///
    /// # Errors
    /// Returns [`WebError`] if the port is not available, or other machines could connect without a token.
    pub fn start(options: &FoxgloveOptions, origin: Origin) -> Result<Self, WebError> {
        let bound = Bound::new(&options.server, NAME)?;
        let origins = ORIGINS.iter().map(ToString::to_string).chain(options.origins.iter().cloned());
        let shared = Arc::new(Shared {
            gate: bound.gate(),
            origins: origins.collect(),
            session: origin.nanoseconds,
            lines: Mutex::default(),
            over: AtomicBool::new(false),
            viewers: AtomicUsize::new(0),
        });
        let serving = shared.clone();
        Ok(Foxglove {
            shared,
            server: bound.serve(move |stream, place| serve(stream, place, &serving)),
            origin,
        })
    }

    /// Returns the address for Foxglove's "Open connection".
    pub fn url(&self) -> String {
        self.server.url("ws")
    }

    /// The address of the server.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Returns the observer for the session's tap.
    pub fn teller(&self) -> Teller<Feed> {
        Teller::new(self.origin, Feed(self.shared.clone()))
    }

    /// Number of connected viewers.
    pub fn viewers(&self) -> usize {
        self.shared.viewers.load(Ordering::SeqCst)
    }

    /// Sends all remaining messages to the viewers and disconnects.
    pub fn end(self) {
        self.shared.over.store(true, Ordering::SeqCst);
        let until = Instant::now() + FAREWELL;
        while self.viewers() > 0 && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Foxglove {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::SeqCst);
    }
}

fn serve(stream: TcpStream, place: &Seat, shared: &Shared) {
    http::with_request(stream, |mut stream, request, rest| {
        if let Err(refused) = shared.gate.look(&request.claims, &shared.origins) {
            return http::refuse(&mut stream, refused);
        }
        let offered = http::header(request.head, "sec-websocket-protocol").unwrap_or_default();
        let Some(chosen) = protocol::subprotocol(offered) else {
            let told =
                format!("this is for Foxglove: a WebSocket with one of {:?}\n", protocol::SUBPROTOCOLS);
            return http::answer(&mut stream, "400 Bad Request", "text/plain", &told, true);
        };
        match client::accept_with(request.head, &format!("Sec-WebSocket-Protocol: {chosen}\r\n")) {
            None => http::answer(&mut stream, "426 Upgrade Required", "text/plain", "a WebSocket\n", true),
            Some(response) => {
                use std::io::Write as _;
                if stream.write_all(&response).is_ok() {
                    viewer::run(stream, rest, place, shared);
                }
            }
        }
    });
}
