//! A clock that a test controls through the socket in `BIMANUAL_TEST_CLOCK`.
//! The test sends the time in milliseconds.
//! The test receives one byte when every participating thread waits for a later time.
//!
//! This clock exists only with the feature `test-clock`, which no released program has.

use std::io::{Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

const VARIABLE: &str = "BIMANUAL_TEST_CLOCK";

/// The test's clock in this process.
#[derive(Debug, Default)]
pub struct TestClock {
    state: Mutex<State>,
    /// Signals that the time has changed or a bell was rung.
    ticked: Condvar,
    /// Signals that another thread waits or has ended.
    settled: Condvar,
}

#[derive(Debug, Default)]
struct State {
    now_ms: u64,
    /// Who takes part.
    seats: Vec<Sitter>,
    next: u64,
}

#[derive(Debug)]
struct Sitter {
    number: u64,
    /// The thread waits for this time, and counts as busy after this time.
    until_ms: u64,
    /// The thread no longer waits.
    rung: bool,
}

impl State {
    fn place(&mut self, number: u64) -> &mut Sitter {
        self.seats
            .iter_mut()
            .find(|place| place.number == number)
            .expect("a seat has a place as long as it exists")
    }

    /// Before any thread participates, the program is starting and counts as busy.
    fn all_wait(&self) -> bool {
        self.next > 0 && self.seats.iter().all(|place| place.until_ms > self.now_ms && !place.rung)
    }
}

impl TestClock {
    /// Returns the clock that a test controls for this process, if there is one.
    pub fn of_this_process() -> Option<&'static Self> {
        static CLOCK: OnceLock<Option<&'static TestClock>> = OnceLock::new();
        *CLOCK.get_or_init(|| {
            let path = std::env::var_os(VARIABLE)?;
            let mut socket = UnixStream::connect(&path)
                .unwrap_or_else(|error| panic!("{VARIABLE}: nobody holds the time at {path:?}: {error}"));
            let clock: &'static TestClock = Box::leak(Box::default());
            clock.lock().now_ms = read(&mut socket);
            std::thread::spawn(move || clock.follow(socket));
            Some(clock)
        })
    }

    /// What the test says.
    pub fn now_ms(&self) -> u64 {
        self.lock().now_ms
    }

    /// A seat for a thread.
    pub fn seat(&'static self) -> Seat {
        let mut state = self.lock();
        let number = state.next;
        state.next += 1;
        state.seats.push(Sitter { number, until_ms: 0, rung: false });
        Seat { clock: self, number }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn follow(&self, mut socket: UnixStream) {
        loop {
            let now_ms = read(&mut socket);
            let mut state = self.lock();
            state.now_ms = now_ms;
            self.ticked.notify_all();
            while !state.all_wait() {
                state = self.settled.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
            drop(state);
            if socket.write_all(&[1]).is_err() {
                end();
            }
        }
    }
}

/// Reads the time that the test has set. When the test has ended, this process ends too.
fn read(socket: &mut UnixStream) -> u64 {
    let mut bytes = [0; 8];
    if socket.read_exact(&mut bytes).is_err() {
        end();
    }
    u64::from_le_bytes(bytes)
}

fn end() -> ! {
    std::process::exit(3)
}

/// A thread that takes part.
#[derive(Debug)]
pub struct Seat {
    clock: &'static TestClock,
    number: u64,
}

impl Seat {
    /// Waits until this much time has passed, but at least for a millisecond.
    pub fn sleep(&self, time: Duration) {
        let until_ms = self.clock.now_ms() + (time.as_millis() as u64).max(1);
        self.wait(until_ms);
    }

    /// Checks every millisecond for a result, for at most this long.
    pub fn until<T>(
        &self,
        patience: Duration,
        mut look: impl FnMut() -> Option<Result<T, RecvTimeoutError>>,
    ) -> Result<T, RecvTimeoutError> {
        let until_ms = self.clock.now_ms() + patience.as_millis() as u64;
        loop {
            if let Some(result) = look() {
                return result;
            }
            let now_ms = self.clock.now_ms();
            if now_ms >= until_ms {
                return Err(RecvTimeoutError::Timeout);
            }
            self.wait(now_ms + 1);
        }
    }

    /// Time continues during this wait.
    pub fn aside<T>(&self, wait: impl FnOnce() -> T) -> T {
        self.clock.lock().place(self.number).until_ms = u64::MAX;
        self.clock.settled.notify_all();
        let value = wait();
        self.clock.lock().place(self.number).until_ms = 0;
        value
    }

    /// Returns a bell that ends the waits of this seat.
    pub fn bell(&self) -> Bell {
        Bell { clock: self.clock, number: self.number }
    }

    fn wait(&self, until_ms: u64) {
        let mut state = self.clock.lock();
        state.place(self.number).until_ms = until_ms;
        self.clock.settled.notify_all();
        while state.now_ms < until_ms && !state.place(self.number).rung {
            state = self.clock.ticked.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.clock.lock().seats.retain(|place| place.number != self.number);
        self.clock.settled.notify_all();
    }
}

/// Ends a seat's waits.
#[derive(Clone, Debug)]
pub struct Bell {
    clock: &'static TestClock,
    number: u64,
}

impl Bell {
    /// Ends all waits of the seat from now on.
    pub fn ring(&self) {
        let mut state = self.clock.lock();
        if let Some(place) = state.seats.iter_mut().find(|place| place.number == self.number) {
            place.rung = true;
        }
        drop(state);
        self.clock.ticked.notify_all();
    }
}
