//! Goals that nobody wants, and that may run all the same.

/// A cancellation is asked for again after this long.
pub const CANCEL_INTERVAL_MS: u64 = 200;
/// More are not remembered.
const STRAYS_MAX: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Stray {
    goal: u32,
    cancelled_ms: u64,
    /// It is over then, whatever is reported.
    until_ms: u64,
    /// Somebody has said that it does not run; that may be forged, or another server's word.
    is_said_over: bool,
}

/// The end of each is requested until it is known, or until longer than any goal runs.
#[derive(Clone, Debug, Default)]
pub struct Strays(Vec<Stray>);

impl Strays {
    /// This one's end was asked for now.
    pub fn add(&mut self, goal: u32, now_ms: u64, until_ms: u64) {
        self.over(goal);
        if self.0.len() == STRAYS_MAX {
            self.0.remove(0);
        }
        self.0.push(Stray { goal, cancelled_ms: now_ms, until_ms, is_said_over: false });
    }

    /// Somebody says that this one does not run. Its end is asked for on, and nobody waits for it any more.
    pub fn said_over(&mut self, goal: u32) {
        for stray in self.0.iter_mut().filter(|stray| stray.goal == goal) {
            stray.is_said_over = true;
        }
    }

    /// Its end is known.
    pub fn over(&mut self, goal: u32) {
        self.0.retain(|stray| stray.goal != goal);
    }

    /// Whether of each of them somebody has said that it does not run.
    pub fn are_said_over(&self) -> bool {
        self.0.iter().all(|stray| stray.is_said_over)
    }

    /// Advances the time to `now_ms`; `cancel` asks again for a goal to be ended.
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

/// Goals that were said to be over before they could be: of two servers, or by a forged word, one may run on. A stop asks
/// for their ends.
#[derive(Clone, Debug, Default)]
pub struct Unsure(Vec<(u32, u64)>);

impl Unsure {
    /// This one may run until then.
    pub fn add(&mut self, goal: u32, until_ms: u64) {
        self.0.retain(|(known, _)| *known != goal);
        if self.0.len() == STRAYS_MAX {
            self.0.remove(0);
        }
        self.0.push((goal, until_ms));
    }

    /// A stop: `cancel` asks for the end of each, which is a stray from now on.
    pub fn halt(&mut self, now_ms: u64, strays: &mut Strays, mut cancel: impl FnMut(u32)) {
        for (goal, until_ms) in self.0.drain(..).filter(|(_, until_ms)| now_ms < *until_ms) {
            cancel(goal);
            strays.add(goal, now_ms, until_ms);
            strays.said_over(goal);
        }
    }
}
