//! A port with access rules and a thread for each connection. The page and Foxglove use it.
//!
//! A new connection always succeeds.
//! If all places are taken, the connection that has been silent for the longest time is closed.
//! Pages are closed last, so nobody can block the page's stop with other connections.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::gate::{self, Gate};

/// Maximum number of connections. A browser opens up to six for files, and each page keeps one.
pub const CONNECTIONS_MAX: usize = 24;
/// Delay before the next connection is accepted if all places are taken.
const ROOM: Duration = Duration::from_millis(2);
/// Maximum number of threads. It is larger because closed connections take some time to end.
const THREADS_MAX: usize = 4 * CONNECTIONS_MAX;

/// The address of the server, and its access rules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WebOptions {
    /// Address to listen on. Other machines can connect only if it is not a loopback address.
    pub address: IpAddr,
    /// Port; 0 = any free one.
    pub port: u16,
    /// The token that a page must send. Required if other machines can reach the address.
    pub token: Option<String>,
}

/// The reason why the server does not start, with a remedy in the text.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// Another program uses the port.
    #[error(
        "{what} cannot be served: {address} is in use, perhaps by another bimanual; choose another port with \
         {option}={}, or {option}=0 for any free one",
        other_port(address)
    )]
    PortTaken {
        /// Name of the service, for the error message.
        what: &'static str,
        /// The option that sets the port.
        option: &'static str,
        /// Which.
        address: SocketAddr,
    },
    /// The system does not permit this.
    #[error(
        "{what} cannot be served on {address}: {source}; choose another port with {option}=PORT (1024 or above), \
         or another address of this machine with --web-listen ADDR"
    )]
    Listen {
        /// Name of the service, for the error message.
        what: &'static str,
        /// The option that sets the port.
        option: &'static str,
        /// Where.
        address: SocketAddr,
        /// The system's error message.
        source: io::Error,
    },
    /// Other machines could reach the page without a token.
    #[error(
        "--web-listen {0} lets other machines in: give a token of 16 or more letters and digits with --web-token, \
         or leave --web-listen out and forward the port over ssh"
    )]
    TokenNeeded(IpAddr),
    /// The token is too simple or cannot be used in an address.
    #[error("--web-token takes {min} to 128 letters, digits, - and _ (for example from `openssl rand -hex 16`)",
        min = gate::TOKEN_MIN)]
    BadToken,
}

fn other_port(address: &SocketAddr) -> u16 {
    address.port().checked_add(1).unwrap_or(super::DEFAULT_PORT)
}

/// The words that error messages use for the service.
#[derive(Clone, Copy, Debug)]
pub struct Name {
    /// The subject in "the page cannot be served".
    pub what: &'static str,
    /// The option that sets the server's port.
    pub option: &'static str,
}

/// An open port, before anything is served.
pub struct Bound {
    listener: TcpListener,
    address: SocketAddr,
    token: Option<String>,
}

impl Bound {
    /// Takes the port.
    ///
    /// # Errors
    /// Returns [`WebError`] if the port is not available, or other machines could connect without a token.
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

    /// Serves in a separate thread, with one more thread for each connection.
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
    /// The address of the server.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the address with this scheme: `http` or `ws`.
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
        // Wakes the accepting thread, so that it reads the flag and closes the port.
        let ip = match self.address.ip() {
            ip if ip.is_unspecified() && ip.is_ipv4() => Ipv4Addr::LOCALHOST.into(),
            ip if ip.is_unspecified() => std::net::Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        let here = SocketAddr::new(ip, self.address.port());
        let _ = TcpStream::connect_timeout(&here, Duration::from_millis(200));
    }
}

/// The state of one open connection.
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

    /// Marks the connection as a page or a viewer. Such connections are closed only after all others.
    pub fn looks_on(&self) {
        self.looks_on.store(true, Ordering::Relaxed);
        self.heard();
    }

    /// Records that the other side has sent data, so that the connection keeps its place.
    pub fn heard(&self) {
        let now_ms = u64::try_from(self.since.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.heard_ms.store(now_ms, Ordering::Relaxed);
    }
}

/// The connections. Each entry has a place, and a handle that closes the connection.
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
            // The connection is closed without an answer, because the threads of closed connections have not ended yet.
            Ok(_) if threads.load(Ordering::SeqCst) >= THREADS_MAX => {}
            Ok((stream, _)) => {
                let Ok(handle) = stream.try_clone() else { continue };
                let place = Arc::new(Seat::new(since));
                if take(&places, Arc::clone(&place), handle) {
                    // However many connections arrive, each of them has time to send a request.
                    std::thread::sleep(ROOM);
                }
                threads.fetch_add(1, Ordering::SeqCst);
                let (serve, counted, left) = (serve.clone(), Leaving(threads.clone()), places.clone());
                let work = move || {
                    let _counted = counted;
                    serve(stream, &place);
                    lock(&left).retain(|(other, _)| !Arc::ptr_eq(other, &place));
                };
                // Without a thread, the connection is closed, and the browser tries again.
                if std::thread::Builder::new().name("page".to_owned()).spawn(work).is_err() {
                    lock(&places).pop();
                }
            }
            // Perhaps no file descriptors are left. The delay avoids a busy loop.
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

fn lock(places: &Places) -> MutexGuard<'_, Vec<(Arc<Seat>, TcpStream)>> {
    places.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Adds a connection to the list.
/// If the list is full, the connection that has been silent for the longest is closed.
/// Connections other than pages are closed first. Returns true if one was closed.
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
            // The client's thread reads the end of the stream and ends.
            let _ = gone.shutdown(Shutdown::Both);
        }
    }
    places.push((place, handle));
    is_full
}

/// Decreases the number of threads, even if the thread never started or has panicked.
struct Leaving(Arc<AtomicUsize>);

impl Drop for Leaving {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Decreases the count when dropped.
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
