//! A port, a thread for whoever comes, and the rules of who may listen where. For the page and for Foxglove.
//!
//! There is always a place for a newcomer: if all are taken, the connection that has said nothing for longest
//! goes, pages last. So nobody who holds connections keeps others from the page's stop.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::gate::{self, Gate};

/// Connections at a time: a browser opens up to six for the files, each page keeps one.
pub const CONNECTIONS_MAX: usize = 24;
/// If all places are taken, the next connection waits this long.
const ROOM: Duration = Duration::from_millis(2);
/// Threads at a time: those whose connection had to go need a moment to end.
const THREADS_MAX: usize = 4 * CONNECTIONS_MAX;

/// The address to serve at, and who may connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WebOptions {
    /// Address to listen on. Other machines reach it only if it is not a loopback address.
    pub address: IpAddr,
    /// Port; 0 = any free one.
    pub port: u16,
    /// What a page must know. Needed if other machines can reach the address.
    pub token: Option<String>,
}

/// Why nothing is served; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// Somebody else has the port.
    #[error(
        "{what} cannot be served: {address} is in use, perhaps by another bimanual; choose another port with \
         {option}={}, or {option}=0 for any free one",
        other_port(address)
    )]
    PortTaken {
        /// What was to be served.
        what: &'static str,
        /// The option that names a port.
        option: &'static str,
        /// Which.
        address: SocketAddr,
    },
    /// The system does not let us.
    #[error(
        "{what} cannot be served on {address}: {source}; choose another port with {option}=PORT (1024 or above), \
         or another address of this machine with --web-listen ADDR"
    )]
    Listen {
        /// What was to be served.
        what: &'static str,
        /// The option that names a port.
        option: &'static str,
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
    address.port().checked_add(1).unwrap_or(super::DEFAULT_PORT)
}

/// What is served, for the texts of errors.
#[derive(Clone, Copy, Debug)]
pub struct Name {
    /// As in "the page cannot be served".
    pub what: &'static str,
    /// The option that names its port.
    pub option: &'static str,
}

/// A port that was taken, before anybody is served.
pub struct Bound {
    listener: TcpListener,
    address: SocketAddr,
    token: Option<String>,
}

impl Bound {
    /// Takes the port.
    ///
    /// # Errors
    /// [`WebError`] if the port cannot be had, or other machines would get in without a token.
    pub fn new(options: &WebOptions, Name { what, option }: Name) -> Result<Self, WebError> {
        match &options.token {
            Some(token) if !gate::is_fit_as_token(token) => return Err(WebError::BadToken),
            None if !options.address.is_loopback() => return Err(WebError::TokenNeeded(options.address)),
            _ => {}
        }
        let wanted = SocketAddr::new(options.address, options.port);
        let refused = |source: io::Error| match source.kind() {
            io::ErrorKind::AddrInUse => WebError::PortTaken { what, option, address: wanted },
            _ => WebError::Listen { what, option, address: wanted, source },
        };
        let listener = TcpListener::bind(wanted).map_err(refused)?;
        let address = listener.local_addr().map_err(refused)?;
        Ok(Bound { listener, address, token: options.token.clone() })
    }

    /// Its rules.
    pub fn gate(&self) -> Gate {
        Gate::new(self.address, self.token.clone())
    }

    /// Serves from a thread of its own, and a thread for each connection.
    pub fn serve(self, serve: impl Fn(TcpStream, &Seat) + Send + Sync + 'static) -> Server {
        let closing = Arc::new(AtomicBool::new(false));
        let (seen, listener) = (closing.clone(), self.listener);
        let serve = Arc::new(serve);
        std::thread::spawn(move || accept(&listener, &seen, &serve));
        Server { closing, address: self.address, token: self.token }
    }
}

/// A running server. Dropping it closes the port.
pub struct Server {
    closing: Arc<AtomicBool>,
    address: SocketAddr,
    token: Option<String>,
}

impl Server {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to type to get there: `http` or `ws`.
    pub fn url(&self, scheme: &str) -> String {
        let host = match self.address.ip() {
            ip if ip.is_unspecified() => "ADDRESS-OF-THIS-MACHINE".to_owned(),
            IpAddr::V6(ip) => format!("[{ip}]"),
            IpAddr::V4(ip) => ip.to_string(),
        };
        let query = self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        format!("{scheme}://{host}:{}/{query}", self.address.port())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::SeqCst);
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

/// One connection's place among the others.
#[derive(Debug)]
pub struct Seat {
    since: Instant,
    heard_ms: AtomicU64,
    looks_on: AtomicBool,
}

impl Seat {
    fn new(since: Instant) -> Self {
        let place = Seat { since, heard_ms: AtomicU64::new(0), looks_on: AtomicBool::new(false) };
        place.heard();
        place
    }

    /// It is a page (or a viewer) from now on, and is disconnected only after all those that are not.
    pub fn looks_on(&self) {
        self.looks_on.store(true, Ordering::Relaxed);
        self.heard();
    }

    /// The other end has said something, so it keeps its place.
    pub fn heard(&self) {
        let now_ms = u64::try_from(self.since.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.heard_ms.store(now_ms, Ordering::Relaxed);
    }
}

/// Who is connected: a place, and a handle to hang up by.
type Places = Mutex<Vec<(Arc<Seat>, TcpStream)>>;

fn accept<S: Fn(TcpStream, &Seat) + Send + Sync + 'static>(
    listener: &TcpListener,
    closing: &AtomicBool,
    serve: &Arc<S>,
) {
    let since = Instant::now();
    let threads = Arc::new(AtomicUsize::new(0));
    let places: Arc<Places> = Arc::default();
    loop {
        let accepted = listener.accept();
        if closing.load(Ordering::SeqCst) {
            return;
        }
        match accepted {
            // Closed without a word: the connections that had to go have not ended yet.
            Ok(_) if threads.load(Ordering::SeqCst) >= THREADS_MAX => {}
            Ok((stream, _)) => {
                let Ok(handle) = stream.try_clone() else { continue };
                let place = Arc::new(Seat::new(since));
                if take(&places, Arc::clone(&place), handle) {
                    // However many connections come, each has time to ask.
                    std::thread::sleep(ROOM);
                }
                threads.fetch_add(1, Ordering::SeqCst);
                let (serve, counted, left) = (serve.clone(), Leaving(threads.clone()), places.clone());
                let work = move || {
                    let _counted = counted;
                    serve(stream, &place);
                    lock(&left).retain(|(other, _)| !Arc::ptr_eq(other, &place));
                };
                // Without a thread the connection is closed, and the browser asks again.
                if std::thread::Builder::new().name("page".to_owned()).spawn(work).is_err() {
                    lock(&places).pop();
                }
            }
            // Out of file descriptors, for example: no reason to turn as fast as possible.
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

fn lock(places: &Places) -> MutexGuard<'_, Vec<(Arc<Seat>, TcpStream)>> {
    places.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Puts a connection on the list; if it is full, one is disconnected: of those that are not pages, else of all, the one
/// that has said nothing for longest. True if one had to go.
fn take(places: &Places, place: Arc<Seat>, handle: TcpStream) -> bool {
    let mut places = lock(places);
    let is_full = places.len() >= CONNECTIONS_MAX;
    if is_full {
        let order = |at: &usize| {
            let place = &places[*at].0;
            (place.looks_on.load(Ordering::Relaxed), place.heard_ms.load(Ordering::Relaxed))
        };
        let quietest = (0..places.len()).min_by_key(order);
        if let Some(at) = quietest {
            let (_, gone) = places.remove(at);
            // Its thread reads the end, and leaves.
            let _ = gone.shutdown(Shutdown::Both);
        }
    }
    places.push((place, handle));
    is_full
}

/// Subtracts a thread from the count, even if it never started or panicked.
struct Leaving(Arc<AtomicUsize>);

impl Drop for Leaving {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Subtracts itself from the count when dropped.
pub struct Counted<'a>(&'a AtomicUsize);

impl<'a> Counted<'a> {
    /// One more.
    pub fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::SeqCst);
        Counted(count)
    }
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}
