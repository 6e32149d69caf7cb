//! A running session for Foxglove and other viewers that speak its WebSocket protocol: the topics and types of
//! [`host_topics::Topic`], as they would be in a file.
//!
//! ```text
//! session loop ─► Teller ─► Feed ══ a bounded queue per viewer ══► a thread per viewer ─► Foxglove
//! ```
//!
//! * `protocol`: what is said, without sockets,
//! * `viewer`: one viewer's connection.
//!
//! Viewers look on: nothing that they say moves or stops anything. The rules of host, origin and token are the
//! page's ([`crate::web::gate`]), with two differences: programs that are no browsers need no origin, and
//! Foxglove's own pages ([`ORIGINS`]) are let in. The session never waits for a viewer: what its queue has no
//! room for is dropped, counted, and told.
//!
//! The `foxglove` crate would bring 131 crates with an asynchronous runtime for these 300 lines; `tungstenite`
//! is there for the page already.

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

/// The address that Foxglove tries unless told otherwise.
pub const DEFAULT_PORT: u16 = 8765;

/// Foxglove in a browser, and its desktop application (whose pages are files).
pub const ORIGINS: [&str; 2] = ["https://app.foxglove.dev", "file://"];

/// Messages that may wait for a viewer: about five seconds of everything.
const QUEUE: usize = 4096;

/// Viewers get this long to take what waits when the session is over.
const FAREWELL: Duration = Duration::from_millis(500);

const NAME: Name = Name { what: "the session for Foxglove", option: "--foxglove" };

/// The address to serve at, and who may connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoxgloveOptions {
    /// Address, port and token, as for the page.
    pub server: WebOptions,
    /// More pages that may look on, as browsers name them: `http://localhost:8080`.
    pub origins: Vec<String>,
}

impl Default for FoxgloveOptions {
    fn default() -> Self {
        let server = WebOptions { address: Ipv4Addr::LOCALHOST.into(), port: DEFAULT_PORT, token: None };
        FoxgloveOptions { server, origins: Vec::new() }
    }
}

/// What session, server and viewers share.
struct Shared {
    gate: Gate,
    origins: Vec<String>,
    /// Tells one session from another after a reconnect.
    session: u64,
    lines: Mutex<Vec<QueueEnd>>,
    over: AtomicBool,
    viewers: AtomicUsize,
}

/// The end of a viewer's queue that the session holds.
struct QueueEnd {
    sender: SyncSender<Arc<Entry>>,
    seen: Arc<Seen>,
}

/// What both ends of a queue share.
#[derive(Default)]
struct Seen {
    /// One bit for each topic that the viewer wants.
    wanted: AtomicU32,
    /// Messages that its queue had no room for.
    lost: AtomicU64,
}

impl Seen {
    fn wants(&self, topic: Topic) -> bool {
        self.wanted.load(Ordering::Relaxed) & 1 << topic as u32 != 0
    }
}

/// Takes the lines of viewers off that have left, whether or not they ever wanted anything: only the list still
/// knows of them.
fn forget_gone(lines: &mut Vec<QueueEnd>) {
    lines.retain(|line| Arc::strong_count(&line.seen) > 1);
}

impl Shared {
    /// Puts a viewer on the list; returns its end of the queue.
    fn join(&self, seen: &Arc<Seen>) -> Receiver<Arc<Entry>> {
        let (sender, queue) = sync_channel(QUEUE);
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        forget_gone(&mut lines);
        lines.push(QueueEnd { sender, seen: seen.clone() });
        queue
    }
}

/// A session's output to all viewers.
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
    /// Takes the port and serves from a thread of its own. The session's clock is zero at `origin`.
    ///
    /// # Errors
    /// [`WebError`] if the port cannot be had, or other machines would get in without a token.
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

    /// What to type into Foxglove's "Open connection".
    pub fn url(&self) -> String {
        self.server.url("ws")
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// The observer to attach to the session's tap.
    pub fn teller(&self) -> Teller<Feed> {
        Teller::new(self.origin, Feed(self.shared.clone()))
    }

    /// How many viewers look on.
    pub fn viewers(&self) -> usize {
        self.shared.viewers.load(Ordering::SeqCst)
    }

    /// Sends the viewers what still waits, and disconnects.
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
