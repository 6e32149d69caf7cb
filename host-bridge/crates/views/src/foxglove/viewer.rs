//! The connection of one viewer: sends subscribed messages and receives subscriptions.

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

/// Interval at which the thread checks for new messages. Data from the viewer wakes it immediately.
const TURN: Duration = Duration::from_millis(4);

/// Maximum length of a viewer's message. A subscription to all topics has less than 1 kB.
const MESSAGE_MAX: usize = 1 << 16;

/// Serves a viewer until it disconnects or the session ends. `rest` are the bytes after the request.
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
    // The viewer displays any end of the connection, and reconnects.
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
            // The flag is read before the last check of the queue, so that all messages are sent at the end.
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
                // The library answers control frames.
                Ok(_) => {}
                Err(Error::Io(error))
                    if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends the messages that wait.
    fn tell(&mut self) -> Result<(), Error> {
        let lost = self.seen.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let told = format!("the connection was too slow for {lost} messages; subscribe to less");
            self.socket.write(Message::text(warning(&told)))?;
        }
        let origin = Origin { nanoseconds: self.shared.session };
        // Only the messages that wait now are sent.
        // In between, the viewer's own messages must be read.
        for entry in self.queue.try_iter().take(QUEUE) {
            // If a topic was unsubscribed in the meantime, its messages are not sent.
            if let Some(id) = self.wanted.to(entry.topic) {
                let data = message_data(id, origin.at(entry.time_ms), &entry.data);
                self.socket.write(Message::binary(data))?;
            }
        }
        self.socket.flush()
    }
}
