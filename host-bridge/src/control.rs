//! The control thread, which runs the engine in real time.
//!
//! ```text
//! links ══ bytes ══►┐                       ┌══► links (frames for boards)
//! keys, page, signals ═►  Control (engine)  ├══► Report: events and states, for whoever draws and prints
//!                                           └──► observers on the tap, robot
//! ```
//!
//! Inputs are read in bounded portions. Outputs are sent without waiting, or dropped.
//! No terminal, file, pipe or socket can therefore delay a stop.
//! When the thread ends, the robot is halted, even if the thread panicked.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use host_core::engine::Engine;
use host_core::episodes::{Mark, MarkedBy};
use host_core::observe::{SessionEvent, Snapshot};
use host_core::safety::{Hand, PerHand};
use host_core::source::HandKey;
use host_links::links::{Clock, EventReceiver, Link, News, Waiter};
use host_robot::Door;

use crate::wearer::Wearer;

/// Incoming bytes wake the loop at once. Without bytes, the loop runs at this interval.
const TURN: Duration = Duration::from_millis(2);
/// Maximum time for reading bytes before the engine runs.
const RECEIVE_MAX: Duration = Duration::from_millis(5);
/// Interval at which a state is reported.
const STATE_INTERVAL_MS: u64 = 33;
/// Maximum number of reports that wait to be printed.
const REPORTS_MAX: usize = 64;
/// Maximum number of events that wait if nobody reads reports. The oldest events are dropped and counted.
const BACKLOG_MAX: usize = 1000;

/// A request from the user or the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// A key that controls a hand is pressed or repeated.
    Press(HandKey),
    /// A key that controls a hand was released.
    Up(HandKey),
    /// The release key was pressed and confirmed.
    Release,
    /// Only the arm's motion ends.
    EndArm,
    /// The left hand takes control of the arm, or is returned to the base.
    Clutch,
    /// An episode begins or ends here.
    Mark(Mark),
    /// The wearer begins to show gestures, or cancels this.
    Show,
}

/// An event of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkReport {
    /// Time of the event.
    pub time_ms: u64,
    /// The hand to which the link belongs.
    pub hand: Hand,
    /// The reason why the link is closed, and a remedy. `None` means that the link is open.
    pub closed: Option<String>,
}

/// The events since the last report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Events of the session, in order.
    pub events: Vec<SessionEvent>,
    /// Events of the links, in order.
    pub links: Vec<LinkReport>,
    /// The state of the session, every 33 ms.
    pub snapshot: Option<Snapshot>,
}

/// Requests that any thread may set at any time without waiting.
#[derive(Clone, Default)]
pub struct Flags {
    stop: Arc<AtomicBool>,
    quit: Arc<AtomicBool>,
}

impl Flags {
    /// Requests the operator's stop. A flag suffices, because several stops have the same effect as one.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::SeqCst);
    }

    /// Ends the session and halts base and arm.
    pub fn quit(&self) {
        self.quit.store(true, Ordering::SeqCst);
    }

    /// Returns whether the end was requested.
    pub fn is_quitting(&self) -> bool {
        self.quit.load(Ordering::SeqCst)
    }

    /// Returns the flag of [`Flags::quit`] for a signal handler.
    pub fn quit_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.quit)
    }
}

/// The data with which the control thread starts.
pub struct Work<D: Door> {
    /// The engine, before its first step.
    pub engine: Engine<'static, D>,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The boards' links.
    pub links: PerHand<Option<Link>>,
    /// The queue for the links' events.
    pub events: EventReceiver<Hand>,
    /// Another source of stops, which is polled in every turn and must not block.
    pub asks_for_stop: Box<dyn Fn() -> bool + Send>,
    /// Another source of marks, which is polled in every turn and must not block.
    pub marks: Box<dyn Fn() -> Option<Mark> + Send>,
    /// The wearer of the right hand, if this session supports showing gestures.
    pub wearer: Option<Wearer>,
    /// Another source for presses of the wearer's key. It is polled in every turn, and must not block.
    pub shows: Box<dyn Fn() -> bool + Send>,
    /// The time at which the session ends by itself.
    pub until_ms: u64,
    /// Time for which the robot is served after the last halt, so that the halt arrives.
    pub farewell_ms: u64,
}

/// The running thread. Dropping it ends the session.
pub struct Control<D: Door> {
    flags: Flags,
    orders: SyncSender<Order>,
    reports: Receiver<Report>,
    dropped: Arc<AtomicU64>,
    result: Arc<Mutex<Option<Engine<'static, D>>>>,
    /// The waiter of the thread that reads reports.
    waiter: Waiter,
    thread: Option<JoinHandle<()>>,
}

impl<D: Door + Send + 'static> Control<D> {
    /// Starts the thread.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start(work: Work<D>, flags: Flags) -> std::io::Result<Self> {
        let (orders, incoming) = sync_channel(REPORTS_MAX);
        let (outgoing, reports) = sync_channel(REPORTS_MAX);
        let (dropped, result) = (Arc::new(AtomicU64::new(0)), Arc::new(Mutex::new(None)));
        let waiter = work.clock.waiter();
        let mut running = Running {
            waiter: work.clock.waiter(),
            work: Some(work),
            flags: flags.clone(),
            orders: incoming,
            reports: outgoing,
            waiting: Report::default(),
            state_ms: None,
            dropped: Arc::clone(&dropped),
            result: Arc::clone(&result),
        };
        let thread = std::thread::Builder::new().name("control".to_owned()).spawn(move || running.run())?;
        Ok(Control { flags, orders, reports, dropped, result, waiter, thread: Some(thread) })
    }

    /// Sends a request. A request that does not fit in the queue is dropped, because it would be late.
    pub fn order(&self, order: Order) {
        let _ = self.orders.try_send(order);
    }

    /// Waits for a report, for at most `patience`. Returns `None` if there was none.
    ///
    /// # Errors
    /// Fails if the thread has ended.
    pub fn report(&self, patience: Duration) -> Result<Option<Report>, Over> {
        match self.waiter.receive(&self.reports, patience) {
            Ok(report) => Ok(Some(report)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(Over),
        }
    }

    /// Returns the number of events that nobody read in time.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Ends the session and returns the engine.
    /// The result is `None` if the thread panicked, which also halts the robot.
    pub fn end(mut self) -> Option<Engine<'static, D>> {
        self.join();
        self.result.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl<D: Door> Control<D> {
    fn join(&mut self) {
        self.flags.quit();
        if let Some(thread) = self.thread.take() {
            // The panic message was already printed.
            let _ = self.waiter.aside(|| thread.join());
        }
    }
}

impl<D: Door> Drop for Control<D> {
    fn drop(&mut self) {
        self.join();
    }
}

/// The control thread has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Over;

struct Running<D: Door> {
    waiter: Waiter,
    /// The engine, which is present until the thread ends.
    work: Option<Work<D>>,
    flags: Flags,
    orders: Receiver<Order>,
    reports: SyncSender<Report>,
    waiting: Report,
    state_ms: Option<u64>,
    dropped: Arc<AtomicU64>,
    result: Arc<Mutex<Option<Engine<'static, D>>>>,
}

impl<D: Door> Running<D> {
    fn run(&mut self) {
        while let Some(work) = &mut self.work {
            if work.clock.now_ms() >= work.until_ms || self.flags.is_quitting() {
                break;
            }
            self.turn();
        }
        if let Some(mut work) = self.work.take() {
            farewell(&mut work, &self.waiter);
            *self.result.lock().unwrap_or_else(PoisonError::into_inner) = Some(work.engine);
        }
        let _ = self.reports.try_send(std::mem::take(&mut self.waiting));
    }

    fn turn(&mut self) {
        let Some(work) = &mut self.work else { return };
        match self.waiter.hear(&work.events, TURN) {
            Ok(event) => {
                let began = Instant::now();
                let mut next = Some(event);
                while let Some(event) = next {
                    let now_ms = work.clock.now_ms();
                    match event.news {
                        // Bytes are processed with their time of arrival.
                        // Bytes that waited therefore count as old.
                        News::Bytes(bytes) => {
                            work.engine.receive(event.link, &bytes, now_ms);
                            if let (Hand::Right, Some(wearer)) = (event.link, &mut work.wearer) {
                                wearer.receive(&bytes, now_ms);
                            }
                        }
                        News::Opened => {
                            self.waiting.links.push(LinkReport {
                                time_ms: now_ms,
                                hand: event.link,
                                closed: None,
                            });
                        }
                        News::Closed(why) => {
                            let closed = Some(why);
                            self.waiting.links.push(LinkReport { time_ms: now_ms, hand: event.link, closed });
                        }
                    }
                    next = if began.elapsed() < RECEIVE_MAX { work.events.try_recv() } else { None };
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => self.waiter.sleep(TURN),
        }
        let now_ms = work.clock.now_ms();
        if self.flags.stop.swap(false, Ordering::SeqCst) | (work.asks_for_stop)() {
            work.engine.stop_key(now_ms);
        }
        for order in self.orders.try_iter().take(REPORTS_MAX) {
            match order {
                Order::Press(key) => work.engine.press(key, now_ms),
                Order::Up(key) => work.engine.release_hand_key(key),
                Order::Release => work.engine.release_key(now_ms),
                Order::EndArm => work.engine.end_arm_key(now_ms),
                Order::Clutch => work.engine.clutch_key(now_ms),
                Order::Mark(mark) => work.engine.mark(mark, MarkedBy::Key, now_ms),
                Order::Show => work.wearer.iter_mut().for_each(Wearer::press),
            }
        }
        if let Some(mark) = (work.marks)() {
            work.engine.mark(mark, MarkedBy::Page, now_ms);
        }
        let ready = PerHand::of(|hand| work.links[hand].as_ref().is_some_and(Link::is_ready));
        if let Some(wearer) = &mut work.wearer {
            if (work.shows)() {
                wearer.press();
            }
            wearer.turn(&mut work.engine, ready.right, now_ms);
        }
        self.waiting.events.extend(work.engine.advance(now_ms, ready));
        for hand in Hand::BOTH {
            for frame in work.engine.take_outgoing(hand) {
                if let Some(link) = &work.links[hand] {
                    link.send(&frame);
                }
            }
        }
        if self.state_ms.is_none_or(|at| now_ms.saturating_sub(at) >= STATE_INTERVAL_MS) {
            self.state_ms = Some(now_ms);
            self.waiting.snapshot = Some(Snapshot::of(&work.engine.now(now_ms)));
        }
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let Report { events, links, snapshot } = &self.waiting;
        if events.is_empty() && links.is_empty() && snapshot.is_none() {
            return;
        }
        match self.reports.try_send(std::mem::take(&mut self.waiting)) {
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(report)) => {
                self.waiting = report;
                let events = self.waiting.events.len().saturating_sub(BACKLOG_MAX);
                self.waiting.events.drain(..events);
                let links = self.waiting.links.len().saturating_sub(BACKLOG_MAX);
                self.waiting.links.drain(..links);
                self.dropped.fetch_add((events + links) as u64, Ordering::Relaxed);
            }
        }
    }
}

fn farewell<D: Door>(work: &mut Work<D>, waiter: &Waiter) {
    work.engine.halt();
    let until_ms = work.clock.now_ms() + work.farewell_ms;
    while work.clock.now_ms() < until_ms {
        let now_ms = work.clock.now_ms();
        let door = work.engine.door_mut();
        door.step(now_ms);
        door.send();
        waiter.sleep(Duration::from_millis(5));
    }
}

impl<D: Door> Drop for Running<D> {
    /// The robot is halted even after a panic.
    fn drop(&mut self) {
        if let Some(work) = &mut self.work {
            farewell(work, &self.waiter);
        }
    }
}
