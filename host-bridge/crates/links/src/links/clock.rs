//! Time, and waiting for it.
//!
//! A thread waits for time to pass through its [`Waiter`] alone. In the released program
//! that is the machine's clock and nothing more. With the feature `test-clock` (tests only) a test may hold the time:
//! it goes on when every waiter waits, so that board, wire and program keep one time, however busy the machine is.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use super::{EventReceiver, LinkEvent};

#[cfg(feature = "test-clock")]
use std::sync::mpsc::TryRecvError;

#[cfg(feature = "test-clock")]
use super::test_clock::{Bell, Seat, TestClock};

/// Milliseconds that never step back. Everything behind the links gets its time from here.
pub trait Clock: Send + Sync {
    /// Milliseconds since some fixed moment.
    fn now_ms(&self) -> u64;

    /// A thread's place on this clock. It is made before the thread starts and dropped with it.
    fn waiter(&self) -> Waiter;
}

/// The machine's time since it booted, from the moment at which this was made.
///
/// `std::time::Instant` stands still on Linux while the machine is suspended: after an hour's sleep every
/// hand would look as fresh as before it. This one goes on, so that a sleep is a silence like any other.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start_ms: u64,
    /// The test's clock that is used instead, and what it showed at that moment.
    #[cfg(feature = "test-clock")]
    test: Option<(&'static TestClock, u64)>,
}

impl SystemClock {
    /// A clock that shows 0 now.
    pub fn start() -> Self {
        SystemClock {
            start_ms: since_boot_ms(),
            #[cfg(feature = "test-clock")]
            test: TestClock::of_this_process().map(|clock| (clock, clock.now_ms())),
        }
    }
}

impl Clock for SystemClock {
    fn now_ms(&self) -> u64 {
        #[cfg(feature = "test-clock")]
        if let Some((clock, start_ms)) = self.test {
            return clock.now_ms() - start_ms;
        }
        since_boot_ms().saturating_sub(self.start_ms)
    }

    fn waiter(&self) -> Waiter {
        Waiter {
            #[cfg(feature = "test-clock")]
            seat: self.test.map(|(clock, _)| clock.seat()),
        }
    }
}

#[cfg(unix)]
fn since_boot_ms() -> u64 {
    use rustix::time::{ClockId, clock_gettime};

    // Elsewhere (macOS) the monotonic clock counts sleep itself.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    let clock = ClockId::Boottime;
    #[cfg(not(any(target_os = "linux", target_os = "android")))]
    let clock = ClockId::Monotonic;
    let time = clock_gettime(clock);
    // Neither is negative, nor does it reach the end of a u64.
    time.tv_sec as u64 * 1000 + time.tv_nsec as u64 / 1_000_000
}

/// From the first call on. Windows' performance counter, which `std` reads, counts sleep.
#[cfg(not(unix))]
fn since_boot_ms() -> u64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    u64::try_from(START.get_or_init(std::time::Instant::now).elapsed().as_millis()).unwrap_or(u64::MAX)
}

/// The place at which one thread waits for time to pass. While it exists and does not wait, its thread is at work.
#[derive(Debug)]
pub struct Waiter {
    #[cfg(feature = "test-clock")]
    seat: Option<Seat>,
}

impl Waiter {
    /// The thread's work is done: it no longer holds back the time.
    pub fn leave(self) {}

    /// Waits this long, or until [`Waker::wake`].
    pub fn sleep(&self, time: Duration) {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.sleep(time);
        }
        std::thread::sleep(time);
    }

    /// Waits at most this long for what comes through a channel.
    ///
    /// # Errors
    /// As [`Receiver::recv_timeout`].
    pub fn receive<T>(&self, channel: &Receiver<T>, patience: Duration) -> Result<T, RecvTimeoutError> {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.until(patience, || match channel.try_recv() {
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => Some(Err(RecvTimeoutError::Disconnected)),
                Ok(value) => Some(Ok(value)),
            });
        }
        channel.recv_timeout(patience)
    }

    /// The same for what links report.
    ///
    /// # Errors
    /// As [`EventReceiver::recv_timeout`].
    pub fn hear<I>(
        &self,
        events: &EventReceiver<I>,
        patience: Duration,
    ) -> Result<LinkEvent<I>, RecvTimeoutError> {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.until(patience, || match events.recv_timeout(Duration::ZERO) {
                Err(RecvTimeoutError::Timeout) => None,
                done => Some(done),
            });
        }
        events.recv_timeout(patience)
    }

    /// How long the operating system may keep this thread waiting for input; [`Waiter::pause`] follows if none came.
    pub fn patience(&self, usual: Duration) -> Duration {
        #[cfg(feature = "test-clock")]
        if self.seat.is_some() {
            return Duration::ZERO;
        }
        usual
    }

    /// The operating system was asked for input, and after [`Waiter::patience`] there was none.
    pub fn pause(&self) {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            seat.sleep(Duration::from_millis(1));
        }
    }

    /// Waits for something that is not time, such as a person: time goes on meanwhile.
    pub fn aside<T>(&self, wait: impl FnOnce() -> T) -> T {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.aside(wait);
        }
        wait()
    }

    /// Returns what ends this thread's waits from elsewhere.
    pub fn waker(&self) -> Waker {
        Waker {
            #[cfg(feature = "test-clock")]
            bell: self.seat.as_ref().map(Seat::bell),
        }
    }
}

/// Ends a thread's waits under a test's clock, so that it can be joined while time stands still. On the machine's
/// clock waits are short, and this does nothing.
#[derive(Clone, Debug)]
pub struct Waker {
    #[cfg(feature = "test-clock")]
    bell: Option<Bell>,
}

impl Waker {
    /// From now on the thread no longer waits.
    pub fn wake(&self) {
        #[cfg(feature = "test-clock")]
        if let Some(bell) = &self.bell {
            bell.ring();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn the_clock_counts_the_time_that_the_machine_slept() {
        use rustix::time::{ClockId, clock_gettime};

        // Both clocks began at boot; only one of them goes on in a sleep. On a machine that never slept
        // they show the same, so the other half of the proof is the clock's name.
        let awake = clock_gettime(ClockId::Monotonic);
        let awake_ms = awake.tv_sec as u64 * 1000 + awake.tv_nsec as u64 / 1_000_000;
        assert!(since_boot_ms() >= awake_ms);
    }
}
