//! Goals that nobody wants, and that may run all the same.

/// A cancellation is asked for again after this long.
pub const CANCEL_INTERVAL_MS: u64 = 200;
/// More are not remembered.
pub const STRAYS_MAX: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Stray {
    goal: u32,
    cancelled_ms: u64,
    /// It is over then, whatever anybody says.
    until_ms: u64,
}

/// The end of each is asked for until it is known, or until no goal runs for so long.
#[derive(Clone, Debug, Default)]
pub struct Strays(Vec<Stray>);

impl Strays {
    /// This one's end was asked for now.
    pub fn add(&mut self, goal: u32, now_ms: u64, until_ms: u64) {
        self.over(goal);
        if self.0.len() == STRAYS_MAX {
            self.0.remove(0);
        }
        self.0.push(Stray { goal, cancelled_ms: now_ms, until_ms });
    }

    /// Its end is known.
    pub fn over(&mut self, goal: u32) {
        self.0.retain(|stray| stray.goal != goal);
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Lets the time become `now_ms`; `cancel` asks for an end again.
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
