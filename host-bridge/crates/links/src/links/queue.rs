//! A bounded queue for the events of links, in which the newest data has priority.
//!
//! A board that sends too much must not fill the memory, and must not delay new bytes behind old bytes.
//! The queue therefore has a maximum size and drops the oldest bytes.
//! This loss is harmless because every state is complete. Events about opened and closed ports are never dropped.

use std::collections::VecDeque;
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::{LinkEvent, News};

/// Maximum number of waiting bytes: half a second of the fastest board's stream.
const BYTES_MAX: usize = 64 * 1024;
/// Maximum number of waiting events of any size.
const EVENTS_MAX: usize = 1024;

/// Creates both ends of a new queue.
pub fn queue<I>() -> (EventSender<I>, EventReceiver<I>) {
    let shared = Arc::new(Shared { waiting: Mutex::default(), news: Condvar::new() });
    lock(&shared.waiting).senders = 1;
    (EventSender(Arc::clone(&shared)), EventReceiver(shared))
}

struct Shared<I> {
    waiting: Mutex<Waiting<I>>,
    news: Condvar,
}

struct Waiting<I> {
    events: VecDeque<LinkEvent<I>>,
    bytes: usize,
    dropped_bytes: u64,
    senders: usize,
}

impl<I> Default for Waiting<I> {
    fn default() -> Self {
        Waiting { events: VecDeque::new(), bytes: 0, dropped_bytes: 0, senders: 0 }
    }
}

/// A panic in another thread must not block the bytes of a stop.
fn lock<I>(waiting: &Mutex<Waiting<I>>) -> MutexGuard<'_, Waiting<I>> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner)
}

fn size<I>(event: &LinkEvent<I>) -> usize {
    if let News::Bytes(bytes) = &event.news { bytes.len() } else { 0 }
}

/// The sending side of the queue. Each link has its own.
pub struct EventSender<I>(Arc<Shared<I>>);

impl<I> EventSender<I> {
    /// Adds an event without waiting. If the queue is full, the oldest bytes are dropped.
    pub fn send(&self, event: LinkEvent<I>) {
        let mut waiting = lock(&self.0.waiting);
        waiting.bytes += size(&event);
        waiting.events.push_back(event);
        while waiting.bytes > BYTES_MAX || waiting.events.len() > EVENTS_MAX {
            let oldest = waiting.events.iter().position(|event| size(event) > 0);
            let Some(event) = oldest.and_then(|at| waiting.events.remove(at)) else { break };
            waiting.bytes -= size(&event);
            waiting.dropped_bytes += size(&event) as u64;
        }
        drop(waiting);
        self.0.news.notify_one();
    }
}

impl<I> Clone for EventSender<I> {
    fn clone(&self) -> Self {
        lock(&self.0.waiting).senders += 1;
        EventSender(Arc::clone(&self.0))
    }
}

impl<I> Drop for EventSender<I> {
    fn drop(&mut self) {
        lock(&self.0.waiting).senders -= 1;
        self.0.news.notify_one();
    }
}

/// The receiving side of the queue, used by the control thread.
pub struct EventReceiver<I>(Arc<Shared<I>>);

impl<I> EventReceiver<I> {
    /// Returns the oldest event, if there is one.
    pub fn try_recv(&self) -> Option<LinkEvent<I>> {
        take(&mut lock(&self.0.waiting))
    }

    /// Waits for the oldest event.
    ///
    /// # Errors
    /// Fails if nothing arrives within `patience`, or no link is left.
    pub fn recv_timeout(&self, patience: Duration) -> Result<LinkEvent<I>, RecvTimeoutError> {
        let until = Instant::now() + patience;
        let mut waiting = lock(&self.0.waiting);
        loop {
            if let Some(event) = take(&mut waiting) {
                return Ok(event);
            }
            if waiting.senders == 0 {
                return Err(RecvTimeoutError::Disconnected);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(RecvTimeoutError::Timeout);
            }
            waiting = self.0.news.wait_timeout(waiting, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Number of bytes dropped because the queue was full.
    pub fn dropped_bytes(&self) -> u64 {
        lock(&self.0.waiting).dropped_bytes
    }
}

fn take<I>(waiting: &mut Waiting<I>) -> Option<LinkEvent<I>> {
    let event = waiting.events.pop_front()?;
    waiting.bytes -= size(&event);
    Some(event)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(number: u64, len: usize) -> LinkEvent<()> {
        LinkEvent { link: (), at_ms: number, news: News::Bytes(vec![number as u8; len]) }
    }

    #[test]
    fn what_fits_arrives_in_order() {
        let (sender, receiver) = queue();
        for number in 0..50 {
            sender.send(bytes(number, 1024));
        }
        let times: Vec<u64> = std::iter::from_fn(|| receiver.try_recv()).map(|event| event.at_ms).collect();
        assert_eq!(times, (0..50).collect::<Vec<_>>());
        assert_eq!(receiver.dropped_bytes(), 0);
    }

    #[test]
    fn a_flood_keeps_the_newest_64_kb_and_that_the_port_was_opened() {
        let (sender, receiver) = queue();
        sender.send(LinkEvent { link: (), at_ms: 0, news: News::Opened });
        for number in 1..=100_000 {
            sender.send(bytes(number, 1024));
        }
        assert_eq!(receiver.try_recv().unwrap().news, News::Opened);
        let times: Vec<u64> = std::iter::from_fn(|| receiver.try_recv()).map(|event| event.at_ms).collect();
        assert_eq!(times, (100_000 - 63..=100_000).collect::<Vec<_>>());
        assert_eq!(receiver.dropped_bytes(), (100_000 - 64) * 1024);
    }

    #[test]
    fn single_bytes_are_bounded_too() {
        let (sender, receiver) = queue();
        for number in 0..1_000_000 {
            sender.send(bytes(number, 1));
        }
        assert_eq!(std::iter::from_fn(|| receiver.try_recv()).count(), EVENTS_MAX);
    }

    #[test]
    fn a_queue_without_links_says_so() {
        let (sender, receiver) = queue::<()>();
        let other = sender.clone();
        drop(sender);
        assert_eq!(receiver.recv_timeout(Duration::ZERO), Err(RecvTimeoutError::Timeout));
        drop(other);
        assert_eq!(receiver.recv_timeout(Duration::from_secs(60)), Err(RecvTimeoutError::Disconnected));
    }
}
