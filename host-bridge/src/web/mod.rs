//! The page: a session to look at in a browser, served by this program itself.
//!
//! ```text
//! session loop ─► Watcher (an Observer) ─► Board: newest state, last seconds ─► a thread per page ─► browser
//!              ◄──────────────── take_stop() ◄──────────────────────────────────┘ "stop"
//! ```
//!
//! * [`gate`]: who may ask: names of hosts, origins, the token,
//! * `http`: one request, one of a few files that are compiled in,
//! * `history`: what a page that comes late must still be told,
//! * `watcher`: from the tap to that history,
//! * `client`: one page's WebSocket.
//!
//! The session never waits for a page: the watcher writes into a bounded history, and each page's thread
//! fetches from there what its page has room for. A page has at most [`IN_FLIGHT_MAX`] frames that it has not
//! acknowledged; a slow one misses states, not events, and never gets old ones late.
//!
//! Threads and two small crates instead of an asynchronous server: `httparse` (hyper's own parser) reads the
//! request, `tungstenite` speaks WebSocket. `axum` would bring 69 crates for five files.

mod client;
pub mod gate;
mod history;
mod http;
mod watcher;

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::observe::Now;
use gate::Gate;
use history::History;
pub use watcher::Watcher;

/// Where the page is, unless asked for elsewhere.
pub const DEFAULT_PORT: u16 = 8042;

/// Frames that a page may have on their way without having acknowledged one.
pub const IN_FLIGHT_MAX: u64 = 2;

/// Connections at a time: a browser opens up to six for the files, each page keeps one.
pub const CONNECTIONS_MAX: usize = 24;

/// Pages get this long to hear that the session is over.
const FAREWELL: Duration = Duration::from_millis(300);

/// Where to serve, and to whom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WebOptions {
    /// Address to listen on. Other machines reach it only where it is not a loopback address.
    pub address: IpAddr,
    /// Port; 0 = any free one.
    pub port: u16,
    /// What a page must know. Needed where other machines can reach the address.
    pub token: Option<String>,
}

impl Default for WebOptions {
    fn default() -> Self {
        WebOptions { address: Ipv4Addr::LOCALHOST.into(), port: DEFAULT_PORT, token: None }
    }
}

/// Why there is no page; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// Somebody else has the port.
    #[error(
        "the page cannot be served: {address} is in use, perhaps by another bimanual; choose another port with \
         --web={}, or --web=0 for any free one",
        other_port(address)
    )]
    PortTaken {
        /// Which.
        address: SocketAddr,
    },
    /// The system does not let us.
    #[error(
        "the page cannot be served on {address}: {source}; choose another port with --web=PORT (1024 or above), \
         or another address of this machine with --web-listen ADDR"
    )]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
    },
    /// Other machines could reach the page, and nothing keeps them out.
    #[error(
        "--web-listen {0} lets other machines in: give a token of 16 or more letters and digits with --web-token, \
         or leave --web-listen out and forward the port over ssh"
    )]
    TokenNeeded(IpAddr),
    /// The token is too easy or does not fit into an address.
    #[error("--web-token takes {min} to 128 letters, digits, - and _ (for example from `openssl rand -hex 16`)",
        min = gate::TOKEN_MIN)]
    BadToken,
}

fn other_port(address: &SocketAddr) -> u16 {
    address.port().checked_add(1).unwrap_or(DEFAULT_PORT)
}

/// What session, server and pages share.
struct Shared {
    gate: Gate,
    history: Mutex<History>,
    /// A page pressed stop. One flag, not a queue: to stop twice is to stop.
    stop: AtomicBool,
    over: AtomicBool,
    closing: AtomicBool,
    connections: AtomicUsize,
    pages: AtomicUsize,
}

impl Shared {
    /// A thread that panicked left at worst a half-written list of points: still a list.
    fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A running server. Dropping it closes the port.
pub struct Web {
    shared: Arc<Shared>,
    address: SocketAddr,
    token: Option<String>,
}

impl Web {
    /// Takes the port and serves from a thread of its own.
    ///
    /// # Errors
    /// [`WebError`] where the port cannot be had, or other machines would get in without a token.
    pub fn start(options: &WebOptions) -> Result<Self, WebError> {
        match &options.token {
            Some(token) if !gate::is_fit_as_token(token) => return Err(WebError::BadToken),
            None if !options.address.is_loopback() => return Err(WebError::TokenNeeded(options.address)),
            _ => {}
        }
        let wanted = SocketAddr::new(options.address, options.port);
        let listener = TcpListener::bind(wanted).map_err(|source| match source.kind() {
            io::ErrorKind::AddrInUse => WebError::PortTaken { address: wanted },
            _ => WebError::Listen { address: wanted, source },
        })?;
        let address = listener.local_addr().map_err(|source| WebError::Listen { address: wanted, source })?;
        let shared = Arc::new(Shared {
            gate: Gate::new(address, options.token.clone()),
            history: Mutex::default(),
            stop: AtomicBool::new(false),
            over: AtomicBool::new(false),
            closing: AtomicBool::new(false),
            connections: AtomicUsize::new(0),
            pages: AtomicUsize::new(0),
        });
        let serving = shared.clone();
        std::thread::spawn(move || accept(&listener, &serving));
        Ok(Web { shared, address, token: options.token.clone() })
    }

    /// What to type into a browser.
    pub fn url(&self) -> String {
        let host = match self.address.ip() {
            ip if ip.is_unspecified() => "ADDRESS-OF-THIS-MACHINE".to_owned(),
            IpAddr::V6(ip) => format!("[{ip}]"),
            IpAddr::V4(ip) => ip.to_string(),
        };
        let query = self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        format!("http://{host}:{}/{query}", self.address.port())
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to hang on the session's tap. `title` is the page's headline.
    pub fn watcher(&self, title: &str) -> Watcher {
        Watcher::new(self.shared.clone(), title)
    }

    /// Whether a page has asked for a stop since the last call. The session's loop asks at every turn, and
    /// stops as it does for its own stop key.
    pub fn take_stop(&self) -> bool {
        self.shared.stop.swap(false, Ordering::SeqCst)
    }

    /// How many pages look on.
    pub fn pages(&self) -> usize {
        self.shared.pages.load(Ordering::SeqCst)
    }

    /// Tells the pages how it ended and that the session is over, and gives them a moment to hear it.
    pub fn end(self, now: &Now<'_>) {
        watcher::publish(&self.shared, now);
        self.shared.over.store(true, Ordering::SeqCst);
        let until = Instant::now() + FAREWELL;
        while self.pages() > 0 && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Web {
    fn drop(&mut self) {
        self.shared.closing.store(true, Ordering::SeqCst);
        // Wakes the accepting thread, so that it sees the flag and lets go of the port.
        let ip = match self.address.ip() {
            ip if ip.is_unspecified() && ip.is_ipv4() => Ipv4Addr::LOCALHOST.into(),
            ip if ip.is_unspecified() => std::net::Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        let here = SocketAddr::new(ip, self.address.port());
        let _ = TcpStream::connect_timeout(&here, Duration::from_millis(200));
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    loop {
        let accepted = listener.accept();
        if shared.closing.load(Ordering::SeqCst) {
            return;
        }
        match accepted {
            Ok((stream, _)) => serve_in_thread(stream, shared),
            // Out of file descriptors, for example: no reason to turn as fast as possible.
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// Counts itself out when dropped.
struct Counted<'a>(&'a AtomicUsize);

impl<'a> Counted<'a> {
    fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::SeqCst);
        Counted(count)
    }
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn serve_in_thread(stream: TcpStream, shared: &Arc<Shared>) {
    let shared = shared.clone();
    if shared.connections.load(Ordering::SeqCst) >= CONNECTIONS_MAX {
        // Closed without a word: whoever opens so many is no browser.
        return;
    }
    let serve = move || {
        let _counted = Counted::new(&shared.connections);
        http::serve(stream, &shared);
    };
    // Without a thread the connection is closed, and the browser asks again.
    let _ = std::thread::Builder::new().name("page".to_owned()).spawn(serve);
}
