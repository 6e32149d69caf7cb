//! Executes the acts of a motion in sequence. If one act fails, all acts end.

use std::collections::VecDeque;
use std::sync::Arc;

use host_robot::trajectory::TimeMap;
use host_robot::{End, Following, Grip, GripEnd, MotionName, Report, Robot, Trajectory};

use crate::plan::Placement;
use crate::things::Touch;

use super::sequence::Act;
use super::{Director, REST_RAD_S};

/// Maximum distance between the arm and the start of its next trajectory.
const OFF_MAX_RAD: f64 = 0.03;
/// Maximum displacement of the base since planning, in m and in rad. A larger displacement ends the motion.
const SHIFTED_MAX: f64 = 0.01;
/// The commander normally repeats itself several times within this time.
/// After a longer silence, no act starts by itself.
pub(super) const SILENCE_MS: u64 = 250;
/// Minimum change of the finger distance that counts as a loss of the object.
/// A wider distance means that the object was released; a narrower distance means that it was lost.
pub(super) const LET_GO_M: f64 = 0.002;

/// A motion under way.
#[derive(Clone, Debug)]
pub(super) struct Running {
    pub(super) motion: MotionName,
    /// What is done now.
    pub(super) now: Act,
    since_ms: u64,
    /// What comes then.
    left: VecDeque<Act>,
    /// How many there were.
    acts: usize,
    /// Placement of the base at the time of planning.
    placement: Option<Placement>,
    pub(super) halted: bool,
    /// The tool follows a hand for as long as the hand is tilted.
    pub(super) jogs: bool,
}

impl Running {
    /// The tool follows a hand.
    pub(super) fn jogging(trajectory: Arc<Trajectory>, now_ms: u64) -> Self {
        Running {
            motion: MotionName::from(MotionName::JOG),
            now: Act::Follow { trajectory, home_s: 0.0, touch: Touch::default(), anchor: None },
            since_ms: now_ms,
            left: VecDeque::new(),
            acts: 1,
            placement: None,
            halted: false,
            jogs: true,
        }
    }

    /// Replaces the trajectory under way, which then continues differently.
    pub(super) fn replace(&mut self, with: Arc<Trajectory>) {
        if let Act::Follow { trajectory, .. } = &mut self.now {
            *trajectory = with;
        }
    }

    /// Replaces the trajectory under way by the same path with other times.
    pub(super) fn retime(&mut self, with: Arc<Trajectory>, map: &TimeMap) {
        if let Act::Follow { trajectory, home_s, .. } = &mut self.now {
            *trajectory = with;
            *home_s = map.now_s(*home_s);
        }
    }

    /// The trajectory under way.
    pub(super) fn trajectory(&self) -> Option<&Arc<Trajectory>> {
        match &self.now {
            Act::Follow { trajectory, .. } => Some(trajectory),
            _ => None,
        }
    }

    pub(super) fn home_s(&self) -> f64 {
        match &self.now {
            Act::Follow { home_s, .. } => *home_s,
            _ => 0.0,
        }
    }

    /// Returns whether the hand is at an object, or will be.
    fn is_at_work(&self) -> bool {
        self.now.is_at_work() || self.left.iter().any(Act::is_at_work)
    }
}

impl<R: Robot> Director<R> {
    /// Begins with the first act.
    pub(super) fn begin(
        &mut self,
        motion: &MotionName,
        mut acts: VecDeque<Act>,
        placement: Option<Placement>,
    ) -> Result<(), String> {
        let count = acts.len();
        let first = acts.pop_front().ok_or("the motion has no step")?;
        let first = self.start_act(first)?;
        self.commanded_ms = self.now_ms;
        self.running = Some(Running {
            motion: motion.clone(),
            now: first,
            since_ms: self.now_ms,
            left: acts,
            acts: count,
            placement,
            halted: false,
            jogs: false,
        });
        *self.draws.entry(motion.clone()).or_default() += 1;
        self.guard_due_ms = 0;
        Ok(())
    }

    /// Returns the act as it was started, at the requested pace.
    fn start_act(&mut self, act: Act) -> Result<Act, String> {
        let mut pace = self.pace;
        let act = pace.begins(act);
        match &act {
            Act::Follow { trajectory, touch, .. } => {
                self.robot.follow(Arc::clone(trajectory))?;
                self.things.touch = touch.clone();
            }
            Act::Grip { opening_m, effort_n, .. } => {
                let flange = self.flange_for_grip()?;
                self.grip_before_m = self.things.opening_m;
                let between = self.site.shop().between(&self.things, &flange);
                let held = self.things.held();
                // An object that is already held is between the fingers.
                let between_m = between.map(|(_, width_m)| width_m).or(held.and(self.things.opening_m));
                self.robot.grip(Grip { opening_m: *opening_m, effort_n: *effort_n, between_m })?;
                self.things.touch = self.site.shop().touching(&self.things, &flange);
            }
            Act::Wait { .. } => {}
        }
        self.pace = pace;
        Ok(act)
    }

    /// Checks the result of the current act, and continues.
    pub(super) fn carry_on(&mut self) {
        let (end, grip_end) = (self.robot.take_end(), self.robot.take_grip_end());
        self.things.opening_m = self.robot.opening_m().map(|opening| opening.value);
        let Some(running) = &self.running else { return };
        let halted = running.halted;
        let done = match (&running.now, end, grip_end) {
            (Act::Follow { .. }, Some(End::Reached), _) => Some(Ok(())),
            (Act::Follow { .. }, Some(End::Halted), _) => Some(Err(None)),
            (&Act::Grip { opening_m, closes_on, .. }, _, Some(end)) => {
                Some(self.gripped(end, opening_m, closes_on))
            }
            (Act::Wait { .. }, ..) if halted => Some(Err(None)),
            (Act::Wait { ms }, ..) => (self.now_ms.saturating_sub(running.since_ms) >= *ms).then_some(Ok(())),
            _ => None,
        };
        match done {
            None => {}
            Some(Ok(())) => self.next_act(),
            Some(Err(why)) => self.give_up(why),
        }
    }

    fn next_act(&mut self) {
        let Some(running) = &mut self.running else { return };
        let Some(next) = running.left.pop_front() else {
            self.end_motion(true);
            return;
        };
        if running.halted {
            running.left.push_front(next);
            self.give_up(None);
            return;
        }
        let planned = running.placement.filter(|_| running.is_at_work() || next.is_at_work());
        let next = match self.can_go_on(&next, planned).and_then(|()| self.start_act(next)) {
            Ok(next) => next,
            Err(why) => {
                self.give_up(Some(why));
                return;
            }
        };
        let now_ms = self.now_ms;
        if let Some(running) = &mut self.running {
            (running.now, running.since_ms) = (next, now_ms);
        }
    }

    /// Checks that the commander, the base and the arm have not changed since the motion was planned.
    /// `planned` is the required placement of the base, if the placement matters.
    pub(super) fn can_go_on(&self, next: &Act, planned: Option<Placement>) -> Result<(), String> {
        if let Some(refusal) = self.robot.refusal() {
            return Err(refusal);
        }
        if let Some(silence) = self.silence() {
            return Err(silence);
        }
        if let Some(planned) = planned {
            let here = Placement::from(self.known_base()?.odometry);
            if has_shifted(here, planned) {
                let off_m = (here.x_m - planned.x_m).hypot(here.y_m - planned.y_m);
                return Err(format!("the base is {off_m:.2} m from where the motion was planned"));
            }
        }
        if let Some(anchor) = next.anchor() {
            self.is_still_there(anchor, false)?;
        }
        let Act::Follow { trajectory, .. } = next else { return Ok(()) };
        let here = self.robot.arm().ok_or("the arm's angles are not known")?.value;
        let arm = self.site.arm();
        let start = arm.unwound(&trajectory.motion(0.0).joints_rad, &here.joints_rad);
        for (i, joint) in arm.joints.iter().enumerate() {
            let off = (here.joints_rad[i] - start[i]).abs();
            if off > OFF_MAX_RAD || here.velocity_rad_s[i].abs() > REST_RAD_S {
                return Err(format!("{} is {off:.2} rad off where the motion goes on, or moves", joint.name));
            }
        }
        Ok(())
    }

    /// Returns a reason to stop the sequence if no command has arrived for too long.
    pub(super) fn silence(&self) -> Option<String> {
        let silent_ms = self.now_ms.saturating_sub(self.commanded_ms);
        (silent_ms > SILENCE_MS).then(|| format!("nobody has commanded for {silent_ms} ms"))
    }

    /// Returns whether the hand is at an object, or will be before the motion ends.
    pub(super) fn is_at_work(&self) -> bool {
        self.running.as_ref().is_some_and(Running::is_at_work)
    }

    /// Processes the result of a grip. Only a stall while closing means an object between the fingers.
    fn gripped(&mut self, end: GripEnd, asked_m: f64, closes_on: bool) -> Result<(), Option<String>> {
        let before_m = self.grip_before_m;
        let felt_m = self.robot.opening_m().map(|reading| reading.value);
        let had = self.things.held();
        let mut told = None;
        if let Ok(flange) = self.flange_for_grip() {
            let shop = self.site.shop();
            let mut things = self.things.clone();
            things.opening_m = before_m;
            // Distance moved by the fingers.
            // Without a report, the gripper is at the requested width or has not moved.
            let reached_m = if end == GripEnd::Reached { Some(asked_m) } else { before_m };
            let now_m = felt_m.or(reached_m);
            let has_moved = match (now_m, before_m) {
                (Some(now_m), Some(before_m)) => (now_m - before_m).abs() > LET_GO_M,
                // Fingers that stall or halt at an unknown position keep their object.
                _ => end == GripEnd::Reached,
            };
            if had.is_some() && has_moved {
                told = shop.let_go_of(&mut things, &flange);
            } else if end == GripEnd::Stalled && had.is_none() {
                told = shop.gripped(&mut things, &flange, asked_m).or_else(|| Some(stalled(felt_m)));
            }
            let attached = had.is_none() && things.held().is_some();
            let believed_m = if attached { things.opening_m } else { now_m };
            things.opening_m = felt_m.or(believed_m);
            things.touch = shop.touching(&things, &flange);
            self.things = things;
        }
        if end == GripEnd::Reached && closes_on && told.is_none() {
            told = Some("has nothing between its fingers".to_owned());
        }
        self.reports.extend(told.map(|told| Report::Note(format!("the gripper {told}"))));
        match end {
            GripEnd::Failed(why) => Err(Some(format!("the gripper: {why}"))),
            GripEnd::Halted => Err(None),
            GripEnd::Reached | GripEnd::Stalled => Ok(()),
        }
    }

    /// Ends the motion at its current position; `why` is set if the robot failed.
    fn give_up(&mut self, why: Option<String>) {
        let Some(running) = &self.running else { return };
        let step = running.acts - running.left.len();
        if let Some(why) = why {
            self.reports.push(Report::Note(why));
        }
        if running.acts > 1 {
            let text =
                format!("{} ended in part {step} of {}; the rest is not done", running.motion, running.acts);
            self.reports.push(Report::Note(text));
        }
        self.end_motion(false);
    }

    fn end_motion(&mut self, reached: bool) {
        self.things.touch = Touch::default();
        let Some(running) = self.running.take() else { return };
        if running.jogs {
            // The motion ends with each tilt.
            // After a halt, the hand must be neutral before it can start the motion again.
            self.jog.needs_neutral |= !reached && !running.halted;
        } else {
            self.reports.push(Report::MotionEnded { motion: running.motion, reached });
        }
    }

    /// Ends the entire motion, whichever part of it is running.
    pub(super) fn halt_motion(&mut self) {
        self.throw_plan_away();
        if let Some(running) = &mut self.running {
            running.halted = true;
        }
    }

    /// Returns the pose of the flange, which is not needed if there is nothing to grip.
    fn flange_for_grip(&self) -> Result<host_robot::Pose, String> {
        if self.site.shop().objects.is_empty() {
            return Ok(host_robot::Pose::IDENTITY);
        }
        let placement = Placement::from(self.known_base()?.odometry);
        let arm = self.robot.arm().ok_or("the arm's angles are not known, and so neither what is gripped")?;
        Ok(self.site.flange(placement, &arm.value.joints_rad))
    }

    /// Returns the arm's progress on its trajectory in s.
    pub(super) fn along(&self) -> Option<(&Arc<Trajectory>, f64)> {
        let Following::Moving { elapsed_s } = self.robot.following() else { return None };
        Some((self.running.as_ref()?.trajectory()?, elapsed_s))
    }
}

/// Returns whether the base has moved away from its planned placement.
pub(super) fn has_shifted(here: Placement, planned: Placement) -> bool {
    (here.x_m - planned.x_m).hypot(here.y_m - planned.y_m) > SHIFTED_MAX
        || (here.heading_rad - planned.heading_rad).abs() > SHIFTED_MAX
}

fn stalled(felt_m: Option<f64>) -> String {
    match felt_m {
        Some(felt_m) => format!("has something ({:.0} mm)", 1000.0 * felt_m),
        None => "has something".to_owned(),
    }
}
