//! The page: a session to look at in a browser, served by this program itself.
//!
//! ```text
//! session loop ─► Watcher (an Observer) ─► Board: newest state, last seconds ─► a thread per page ─► browser
//!              ◄──────────────── take_stop() ◄──────────────────────────────────┘ "stop"
//! ```
//!
//! * [`gate`]: who may ask: names of hosts, origins, the token,
//! * [`server`]: a port and its threads,
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

/// The page's address, unless another is asked for.
pub const DEFAULT_PORT: u16 = 8042;

/// Frames that a page may have on their way without having acknowledged one.
pub const IN_FLIGHT_MAX: u64 = 2;

/// Marks that may wait for the session.
const MARKS_MAX: usize = 16;

/// Pages get this long to hear that the session is over.
const FAREWELL: Duration = Duration::from_millis(300);

const NAME: Name = Name { what: "the page", option: "--web" };

impl Default for WebOptions {
    fn default() -> Self {
        WebOptions { address: Ipv4Addr::LOCALHOST.into(), port: DEFAULT_PORT, token: None }
    }
}

/// What session, server and pages share.
struct Shared {
    gate: Gate,
    history: Mutex<History>,
    /// A page pressed stop. One flag, not a queue: to stop twice is to stop.
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
    /// A page marks an episode; false if the session takes no marks.
    fn mark(&self, mark: Mark) -> bool {
        let Some(marks) = &self.marks else { return false };
        let mut marks = marks.lock().unwrap_or_else(PoisonError::into_inner);
        // Nobody presses so many buttons between two turns of the session.
        if marks.len() < MARKS_MAX {
            marks.push_back(mark);
        }
        true
    }

    /// At worst a thread that panicked left a half-written list of points, which is still a list.
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
    /// Takes the port and serves from a thread of its own.
    ///
    /// # Errors
    /// [`WebError`] if the port cannot be had, or other machines would get in without a token.
    pub fn start(options: &WebOptions) -> Result<Self, WebError> {
        Self::start_with(options, false)
    }

    /// The same; with `marks` its pages can mark episodes.
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

    /// What to type into a browser.
    pub fn url(&self) -> String {
        self.server.url("http")
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// The observer to attach to the session's tap. `title` is the page's headline.
    pub fn watcher(&self, title: &str) -> Watcher {
        Watcher::new(self.shared.clone(), title)
    }

    /// Whether a page has asked for a stop since the last call. The session's loop asks at every turn, and
    /// stops as it does for its own stop key.
    pub fn take_stop(&self) -> bool {
        self.shared.stop.swap(false, Ordering::SeqCst)
    }

    /// The same for another thread.
    pub fn stops(&self) -> impl Fn() -> bool + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.stop.swap(false, Ordering::SeqCst)
    }

    /// Whether a page has pressed the wearer's button since the last call, for another thread.
    pub fn shows(&self) -> impl Fn() -> bool + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.show.swap(false, Ordering::SeqCst)
    }

    /// Takes the marks that pages have made, one a call, for another thread; never waits.
    pub fn marks(&self) -> impl Fn() -> Option<Mark> + Send + use<> {
        let shared = Arc::clone(&self.shared);
        move || shared.marks.as_ref()?.try_lock().ok()?.pop_front()
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
    }
}
