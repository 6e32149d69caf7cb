//! The budget for planning one complete motion.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Maximum number of checks for one motion, over all its steps.
/// `run` plans beside the thread that stops the robot. In virtual time, the session waits for the plan.
/// The test `a_motion_is_planned_or_refused_within_its_checks` prints the time that this takes.
pub const MOTION_CHECKS_MAX: u64 = 40_000;

/// The remaining checks of a motion.
/// They are complete checks of a configuration, and (cheaper) steps of inverse kinematics.
/// Steps are counted and never timed, so that equal calls give equal results on any machine.
#[derive(Clone, Debug)]
pub struct Purse {
    full: u64,
    spent: Cell<u64>,
    /// Once this flag is set, the purse is empty, because nobody waits for the answer any more.
    ends: Option<Arc<AtomicBool>>,
}

impl Default for Purse {
    fn default() -> Self {
        Purse::of(MOTION_CHECKS_MAX)
    }
}

impl Purse {
    /// This many checks.
    pub fn of(checks: u64) -> Self {
        Purse { full: checks, spent: Cell::new(0), ends: None }
    }

    /// Returns the same purse, which also becomes empty when this flag is set.
    #[must_use]
    pub fn ended_by(self, ends: Arc<AtomicBool>) -> Self {
        Purse { ends: Some(ends), ..self }
    }

    /// Returns a separate purse with this many checks, which ends together with this one.
    #[must_use]
    pub fn apart(&self, checks: u64) -> Self {
        Purse { ends: self.ends.clone(), ..Purse::of(checks) }
    }

    /// This many were made.
    pub fn spend(&self, checks: u64) {
        self.spent.set(self.spent.get() + checks);
    }

    /// Returns the number of checks made.
    /// This number may slightly exceed the budget,
    /// because finding the reason for a refusal takes further checks.
    pub fn spent(&self) -> u64 {
        self.spent.get()
    }

    /// How many are left.
    pub fn left(&self) -> u64 {
        if self.ends.as_ref().is_some_and(|ends| ends.load(Ordering::Relaxed)) {
            return 0;
        }
        self.full.saturating_sub(self.spent.get())
    }

    /// Returns whether no checks are left. Anything that was not checked does not count as clear.
    pub fn is_empty(&self) -> bool {
        self.left() == 0
    }

    /// Returns why a motion was not planned, if no checks are left.
    pub fn refusal(&self) -> Option<String> {
        self.is_empty().then(|| {
            format!(
                "planning it takes more than {} checks, and nobody is kept waiting for longer: give the motion fewer steps, \
                 put a pose in between, or clear the way",
                self.full
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_left_once_nobody_waits_any_more_nor_in_what_was_set_apart() {
        let ends = Arc::<AtomicBool>::default();
        let purse = Purse::of(100).ended_by(Arc::clone(&ends));
        let apart = purse.apart(50);
        purse.spend(10);
        assert_eq!((purse.left(), apart.left()), (90, 50));
        ends.store(true, Ordering::Relaxed);
        assert!(purse.is_empty() && apart.is_empty());
    }
}
