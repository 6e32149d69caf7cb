//! The WebSocket of one page. It sends frames as fast as the page accepts them.
//! The socket receives `stop`, marks and acknowledgements.

use std::io;
use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use super::history::Told;
use super::server::Seat;
use super::{Counted, IN_FLIGHT_MAX, Shared};

/// Interval at which the thread checks for new data. Data from the page wakes it immediately.
const TURN: Duration = Duration::from_millis(4);

/// A page that accepts no data for this long is disconnected. The page reconnects automatically.
const TAKES_NOTHING: Duration = Duration::from_secs(30);

/// Maximum length of a page's message, which is always short.
const MESSAGE_MAX: usize = 256;

/// Returns the answer to a WebSocket request, or `None` for other requests.
pub fn accept(head: &httparse::Request<'_, '_>) -> Option<Vec<u8>> {
    accept_with(head, "")
}

/// Like [`accept`], with additional header lines, each with its line end.
pub fn accept_with(head: &httparse::Request<'_, '_>, more: &str) -> Option<Vec<u8>> {
    let has = |name: &str, word: &str| {
        let mut found = head.headers.iter().filter(|h| h.name.eq_ignore_ascii_case(name));
        found.any(|h| {
            let value = std::str::from_utf8(h.value).unwrap_or_default();
            value.split(',').any(|part| part.trim().eq_ignore_ascii_case(word))
        })
    };
    let key = head.headers.iter().find(|h| h.name.eq_ignore_ascii_case("sec-websocket-key"))?;
    let is_upgrade = head.method == Some("GET")
        && has("connection", "upgrade")
        && has("upgrade", "websocket")
        && has("sec-websocket-version", "13");
    is_upgrade.then(|| {
        let accepted = derive_accept_key(key.value);
        format!(
            "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Accept: {accepted}\r\n{more}\r\n"
        )
        .into_bytes()
    })
}

/// Serves a page until it disconnects, the session ends, or the server closes.
/// `rest` contains the bytes after the request.
pub(super) fn run(stream: TcpStream, rest: Vec<u8>, place: &Seat, shared: &Shared) {
    let _counted = Counted::new(&shared.pages);
    place.looks_on();
    if stream.set_read_timeout(Some(TURN)).is_err() {
        return;
    }
    let config = WebSocketConfig::default()
        .read_buffer_size(4096)
        .write_buffer_size(0)
        .max_message_size(Some(MESSAGE_MAX))
        .max_frame_size(Some(MESSAGE_MAX));
    let socket = WebSocket::from_partially_read(stream, rest, Role::Server, Some(config));
    let mut page = Page {
        socket,
        place,
        shared,
        told: Told::default(),
        greeted: false,
        sent: 0,
        taken: 0,
        taken_at: Instant::now(),
    };
    // The page displays any end of the connection, and reconnects.
    let _ = page.run();
}

struct Page<'a> {
    socket: WebSocket<TcpStream>,
    place: &'a Seat,
    shared: &'a Shared,
    told: Told,
    greeted: bool,
    /// Numbers of frames sent and acknowledged.
    sent: u64,
    taken: u64,
    taken_at: Instant,
}

impl Page<'_> {
    fn run(&mut self) -> Result<(), Error> {
        loop {
            // The flag is read before the last check of the history, so that everything is sent at the end.
            let over = self.shared.over.load(Ordering::SeqCst);
            if over || self.sent - self.taken < IN_FLIGHT_MAX {
                self.tell()?;
            } else if self.taken_at.elapsed() > TAKES_NOTHING {
                return self.socket.close(None);
            }
            if over || self.shared.closing.load(Ordering::SeqCst) {
                self.socket.send(Message::text(r#"{"over":true}"#))?;
                return self.socket.close(None);
            }
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    if !self.hear(text.as_str()) {
                        return self.socket.close(None);
                    }
                }
                // The library answers control frames.
                Ok(Message::Ping(_) | Message::Pong(_) | Message::Close(_)) => {}
                Ok(_) => return self.socket.close(None),
                Err(Error::Io(error))
                    if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends the newest state and all related data.
    fn tell(&mut self) -> Result<(), Error> {
        let (hello, frame) = {
            let history = self.shared.history();
            let hello = if self.greeted { None } else { history.hello.clone() };
            let known = self.greeted || hello.is_some();
            (hello, if known { history.frame(&mut self.told) } else { None })
        };
        if let Some(hello) = hello {
            self.greeted = true;
            self.socket.send(Message::text(&*hello))?;
        }
        if let Some(frame) = frame {
            if self.sent == self.taken {
                self.taken_at = Instant::now();
            }
            self.sent += 1;
            self.socket.send(Message::text(frame.to_json()))?;
        }
        Ok(())
    }

    /// Returns false for messages that our pages never send.
    fn hear(&mut self, text: &str) -> bool {
        match text {
            "stop" => self.shared.stop.store(true, Ordering::SeqCst),
            "show" => self.shared.show.store(true, Ordering::SeqCst),
            "took" if self.taken < self.sent => {
                self.taken += 1;
                self.taken_at = Instant::now();
            }
            _ => {
                let mark = text.strip_prefix("mark ").and_then(|mark| mark.parse().ok());
                return mark.is_some_and(|mark| self.shared.mark(mark));
            }
        }
        self.place.heard();
        true
    }
}
