//! Planning beside the thread that also stops the robot.
//!
//! While a motion is planned, the arm rests, and stops, silence and everything else go on as ever: they throw the plan away. A
//! plan that is there is begun only if nothing has changed since. Without a thread ([`How::AtOnce`], virtual time) a motion
//! begins in the moment in which it was asked for; a session that is computed again from its file begins it where the file says
//! that it began ([`How::Held`]).

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use host_robot::{MotionName, Report, Robot};

use crate::plan::Placement;

use super::Director;
use super::sequence::{Act, Task};

/// Where motions are planned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum How {
    /// Here and now.
    #[default]
    AtOnce,
    /// On a thread of its own.
    Aside,
    /// Here and now, but it begins only when that is said.
    Held,
}

type Plan = Result<VecDeque<Act>, String>;

/// A motion that is being planned.
#[derive(Clone, Debug)]
pub(super) struct Planning {
    pub(super) motion: MotionName,
    /// Where the base stood.
    placement: Option<Placement>,
    job: Job,
}

#[derive(Clone, Debug)]
enum Job {
    Done(Plan),
    /// Taken once. Whoever drops it does not wait for it: its plan is thrown away.
    Thread(Arc<Mutex<Option<JoinHandle<Plan>>>>),
}

impl Job {
    fn is_finished(&self) -> bool {
        let Job::Thread(handle) = self else { return false };
        handle.lock().unwrap_or_else(PoisonError::into_inner).as_ref().is_some_and(JoinHandle::is_finished)
    }

    fn plan(self) -> Plan {
        match self {
            Job::Done(plan) => plan,
            Job::Thread(handle) => {
                let handle = handle.lock().unwrap_or_else(PoisonError::into_inner).take();
                // A panic was printed where it happened.
                let failed = || Err("planning it failed; please report this".to_owned());
                handle.and_then(|handle| handle.join().ok()).unwrap_or_else(failed)
            }
        }
    }
}

impl<R: Robot> Director<R> {
    /// Motions in a scene are planned on threads of their own; whoever runs this asks [`host_robot::Door::plan_is_ready`].
    #[must_use]
    pub fn planning_aside(self) -> Self {
        Director { how: How::Aside, ..self }
    }

    /// Motions in a scene begin only where [`host_robot::Door::begin_planned`] is called: for sessions that are computed again.
    #[must_use]
    pub fn planning_held(self) -> Self {
        Director { how: How::Held, ..self }
    }

    /// Plans it, and begins it if it is planned already.
    pub(super) fn plan(&mut self, motion: &MotionName, task: Task) -> Result<(), String> {
        let placement = self.planner.as_ref().and_then(|_| self.known_base().ok());
        let placement = placement.map(|base| Placement::from(base.odometry));
        // Without a scene there is hardly anything to plan.
        let job = match self.how {
            How::Aside if self.planner.is_some() => {
                let thread = std::thread::Builder::new().name("planner".to_owned());
                let handle = thread.spawn(move || task.plan());
                let handle =
                    handle.map_err(|error| format!("the system starts no thread to plan it: {error}"))?;
                Job::Thread(Arc::new(Mutex::new(Some(handle))))
            }
            How::Held if self.planner.is_some() => Job::Done(task.plan()),
            _ => {
                let acts = task.plan()?;
                return self.begin(motion, acts, placement);
            }
        };
        self.planning = Some(Planning { motion: motion.clone(), placement, job });
        Ok(())
    }

    pub(super) fn has_planned(&self) -> bool {
        self.planning.as_ref().is_some_and(|planning| planning.job.is_finished())
    }

    /// Begins what was planned, unless something has changed since.
    pub(super) fn begin_what_is_planned(&mut self) {
        let Some(Planning { motion, placement, job }) = self.planning.take() else { return };
        let begun = job.plan().and_then(|acts| {
            if let Some(first) = acts.front() {
                let at_work = acts.iter().any(Act::is_at_work);
                self.can_go_on(first, placement.filter(|_| at_work))?;
            }
            self.begin(&motion, acts, placement)
        });
        if let Err(reason) = begun {
            self.reports.push(Report::MotionRefused { motion, reason });
        }
    }

    /// Whatever is planned is not begun.
    pub(super) fn throw_plan_away(&mut self) {
        if let Some(Planning { motion, .. }) = self.planning.take() {
            self.reports.push(Report::MotionEnded { motion, reached: false });
        }
    }
}
