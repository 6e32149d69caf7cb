//! Permits motion of base and arm only while both can still stop.
//! This module is the director's part of [`crate::plan::guard`].

use host_robot::{Base, BaseState, Motion, Reading, Report, Robot, Trajectory, Twist};

use crate::plan::guard::{Guard, Moving, TICK_MS};

use super::Director;

/// Maximum age of the base's pose with which the base may drive in a scene.
const BASE_AGE_MAX_MS: u64 = 250;

impl<R: Robot> Director<R> {
    /// Returns the state of the base if it is recent enough for the guard.
    pub(super) fn known_base(&self) -> Result<BaseState, String> {
        match self.robot.base() {
            Some(Reading { value, age_ms }) if age_ms <= BASE_AGE_MAX_MS => Ok(value),
            Some(Reading { age_ms, .. }) => Err(format!("the base's pose is {age_ms} ms old")),
            None => Err("the base's pose is not known; does the robot report its odometry?".to_owned()),
        }
    }

    /// Returns the arm's future motion, one state per millisecond.
    fn arm_ahead(&self, steps: u64, halt: bool) -> Option<(Motion, Vec<Motion>)> {
        let reported = self.robot.arm()?.value;
        let ahead = |trajectory: &Trajectory, from_s: f64| -> Vec<Motion> {
            (1..=steps).map(|k| trajectory.motion(from_s + k as f64 / 1000.0)).collect()
        };
        Some(match self.along() {
            Some((trajectory, elapsed_s)) => {
                let now = trajectory.motion(elapsed_s);
                if halt {
                    (now, ahead(&Trajectory::braking(now, self.joint_limits()), 0.0))
                } else {
                    (now, ahead(trajectory, elapsed_s))
                }
            }
            None => (reported, ahead(&Trajectory::braking(reported, self.joint_limits()), 0.0)),
        })
    }

    /// Permits the next tick of base and arm if both can stop after it. Otherwise, base and arm brake.
    pub(super) fn guard(&mut self) {
        let Some(planner) = self.site.planner().cloned() else { return };
        if self.now_ms < self.guard_due_ms {
            return;
        }
        let still = self.wanted == Twist::ZERO && self.allowed == Twist::ZERO && self.running.is_none();
        let base = match self.known_base() {
            Ok(base) => base,
            Err(why) => {
                if !still {
                    self.hold(Twist::ZERO, self.running.is_some(), why);
                }
                return;
            }
        };
        if still && base.odometry.twist == Twist::ZERO {
            self.set_held(None);
            return;
        }
        self.guard_due_ms = self.now_ms + TICK_MS;
        let steps =
            TICK_MS + self.robot.reaction_ms() + self.robot.base().map_or(0, |reading| reading.age_ms);
        let guard = Guard { world: planner.world(), limits: planner.limits(), things: &self.things };
        // While the hand is at an object, the base must not move.
        let at_work = self.is_at_work();
        let wanted = if at_work { Twist::ZERO } else { self.wanted };
        let try_tick = |twist: Twist, halt_arm: bool| {
            let Some((arm_now, arm_ahead)) = self.arm_ahead(steps, halt_arm) else { return false };
            let mut model = Base::at(*self.robot.base_limits(), &base);
            let now = Moving::now(&model, arm_now);
            model.drive(twist);
            let instants: Vec<Moving> = arm_ahead
                .into_iter()
                .map(|arm| {
                    model.step(0.001);
                    Moving::now(&model, arm)
                })
                .collect();
            guard.allows(&now, &instants)
        };
        let choices = [(wanted, false), (Twist::ZERO, false), (wanted, true)];
        let chosen = choices.into_iter().find(|&(twist, halt_arm)| try_tick(twist, halt_arm));
        if chosen == Some(choices[0]) {
            self.allowed = wanted;
            self.robot.drive(wanted);
            let waits = self.running.as_ref().filter(|_| at_work && wanted != self.wanted);
            self.set_held(waits.map(|running| format!("the hand is at work ({})", running.motion)));
            return;
        }
        let (twist, halt_arm) = chosen.unwrap_or((Twist::ZERO, true));
        let reason = match self.robot.arm() {
            None => "the arm's angles are not known".to_owned(),
            Some(arm) => guard.nearest(&base.odometry, &arm.value),
        };
        self.hold(twist, halt_arm, reason);
    }

    fn hold(&mut self, twist: Twist, halt_arm: bool, reason: String) {
        self.guard_stops += 1;
        self.allowed = twist;
        self.robot.drive(twist);
        if halt_arm {
            // Whichever part of a motion is running, its remaining parts are cancelled.
            self.jog.needs_neutral = true;
            self.halt_motion();
            self.robot.halt_arm();
            self.robot.halt_gripper();
        }
        self.set_held((twist != self.wanted).then_some(reason));
    }

    pub(super) fn set_held(&mut self, held: Option<String>) {
        match (&self.held, &held) {
            (None, Some(reason)) => self.reports.push(Report::BaseHeld { reason: reason.clone() }),
            (Some(_), None) => self.reports.push(Report::BaseFree),
            _ => {}
        }
        self.held = held;
    }
}
