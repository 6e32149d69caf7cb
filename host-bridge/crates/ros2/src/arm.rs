//! An arm with a `joint_trajectory_controller`: its commands and their results.
//!
//! There are three interfaces: a stream of short pieces ([`crate::stream`]), an action goal, or a single message.
//! Only with the stream does the arm stop after the death of this program.
//!
//! This module is sans-IO. A trajectory starts at the angles that the robot reports, and is sent as a whole.
//! A motion runs until the controller (action), or the angles and the time (topic), indicate its end.
//! A stop cancels the motion, and also any goal that is accepted later.

use std::sync::Arc;

use super::angles::Angles;
use super::answer::Answer;
use super::config::{ArmInterface, Ros2Config};
use super::doubts::{Doubts, in_order};
use super::points::{message, points};
use super::robot::Output;
use super::strays::{CANCEL_INTERVAL_MS, Strays, Unsure};
use super::stream::{self, Late, RobotClock, Stream, off_rad};
use host_robot::{End, Following, JointLimits, Joints, Motion, Reading, Trajectory};
use host_topics::message::{ControllerState, Header, JointState};

/// Maximum distance at which the goal counts as reached if its end is not reported.
const REACHED_RAD: f64 = 0.05;
/// Maximum distance between the arm and its plan.
/// The plan's positions within the last [`FOLLOW_STEPS`] times 20 ms are compared.
/// The arm is stopped if this distance is exceeded.
const FOLLOW_RAD: f64 = 0.1;
const FOLLOW_STEPS: u32 = 10;
/// If the controller's set point changes by more than this, the arm has begun to move.
const BEGUN_RAD: f64 = 1e-4;
/// Time after which an unconfirmed cancellation is abandoned.
const CANCEL_PATIENCE_MS: u64 = 5000;
/// Maximum duration of any goal.
const STRAY_MS: u64 = 300_000;
/// A goal may have been reported as finished too early.
/// A stop cancels such a goal until this long after its planned end.
const UNSURE_MS: u64 = 5000;
/// Maximum delay of a motion compared with its plan.
const OVERDUE_MS: u64 = 10_000;

#[derive(Clone, Debug)]
struct Run {
    goal: u32,
    trajectory: Arc<Trajectory>,
    asked_ms: u64,
    /// Time at which the motion began; `None` without an answer.
    moving_since_ms: Option<u64>,
    /// Elapsed time as reported by the controller.
    elapsed_s: Option<f64>,
    /// The motion is sent in pieces.
    stream: Option<Stream>,
    /// The time at which the motion was abandoned.
    stopping_since_ms: Option<u64>,
    cancelled_ms: u64,
}

impl Run {
    fn elapsed_s(&self, now_ms: u64) -> f64 {
        let by_time = self.moving_since_ms.map_or(0.0, |since| now_ms.saturating_sub(since) as f64 / 1000.0);
        self.elapsed_s.unwrap_or(by_time)
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct ArmLink {
    interface: ArmInterface,
    limits: JointLimits,
    answer_ms: u64,
    angles: Angles,
    clock: RobotClock,
    /// Whether there is a subscriber for goals (or trajectories).
    listened_to: bool,
    run: Option<Run>,
    goals: u32,
    /// Abandoned goals that may still be running. Their cancellation is requested.
    strays: Strays,
    /// Goals that may have been reported as finished too early, and until when they may still be running.
    unsure: Unsure,
    doubts: Doubts,
    end: Option<End>,
    /// Whether the controller has started the trajectory.
    is_accepted: bool,
    /// The controller's set point when a trajectory was sent; stored until the start is detected.
    wanted_then: Option<Joints>,
    /// The controller's set point.
    wanted: Option<Joints>,
    notes: Vec<String>,
}

impl ArmLink {
    /// Creates an arm without any information.
    pub fn new(config: &Ros2Config, limits: JointLimits) -> Self {
        ArmLink {
            interface: config.arm,
            limits,
            answer_ms: config.answer_ms,
            angles: Angles::new(config),
            clock: RobotClock::default(),
            listened_to: false,
            run: None,
            goals: 0,
            strays: Strays::default(),
            unsure: Unsure::default(),
            doubts: Doubts::default(),
            end: None,
            is_accepted: false,
            wanted_then: None,
            wanted: None,
            notes: Vec::new(),
        }
    }

    /// Returns the interface by which motions are sent.
    pub fn interface(&self) -> ArmInterface {
        self.interface
    }

    /// Reads angles, except NaN and those of other joints.
    pub fn see(&mut self, state: &JointState, now_ms: u64) {
        self.see_from("", state, now_ms);
    }

    /// Like [`Self::see`], for angles from a named publisher.
    pub fn see_from(&mut self, teller: &str, state: &JointState, now_ms: u64) {
        self.clock.see(state.header.stamp, now_ms);
        if self.angles.see(state, now_ms, &mut self.doubts) {
            self.doubts.told_by(teller, now_ms);
        }
    }

    /// Processes the controller's report about itself, including its speed scaling if reported.
    pub fn see_controller(&mut self, state: &ControllerState, scaling: Option<f64>, now_ms: u64) {
        let read = |values: &[f64]| in_order(self.angles.names(), &state.joint_names, values);
        self.wanted = read(&state.reference.positions);
        if let (Some(then), Some(wanted)) = (&self.wanted_then, &self.wanted)
            && off_rad(then, wanted) > BEGUN_RAD
        {
            (self.wanted_then, self.is_accepted) = (None, true);
        }
        let reference = self.wanted.zip(read(&state.reference.velocities));
        self.doubts.controller(reference, scaling, now_ms);
    }

    /// Sets the number of other programs' active goals on the controller's action server.
    pub fn set_foreign_goals(&mut self, goals: usize) {
        self.doubts.set_foreign(goals);
    }

    /// Returns the position at which the controller holds the resting arm.
    pub fn held_rad(&self, now_ms: u64) -> Option<Joints> {
        let here = self.sample(now_ms)?;
        self.doubts.held(&here.joints_rad, now_ms)
    }

    /// Returns the reason why the arm must not move, if there is one.
    fn problem(&self, now_ms: u64) -> Option<String> {
        self.doubts.problem(self.interface == ArmInterface::Stream, now_ms)
    }

    /// Sets whether there is a subscriber for goals (or trajectories).
    pub fn set_listened_to(&mut self, listened_to: bool) {
        self.listened_to = listened_to;
    }

    /// Returns the motion of all joints, if all were reported recently. Accelerations are not reported.
    pub fn sample(&self, now_ms: u64) -> Option<Motion> {
        self.reading(now_ms).map(|reading| reading.value)
    }

    /// Returns the motion of all joints as above, with the age of the oldest value.
    pub fn reading(&self, now_ms: u64) -> Option<Reading<Motion>> {
        self.angles.reading(now_ms)
    }

    /// Checks whether a trajectory can be sent now.
    ///
    /// # Errors
    /// Fails if the arm's angles are unknown or old, or there is no subscriber.
    pub fn can_follow(&self, now_ms: u64) -> Result<(), String> {
        if self.interface == ArmInterface::None {
            return Err("this robot's arm is not driven (arm = \"none\" in [ros2])".to_owned());
        }
        self.sample(now_ms).ok_or_else(|| self.angles.what_is_missing(now_ms))?;
        if let Some(problem) = self.problem(now_ms) {
            return Err(problem);
        }
        if self.interface == ArmInterface::Stream && self.clock.at_ns(now_ms).is_none() {
            return Err(
                "the robot's joint states carry no time stamps, so pieces of a motion cannot be timed; \
                        arm = \"action\" in [ros2] sends whole goals instead, which have no third stop"
                    .to_owned(),
            );
        }
        if !self.listened_to {
            let what = match self.interface {
                ArmInterface::Action => "no action server takes goals",
                _ => "nobody takes trajectories",
            };
            return Err(format!("{what}: is the arm's controller active? `doctor --ros2` tells"));
        }
        Ok(())
    }

    /// Sends a trajectory.
    ///
    /// # Errors
    /// Fails like [`ArmLink::can_follow`], or if another trajectory is running.
    pub fn follow(
        &mut self,
        trajectory: Arc<Trajectory>,
        now_ms: u64,
        outputs: &mut Vec<Output>,
    ) -> Result<(), String> {
        if self.run.is_some() {
            return Err("the arm still follows another trajectory".to_owned());
        }
        self.can_follow(now_ms)?;
        self.goals += 1;
        let robot_ns = self.clock.at_ns(now_ms).filter(|_| self.interface == ArmInterface::Stream);
        let stream = robot_ns.map(Stream::new);
        if stream.is_none() {
            outputs.push(self.output(self.goals, &trajectory));
        }
        self.is_accepted = false;
        // An action server answers. For a topic, only the controller's own state shows the progress.
        self.wanted_then = self.wanted.filter(|_| self.interface != ArmInterface::Action);
        self.run = Some(Run {
            goal: self.goals,
            trajectory,
            asked_ms: now_ms,
            moving_since_ms: (self.interface == ArmInterface::Topic).then_some(now_ms),
            elapsed_s: None,
            stream,
            stopping_since_ms: None,
            cancelled_ms: 0,
        });
        self.step(now_ms, outputs);
        Ok(())
    }

    /// Returns how far ahead of now a running motion can be changed.
    ///
    /// # Errors
    /// Fails for whole goals, which would continue after this program's death.
    pub fn ahead_ms(&self) -> Result<u64, String> {
        match self.interface {
            ArmInterface::Stream => Ok(stream::AHEAD_MS),
            _ => Err("it needs arm = \"stream\" in [ros2]: of whole goals nothing ends at rest by itself"
                .to_owned()),
        }
    }

    /// Changes the running motion, starting at `from_s` of its own time.
    ///
    /// # Errors
    /// Fails if no motion runs, if the motion was abandoned, or if the piece would come too late.
    /// The arm then continues as before.
    pub fn follow_on(
        &mut self,
        trajectory: Arc<Trajectory>,
        from_s: f64,
        now_ms: u64,
        outputs: &mut Vec<Output>,
    ) -> Result<(), String> {
        self.ahead_ms()?;
        let robot_ns = self.clock.at_ns(now_ms).ok_or("the robot's clock is not known")?;
        let Some(Run { trajectory: run, stream: Some(stream), stopping_since_ms: None, .. }) = &mut self.run
        else {
            return Err("there is no motion that could be continued".to_owned());
        };
        let points = stream
            .go_on([run, &trajectory], from_s, &self.limits, now_ms, robot_ns)
            .map_err(|Late| "the next piece would come too late".to_owned())?;
        *run = trajectory;
        // If one turn contains two pieces, only the last piece counts.
        outputs.retain(|output| !matches!(output, Output::Trajectory(_)));
        outputs.push(Output::Trajectory(stream.message(self.angles.names(), points)));
        Ok(())
    }

    /// Its progress so far.
    pub fn following(&self, now_ms: u64) -> Following {
        match &self.run {
            None => Following::Idle,
            Some(run) if run.stopping_since_ms.is_some() => Following::Halting,
            Some(Run { stream: Some(stream), .. }) => {
                let robot_ns = self.clock.at_ns(now_ms).unwrap_or_default();
                Following::Moving { elapsed_s: stream.elapsed_s(robot_ns).max(0.0) }
            }
            Some(run) => Following::Moving { elapsed_s: run.elapsed_s(now_ms) },
        }
    }

    fn output(&self, goal: u32, trajectory: &Trajectory) -> Output {
        let trajectory = message(Header::default(), self.angles.names(), points(trajectory));
        match self.interface {
            ArmInterface::Action => Output::Goal { goal, trajectory },
            _ => Output::Trajectory(trajectory),
        }
    }

    /// Abandons the motion, if there is one.
    pub fn halt(&mut self, now_ms: u64, outputs: &mut Vec<Output>) {
        self.unsure.halt(now_ms, &mut self.strays, |goal| outputs.push(Output::Cancel { goal }));
        let fresh = self.sample(now_ms);
        let Some(run) = &mut self.run else { return };
        if run.stopping_since_ms.is_some() {
            return;
        }
        run.stopping_since_ms = Some(now_ms);
        run.cancelled_ms = now_ms;
        if let Some(stream) = &mut run.stream {
            let robot_ns = self.clock.at_ns(now_ms).unwrap_or_default();
            let points = stream.halt(&run.trajectory, &self.limits, robot_ns);
            outputs.push(Output::Trajectory(stream.message(self.angles.names(), points)));
            return;
        }
        if self.interface == ArmInterface::Action {
            outputs.push(Output::Cancel { goal: run.goal });
            return;
        }
        let planned = run.trajectory.motion(run.elapsed_s(now_ms));
        let from =
            fresh.map_or(planned, |seen| Motion { acceleration_rad_s2: planned.acceleration_rad_s2, ..seen });
        let braking = Trajectory::braking(from, &self.limits);
        let braking = Arc::new(braking);
        run.trajectory = Arc::clone(&braking);
        run.moving_since_ms = Some(now_ms);
        let output = self.output(0, &braking);
        outputs.push(output);
    }

    /// Processes an answer of the action server.
    pub fn answer(&mut self, goal: u32, answer: Answer, now_ms: u64, outputs: &mut Vec<Output>) {
        let Some(run) = self.run.as_mut().filter(|run| run.goal == goal) else {
            match answer {
                Answer::Accepted => {
                    // The goal was abandoned or rejected, so it must not move the arm now.
                    self.strays.add(goal, now_ms, now_ms + STRAY_MS);
                    outputs.push(Output::Cancel { goal });
                    self.notes
                        .push("the arm's controller accepted a goal too late; it is cancelled".to_owned());
                }
                Answer::Succeeded | Answer::Ended(_) => self.strays.over(goal),
                Answer::Progress(_) | Answer::Rejected => {}
            }
            return;
        };
        if matches!(answer, Answer::Succeeded | Answer::Rejected | Answer::Ended(_)) {
            // After a forged answer, or with two servers, a finished motion may still be running.
            let planned_ms = (run.trajectory.duration_s() * 1000.0) as u64;
            if now_ms.saturating_sub(run.asked_ms) < planned_ms {
                self.unsure.add(goal, run.asked_ms + planned_ms + UNSURE_MS);
            }
        }
        match answer {
            Answer::Accepted if run.moving_since_ms.is_some() && run.stopping_since_ms.is_none() => {
                // With two servers or a forged answer, two motions may run, and only one would be monitored.
                self.notes.push(
                    "two controllers have accepted the goal: it is cancelled; end all but one of them"
                        .to_owned(),
                );
                self.halt(now_ms, outputs);
            }
            Answer::Accepted => {
                run.moving_since_ms = Some(now_ms);
                self.is_accepted = true;
                if run.stopping_since_ms.is_some() {
                    run.cancelled_ms = now_ms;
                    outputs.push(Output::Cancel { goal });
                }
            }
            Answer::Progress(elapsed_s) => run.elapsed_s = Some(elapsed_s),
            Answer::Succeeded => self.end(true),
            Answer::Rejected => {
                self.notes.push("the arm's controller rejected the goal; its log says why".to_owned());
                self.end(false);
            }
            Answer::Ended(why) => {
                if run.stopping_since_ms.is_none() {
                    self.notes.push(format!("the arm's controller gave up: {why}"));
                }
                self.end(false);
            }
        }
    }

    /// Returns whether the controller has accepted the motion since the last call.
    pub fn take_accepted(&mut self) -> bool {
        std::mem::take(&mut self.is_accepted)
    }

    fn end(&mut self, reached: bool) {
        self.wanted_then = None;
        if self.run.take().is_some() {
            self.end = Some(if reached { End::Reached } else { End::Halted });
        }
    }

    /// Advances the time to `now_ms`.
    pub fn step(&mut self, now_ms: u64, outputs: &mut Vec<Output>) {
        let sample = self.sample(now_ms);
        self.strays.step(now_ms, |goal| outputs.push(Output::Cancel { goal }));
        if self.run.as_ref().is_some_and(|run| run.stopping_since_ms.is_none())
            && let Some(problem) = self.problem(now_ms)
        {
            self.notes.push(format!("{problem}; the arm was stopped"));
            self.halt(now_ms, outputs);
            return;
        }
        if self.interface == ArmInterface::Stream {
            self.step_stream(sample, now_ms, outputs);
            return;
        }
        let Some(run) = &mut self.run else { return };
        let planned_ms = (run.trajectory.duration_s() * 1000.0) as u64;
        if self.interface == ArmInterface::Topic {
            let since_ms = now_ms.saturating_sub(run.moving_since_ms.unwrap_or(now_ms));
            if since_ms < planned_ms {
                return;
            }
            let goal = run.trajectory.goal_rad();
            let arrived = sample.is_some_and(|sample| off_rad(&sample.joints_rad, &goal) <= REACHED_RAD);
            if run.stopping_since_ms.is_some() {
                self.end(false);
            } else if arrived {
                self.end(true);
            } else if since_ms > planned_ms + OVERDUE_MS {
                self.notes.push("the arm did not arrive at its pose".to_owned());
                self.end(false);
            }
            return;
        }
        if let Some(since_ms) = run.stopping_since_ms {
            if now_ms.saturating_sub(since_ms) > CANCEL_PATIENCE_MS {
                self.notes.push(
                    "ALARM: the arm's controller does not confirm the cancellation, which is asked for again and again: the arm \
                     may move; use its own e-stop"
                        .to_owned(),
                );
                let goal = run.goal;
                self.strays.add(goal, now_ms, now_ms + STRAY_MS);
                self.end(false);
            } else if now_ms.saturating_sub(run.cancelled_ms) >= CANCEL_INTERVAL_MS {
                run.cancelled_ms = now_ms;
                outputs.push(Output::Cancel { goal: run.goal });
            }
            return;
        }
        let silent = run.moving_since_ms.is_none() && now_ms.saturating_sub(run.asked_ms) > self.answer_ms;
        let overdue =
            run.moving_since_ms.is_some_and(|since| now_ms.saturating_sub(since) > planned_ms + OVERDUE_MS);
        if silent || overdue {
            let why = if silent { "does not answer" } else { "does not finish" };
            self.notes.push(format!("the arm's controller {why}; the goal is cancelled"));
            self.halt(now_ms, outputs);
        }
    }

    /// Like [`Self::step`], for a trajectory in pieces.
    fn step_stream(&mut self, sample: Option<Motion>, now_ms: u64, outputs: &mut Vec<Output>) {
        let Some(robot_ns) = self.clock.at_ns(now_ms) else { return };
        let Some(Run { trajectory, stream: Some(stream), stopping_since_ms, .. }) = &mut self.run else {
            return;
        };
        if stream.has_braked(robot_ns) {
            self.end(false);
            return;
        }
        if stopping_since_ms.is_some() {
            return;
        }
        let elapsed_s = stream.elapsed_s(robot_ns);
        let problem = match sample {
            None => Some("the arm's angles are no longer heard of".to_owned()),
            Some(sample) => {
                // Returns the expected position at a recent time.
                let ago = |k: u32| trajectory.motion((elapsed_s - f64::from(k) * 0.02).max(0.0)).joints_rad;
                let off = (0..=FOLLOW_STEPS)
                    .map(|k| off_rad(&sample.joints_rad, &ago(k)))
                    .fold(f64::INFINITY, f64::min);
                (off > FOLLOW_RAD).then(|| {
                    format!(
                        "the arm does not follow ({off:.2} rad off): does another goal run, is its speed scaled \
                         down, or is something in its way?"
                    )
                })
            }
        };
        if let Some(problem) = problem {
            self.notes.push(format!("{problem} It was stopped"));
            self.halt(now_ms, outputs);
            return;
        }
        match stream.renew(trajectory, &self.limits, now_ms, robot_ns) {
            Ok(Some(points)) => outputs.push(Output::Trajectory(stream.message(self.angles.names(), points))),
            Ok(None) => {}
            Err(Late) => {
                *stopping_since_ms = Some(now_ms);
                self.notes.push("this program was late: the arm has come to rest by itself".to_owned());
                return;
            }
        }
        let over_s = elapsed_s - trajectory.duration_s();
        let goal_rad = trajectory.goal_rad();
        if over_s >= 0.0 && sample.is_some_and(|sample| off_rad(&sample.joints_rad, &goal_rad) <= REACHED_RAD)
        {
            self.end(true);
        } else if over_s * 1000.0 > OVERDUE_MS as f64 {
            self.notes.push("the arm did not arrive at its pose".to_owned());
            self.end(false);
        }
    }

    /// Returns the result of the last trajectory, once.
    pub fn take_end(&mut self) -> Option<End> {
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
    use host_robot::{JOINTS, Joints, joints};
    use host_topics::message::JointTrajectoryPoint;

    const HOME: Joints = joints([0.0, 0.26, 3.1, -2.27, 0.0, 0.96, 1.57]);
    const GOAL: Joints = joints([0.0, 1.01, 3.1, -1.72, 0.0, 0.41, 1.57]);

    fn names() -> Vec<String> {
        (1..=7).map(|i| format!("joint_{i}")).collect()
    }

    fn limits() -> JointLimits {
        JointLimits {
            velocity_rad_s: [0.13963; JOINTS],
            acceleration_rad_s2: [0.43; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        }
    }

    fn angles(joints: Joints) -> JointState {
        JointState {
            name: names(),
            position: joints[..7].to_vec(),
            velocity: vec![0.0; 7],
            ..JointState::default()
        }
    }

    struct Rig {
        arm: ArmLink,
        outputs: Vec<Output>,
        now_ms: u64,
    }

    impl Rig {
        fn new(interface: ArmInterface) -> Self {
            let config = Ros2Config { arm: interface, ..Ros2Config::default() };
            let mut arm = ArmLink::new(&config, limits());
            arm.set_listened_to(true);
            arm.see(&angles(HOME), 0);
            Rig { arm, outputs: Vec::new(), now_ms: 0 }
        }

        fn start(&mut self) -> Result<(), String> {
            let here = self.arm.sample(self.now_ms).map_or(HOME, |sample| sample.joints_rad);
            let trajectory = Trajectory::through(&[here, GOAL], &[], &limits());
            self.arm.follow(Arc::new(trajectory), self.now_ms, &mut self.outputs)
        }

        fn answer(&mut self, goal: u32, answer: Answer) {
            self.arm.answer(goal, answer, self.now_ms, &mut self.outputs);
        }

        fn run(&mut self, ms: u64) -> Vec<Output> {
            for _ in 0..ms / 10 {
                self.now_ms += 10;
                self.arm.step(self.now_ms, &mut self.outputs);
            }
            std::mem::take(&mut self.outputs)
        }
    }

    #[test]
    fn a_goal_is_the_trajectory_from_its_start_to_rest_at_its_end() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        let [Output::Goal { goal: 1, trajectory }] = &rig.outputs[..] else { panic!("{:?}", rig.outputs) };
        assert_eq!(trajectory.joint_names, names());
        let points = &trajectory.points;
        assert!((points[0].positions[1] - HOME[1]).abs() < 0.02, "starts there");
        let last = points.last().unwrap();
        assert_eq!(last.velocities, [0.0; 7]);
        assert!((last.positions[1] - GOAL[1]).abs() < 1e-12);
        let times: Vec<f64> = points.iter().map(|p| p.time_from_start.seconds()).collect();
        assert!(times.windows(2).all(|t| t[1] > t[0]) && times[0] > 0.0);
        assert_eq!(trajectory.header, host_topics::message::Header::default(), "starts on arrival");
    }

    #[test]
    fn a_controller_has_taken_a_motion_when_its_server_says_so_or_when_it_wants_the_arm_elsewhere() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        assert!(!rig.arm.take_accepted());
        rig.answer(1, Answer::Accepted);
        assert!(rig.arm.take_accepted() && !rig.arm.take_accepted(), "once");

        let mut rig = Rig::new(ArmInterface::Topic);
        let tell = |rig: &mut Rig, joints: Joints| {
            let reference = JointTrajectoryPoint { positions: joints[..7].to_vec(), ..Default::default() };
            let state = ControllerState { joint_names: names(), reference, ..Default::default() };
            rig.arm.see_controller(&state, None, rig.now_ms);
        };
        // The controller holds the arm at a small distance from the reported angles.
        let mut held = HOME;
        held[1] += 0.01;
        tell(&mut rig, held);
        rig.start().unwrap();
        tell(&mut rig, held);
        assert!(!rig.arm.take_accepted(), "it has not begun");
        held[1] += 0.001;
        tell(&mut rig, held);
        assert!(rig.arm.take_accepted());
        tell(&mut rig, GOAL);
        assert!(!rig.arm.take_accepted(), "once");
    }

    #[test]
    fn cubics_through_the_points_are_the_planned_motion() {
        let mut from = HOME;
        from[3] += 0.8;
        let trajectory = Trajectory::through(&[from, HOME], &[], &limits());
        let sent = points(&trajectory);
        let mut before = (0.0, from[3], 0.0);
        for point in &sent {
            let (t0, p0, v0) = before;
            let (t1, p1, v1) = (point.time_from_start.seconds(), point.positions[3], point.velocities[3]);
            let h = t1 - t0;
            for k in 1..10 {
                let s = f64::from(k) / 10.0;
                let cubic = p0 * (1.0 + 2.0 * s) * (1.0 - s).powi(2)
                    + v0 * h * s * (1.0 - s).powi(2)
                    + p1 * s * s * (3.0 - 2.0 * s)
                    + v1 * h * s * s * (s - 1.0);
                let planned = trajectory.motion(t0 + s * h).joints_rad[3];
                assert!((cubic - planned).abs() < 1e-6, "{cubic} {planned} at {t0}");
            }
            before = (t1, p1, v1);
        }
    }

    #[test]
    fn nothing_is_sent_from_unknown_or_old_joints_or_to_nobody() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.run(600);
        assert!(rig.start().unwrap_err().contains("joint_1"), "too old");
        let mut part = angles(HOME);
        part.name.truncate(6);
        part.position.truncate(6);
        rig.arm.see(&part, rig.now_ms);
        let text = rig.start().unwrap_err();
        assert!(text.contains("joint_7") && !text.contains("joint_1,"), "{text}");
        // The gripper's joint is reported in a separate message, as by some drivers.
        let last = JointState { name: vec!["joint_7".into()], position: vec![1.57], ..JointState::default() };
        rig.arm.see(&last, rig.now_ms);
        rig.start().unwrap();

        let mut rig = Rig::new(ArmInterface::Action);
        rig.arm.set_listened_to(false);
        assert!(rig.start().unwrap_err().contains("no action server"));
        let mut broken = angles(HOME);
        broken.position[0] = f64::NAN;
        let mut fresh = Rig::new(ArmInterface::Action);
        fresh.arm.angles = Angles::new(&Ros2Config::default());
        fresh.arm.see(&broken, 0);
        assert!(fresh.start().unwrap_err().contains("joint_1"));
        assert!(rig.outputs.is_empty() && fresh.outputs.is_empty());
    }

    #[test]
    fn success_and_failure_are_reported_once_and_a_second_goal_waits() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        assert!(rig.start().unwrap_err().contains("another trajectory"));
        rig.answer(1, Answer::Accepted);
        assert_eq!(rig.arm.following(0), Following::Moving { elapsed_s: 0.0 });
        rig.answer(1, Answer::Succeeded);
        assert_eq!(rig.arm.take_end(), Some(End::Reached));
        assert_eq!(rig.arm.take_end(), None);
        rig.start().unwrap();
        rig.answer(2, Answer::Rejected);
        assert_eq!(rig.arm.take_end(), Some(End::Halted));
    }

    #[test]
    fn a_stop_cancels_until_the_controller_confirms() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        rig.answer(1, Answer::Accepted);
        rig.run(500);
        rig.arm.halt(rig.now_ms, &mut rig.outputs);
        assert_eq!(rig.outputs, [Output::Cancel { goal: 1 }]);
        rig.outputs.clear();
        assert_eq!(rig.run(450), [Output::Cancel { goal: 1 }, Output::Cancel { goal: 1 }]);
        assert!(rig.start().is_err(), "still braking");
        rig.answer(1, Answer::Ended("cancelled".to_owned()));
        assert_eq!(rig.arm.take_end(), Some(End::Halted));
        assert!(rig.run(1000).is_empty());
    }

    #[test]
    fn a_goal_without_an_answer_is_cancelled_and_so_is_one_accepted_too_late() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        rig.outputs.clear();
        assert!(rig.run(1000).is_empty());
        assert_eq!(rig.run(20), [Output::Cancel { goal: 1 }]);
        rig.run(6000);
        assert_eq!(rig.arm.take_end(), Some(End::Halted));
        rig.answer(1, Answer::Accepted);
        assert_eq!(rig.outputs, [Output::Cancel { goal: 1 }]);
        assert!(!rig.arm.take_notes().is_empty());
    }

    #[test]
    fn an_arm_of_three_joints_is_sent_three_of_each_and_arrives() {
        use host_topics::message::Time;
        let names: Vec<String> = ["lift", "shoulder", "wrist"].map(str::to_owned).to_vec();
        let (mut from, mut to) = ([0.0; JOINTS], [0.0; JOINTS]);
        from[..3].copy_from_slice(&[0.1, 0.2, 0.3]);
        to[..3].copy_from_slice(&[0.2, -0.1, 0.5]);
        let trajectory = Arc::new(Trajectory::through(&[from, to], &[], &limits()));
        for interface in [ArmInterface::Stream, ArmInterface::Topic, ArmInterface::Action] {
            let config = Ros2Config { arm: interface, joint_names: names.clone(), ..Ros2Config::default() };
            let mut arm = ArmLink::new(&config, limits());
            arm.set_listened_to(true);
            let (mut outputs, mut sent) = (Vec::new(), 0);
            for now_ms in 1..6000_u64 {
                if now_ms.is_multiple_of(10) {
                    let here = trajectory.motion(now_ms.saturating_sub(520) as f64 / 1000.0).joints_rad;
                    let stamp = Time::at_ns(1_700_000_000_000_000_000 + now_ms * 1_000_000);
                    let state = JointState {
                        header: Header { stamp, ..Header::default() },
                        name: names.clone(),
                        position: here[..3].to_vec(),
                        velocity: vec![0.0; 3],
                        ..JointState::default()
                    };
                    arm.see(&state, now_ms);
                }
                if now_ms == 500 {
                    arm.follow(Arc::clone(&trajectory), now_ms, &mut outputs).unwrap();
                }
                arm.step(now_ms, &mut outputs);
                for output in outputs.drain(..) {
                    let (Output::Trajectory(message) | Output::Goal { trajectory: message, .. }) = output
                    else {
                        panic!("{output:?}")
                    };
                    assert_eq!(message.joint_names, names);
                    assert!(message.points.iter().all(|p| p.positions.len() == 3 && p.velocities.len() == 3));
                    sent += 1;
                    if interface == ArmInterface::Action {
                        arm.answer(1, Answer::Accepted, now_ms, &mut Vec::new());
                    }
                }
            }
            if interface == ArmInterface::Action {
                arm.answer(1, Answer::Succeeded, 6000, &mut outputs);
            }
            assert_eq!(arm.take_end(), Some(End::Reached), "{interface:?}: {:?}", arm.take_notes());
            assert!(sent > 0, "{interface:?}");
        }
    }

    #[test]
    fn a_stop_between_goal_and_answer_cancels_again_when_it_is_accepted() {
        let mut rig = Rig::new(ArmInterface::Action);
        rig.start().unwrap();
        rig.arm.halt(0, &mut rig.outputs);
        rig.outputs.clear();
        rig.answer(1, Answer::Accepted);
        assert_eq!(rig.outputs, [Output::Cancel { goal: 1 }]);
    }

    #[test]
    fn on_the_topic_a_stop_brakes_from_where_the_arm_is_and_arrival_is_seen_in_its_angles() {
        let mut rig = Rig::new(ArmInterface::Topic);
        rig.start().unwrap();
        assert!(matches!(&rig.outputs[..], [Output::Trajectory(_)]));
        rig.outputs.clear();
        rig.run(1000);
        let mut moving = angles(HOME);
        moving.velocity[1] = 0.13;
        rig.arm.see(&moving, rig.now_ms);
        rig.arm.halt(rig.now_ms, &mut rig.outputs);
        let [Output::Trajectory(braking)] = &rig.outputs[..] else { panic!("{:?}", rig.outputs) };
        let last = braking.points.last().unwrap();
        assert!(last.velocities.iter().all(|v| *v == 0.0));
        assert!((last.positions[1] - HOME[1] - 0.13 * 0.13 / 2.0 / 0.43).abs() < 1e-9, "v²/2a further");
        rig.run(1000);
        assert_eq!(rig.arm.take_end(), Some(End::Halted));

        let mut rig = Rig::new(ArmInterface::Topic);
        rig.start().unwrap();
        rig.run(7000);
        rig.arm.see(&angles(GOAL), rig.now_ms);
        rig.run(100);
        assert_eq!(rig.arm.take_end(), Some(End::Reached));
    }
}
