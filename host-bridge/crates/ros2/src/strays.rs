//! Abandoned goals that may still be running.

/// Repetition interval of cancellation requests.
pub const CANCEL_INTERVAL_MS: u64 = 200;
/// Maximum number of goals that are remembered.
const STRAYS_MAX: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Stray {
    goal: u32,
    cancelled_ms: u64,
    /// Latest end of the waiting time.
    until_ms: u64,
    /// Whether the goal was reported as not running. The report may be forged, or refer to another server.
    is_said_over: bool,
}

/// Abandoned goals, whose cancellation is requested.
/// The requests end when the goal's end is known, or after the maximum duration of a goal.
#[derive(Clone, Debug, Default)]
pub struct Strays(Vec<Stray>);

impl Strays {
    /// Adds a goal whose cancellation was requested now.
    pub fn add(&mut self, goal: u32, now_ms: u64, until_ms: u64) {
        self.over(goal);
        if self.0.len() == STRAYS_MAX {
            self.0.remove(0);
        }
        self.0.push(Stray { goal, cancelled_ms: now_ms, until_ms, is_said_over: false });
    }

    /// Records a report that this goal is not running.
    /// Its cancellation is still requested, but no other goal waits for it.
    pub fn said_over(&mut self, goal: u32) {
        for stray in self.0.iter_mut().filter(|stray| stray.goal == goal) {
            stray.is_said_over = true;
        }
    }

    /// Its end is known.
    pub fn over(&mut self, goal: u32) {
        self.0.retain(|stray| stray.goal != goal);
    }

    /// Returns whether all goals were reported as not running.
    pub fn are_said_over(&self) -> bool {
        self.0.iter().all(|stray| stray.is_said_over)
    }

    /// Advances the time to `now_ms`; `cancel` repeats the request for a goal.
    pub fn step(&mut self, now_ms: u64, mut cancel: impl FnMut(u32)) {
        self.0.retain(|stray| now_ms < stray.until_ms);
        for Stray { goal, cancelled_ms, .. } in &mut self.0 {
            if now_ms.saturating_sub(*cancelled_ms) >= CANCEL_INTERVAL_MS {
                *cancelled_ms = now_ms;
                cancel(*goal);
            }
        }
    }
}

/// Goals that may have been reported as finished too early.
/// With two servers or a forged answer, one may still be running.
/// A stop requests their cancellation.
#[derive(Clone, Debug, Default)]
pub struct Unsure(Vec<(u32, u64)>);

impl Unsure {
    /// Adds a goal that may be running until this time.
    pub fn add(&mut self, goal: u32, until_ms: u64) {
        self.0.retain(|(known, _)| *known != goal);
        if self.0.len() == STRAYS_MAX {
            self.0.remove(0);
        }
        self.0.push((goal, until_ms));
    }

    /// Processes a stop. `cancel` requests the cancellation of each goal.
    /// From now on, each goal counts as a stray.
    pub fn halt(&mut self, now_ms: u64, strays: &mut Strays, mut cancel: impl FnMut(u32)) {
        for (goal, until_ms) in self.0.drain(..).filter(|(_, until_ms)| now_ms < *until_ms) {
            cancel(goal);
            strays.add(goal, now_ms, until_ms);
            strays.said_over(goal);
        }
    }
}
