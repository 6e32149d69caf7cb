//! The web page, which shows a session in a browser. This program serves the page.
//!
//! ```text
//! session loop ─► Watcher (an Observer) ─► Board: newest state, last seconds ─► a thread per page ─► browser
//!              ◄──────────────── take_stop() ◄──────────────────────────────────┘ "stop"
//! ```
//!
//! * [`gate`]: access rules for host names, origins and the token,
//! * [`server`]: a port and its threads,
//! * `http`: one request for a compiled-in file,
//! * `history`: data for pages that connect later,
//! * `watcher`: fills the history from the tap,
//! * `client`: the WebSocket of one page.
//!
//! The session never waits for a page.
//! The watcher writes to a bounded history, and each page's thread reads from there.
//! A page has at most [`IN_FLIGHT_MAX`] unacknowledged frames.
//! A slow page misses states but no events, and never receives outdated states.
//!
//! The server uses threads and two small crates instead of an asynchronous runtime.
//! `httparse` (hyper's own parser) reads requests, and `tungstenite` handles WebSockets. `axum` would add 69 crates.

pub(crate) mod client;
pub mod gate;
mod history;
pub(crate) mod http;
pub mod server;
mod watcher;

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gate::Gate;
use history::History;
use host_core::episodes::Mark;
use host_core::observe::Now;
use server::{Bound, Counted, Name, Server};
pub use server::{CONNECTIONS_MAX, WebError, WebOptions};
pub use watcher::{INTERVAL, Watcher};

/// The default port of the page.
pub const DEFAULT_PORT: u16 = 8042;

/// Maximum number of frames that a page has not acknowledged.
pub const IN_FLIGHT_MAX: u64 = 2;

/// Maximum number of marks that wait for the session.
const MARKS_MAX: usize = 16;

/// Time for pages to receive the end of the session.
const FAREWELL: Duration = Duration::from_millis(300);

const NAME: Name = Name { what: "the page", option: "--web" };

impl Default for WebOptions {
    fn default() -> Self {
        WebOptions { address: Ipv4Addr::LOCALHOST.into(), port: DEFAULT_PORT, token: None }
    }
}

/// Data shared by session, server and pages.
struct Shared {
    gate: Gate,
    history: Mutex<History>,
    /// Set when a page requests a stop. A flag suffices, because several stops have the same effect as one.
    stop: AtomicBool,
    /// A page pressed the wearer's button.
    show: AtomicBool,
    /// Marks of episodes that pages have made, if the session takes any.
    marks: Option<Mutex<VecDeque<Mark>>>,
    over: AtomicBool,
    closing: AtomicBool,
    pages: AtomicUsize,
}

impl Shared {
    /// Marks an episode. Returns false if the session accepts no marks.
    fn mark(&self, mark: Mark) -> bool {
        let Some(marks) = &self.marks else { return false };
        let mut marks = marks.lock().unwrap_or_else(PoisonError::into_inner);
        // Nobody can press more buttons between two turns of the session.
        if marks.len() < MARKS_MAX {
            marks.push_back(mark);
        }
        true
    }

    /// After a panic in another thread, the list of points may be incomplete, but it is still valid.
    fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A running server. Dropping it closes the port.
pub struct Web {
    shared: Arc<Shared>,
    server: Server,
}

impl Web {
    /// Opens the port, and serves it in a separate thread.
    ///
    /// # Errors
    /// Returns [`WebError`] if the port is not available, or other machines could connect without a token.
    pub fn start(options: &WebOptions) -> Result<Self, WebError> {
        Self::start_with(options, false)
    }

    /// Like the function above, but with `marks`, the pages can mark episodes.
    ///
    /// # Errors
    /// As [`Web::start`].
    pub fn start_with(options: &WebOptions, marks: bool) -> Result<Self, WebError> {
        let bound = Bound::new(options, NAME)?;
        let shared = Arc::new(Shared {
            gate: bound.gate(),
            history: Mutex::default(),
            stop: AtomicBool::new(false),
            show: AtomicBool::new(false),
            marks: marks.then(Mutex::default),
            over: AtomicBool::new(false),
            closing: AtomicBool::new(false),
            pages: AtomicUsize::new(0),
        });
        let serving = shared.clone();
        Ok(Web { shared, server: bound.serve(move |stream, place| http::serve(stream, place, &serving)) })
    }

    /// Returns the address for a browser.
    pub fn url(&self) -> String {
        self.server.url("http")
    }

    /// The address of the server.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Returns the observer for the session's tap. `title` is the page's headline.
    pub fn watcher(&self, title: &str) -> Watcher {
        Watcher::new(self.shared.clone(), title)
    }

    /// Returns whether a page has requested a stop since the last call.
    /// The session calls this at every turn.
    pub fn take_stop(&self) -> bool {
        self.shared.stop.swap(false, Ordering::SeqCst)
    }

    /// Returns the function [`Self::take_stop`] for another thread.
    pub fn stops(&self) -> impl Fn() -> bool + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.stop.swap(false, Ordering::SeqCst)
    }

    /// Returns whether a page has pressed the wearer's button since the last call, for another thread.
    pub fn shows(&self) -> impl Fn() -> bool + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.show.swap(false, Ordering::SeqCst)
    }

    /// Returns a function for another thread. Each call removes and returns the oldest mark that a page has made.
    /// The function never waits.
    pub fn marks(&self) -> impl Fn() -> Option<Mark> + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.marks.as_ref()?.try_lock().ok()?.pop_front()
    }

    /// Number of connected pages.
    pub fn pages(&self) -> usize {
        self.shared.pages.load(Ordering::SeqCst)
    }

    /// Sends the final state and the end of the session to the pages, and waits briefly.
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
    }
}
