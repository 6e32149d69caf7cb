//! The outbox: each lane has a thread that passes messages to Zenoh. The control thread never waits for the network.
//! Only the lanes' threads wait (congestion control "block").
//! Meanwhile, a newer speed replaces a speed that is waiting.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::{Session, Wait};

use super::inbox::{Asked, Inbox, Read, Which};
use super::waiting::{Ask, Job, Lane, Order, Place, Waiting};
use super::writer_of;
use crate::transport::{NodeError, Sent, Unsent};
use crate::zenoh_keys::{Attached, Entity, Named, Node, Quality};

/// At the end, the program waits this long for the last messages, such as a zero speed.
const LAST_WORDS: Duration = Duration::from_millis(300);

impl Lane {
    /// The lane's queue in Zenoh, and the behaviour if it is full.
    fn quality(self) -> (Priority, CongestionControl) {
        match self {
            Lane::Requests => (Priority::RealTime, CongestionControl::Block),
            Lane::Arm => (Priority::InteractiveHigh, CongestionControl::Block),
            Lane::Base => (Priority::InteractiveLow, CongestionControl::Block),
            Lane::Rest => (Priority::Data, CongestionControl::Drop),
        }
    }

    fn thread_name(self) -> &'static str {
        match self {
            Lane::Requests => "zenoh-requests",
            Lane::Arm => "zenoh-arm",
            Lane::Base => "zenoh-base",
            Lane::Rest => "zenoh-rest",
        }
    }
}

#[derive(Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    came: Condvar,
    /// Counts of messages that Zenoh did not accept.
    failed: AtomicU64,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The sending side. When its last copy is dropped, the threads and the session end.
#[derive(Clone)]
pub struct Outbox {
    end: Arc<End>,
}

struct End {
    lanes: [Arc<Shared>; 4],
    /// Receives a signal when the last thread has ended.
    ended: Mutex<Receiver<()>>,
    ids: AtomicU32,
}

impl Drop for End {
    fn drop(&mut self) {
        for lane in &self.lanes {
            lane.lock().has_ended = true;
            lane.came.notify_all();
        }
        // The channel is closed when the last thread drops its side.
        let ended = self.ended.get_mut().unwrap_or_else(PoisonError::into_inner);
        let _ = ended.recv_timeout(LAST_WORDS);
    }
}

/// The session with its subscriptions and tokens, which the last lane to end closes.
struct Held {
    session: Session,
    _read_and_said: Box<dyn Send + Sync>,
}

impl Drop for Held {
    fn drop(&mut self) {
        // Errors of a session that ends are irrelevant.
        let _ = self.session.close().wait();
    }
}

impl Outbox {
    /// Starts the threads; `held` is dropped when the last one ends.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start(
        session: Session,
        node: &Node,
        inbox: &Inbox,
        held: Box<dyn Send + Sync>,
    ) -> Result<Self, NodeError> {
        let lanes: [Arc<Shared>; 4] = std::array::from_fn(|_| Arc::default());
        let held = Arc::new(Held { session: session.clone(), _read_and_said: held });
        let (sender, ended) = channel();
        let end = End { lanes: lanes.clone(), ended: Mutex::new(ended), ids: AtomicU32::new(CALLERS_IDS) };
        for (lane, shared) in Lane::ALL.into_iter().zip(&lanes) {
            let courier = Courier {
                lane,
                session: session.clone(),
                node: node.clone(),
                inbox: inbox.clone(),
                shared: Arc::clone(shared),
                writers: BTreeMap::new(),
                readers: BTreeMap::new(),
                said: Vec::new(),
                ids: COURIERS_IDS * (1 + lane as u32),
            };
            let last = (Arc::clone(&held), sender.clone());
            std::thread::Builder::new()
                .name(lane.thread_name().to_owned())
                .spawn(move || {
                    courier.run();
                    let (held, ended): (Arc<Held>, std::sync::mpsc::Sender<()>) = last;
                    // The order matters: after the signal, the process may end.
                    drop(held);
                    drop(ended);
                })
                .map_err(|error| NodeError::of("a thread", &error))?;
        }
        Ok(Outbox { end: Arc::new(end) })
    }

    fn lane(&self, lane: Lane) -> &Shared {
        &self.end.lanes[lane as usize]
    }

    /// Returns a number for an end point that no other end point has.
    pub fn id(&self) -> u32 {
        self.end.ids.fetch_add(1, Ordering::Relaxed)
    }

    /// Executes this order when its turn comes.
    pub fn order(&self, order: Order) {
        let lane = self.lane(order.lane());
        lane.lock().order(order);
        lane.came.notify_all();
    }

    /// Adds a message. It replaces an older message that is still waiting.
    pub fn put(&self, place: Place, message: Vec<u8>) -> Sent {
        let lane = self.lane(place.lane());
        let replaces = lane.lock().put(place, message);
        lane.came.notify_all();
        if replaces { Sent::Instead } else { Sent::Yes }
    }

    /// Adds a request, unless too many requests are already waiting.
    pub fn ask(&self, ask: Ask) -> Sent {
        let lane = self.lane(Lane::Requests);
        let taken = lane.lock().ask(ask);
        lane.came.notify_all();
        taken
    }

    /// Drops a request that still waits.
    pub fn withdraw(&self, about: Asked) {
        self.lane(Lane::Requests).lock().withdraw(about);
    }

    /// Returns the counts of messages that were accepted but not sent since the last call.
    pub fn take_unsent(&self) -> Unsent {
        let failed = self.end.lanes.iter().map(|lane| lane.failed.swap(0, Ordering::Relaxed)).sum();
        Unsent { withdrawn: self.lane(Lane::Requests).lock().take_withdrawn(), failed }
    }
}

/// First numbers of the end points that [`Outbox::id`] creates, and of those that the threads create.
/// Lower numbers are used at the start.
const CALLERS_IDS: u32 = 1000;
const COURIERS_IDS: u32 = 1_000_000;

/// A subscription to a topic, and the token that announces it.
pub type Reader = (Subscriber<()>, LivelinessToken);

/// Subscribes to a topic from now on.
///
/// # Errors
/// Fails if the session is over, or the name is invalid.
pub fn listen(
    session: &Session,
    node: &Node,
    inbox: &Inbox,
    id: u32,
    (read, named, quality): (Read, &Named, Quality),
) -> zenoh::Result<Reader> {
    let inbox = inbox.clone();
    let subscriber = session
        .declare_subscriber(named.key(node.domain))
        .callback(move |sample| inbox.hear(read, &sample))
        .wait()?;
    let token = node.end_token(id, Entity::Subscription, named, quality);
    Ok((subscriber, session.liveliness().declare_token(token).wait()?))
}

struct Writer {
    publisher: Publisher<'static>,
    /// The token that announces the publisher.
    _token: LivelinessToken,
    writer: [u8; 16],
    number: i64,
}

/// Runs the thread of a lane.
struct Courier {
    lane: Lane,
    session: Session,
    node: Node,
    inbox: Inbox,
    shared: Arc<Shared>,
    writers: BTreeMap<Place, Writer>,
    readers: BTreeMap<Read, Reader>,
    said: Vec<(Which, LivelinessToken)>,
    ids: u32,
}

impl Courier {
    fn run(mut self) {
        while let Some(job) = self.next() {
            let done = match job {
                Job::Put(place, message) => self.put(place, message),
                Job::Ask(ask) => self.ask(ask),
                Job::Order(order) => self.carry_out(order),
            };
            if done.is_err() {
                self.shared.failed.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    fn next(&self) -> Option<Job> {
        let mut waiting = self.shared.lock();
        loop {
            if let Some(job) = waiting.next(Instant::now()) {
                return Some(job);
            }
            if waiting.has_ended {
                return None;
            }
            waiting = self.shared.came.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn carry_out(&mut self, order: Order) -> zenoh::Result<()> {
        match order {
            Order::Write(place, named, quality) => self.declare(place, &named, quality)?,
            Order::Unwrite(place) => drop(self.writers.remove(&place)),
            Order::Read(read, named, quality) => {
                self.ids += 1;
                let reader =
                    listen(&self.session, &self.node, &self.inbox, self.ids, (read, &named, quality))?;
                self.readers.insert(read, reader);
            }
            Order::Say(which, token) => {
                let declared = self.session.liveliness().declare_token(token).wait()?;
                self.said.push((which, declared));
            }
            Order::Forget(which) => {
                self.readers.retain(|read, _| ![Read::Status(which), Read::Feedback(which)].contains(read));
                self.said.retain(|(known, _)| *known != which);
            }
        }
        Ok(())
    }

    fn declare(&mut self, place: Place, named: &Named, quality: Quality) -> zenoh::Result<()> {
        self.ids += 1;
        let token = self.node.end_token(self.ids, Entity::Publisher, named, quality);
        let (priority, congestion) = self.lane.quality();
        let publisher = self
            .session
            .declare_publisher(named.key(self.node.domain))
            .congestion_control(congestion)
            .priority(priority)
            // Only one message is passed on at a time,
            // because a message inside Zenoh can no longer be replaced.
            .express(true)
            .wait()?;
        let writer = writer_of(&token);
        let token = self.session.liveliness().declare_token(token).wait()?;
        self.writers.insert(place, Writer { publisher, _token: token, writer, number: 0 });
        Ok(())
    }

    fn put(&mut self, place: Place, message: Vec<u8>) -> zenoh::Result<()> {
        let Some(Writer { publisher, writer, number, .. }) = self.writers.get_mut(&place) else {
            return Err(format!("{place:?} is not written").into());
        };
        *number += 1;
        let attached = Attached { number: *number, sent_ns: now_ns(), writer: *writer };
        let attached = attached.bytes(self.inbox.is_labelled.load(Ordering::Relaxed));
        publisher.put(message).attachment(attached).wait()
    }

    fn ask(&self, ask: Ask) -> zenoh::Result<()> {
        let Ask { key, payload, attached, about, patience, .. } = ask;
        let inbox = self.inbox.clone();
        let (priority, congestion) = self.lane.quality();
        let mut get = self
            .session
            .get(key)
            .congestion_control(congestion)
            .priority(priority)
            .express(true)
            .consolidation(ConsolidationMode::None)
            .timeout(patience);
        get = match attached {
            Some(attached) => get
                .target(QueryTarget::AllComplete)
                .payload(payload)
                .attachment(attached.bytes(self.inbox.is_labelled.load(Ordering::Relaxed))),
            // A writer's stored message for late subscribers has the topic's own key.
            None => get.target(QueryTarget::All).accept_replies(ReplyKeyExpr::Any),
        };
        get.callback(move |reply| {
            if let Ok(sample) = reply.result() {
                inbox.answer(about, sample);
            }
        })
        .wait()
    }
}

/// Nanoseconds since 1970.
pub fn now_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
