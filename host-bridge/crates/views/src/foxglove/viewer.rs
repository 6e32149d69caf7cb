//! One viewer's connection: what it subscribed to goes out, subscriptions come in.

use std::io;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use super::protocol::{Subscriptions, advertise, message_data, server_info, warning};
use super::{QUEUE, Seen, Shared};
use crate::web::server::{Counted, Seat};
use host_topics::{Entry, Origin};

/// The thread looks for news this often; what the viewer says wakes it at once.
const TURN: Duration = Duration::from_millis(4);

/// Longest message of a viewer: a subscription to everything is below 1 kB.
const MESSAGE_MAX: usize = 1 << 16;

/// Serves a viewer until it goes or the session ends. `rest` came behind the request.
pub fn run(stream: TcpStream, rest: Vec<u8>, place: &Seat, shared: &Shared) {
    let _counted = Counted::new(&shared.viewers);
    place.looks_on();
    if stream.set_read_timeout(Some(TURN)).is_err() {
        return;
    }
    let config = WebSocketConfig::default()
        .read_buffer_size(4096)
        .max_message_size(Some(MESSAGE_MAX))
        .max_frame_size(Some(MESSAGE_MAX));
    let socket = WebSocket::from_partially_read(stream, rest, Role::Server, Some(config));
    let seen = Arc::new(Seen::default());
    let queue = shared.join(&seen);
    // Whatever ends the connection, the viewer shows that it is gone and tries again.
    let _ = Viewer { socket, place, shared, queue, seen, wanted: Subscriptions::default() }.run();
}

struct Viewer<'a> {
    socket: WebSocket<TcpStream>,
    place: &'a Seat,
    shared: &'a Shared,
    queue: Receiver<Arc<Entry>>,
    seen: Arc<Seen>,
    wanted: Subscriptions,
}

impl Viewer<'_> {
    fn run(&mut self) -> Result<(), Error> {
        self.socket.send(Message::text(server_info(self.shared.session)))?;
        self.socket.send(Message::text(advertise()))?;
        loop {
            // Asked before the last look at the queue, so that nothing is left unsent at the end.
            let over = self.shared.over.load(Ordering::SeqCst);
            self.tell()?;
            if over {
                return self.socket.close(None);
            }
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.place.heard();
                    if let Err(problem) = self.wanted.hear(text.as_str()) {
                        self.socket.send(Message::text(warning(&problem)))?;
                    }
                    self.seen.wanted.store(self.wanted.bits(), Ordering::Relaxed);
                }
                Ok(Message::Binary(_)) => {
                    self.socket.send(Message::text(warning("viewers of this robot only look on")))?;
                }
                // Control frames are answered by the library.
                Ok(_) => {}
                Err(Error::Io(error))
                    if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends what waits.
    fn tell(&mut self) -> Result<(), Error> {
        let lost = self.seen.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let told = format!("the connection was too slow for {lost} messages; subscribe to less");
            self.socket.write(Message::text(warning(&told)))?;
        }
        let origin = Origin { nanoseconds: self.shared.session };
        // No more than what waits now: the viewer's messages must be read in between.
        for entry in self.queue.try_iter().take(QUEUE) {
            // What was unsubscribed while it waited is not sent.
            if let Some(id) = self.wanted.to(entry.topic) {
                let data = message_data(id, origin.at(entry.time_ms), &entry.data);
                self.socket.write(Message::binary(data))?;
            }
        }
        self.socket.flush()
    }
}
