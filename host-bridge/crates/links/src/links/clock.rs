//! The laptop's time, as the stops need it: elapsed time, with the time that the machine slept.

use rustix::time::{ClockId, clock_gettime};

/// Milliseconds that never step back. Everything behind the links gets its time from here.
pub trait Clock: Send + Sync {
    /// Time since some fixed moment.
    fn now_ms(&self) -> u64;
}

/// The machine's time since it booted, from the moment this was made.
///
/// `std::time::Instant` stands still on Linux while the machine is suspended: after an hour's sleep every
/// hand would look as fresh as before it. This one goes on, so that a sleep is a silence like any other.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start_ms: u64,
}

impl SystemClock {
    /// A clock that shows 0 now.
    pub fn start() -> Self {
        SystemClock { start_ms: since_boot_ms() }
    }
}

impl Clock for SystemClock {
    fn now_ms(&self) -> u64 {
        since_boot_ms().saturating_sub(self.start_ms)
    }
}

fn since_boot_ms() -> u64 {
    // Elsewhere (macOS) the monotonic clock counts sleep itself.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    let clock = ClockId::Boottime;
    #[cfg(not(any(target_os = "linux", target_os = "android")))]
    let clock = ClockId::Monotonic;
    let time = clock_gettime(clock);
    // Neither is negative, nor does it reach the end of a u64.
    time.tv_sec as u64 * 1000 + time.tv_nsec as u64 / 1_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_counts_the_time_that_the_machine_slept() {
        // Both clocks began at boot; only one of them goes on in a sleep. On a machine that never slept
        // they show the same, so the other half of the proof is the clock's name.
        let awake = clock_gettime(ClockId::Monotonic);
        let awake_ms = awake.tv_sec as u64 * 1000 + awake.tv_nsec as u64 / 1_000_000;
        assert!(since_boot_ms() >= awake_ms);
    }
}
