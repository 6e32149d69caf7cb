//! Carries a motion's acts out, one after the other, and ends all of them where one does not work.

use std::collections::VecDeque;
use std::sync::Arc;

use host_robot::{End, Following, Grip, GripEnd, MotionName, Report, Robot, Trajectory};

use crate::plan::Placement;
use crate::things::Touch;

use super::Director;
use super::sequence::Act;

/// An arm further than this from where its motion goes on is not moved.
const OFF_MAX_RAD: f64 = 0.1;
/// A halted gripper that has opened further than this has let go.
const LET_GO_M: f64 = 0.002;

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
    pub(super) halted: bool,
}

impl Running {
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

    /// The hand is at a thing, or will be.
    pub(super) fn is_at_work(&self) -> bool {
        self.now.is_at_work() || self.left.iter().any(Act::is_at_work)
    }
}

impl<R: Robot> Director<R> {
    /// Begins with the first act.
    pub(super) fn begin(&mut self, motion: &MotionName, mut acts: VecDeque<Act>) -> Result<(), String> {
        let count = acts.len();
        let first = acts.pop_front().ok_or("the motion has no step")?;
        self.start_act(&first)?;
        self.running = Some(Running {
            motion: motion.clone(),
            now: first,
            since_ms: self.now_ms,
            left: acts,
            acts: count,
            halted: false,
        });
        Ok(())
    }

    fn start_act(&mut self, act: &Act) -> Result<(), String> {
        match act {
            Act::Follow { trajectory, touch, .. } => {
                self.robot.follow(Arc::clone(trajectory))?;
                self.things.touch = touch.clone();
            }
            Act::Grip { opening_m, effort_n, .. } => {
                let flange = self.flange_now();
                self.grip_before_m = self.things.opening_m;
                let between = self.shop().between(&self.things, &flange);
                let held = self.shop().held(&self.things);
                // What it has already is between its fingers.
                let between_m = between.map(|(_, width_m)| width_m).or(held.map(|_| self.things.opening_m));
                self.robot.grip(Grip { opening_m: *opening_m, effort_n: *effort_n, between_m })?;
                self.things.touch = self.shop().touching(&self.things, &flange);
            }
            Act::Wait { .. } => {}
        }
        Ok(())
    }

    /// Looks what has become of the act under way, and goes on.
    pub(super) fn carry_on(&mut self) {
        let (end, grip_end) = (self.robot.take_end(), self.robot.take_grip_end());
        if let Some(opening) = self.robot.opening_m() {
            self.things.opening_m = opening.value;
        }
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
        if let Err(why) = self.can_go_on(&next).and_then(|()| self.start_act(&next)) {
            self.give_up(Some(why));
            return;
        }
        let now_ms = self.now_ms;
        if let Some(running) = &mut self.running {
            (running.now, running.since_ms) = (next, now_ms);
        }
    }

    /// The arm rests where the next act begins.
    fn can_go_on(&self, next: &Act) -> Result<(), String> {
        let Act::Follow { trajectory, .. } = next else { return Ok(()) };
        let here = self.robot.arm().ok_or("the arm's angles are not known")?.value.joints_rad;
        let start = trajectory.motion(0.0).joints_rad;
        let off = here.iter().zip(start).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if off <= OFF_MAX_RAD {
            return Ok(());
        }
        Err(format!("the arm is {off:.2} rad off where the motion goes on"))
    }

    /// What the gripper came to.
    fn gripped(&mut self, end: GripEnd, opening_m: f64, closes_on: bool) -> Result<(), Option<String>> {
        let flange = self.flange_now();
        let mut things = self.things.clone();
        let before = self.grip_before_m;
        things.opening_m = before;
        let told = match end {
            GripEnd::Failed(why) => return Err(Some(format!("the gripper: {why}"))),
            GripEnd::Halted => {
                let opened_m = self.things.opening_m;
                if self.shop().held(&things).is_some() && opened_m > before + LET_GO_M {
                    let told = self.shop().gripped(&mut things, &flange, opened_m);
                    self.reports.extend(told.map(|told| Report::Note(format!("the gripper {told}"))));
                }
                things.opening_m = opened_m;
                self.things = things;
                return Err(None);
            }
            GripEnd::Reached if closes_on => {
                things.opening_m = opening_m;
                let held = self.shop().held(&things);
                match held {
                    Some(_) => None,
                    None => Some("has nothing between its fingers".to_owned()),
                }
            }
            GripEnd::Reached => self.shop().gripped(&mut things, &flange, opening_m),
            GripEnd::Stalled => {
                let had = self.shop().held(&things).is_some();
                let told = self.shop().gripped(&mut things, &flange, opening_m);
                let felt_m = self.robot.opening_m().map(|reading| reading.value);
                if had { None } else { told.or_else(|| Some(stalled(felt_m))) }
            }
        };
        if let Some(opening) = self.robot.opening_m() {
            things.opening_m = opening.value;
        }
        things.touch = Touch::default();
        self.things = things;
        self.reports.extend(told.map(|told| Report::Note(format!("the gripper {told}"))));
        Ok(())
    }

    /// Ends the motion where it is; `why` where the robot did not work.
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
        if let Some(running) = self.running.take() {
            self.reports.push(Report::MotionEnded { motion: running.motion, reached });
        }
    }

    /// Nothing of the motion goes on.
    pub(super) fn halt_motion(&mut self) {
        if let Some(running) = &mut self.running {
            running.halted = true;
        }
    }

    fn flange_now(&self) -> host_robot::Pose {
        let placement = self.robot.base().map_or(Placement::default(), |base| base.value.odometry.into());
        let joints_rad = self.robot.arm().map(|arm| arm.value.joints_rad).unwrap_or_default();
        self.flange_in_scene(placement, &joints_rad)
    }

    /// Where the arm is on its trajectory, in s.
    pub(super) fn along(&self) -> Option<(&Arc<Trajectory>, f64)> {
        let Following::Moving { elapsed_s } = self.robot.following() else { return None };
        Some((self.running.as_ref()?.trajectory()?, elapsed_s))
    }
}

fn stalled(felt_m: Option<f64>) -> String {
    match felt_m {
        Some(felt_m) => format!("has something ({:.0} mm)", 1000.0 * felt_m),
        None => "has something".to_owned(),
    }
}
