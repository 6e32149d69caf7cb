//! What planning one whole motion may cost.

use std::cell::Cell;

/// Checks that one motion may take, over all its steps. `run` makes them beside the thread that stops the robot; whoever plans
/// at once, as in virtual time, waits for them: `a_motion_is_planned_or_refused_within_its_checks` in tests/plan_scenes.rs
/// prints what that is in time.
pub const MOTION_CHECKS_MAX: u64 = 40_000;

/// Checks that are left to a motion: looks of one configuration at everything around it, and steps of inverse kinematics,
/// which cost less. Counted, never timed, so that equal calls give equal answers on any machine.
#[derive(Clone, Debug)]
pub struct Purse {
    full: u64,
    spent: Cell<u64>,
}

impl Default for Purse {
    fn default() -> Self {
        Purse::of(MOTION_CHECKS_MAX)
    }
}

impl Purse {
    /// This many checks.
    pub fn of(checks: u64) -> Self {
        Purse { full: checks, spent: Cell::new(0) }
    }

    /// This many were made.
    pub fn spend(&self, checks: u64) {
        self.spent.set(self.spent.get() + checks);
    }

    /// How many were made; the few that a refusal needs for its reason may be more than there were.
    pub fn spent(&self) -> u64 {
        self.spent.get()
    }

    /// How many are left.
    pub fn left(&self) -> u64 {
        self.full.saturating_sub(self.spent.get())
    }

    /// Nothing more may be looked at: what was not seen to be clear is not.
    pub fn is_empty(&self) -> bool {
        self.left() == 0
    }

    /// Why a motion was not planned, when nothing is left.
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
