//! A gripper with `GripperCommand` or `ParallelGripperCommand`: its commands and their results.
//!
//! This module is sans-IO. A stall while closing means an object between the fingers, which is success.
//! A server without a report for too long has failed.
//! A stop requests the cancellation of the goal repeatedly, until the end of the goal is known. It sends no new goal.
//! Goals that were rejected or reported as finished are cancelled again by each stop, like those of the arm.

use host_robot::{Grip, GripEnd, Reading};
use host_topics::message::JointState;

use super::config::Ros2Config;
use super::robot::Output;
use super::strays::{CANCEL_INTERVAL_MS, Strays, Unsure};

/// Maximum wait for the confirmation of a cancellation. Afterwards, the requests continue.
const CANCEL_PATIENCE_MS: u64 = 2000;
/// Maximum duration of a gripper's goal.
const STRAY_MS: u64 = 60_000;
/// Time after which a goal is over, regardless of later reports.
const OVERALL_MS: u64 = 30_000;
/// Maximum age of joint states.
const TOLD_MS: u64 = 1000;

/// The gripper server's report about a goal.
#[derive(Clone, Debug, PartialEq)]
pub enum GripAnswer {
    /// The goal was accepted.
    Accepted,
    /// It will not.
    Rejected,
    /// Current position in the joint's own units.
    At(f64),
    /// It is over.
    Done {
        /// Final position in the joint's own units.
        position: f64,
        /// Whether an object stopped the fingers.
        stalled: bool,
        /// Whether the requested position was reached.
        reached: bool,
        /// The status in the server's own terms.
        status: String,
    },
}

#[derive(Clone, Debug)]
struct Run {
    goal: u32,
    closing: bool,
    asked_ms: u64,
    accepted_ms: Option<u64>,
    /// Time of the last report about the goal.
    heard_ms: u64,
    stopping_since_ms: Option<u64>,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct GripperLink {
    joint: String,
    open: f64,
    closed: f64,
    width_m: f64,
    answer_ms: u64,
    timeout_ms: u64,
    /// The reason why there is no server, or `None`.
    missing: Option<String>,
    goals: u32,
    run: Option<Run>,
    strays: Strays,
    unsure: Unsure,
    /// Distance between the fingers, and the time of its report.
    seen: Option<(f64, u64)>,
    end: Option<GripEnd>,
    notes: Vec<String>,
}

impl GripperLink {
    /// Creates a gripper without any information.
    pub fn new(config: &Ros2Config) -> Self {
        GripperLink {
            joint: config.gripper_joint.clone(),
            open: config.gripper_open,
            closed: config.gripper_closed,
            width_m: config.gripper_width_m,
            answer_ms: config.answer_ms,
            timeout_ms: config.gripper_timeout_ms,
            missing: Some("nobody was looked for yet".to_owned()),
            goals: 0,
            run: None,
            strays: Strays::default(),
            unsure: Unsure::default(),
            seen: None,
            end: None,
            notes: Vec::new(),
        }
    }

    /// Sets the reason why there is no server, or `None` if there is one.
    pub fn set_missing(&mut self, missing: Option<String>) {
        self.missing = missing;
    }

    fn opening_of(&self, position: f64) -> f64 {
        let share = (position - self.closed) / (self.open - self.closed);
        (share * self.width_m).clamp(0.0, self.width_m)
    }

    fn position_of(&self, opening_m: f64) -> f64 {
        let share = (opening_m / self.width_m).clamp(0.0, 1.0);
        self.closed + share * (self.open - self.closed)
    }

    /// Reads the position of the gripper's joint, if the message contains it.
    pub fn see(&mut self, state: &JointState, now_ms: u64) {
        let mut joints = state.name.iter().zip(&state.position);
        if let Some((_, &position)) = joints.find(|(name, _)| **name == self.joint) {
            self.told(position, now_ms);
        }
    }

    /// Returns the distance between the fingers.
    pub fn opening_m(&self, now_ms: u64) -> Option<Reading<f64>> {
        let (value, at_ms) = self.seen?;
        let age_ms = now_ms.saturating_sub(at_ms);
        // If the gripper's joint is not reported regularly, the last result remains valid.
        (self.joint.is_empty() || age_ms <= TOLD_MS).then_some(Reading { value, age_ms })
    }

    /// Checks whether a goal can be sent now.
    ///
    /// # Errors
    /// Why not.
    pub fn can_grip(&self) -> Result<(), String> {
        match &self.missing {
            None if self.run.is_some() => Err("the gripper is still at another goal".to_owned()),
            None if !self.strays.are_said_over() => {
                Err("whether the gripper's last goal has ended is not known yet; its end is asked for"
                    .to_owned())
            }
            None => Ok(()),
            Some(why) => Err(format!("the gripper cannot be asked: {why} (gripper in [ros2])")),
        }
    }

    /// Sends a goal.
    ///
    /// # Errors
    /// As [`GripperLink::can_grip`].
    pub fn grip(&mut self, grip: Grip, now_ms: u64, outputs: &mut Vec<Output>) -> Result<(), String> {
        self.can_grip()?;
        self.goals += 1;
        let from_m = self.opening_m(now_ms).map_or(self.width_m, |reading| reading.value);
        self.end = None;
        self.run = Some(Run {
            goal: self.goals,
            // If the width is unknown, every goal except fully open counts as closing.
            closing: grip.opening_m < from_m,
            asked_ms: now_ms,
            accepted_ms: None,
            heard_ms: now_ms,
            stopping_since_ms: None,
        });
        outputs.push(Output::Grip {
            goal: self.goals,
            position: self.position_of(grip.opening_m),
            effort: grip.effort_n,
        });
        Ok(())
    }

    /// Abandons the goal, if there is one. The fingers stay in place.
    pub fn halt(&mut self, now_ms: u64, outputs: &mut Vec<Output>) {
        self.unsure.halt(now_ms, &mut self.strays, |goal| outputs.push(Output::CancelGrip { goal }));
        let Some(run) = self.run.as_mut().filter(|run| run.stopping_since_ms.is_none()) else { return };
        run.stopping_since_ms = Some(now_ms);
        run.heard_ms = now_ms;
        outputs.push(Output::CancelGrip { goal: run.goal });
    }

    /// Processes an answer of the server.
    pub fn answer(&mut self, goal: u32, answer: GripAnswer, now_ms: u64, outputs: &mut Vec<Output>) {
        let Some(run) = self.run.as_mut().filter(|run| run.goal == goal) else {
            match answer {
                // The goal may also be one that was rejected or finished earlier.
                // Such a goal must not run now.
                GripAnswer::Accepted => {
                    outputs.push(Output::CancelGrip { goal });
                    self.stray(goal, now_ms);
                }
                // With two servers, the second server may execute the goal.
                GripAnswer::Rejected => self.strays.said_over(goal),
                GripAnswer::At(position) => self.told(position, now_ms),
                GripAnswer::Done { position, .. } => {
                    self.told(position, now_ms);
                    self.strays.over(goal);
                }
            }
            return;
        };
        let (closing, stopping) = (run.closing, run.stopping_since_ms.is_some());
        if !stopping {
            run.heard_ms = now_ms;
        }
        if matches!(answer, GripAnswer::Rejected | GripAnswer::Done { .. }) {
            // The duration of a grip is unknown.
            // After any answer, a stop therefore cancels the goal once more.
            self.unsure.add(goal, run.asked_ms + OVERALL_MS);
        }
        match answer {
            GripAnswer::Accepted if run.accepted_ms.is_some() && !stopping => {
                // Two motions may run, and only one would be monitored.
                self.notes.push(
                    "two controllers have accepted the gripper's goal: it is cancelled; end all but one of them".to_owned(),
                );
                self.halt(now_ms, outputs);
            }
            GripAnswer::Accepted => {
                run.accepted_ms = run.accepted_ms.or(Some(now_ms));
                if stopping {
                    // The cancellation was requested before the goal began.
                    outputs.push(Output::CancelGrip { goal });
                }
            }
            GripAnswer::Rejected => {
                self.finish(if stopping {
                    GripEnd::Halted
                } else {
                    GripEnd::Failed("its controller refused the goal".to_owned())
                });
            }
            GripAnswer::At(position) => self.told(position, now_ms),
            GripAnswer::Done { position, stalled, reached, status } => {
                self.told(position, now_ms);
                self.finish(if stopping {
                    GripEnd::Halted
                } else if stalled && closing {
                    GripEnd::Stalled
                } else if reached {
                    GripEnd::Reached
                } else if stalled {
                    GripEnd::Failed("something keeps it from opening".to_owned())
                } else {
                    GripEnd::Failed(format!("its controller gave up ({status})"))
                });
            }
        }
    }

    fn told(&mut self, position: f64, now_ms: u64) {
        if position.is_finite() {
            self.seen = Some((self.opening_of(position), now_ms));
        }
    }

    /// Handles a goal that may run unintentionally. Its cancellation is requested until its end is known.
    fn stray(&mut self, goal: u32, now_ms: u64) {
        self.strays.add(goal, now_ms, now_ms + STRAY_MS);
    }

    fn finish(&mut self, end: GripEnd) {
        if self.run.take().is_some() {
            self.end = Some(end);
        }
    }

    /// Advances the time to `now_ms`.
    pub fn step(&mut self, now_ms: u64, outputs: &mut Vec<Output>) {
        self.strays.step(now_ms, |goal| outputs.push(Output::CancelGrip { goal }));
        let Some(run) = &mut self.run else { return };
        let (goal, silent_ms) = (run.goal, now_ms.saturating_sub(run.heard_ms));
        if let Some(since_ms) = run.stopping_since_ms {
            if now_ms.saturating_sub(since_ms) > CANCEL_PATIENCE_MS {
                self.notes.push(
                    "ALARM: the gripper's controller does not confirm that it has stopped; it is asked again and again"
                        .to_owned(),
                );
                self.stray(goal, now_ms);
                self.finish(GripEnd::Halted);
            } else if silent_ms >= CANCEL_INTERVAL_MS {
                run.heard_ms = now_ms;
                outputs.push(Output::CancelGrip { goal });
            }
            return;
        }
        let (patience_ms, what) = if run.accepted_ms.is_some() {
            (self.timeout_ms, "told nothing of the goal")
        } else {
            (self.answer_ms, "did not answer")
        };
        let overdue = run.accepted_ms.is_some_and(|at_ms| now_ms.saturating_sub(at_ms) > OVERALL_MS);
        if overdue || silent_ms > patience_ms {
            outputs.push(Output::CancelGrip { goal });
            self.stray(goal, now_ms);
            self.finish(GripEnd::Failed(if overdue {
                format!("its controller does not finish within {} s", OVERALL_MS / 1000)
            } else {
                format!("its controller {what} within {patience_ms} ms")
            }));
        }
    }

    /// Returns the result of the last goal, once.
    pub fn take_end(&mut self) -> Option<GripEnd> {
        self.end.take()
    }

    /// Returns messages for the user, each of them once.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rig {
        gripper: GripperLink,
        outputs: Vec<Output>,
        now_ms: u64,
    }

    impl Rig {
        fn new() -> Self {
            let config = Ros2Config { gripper_joint: "knuckle".to_owned(), ..Ros2Config::default() };
            let mut gripper = GripperLink::new(&config);
            gripper.set_missing(None);
            Rig { gripper, outputs: Vec::new(), now_ms: 0 }
        }

        fn grip(&mut self, opening_m: f64) -> Result<(), String> {
            let grip = Grip { opening_m, effort_n: None, between_m: None };
            self.gripper.grip(grip, self.now_ms, &mut self.outputs)
        }

        fn answer(&mut self, goal: u32, answer: GripAnswer) {
            self.gripper.answer(goal, answer, self.now_ms, &mut self.outputs);
        }

        fn done(&mut self, goal: u32, position: f64, stalled: bool) -> Option<GripEnd> {
            let status = "Aborted".to_owned();
            self.answer(goal, GripAnswer::Done { position, stalled, reached: !stalled, status });
            self.gripper.take_end()
        }

        fn run(&mut self, ms: u64) -> Vec<Output> {
            for _ in 0..ms / 10 {
                self.now_ms += 10;
                self.gripper.step(self.now_ms, &mut self.outputs);
            }
            std::mem::take(&mut self.outputs)
        }
    }

    #[test]
    fn widths_are_the_joints_positions() {
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        assert!(matches!(rig.outputs[..], [Output::Grip { goal: 1, position: 0.8, effort: None }]));
        assert_eq!(rig.done(1, 0.2, true), Some(GripEnd::Stalled));
        let opening_m = rig.gripper.opening_m(0).unwrap().value;
        assert!((opening_m - 0.75 * 0.085).abs() < 1e-12, "{opening_m}");
        let state =
            JointState { name: vec!["knuckle".to_owned()], position: vec![0.0], ..JointState::default() };
        rig.gripper.see(&state, 0);
        assert!((rig.gripper.opening_m(0).unwrap().value - 0.085).abs() < 1e-12);
        assert_eq!(rig.gripper.opening_m(5000), None, "what was told long ago is not known");
    }

    #[test]
    fn a_stall_while_closing_is_success_and_while_opening_a_failure() {
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        rig.answer(1, GripAnswer::Accepted);
        assert!(rig.grip(0.0).unwrap_err().contains("another goal"));
        assert_eq!(rig.done(1, 0.3, true), Some(GripEnd::Stalled));
        rig.grip(0.085).unwrap();
        assert!(matches!(rig.done(2, 0.25, true), Some(GripEnd::Failed(_))));
        rig.grip(0.0).unwrap();
        assert_eq!(rig.done(3, 0.8, false), Some(GripEnd::Reached));
    }

    #[test]
    fn who_tells_nothing_has_failed_and_its_goal_is_cancelled_until_it_ends() {
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        rig.outputs.clear();
        assert!(rig.run(1000).is_empty());
        assert_eq!(rig.run(10), [Output::CancelGrip { goal: 1 }]);
        assert!(
            matches!(rig.gripper.take_end(), Some(GripEnd::Failed(why)) if why.contains("did not answer"))
        );
        assert_eq!(rig.run(400).len(), 2, "asked again");
        assert!(rig.grip(0.0).unwrap_err().contains("not known yet"));
        rig.answer(1, GripAnswer::Rejected);
        // Another server may have accepted the goal, so the cancellation requests continue without waiting.
        assert_eq!(rig.run(400).len(), 2);
        assert_eq!(rig.gripper.can_grip(), Ok(()));

        // The goal is accepted after all, so it is cancelled. No other goal is sent until its end is known.
        rig.answer(1, GripAnswer::Accepted);
        assert_eq!(rig.outputs, [Output::CancelGrip { goal: 1 }]);
        assert!(rig.grip(0.0).unwrap_err().contains("not known yet"));
        assert_eq!(rig.done(1, 0.2, false), None);
        rig.outputs.clear();

        rig.grip(0.0).unwrap();
        rig.answer(2, GripAnswer::Accepted);
        rig.outputs.clear();
        rig.run(4000);
        rig.answer(2, GripAnswer::At(0.1));
        assert!(rig.run(4900).is_empty(), "feedback counts");
        assert_eq!(rig.run(200).first(), Some(&Output::CancelGrip { goal: 2 }));
        assert!(matches!(rig.gripper.take_end(), Some(GripEnd::Failed(why)) if why.contains("told nothing")));
    }

    #[test]
    fn a_stop_cancels_until_it_is_confirmed_and_sends_nothing_else() {
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        rig.outputs.clear();
        rig.gripper.halt(rig.now_ms, &mut rig.outputs);
        // The server accepts the goal only now. The cancellation is therefore repeated.
        rig.answer(1, GripAnswer::Accepted);
        let sent = rig.run(500);
        assert!(sent.len() >= 3 && sent.iter().all(|o| *o == Output::CancelGrip { goal: 1 }), "{sent:?}");
        assert_eq!(rig.done(1, 0.4, false), Some(GripEnd::Halted));
        assert!(rig.run(1000).is_empty());

        rig.grip(0.085).unwrap();
        rig.gripper.halt(rig.now_ms, &mut rig.outputs);
        rig.run(2100);
        assert_eq!(rig.gripper.take_end(), Some(GripEnd::Halted));
        assert!(rig.gripper.take_notes()[0].contains("ALARM"));
        assert!(rig.run(200).contains(&Output::CancelGrip { goal: 2 }), "asked on");
    }

    #[test]
    fn a_goal_that_was_rejected_or_said_to_be_over_is_cancelled_by_a_stop_and_no_grip_waits_for_it() {
        for said in [
            GripAnswer::Rejected,
            GripAnswer::Done { position: 0.8, stalled: false, reached: true, status: "Succeeded".to_owned() },
        ] {
            let mut rig = Rig::new();
            rig.grip(0.0).unwrap();
            rig.answer(1, said.clone());
            assert!(rig.gripper.take_end().is_some());
            rig.outputs.clear();
            assert!(rig.run(2000).is_empty(), "nobody has stopped");
            rig.gripper.halt(rig.now_ms, &mut rig.outputs);
            assert_eq!(rig.outputs, [Output::CancelGrip { goal: 1 }], "{said:?}");
            rig.outputs.clear();
            assert_eq!(rig.run(600), vec![Output::CancelGrip { goal: 1 }; 3], "{said:?}: asked again");
            rig.grip(0.085).unwrap();
        }
        // When no goal can still be running, no more requests are sent.
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        rig.answer(1, GripAnswer::Rejected);
        rig.outputs.clear();
        rig.run(OVERALL_MS);
        rig.gripper.halt(rig.now_ms, &mut rig.outputs);
        assert!(rig.outputs.is_empty(), "{:?}", rig.outputs);
    }

    #[test]
    fn a_goal_that_two_accept_is_cancelled_and_said() {
        let mut rig = Rig::new();
        rig.grip(0.0).unwrap();
        rig.answer(1, GripAnswer::Accepted);
        rig.outputs.clear();
        rig.answer(1, GripAnswer::Accepted);
        assert_eq!(rig.outputs, [Output::CancelGrip { goal: 1 }]);
        assert!(rig.gripper.take_notes()[0].contains("two controllers"));
        rig.outputs.clear();
        assert_eq!(rig.run(400), vec![Output::CancelGrip { goal: 1 }; 2]);
        // The first server reports that it has stopped.
        // The next stop therefore cancels the other server's goal.
        assert_eq!(rig.done(1, 0.3, false), Some(GripEnd::Halted));
        rig.gripper.halt(rig.now_ms, &mut rig.outputs);
        assert_eq!(rig.outputs, [Output::CancelGrip { goal: 1 }]);
    }

    #[test]
    fn without_a_server_it_is_refused_with_the_reason() {
        let mut rig = Rig::new();
        rig.gripper.set_missing(Some("no server of a name that ends in gripper_cmd".to_owned()));
        assert!(rig.grip(0.0).unwrap_err().contains("gripper_cmd"));
        assert!(rig.outputs.is_empty());
    }
}
