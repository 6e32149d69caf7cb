//! Plans motions on a separate thread, so that the thread that stops the robot never waits.
//!
//! While a motion is planned, the arm rests. Stop commands and the dead-man work as usual.
//! Each of these events discards the plan.
//! A plan that comes too late is not begun ([`AGE_MAX_MS`]). A plan that no longer fits is not begun either:
//! objects, fingers and arm must be unchanged.
//! If the base has moved in the meantime, the path must be clear from its current position.
//!
//! In virtual time there is no thread ([`How::AtOnce`]), and a motion begins at the moment of its request.
//! A replayed session begins a motion at the time that its file contains ([`How::Held`]).
//! Ages are measured in the session's own time, so both kinds of session have the same result.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use host_robot::{MotionName, Report, Robot, Trajectory};

use crate::plan::guard::MARGIN_M;
use crate::plan::{Placement, Planner};
use crate::things::Things;

use super::Director;
use super::carry::{LET_GO_M, has_shifted};
use super::sequence::{Act, Task};

/// A plan that takes longer than this is discarded: an arm must not start when nobody expects it any more.
/// In a release build, the most expensive motion takes about a tenth of this time on one core.
pub const AGE_MAX_MS: u64 = 2000;

/// A path from another position of the base is checked at intervals of this length.
const LOOK_S: f64 = 0.05;

/// Where motions are planned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum How {
    /// Here and now.
    #[default]
    AtOnce,
    /// On a thread of its own.
    Aside,
    /// The motion is planned here and now, but begins only on request.
    Held,
}

type Plan = Result<VecDeque<Act>, String>;

/// A motion that is being planned.
#[derive(Clone, Debug)]
pub(super) struct Planning {
    pub(super) motion: MotionName,
    /// Time of the request for the motion.
    since_ms: u64,
    /// The position of the base at the time of planning.
    placement: Placement,
    /// Tool and objects at the time of planning.
    things: Things,
    job: Job,
}

#[derive(Clone, Debug)]
enum Job {
    Done(Plan),
    Thread(Arc<Thread>),
    /// No thread could be started, so there will never be a plan.
    Never,
}

/// The planning job. Dropping it does not wait for the thread:
/// the search ends soon, and its plan is discarded.
#[derive(Debug)]
struct Thread {
    /// A value of `None` means that planning failed.
    handle: Mutex<Option<JoinHandle<Option<Plan>>>>,
    /// Set when there is a plan, or a reason why there is none.
    is_done: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
}

impl Drop for Thread {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

impl Job {
    /// If the thread cannot start, or if it fails, the plan never arrives.
    /// Such a plan never arrives in a replayed session either.
    fn aside(task: Task) -> Self {
        let (is_done, ends) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let task = task.ended_by(Arc::clone(&ends));
        let told = Arc::clone(&is_done);
        let thread = std::thread::Builder::new().name("planner".to_owned()).spawn(move || {
            let plan = planned(task);
            told.store(plan.is_some(), Ordering::Release);
            plan
        });
        thread.map_or(Job::Never, |handle| {
            Job::Thread(Arc::new(Thread { handle: Mutex::new(Some(handle)), is_done, ends }))
        })
    }

    fn here(task: Task) -> Self {
        planned(task).map_or(Job::Never, Job::Done)
    }

    fn is_ready(&self) -> bool {
        matches!(self, Job::Thread(thread) if thread.is_done.load(Ordering::Acquire))
    }

    fn plan(self) -> Plan {
        let plan = match self {
            Job::Done(plan) => Some(plan),
            Job::Thread(thread) => {
                let handle = thread.handle.lock().unwrap_or_else(PoisonError::into_inner).take();
                handle.and_then(|handle| handle.join().ok()).flatten()
            }
            Job::Never => None,
        };
        plan.unwrap_or_else(|| Err("planning it failed; please report this".to_owned()))
    }
}

/// Returns `None` if planning failed; the panic was printed where it happened.
fn planned(task: Task) -> Option<Plan> {
    // A task owns a copy of the state, which a panic cannot damage for others.
    catch_unwind(AssertUnwindSafe(|| task.plan())).ok()
}

impl<R: Robot> Director<R> {
    /// Plans motions in a scene on separate threads. The owner polls [`host_robot::Door::plan_is_ready`].
    #[must_use]
    pub fn planning_aside(self) -> Self {
        Director { how: How::Aside, ..self }
    }

    /// Motions in a scene begin only when [`host_robot::Door::begin_planned`] is called,
    /// as replayed sessions require.
    #[must_use]
    pub fn planning_held(self) -> Self {
        Director { how: How::Held, ..self }
    }

    /// Plans the motion, and begins it if its plan is ready at once.
    pub(super) fn plan(&mut self, motion: &MotionName, task: Task) -> Result<(), String> {
        let (placement, things) = task.taken();
        // Without a scene there is hardly anything to plan.
        let job = match self.how {
            How::Aside if self.site.planner().is_some() => Job::aside(task),
            How::Held if self.site.planner().is_some() => Job::here(task),
            _ => {
                let acts = task.plan()?;
                return self.begin(motion, acts, self.site.planner().map(|_| placement));
            }
        };
        let since_ms = self.now_ms;
        self.commanded_ms = since_ms;
        self.planning = Some(Planning { motion: motion.clone(), since_ms, placement, things, job });
        Ok(())
    }

    pub(super) fn has_planned(&self) -> bool {
        self.planning.as_ref().is_some_and(|planning| planning.job.is_ready())
    }

    /// Begins the planned motion, unless something has changed since it was planned.
    pub(super) fn begin_what_is_planned(&mut self) {
        let Some(planning) = self.planning.take() else { return };
        let Planning { motion, placement, things, job, .. } = planning;
        let begun = job.plan().and_then(|acts| {
            self.still_fits(&acts, placement, &things)?;
            self.begin(&motion, acts, Some(placement))
        });
        if let Err(reason) = begun {
            self.reports.push(Report::MotionRefused { motion, reason });
        }
    }

    fn still_fits(&self, acts: &VecDeque<Act>, planned: Placement, then: &Things) -> Result<(), String> {
        let Some(planner) = self.site.planner() else { return Ok(()) };
        let at_work = acts.iter().any(Act::is_at_work);
        if let Some(first) = acts.front() {
            self.can_go_on(first, at_work.then_some(planned))?;
        }
        acts.iter().filter_map(Act::anchor).try_for_each(|anchor| self.is_still_there(anchor, true))?;
        let fingers = [then, &self.things].map(|things| things.opening_m);
        let are_same = match fingers {
            [Some(then_m), Some(now_m)] => (then_m - now_m).abs() <= LET_GO_M,
            [then_m, now_m] => then_m == now_m,
        };
        if !are_same || then.poses != self.things.poses {
            return Err("the gripper has moved while it was planned; ask for the motion again".to_owned());
        }
        let here = Placement::from(self.known_base()?.odometry);
        if has_shifted(here, planned) && !self.is_clear_from(here, planner, acts) {
            return Err("the base has moved while it was planned, and from here the way is not clear; let the base rest, \
                        and ask for the motion again"
                .to_owned());
        }
        Ok(())
    }

    /// Returns whether the arm touches nothing on its path with the base at this placement.
    fn is_clear_from(&self, here: Placement, planner: &Planner, acts: &VecDeque<Act>) -> bool {
        let around = planner.world().around_with(here, &self.things);
        let is_clear = |trajectory: &Trajectory| {
            let pieces = (trajectory.duration_s() / LOOK_S).ceil() as usize;
            let at = |k: usize| trajectory.motion(LOOK_S * k as f64).joints_rad;
            (0..pieces).all(|k| around.way_is_clear(&at(k), &at(k + 1), MARGIN_M))
        };
        acts.iter().all(|act| match act {
            Act::Follow { trajectory, .. } => is_clear(trajectory),
            _ => true,
        })
    }

    /// Discards a plan that comes too late or after a silence.
    pub(super) fn doubt_plan(&mut self) {
        let Some(planning) = &self.planning else { return };
        let reason = if let Some(silence) = self.silence() {
            silence
        } else if self.now_ms.saturating_sub(planning.since_ms) > AGE_MAX_MS {
            format!(
                "it is not planned after {} s: this computer is busy with something else, or starts no thread for it; ask for \
                 the motion again",
                AGE_MAX_MS / 1000
            )
        } else {
            return;
        };
        let motion = planning.motion.clone();
        self.planning = None;
        self.reports.push(Report::MotionRefused { motion, reason });
    }

    /// Discards the plan, whatever is being planned.
    pub(super) fn throw_plan_away(&mut self) {
        if let Some(Planning { motion, .. }) = self.planning.take() {
            self.reports.push(Report::MotionEnded { motion, reached: false });
        }
    }
}
