//! Clocks and timed waits.
//!
//! A thread waits for time only through its [`Waiter`].
//! In the released program, the waiter uses the machine's clock.
//! With the feature `test-clock` (tests only), a test can control the time.
//! The time then advances only when all waiters wait.
//! Board, line and program therefore share the same time, however busy the machine is.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use super::{EventReceiver, LinkEvent};

#[cfg(feature = "test-clock")]
use std::sync::mpsc::TryRecvError;

#[cfg(feature = "test-clock")]
use super::test_clock::{Bell, Seat, TestClock};

/// A clock in milliseconds that never steps back. All code behind the links uses it.
pub trait Clock: Send + Sync {
    /// Returns the milliseconds since some fixed moment.
    fn now_ms(&self) -> u64;

    /// Returns a waiter for one thread. Create it before the thread starts, and drop it with the thread.
    fn waiter(&self) -> Waiter;
}

/// The time since this clock was created, based on the machine's time since boot.
///
/// On Linux, `std::time::Instant` stops while the machine is suspended.
/// After an hour of sleep, every hand would then seem as recent as before.
/// This clock continues during suspend, so a sleeping laptop is noticed like any other silence.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start_ms: u64,
    /// The test's clock, if one is used instead, and its time at creation.
    #[cfg(feature = "test-clock")]
    test: Option<(&'static TestClock, u64)>,
}

impl SystemClock {
    /// Creates a clock that shows 0 now.
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

    // On other systems (macOS), the monotonic clock includes sleep.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    let clock = ClockId::Boottime;
    #[cfg(not(any(target_os = "linux", target_os = "android")))]
    let clock = ClockId::Monotonic;
    let time = clock_gettime(clock);
    // Neither value is negative or exceeds the range of a u64.
    time.tv_sec as u64 * 1000 + time.tv_nsec as u64 / 1_000_000
}

/// Returns the time since the first call. `std` uses Windows' performance counter, which includes sleep.
#[cfg(not(unix))]
fn since_boot_ms() -> u64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    u64::try_from(START.get_or_init(std::time::Instant::now).elapsed().as_millis()).unwrap_or(u64::MAX)
}

/// Lets one thread wait for time to pass.
/// While the waiter exists and does not wait, its thread counts as busy.
#[derive(Debug)]
pub struct Waiter {
    #[cfg(feature = "test-clock")]
    seat: Option<Seat>,
}

impl Waiter {
    /// Reports that the thread has finished and no longer delays the time.
    pub fn leave(self) {}

    /// Waits this long, or until [`Waker::wake`] is called.
    pub fn sleep(&self, time: Duration) {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.sleep(time);
        }
        std::thread::sleep(time);
    }

    /// Waits for at most this long for data from a channel.
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

    /// Like [`Self::receive`], for events of links.
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

    /// Returns the time for a blocking read of this thread. If no input arrives, call [`Waiter::pause`].
    pub fn patience(&self, usual: Duration) -> Duration {
        #[cfg(feature = "test-clock")]
        if self.seat.is_some() {
            return Duration::ZERO;
        }
        usual
    }

    /// Call this after a blocking read without input; [`Waiter::patience`] returns the time for such a read.
    pub fn pause(&self) {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            seat.sleep(Duration::from_millis(1));
        }
    }

    /// Waits for something other than time, such as a person, while time continues.
    pub fn aside<T>(&self, wait: impl FnOnce() -> T) -> T {
        #[cfg(feature = "test-clock")]
        if let Some(seat) = &self.seat {
            return seat.aside(wait);
        }
        wait()
    }

    /// Returns a waker that ends this thread's waits from another thread.
    pub fn waker(&self) -> Waker {
        Waker {
            #[cfg(feature = "test-clock")]
            bell: self.seat.as_ref().map(Seat::bell),
        }
    }
}

/// Ends a thread's waits under a test's clock, so that the thread can be joined while time stands still.
/// This function does nothing for the machine's own clock, because waits are short there.
#[derive(Clone, Debug)]
pub struct Waker {
    #[cfg(feature = "test-clock")]
    bell: Option<Bell>,
}

impl Waker {
    /// Ends all waits of the thread from now on.
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

        // Both clocks start at boot, but only one of the two continues during sleep.
        // On a machine that has never slept, both are equal, so the test also checks the name of the clock.
        let awake = clock_gettime(ClockId::Monotonic);
        let awake_ms = awake.tv_sec as u64 * 1000 + awake.tv_nsec as u64 / 1_000_000;
        assert!(since_boot_ms() >= awake_ms);
    }
}
