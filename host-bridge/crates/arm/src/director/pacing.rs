//! Lets the operator slow the arm down while it moves, and bring it back to its planned speed.
//!
//! The pace is the fraction of the planned speed, at most 1, because a plan already uses its limits.
//! A change of pace keeps the path, so what was planned to be clear remains clear.
//! The change waits for a stretch of even speed ([`host_robot::Trajectory::paced`]); there, it is a ramp within the limits.
//! If the robot cannot change a running motion, the pace applies from the next part of the motion on.

use std::sync::Arc;

use host_robot::trajectory::Paced;
use host_robot::{PACE_LEAST, Report, Robot};

use super::Director;
use super::sequence::Act;

/// The pace of the arm's motions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// The requested pace.
    wanted: f64,
    /// The pace of the running trajectory.
    runs_at: f64,
}

impl Default for Pace {
    fn default() -> Self {
        Pace { wanted: 1.0, runs_at: 1.0 }
    }
}

impl Pace {
    /// Returns the act at the requested pace, which from then on is the pace of the running trajectory.
    pub(super) fn begins(&mut self, act: Act) -> Act {
        self.runs_at = self.wanted;
        match act {
            Act::Follow { trajectory, home_s, touch, anchor } if self.wanted < 1.0 => {
                let trajectory = Arc::new(trajectory.at_pace(self.wanted));
                Act::Follow { trajectory, home_s: home_s / self.wanted, touch, anchor }
            }
            act => act,
        }
    }
}

impl<R: Robot> Director<R> {
    pub(super) fn want_pace(&mut self, share: f64) {
        // A pace that is not a number is the slowest one.
        let share = if share.is_nan() { PACE_LEAST } else { share.clamp(PACE_LEAST, 1.0) };
        if share == self.pace.wanted {
            return;
        }
        self.pace.wanted = share;
        if self.running.as_ref().is_some_and(|running| !running.jogs && !running.halted) {
            let when = if self.robot.ahead_ms().is_ok() { "" } else { " from its next part on" };
            self.reports.push(Report::Note(format!(
                "the arm moves at {:.0} % of its planned speed{when}",
                100.0 * share
            )));
        }
    }

    /// Changes the running motion to the requested pace as soon as this is possible.
    pub(super) fn pace_on(&mut self) {
        let Pace { wanted, runs_at } = self.pace;
        if wanted == runs_at || self.running.as_ref().is_none_or(|running| running.jogs || running.halted) {
            return;
        }
        let Ok(ahead_ms) = self.robot.ahead_ms() else { return };
        let Some((trajectory, elapsed_s)) = self.along() else { return };
        let at_s = elapsed_s + ahead_ms as f64 / 1000.0;
        let Some(Paced { trajectory, map }) = trajectory.paced(at_s, wanted / runs_at, self.joint_limits())
        else {
            return;
        };
        let trajectory = Arc::new(trajectory);
        // If the change would come too late, the arm continues as before, and the next turn tries again.
        if self.robot.follow_on(Arc::clone(&trajectory), at_s).is_ok() {
            self.pace.runs_at = wanted;
            if let Some(running) = &mut self.running {
                running.retime(trajectory, &map);
            }
        }
    }
}
