//! One emulated board in a thread of its own, at the pace of the wall clock, with its port.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::port::Port;

/// A board that is behind the clock is run in steps of this, so that its port is not kept waiting.
const STEP_MS: u64 = 10;
/// A board that is on time rests so long.
const NAP: Duration = Duration::from_millis(1);

/// An emulated board as its station handles it.
pub trait Board {
    /// Milliseconds since power-on, over resets.
    fn now_ms(&self) -> u64;
    /// Runs until this time. Starting up may have taken it further already.
    fn run_until_ms(&mut self, ms: u64);
    /// What it has sent since the last call.
    fn sent(&mut self) -> Vec<u8>;
    /// Bytes of the laptop.
    fn receive(&mut self, bytes: &[u8]);
    /// The laptop opened the port, or closed it.
    fn opened(&mut self, open: bool);
    /// The cable was pulled; the board has no other supply.
    fn pulled(&mut self);
    /// The cable was plugged in: the board starts, and its port appears when this returns.
    fn plugged(&mut self);
    /// Somebody presses the reset button. True if the port goes and comes back with it (USB of its own).
    fn restart(&mut self) -> bool;
}

type Deed<B> = Box<dyn FnOnce(&mut B) + Send>;
type Moment<B> = Box<dyn FnMut(&mut B) -> bool + Send>;

enum Order<B> {
    Do(Deed<B>),
    Pull,
    PullWhen(Moment<B>),
    Plug(Sender<()>),
    Restart(Sender<()>),
    Pace(f64),
    End,
}

/// A board's thread and port. Ends with it.
pub struct Station<B> {
    place: PathBuf,
    orders: Sender<Order<B>>,
    board_ms: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl<B: Board + 'static> Station<B> {
    /// Powers a board; its port is at `place` from now on. `make` runs in the board's thread.
    pub fn start(place: &Path, make: impl FnOnce() -> B + Send + 'static) -> Self {
        let (orders, received) = channel();
        let (ready, is_ready) = channel();
        let board_ms = Arc::new(AtomicU64::new(0));
        let (port, shown) = (Port::new(place.to_path_buf()), Arc::clone(&board_ms));
        let thread = std::thread::spawn(move || {
            let mut desk = Desk::new(make(), port, shown);
            desk.plug();
            let _ = ready.send(());
            desk.run(&received);
        });
        is_ready.recv().expect("the board starts");
        Self { place: place.to_path_buf(), orders, board_ms, thread: Some(thread) }
    }

    /// What to give to `--left`, `--right` or `--port`.
    pub fn port(&self) -> String {
        self.place.display().to_string()
    }

    /// Virtual milliseconds that the board has run.
    pub fn board_ms(&self) -> u64 {
        self.board_ms.load(Ordering::Relaxed)
    }

    /// Does something to the board or its wearer, soon.
    pub fn with(&self, deed: impl FnOnce(&mut B) + Send + 'static) {
        self.order(Order::Do(Box::new(deed)));
    }

    /// Pulls the cable.
    pub fn pull(&self) {
        self.order(Order::Pull);
    }

    /// Pulls the cable at the moment at which this becomes true.
    pub fn pull_when(&self, moment: impl FnMut(&mut B) -> bool + Send + 'static) {
        self.order(Order::PullWhen(Box::new(moment)));
    }

    /// Plugs it in again; the port is there when this returns.
    pub fn plug(&self) {
        let (done, is_done) = channel();
        self.order(Order::Plug(done));
        let _ = is_done.recv();
    }

    /// Presses the reset button; the port is there (again) when this returns.
    pub fn restart(&self) {
        let (done, is_done) = channel();
        self.order(Order::Restart(done));
        let _ = is_done.recv();
    }

    /// From now on so many milliseconds of the board's pass in one of ours. Only where the program does not
    /// compare the two clocks: `run` would take a fast board for a broken one, and be right.
    pub fn pace(&self, factor: f64) {
        self.order(Order::Pace(factor));
    }

    fn order(&self, order: Order<B>) {
        self.orders.send(order).expect("the board runs");
    }
}

impl<B> Drop for Station<B> {
    fn drop(&mut self) {
        let _ = self.orders.send(Order::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Desk<B> {
    board: B,
    port: Port,
    open: bool,
    board_ms: Arc<AtomicU64>,
    pull_when: Option<Moment<B>>,
    pace: f64,
    /// The board's time was to be `from_ms` at this moment.
    since: Instant,
    from_ms: u64,
}

impl<B: Board> Desk<B> {
    fn new(board: B, port: Port, board_ms: Arc<AtomicU64>) -> Self {
        Self {
            board,
            port,
            open: false,
            board_ms,
            pull_when: None,
            pace: 1.0,
            since: Instant::now(),
            from_ms: 0,
        }
    }

    fn wanted_ms(&self) -> u64 {
        self.from_ms + (self.since.elapsed().as_secs_f64() * 1000.0 * self.pace) as u64
    }

    fn plug(&mut self) {
        if !self.port.is_plugged() {
            self.board.plugged();
            self.board.sent();
            self.port.plug();
        }
    }

    fn pull(&mut self) {
        self.port.pull();
        self.open = false;
        self.board.pulled();
    }

    fn run(&mut self, orders: &Receiver<Order<B>>) {
        self.since = Instant::now();
        self.from_ms = self.board.now_ms();
        loop {
            while let Ok(order) = orders.try_recv() {
                match order {
                    Order::Do(deed) => deed(&mut self.board),
                    Order::Pull => self.pull(),
                    Order::PullWhen(moment) => self.pull_when = Some(moment),
                    Order::Plug(done) => {
                        self.plug();
                        let _ = done.send(());
                    }
                    Order::Restart(done) => {
                        if self.board.restart() {
                            self.pull();
                            // A system needs a moment to see a device go and come.
                            std::thread::sleep(Duration::from_millis(200));
                            self.plug();
                        }
                        let _ = done.send(());
                    }
                    Order::Pace(pace) => {
                        self.from_ms = self.wanted_ms();
                        self.since = Instant::now();
                        self.pace = pace;
                    }
                    Order::End => return,
                }
            }
            self.turn();
            if self.pull_when.as_mut().is_some_and(|moment| moment(&mut self.board)) {
                self.pull_when = None;
                self.pull();
            }
        }
    }

    fn turn(&mut self) {
        let (now_ms, wanted_ms) = (self.board.now_ms(), self.wanted_ms());
        if now_ms < wanted_ms {
            self.board.run_until_ms(wanted_ms.min(now_ms + STEP_MS));
        } else {
            std::thread::sleep(NAP);
        }
        self.board_ms.store(self.board.now_ms(), Ordering::Relaxed);
        let sent = self.board.sent();
        self.port.write(&sent);
        let mut bytes = Vec::new();
        let open = self.port.read(&mut bytes);
        if open != self.open {
            self.open = open;
            self.board.opened(open);
        }
        if !bytes.is_empty() {
            self.board.receive(&bytes);
        }
    }
}
