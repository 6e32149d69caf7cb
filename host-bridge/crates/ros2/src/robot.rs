//! A robot on a ROS 2 graph. It decides which messages are sent at which time. It is sans-IO; `ros2::node` sends them.
//!
//! Safety on the graph: nothing is sent until the bridge is armed for the first time, which requires neutral.
//! While driving, the speed is repeated at a fixed rate.
//! After a stop, zero is repeated for a limited time.
//! Then the topic is silent, so that another source may drive.
//! A stop also cancels the arm's motion.

use std::sync::Arc;

use serde::Serialize;

use super::answer::Answer;
use super::arm::ArmLink;
use super::config::Ros2Config;
use super::gripper::{GripAnswer, GripperLink};
use super::sightings::Sightings;
use host_robot::{
    BaseConfig, BaseState, End, Following, Grip, GripEnd, JointLimits, Joints, Motion, Odometry, Part,
    Reading, Robot, Sighting, Trajectory, Twist,
};
use host_topics::message::{self as ros, JointState, JointTrajectory};

/// A bridge that is silent for this long counts as stopped.
const QUIET_MS: u64 = 250;

/// Maximum time between a command and its reported effect.
/// This time includes the network, the controller's cycle, and the way back.
const REACTION_MS: u64 = 60;

/// What goes out.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// The base's speed, decided now.
    Twist(Twist),
    /// An arm motion for the action server.
    Goal {
        /// Our number for it.
        goal: u32,
        /// The motion.
        trajectory: JointTrajectory,
    },
    /// The goal with this number must end.
    Cancel {
        /// Our number for it.
        goal: u32,
    },
    /// An arm motion, or a piece of one, for the controller's topic.
    Trajectory(JointTrajectory),
    /// A goal for the gripper.
    Grip {
        /// Our number for it.
        goal: u32,
        /// In the joint's own units.
        position: f64,
        /// Maximum force; `None` means the controller's default.
        effort: Option<f64>,
    },
    /// Requests the cancellation of this goal of the gripper.
    CancelGrip {
        /// Our number for it.
        goal: u32,
    },
}

/// Counters of sent and received messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Speeds.
    pub twists: u64,
    /// Arm motions.
    pub motions: u64,
    /// Requests to end a goal of arm or gripper, not counting those that are already waiting.
    pub cancels: u64,
    /// Number of speeds and pieces of arm motions that newer ones replaced before they were sent.
    /// This happens only in stalled Zenoh networks.
    pub replaced: u64,
    /// Goals that were cancelled or became too old before they were sent. This also happens only in stalled networks.
    pub withdrawn: u64,
    /// Messages and requests that could not be sent.
    pub failed: u64,
    /// Joint states heard.
    pub joint_states: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BaseCommand {
    /// Nothing is sent.
    Silent,
    /// The speed is repeated.
    Driving,
    /// Zero is repeated.
    Stopping { since_ms: u64 },
}

/// See the module.
#[derive(Clone, Debug)]
pub struct RosRobot {
    interval_ms: u64,
    stop_ms: u64,
    now_ms: u64,
    /// Whether the bridge has been armed at least once.
    allowed: bool,
    base: BaseCommand,
    wanted: Twist,
    /// Time of the bridge's last command.
    wanted_ms: u64,
    sent_ms: Option<u64>,
    arm: ArmLink,
    gripper: GripperLink,
    things: Sightings,
    outputs: Vec<Output>,
    limits: JointLimits,
    base_limits: BaseConfig,
    /// The newest odometry relative to the first known position, and its time of arrival.
    seen: Option<(BaseState, u64)>,
    first: Option<Odometry>,
    /// The base's speed at the last change of its command. It is stored until the odometry begins to follow.
    speed_then: Option<Twist>,
    /// It has.
    base_follows: bool,
}

impl RosRobot {
    /// Creates a robot that has not received any command.
    pub fn new(config: &Ros2Config, limits: JointLimits, base_limits: BaseConfig) -> Self {
        RosRobot {
            // The bridge repeats commands every 20 ms. They are delayed by at most one turn of its loop.
            interval_ms: (1000 / u64::from(config.rate_hz.max(1))).saturating_sub(2),
            stop_ms: config.stop_ms,
            now_ms: 0,
            allowed: false,
            base: BaseCommand::Silent,
            wanted: Twist::ZERO,
            wanted_ms: 0,
            sent_ms: None,
            arm: ArmLink::new(config, limits),
            gripper: GripperLink::new(config),
            things: Sightings::new(config),
            outputs: Vec::new(),
            limits,
            base_limits,
            seen: None,
            first: None,
            speed_then: None,
            base_follows: false,
        }
    }

    /// Sets the current time for all following calls.
    pub fn at(&mut self, now_ms: u64) {
        self.now_ms = self.now_ms.max(now_ms);
    }

    /// Angles that the robot reports.
    pub fn see(&mut self, state: &JointState) {
        self.see_from("", state);
    }

    /// Like [`Self::see`], for angles from a named publisher.
    pub fn see_from(&mut self, teller: &str, state: &JointState) {
        self.arm.see_from(teller, state, self.now_ms);
        self.gripper.see(state, self.now_ms);
    }

    /// Processes the report of the arm's controller about itself, and its speed scaling, if reported.
    pub fn see_controller(&mut self, state: &ros::ControllerState, scaling: Option<f64>) {
        self.arm.see_controller(state, scaling, self.now_ms);
    }

    /// Sets the number of other programs' active goals on the arm's action server.
    pub fn set_foreign_goals(&mut self, goals: usize) {
        self.arm.set_foreign_goals(goals);
    }

    /// Processes the robot's odometry. The first known position of the base is the scene's origin.
    pub fn see_base(&mut self, odometry: &ros::Odometry) {
        let position = odometry.pose.pose.position;
        let here = Odometry {
            x_m: position.x,
            y_m: position.y,
            heading_rad: odometry.pose.pose.orientation.yaw_rad(),
            path_m: 0.0,
            twist: Twist {
                linear_m_s: odometry.twist.twist.linear.x,
                angular_rad_s: odometry.twist.twist.angular.z,
            },
        };
        let values = [here.x_m, here.y_m, here.heading_rad, here.twist.linear_m_s, here.twist.angular_rad_s];
        if !values.iter().all(|value| value.is_finite()) {
            return;
        }
        if let Some(then) = self.speed_then
            && begins(then, here.twist, self.wanted)
        {
            (self.speed_then, self.base_follows) = (None, true);
        }
        let first = *self.first.get_or_insert(here);
        let (s, c) = first.heading_rad.sin_cos();
        let (x, y) = (here.x_m - first.x_m, here.y_m - first.y_m);
        let mut moved = Odometry { x_m: c * x + s * y, y_m: c * y - s * x, ..here };
        moved.heading_rad -= first.heading_rad;
        if let Some((last, _)) = self.seen {
            let step_m = (moved.x_m - last.odometry.x_m).hypot(moved.y_m - last.odometry.y_m);
            moved.path_m = last.odometry.path_m + step_m;
            // Continues the rotation without wrapping.
            let turn = moved.heading_rad - last.odometry.heading_rad;
            moved.heading_rad -= std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
        }
        let mut covariance = [[0.0; 3]; 3];
        let from = [0, 1, 5];
        for (row, values) in covariance.iter_mut().enumerate() {
            for (column, value) in values.iter_mut().enumerate() {
                *value = odometry.pose.covariance[from[row]][from[column]];
            }
        }
        self.seen = Some((BaseState { odometry: moved, covariance, wheels: None }, self.now_ms));
    }

    /// Sets the graph's current time in seconds, which determines the ages of poses.
    pub fn set_clock(&mut self, clock_s: f64) {
        self.things.at(clock_s);
    }

    /// Processes the pose of an object.
    pub fn see_thing(&mut self, topic: &str, pose: &ros::PoseStamped) {
        self.see_thing_from("", topic, pose);
    }

    /// Like [`Self::see_thing`], for a pose from a named publisher.
    pub fn see_thing_from(&mut self, writer: &str, topic: &str, pose: &ros::PoseStamped) {
        self.things.see(topic, pose, writer, self.now_ms);
    }

    /// Sets whether there is a subscriber for arm motions.
    pub fn set_arm_listened_to(&mut self, listened_to: bool) {
        self.arm.set_listened_to(listened_to);
    }

    /// An answer of the action server.
    pub fn answer(&mut self, goal: u32, answer: Answer) {
        self.arm.answer(goal, answer, self.now_ms, &mut self.outputs);
    }

    /// Sets the reason why the gripper's action has no server, or `None`.
    pub fn set_gripper_missing(&mut self, missing: Option<String>) {
        self.gripper.set_missing(missing);
    }

    /// An answer of the gripper's action server.
    pub fn grip_answer(&mut self, goal: u32, answer: GripAnswer) {
        self.gripper.answer(goal, answer, self.now_ms, &mut self.outputs);
    }

    /// Returns the messages to send, in order.
    pub fn take_outputs(&mut self) -> Vec<Output> {
        std::mem::take(&mut self.outputs)
    }

    fn stop_base(&mut self) {
        self.wanted = Twist::ZERO;
        self.base = BaseCommand::Stopping { since_ms: self.now_ms };
        self.send_speed();
    }

    fn send_speed(&mut self) {
        self.sent_ms = Some(self.now_ms);
        // Only the last decision in a turn of the loop counts, so that no two commands have the same stamp.
        self.outputs.retain(|output| !matches!(output, Output::Twist(_)));
        self.outputs.push(Output::Twist(self.wanted));
    }

    fn repeat(&mut self) {
        if let BaseCommand::Stopping { since_ms } = self.base
            && self.now_ms.saturating_sub(since_ms) > self.stop_ms
        {
            self.base = BaseCommand::Silent;
        }
        let due = self.sent_ms.is_none_or(|sent| self.now_ms.saturating_sub(sent) >= self.interval_ms);
        if self.base != BaseCommand::Silent && due {
            self.send_speed();
        }
    }
}

/// Returns whether a base has completed a tenth of a requested change in speed.
/// Odometry noise is always smaller than this tenth.
fn begins(then: Twist, now: Twist, wanted: Twist) -> bool {
    const SHARE: f64 = 0.1;
    let linear = (wanted.linear_m_s - then.linear_m_s, now.linear_m_s - then.linear_m_s);
    let angular = (wanted.angular_rad_s - then.angular_rad_s, now.angular_rad_s - then.angular_rad_s);
    let (asked, done) = if linear.0.abs() >= angular.0.abs() { linear } else { angular };
    asked != 0.0 && done / asked >= SHARE
}

impl Robot for RosRobot {
    fn hear(&mut self, now_ms: u64) {
        self.at(now_ms);
    }

    /// Performs repetitions, waits and time-outs, as described in the module documentation.
    fn step(&mut self, now_ms: u64) {
        self.at(now_ms);
        let quiet_ms = self.now_ms.saturating_sub(self.wanted_ms);
        if self.base == BaseCommand::Driving && quiet_ms >= QUIET_MS {
            // This program was paused, so its last command is outdated.
            self.stop_base();
        }
        self.repeat();
        self.arm.step(self.now_ms, &mut self.outputs);
        self.gripper.step(self.now_ms, &mut self.outputs);
    }

    fn arm(&self) -> Option<Reading<Motion>> {
        self.arm.reading(self.now_ms)
    }

    fn base(&self) -> Option<Reading<BaseState>> {
        let (value, at_ms) = self.seen?;
        Some(Reading { value, age_ms: self.now_ms.saturating_sub(at_ms) })
    }

    fn joint_limits(&self) -> &JointLimits {
        &self.limits
    }

    fn base_limits(&self) -> &BaseConfig {
        &self.base_limits
    }

    fn drive(&mut self, twist: Twist) {
        self.allowed = true;
        let sound = twist.linear_m_s.is_finite() && twist.angular_rad_s.is_finite();
        let twist = if sound { twist } else { Twist::ZERO };
        self.wanted_ms = self.now_ms;
        if twist != self.wanted {
            self.base_follows = false;
            self.speed_then = self.seen.map(|(base, _)| base.odometry.twist);
        }
        if twist == Twist::ZERO {
            // The base is already at rest. Another source of speeds must not be disturbed.
            if self.base == BaseCommand::Driving {
                self.stop_base();
            }
            return;
        }
        let changed = self.base != BaseCommand::Driving || twist != self.wanted;
        self.base = BaseCommand::Driving;
        self.wanted = twist;
        if changed {
            self.send_speed();
        }
        // The function `step` repeats the speed.
    }

    fn can_follow(&self) -> Result<(), String> {
        self.arm.can_follow(self.now_ms)
    }

    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.arm.follow(trajectory, self.now_ms, &mut self.outputs)
    }

    fn ahead_ms(&self) -> Result<u64, String> {
        self.arm.ahead_ms()
    }

    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        self.arm.follow_on(trajectory, from_s, self.now_ms, &mut self.outputs)
    }

    fn held_rad(&self) -> Option<Joints> {
        self.arm.held_rad(self.now_ms)
    }

    fn following(&self) -> Following {
        self.arm.following(self.now_ms)
    }

    fn take_end(&mut self) -> Option<End> {
        self.arm.take_end()
    }

    fn halt_arm(&mut self) {
        self.arm.halt(self.now_ms, &mut self.outputs);
    }

    fn halt(&mut self) {
        if self.allowed {
            self.stop_base();
        }
        self.halt_arm();
        self.halt_gripper();
    }

    fn opening_m(&self) -> Option<Reading<f64>> {
        self.gripper.opening_m(self.now_ms)
    }

    fn can_grip(&self) -> Result<(), String> {
        self.gripper.can_grip()
    }

    fn grip(&mut self, grip: Grip) -> Result<(), String> {
        self.gripper.grip(grip, self.now_ms, &mut self.outputs)
    }

    fn take_grip_end(&mut self) -> Option<GripEnd> {
        self.gripper.take_end()
    }

    fn halt_gripper(&mut self) {
        self.gripper.halt(self.now_ms, &mut self.outputs);
    }

    fn sighting(&self, topic: &str) -> Result<Reading<Sighting>, String> {
        self.things.get(topic, self.now_ms)
    }

    fn reaction_ms(&self) -> u64 {
        REACTION_MS
    }

    fn take_accepted(&mut self) -> Vec<Part> {
        let base = std::mem::take(&mut self.base_follows).then_some(Part::Base);
        let arm = self.arm.take_accepted().then_some(Part::Arm);
        base.into_iter().chain(arm).collect()
    }

    fn take_notes(&mut self) -> Vec<String> {
        let mut notes = self.arm.take_notes();
        notes.extend(self.gripper.take_notes());
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> JointLimits {
        use host_robot::JOINTS;
        JointLimits {
            velocity_rad_s: [0.14; JOINTS],
            acceleration_rad_s2: [0.43; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        }
    }

    const FORWARD: Twist = Twist { linear_m_s: 0.5, angular_rad_s: 0.0 };

    struct Rig {
        robot: RosRobot,
        now_ms: u64,
        /// Sends the bridge's command every 20 ms.
        bridge: Option<Twist>,
    }

    impl Rig {
        fn new() -> Self {
            let robot = RosRobot::new(&Ros2Config::default(), limits(), BaseConfig::default());
            Rig { robot, now_ms: 1000, bridge: None }
        }

        /// Returns time and speed of each sent command.
        fn run(&mut self, ms: u64) -> Vec<(u64, f64)> {
            let mut sent = Vec::new();
            for _ in 0..ms {
                self.now_ms += 1;
                self.robot.step(self.now_ms);
                if let Some(twist) = self.bridge.filter(|_| self.now_ms.is_multiple_of(20)) {
                    self.robot.drive(twist);
                }
                sent.extend(self.robot.take_outputs().into_iter().map(|output| match output {
                    Output::Twist(twist) => (self.now_ms, twist.linear_m_s),
                    other => panic!("{other:?}"),
                }));
            }
            sent
        }
    }

    #[test]
    fn nothing_is_sent_before_the_bridge_was_armed_not_even_by_a_stop() {
        let mut rig = Rig::new();
        rig.robot.halt();
        assert!(rig.run(2000).is_empty());
        // The bridge is armed and at rest, so nothing is sent yet.
        rig.bridge = Some(Twist::ZERO);
        assert!(rig.run(2000).is_empty());
    }

    #[test]
    fn a_speed_is_sent_at_once_and_then_50_times_per_second() {
        let mut rig = Rig::new();
        rig.bridge = Some(FORWARD);
        let sent = rig.run(2020);
        assert_eq!(sent[0], (1020, 0.5), "at once");
        assert!(sent.windows(2).all(|two| (15..=25).contains(&(two[1].0 - two[0].0))), "{sent:?}");
        assert!(sent.iter().all(|(_, speed)| *speed == 0.5));
        rig.bridge = Some(Twist { linear_m_s: 0.55, ..FORWARD });
        assert_eq!(rig.run(20).last().unwrap().1, 0.55, "a change does not wait");
    }

    #[test]
    fn after_a_stop_zero_is_repeated_for_a_second_and_then_there_is_silence() {
        for halted in [false, true] {
            let mut rig = Rig::new();
            rig.bridge = Some(FORWARD);
            rig.run(500);
            rig.bridge = Some(Twist::ZERO);
            if halted {
                rig.robot.halt();
            }
            let start_ms = rig.now_ms;
            let sent = rig.run(5000);
            let zeros: Vec<_> = sent.iter().filter(|(_, speed)| *speed == 0.0).collect();
            assert!(zeros[0].0 - start_ms <= 20, "{:?}", zeros[0]);
            assert!(zeros.len() >= 45, "{}", zeros.len());
            let last_ms = zeros.last().unwrap().0 - start_ms;
            assert!((950..=1060).contains(&last_ms), "{last_ms}");
            // After the first zero, only zeros are sent.
            let first = sent.iter().position(|(_, speed)| *speed == 0.0).unwrap();
            assert!(sent[first..].iter().all(|(_, speed)| *speed == 0.0));
        }
    }

    #[test]
    fn an_operators_stop_at_rest_is_said_aloud() {
        let mut rig = Rig::new();
        rig.bridge = Some(Twist::ZERO);
        rig.run(100);
        rig.robot.halt();
        assert!(rig.run(3000).len() >= 45);
        assert!(rig.run(3000).is_empty());
    }

    #[test]
    fn a_bridge_that_says_nothing_more_stops_the_base_within_a_quarter_second() {
        let mut rig = Rig::new();
        rig.bridge = Some(FORWARD);
        rig.run(500);
        rig.bridge = None;
        let start_ms = rig.now_ms;
        let sent = rig.run(2000);
        let zero = sent.iter().find(|(_, speed)| *speed == 0.0).unwrap();
        assert!(zero.0 - start_ms <= 251, "{zero:?}");
        // After a pause of the program, the first command is zero.
        rig.bridge = Some(FORWARD);
        rig.run(500);
        rig.bridge = None;
        rig.now_ms += 3000;
        assert_eq!(rig.run(1), [(rig.now_ms, 0.0)]);
    }

    fn odometry(linear_m_s: f64, angular_rad_s: f64) -> ros::Odometry {
        let twist = ros::Twist::from(Twist { linear_m_s, angular_rad_s });
        let twist = ros::TwistWithCovariance { twist, ..Default::default() };
        ros::Odometry { twist, ..Default::default() }
    }

    #[test]
    fn a_base_acts_on_a_speed_when_its_odometry_begins_to_follow_and_that_counts_once() {
        let mut robot = RosRobot::new(&Ros2Config::default(), limits(), BaseConfig::default());
        robot.drive(FORWARD);
        assert_eq!(robot.take_accepted(), [], "a base without odometry never tells");
        robot.see_base(&odometry(0.3, 0.0));
        assert_eq!(robot.take_accepted(), [], "what it had before is not known");
        robot.drive(Twist { linear_m_s: 0.0, angular_rad_s: 0.5 });
        // The test reports noise first, then a twentieth of the change, and then more than a tenth.
        for (turn, expected) in [(-0.01, vec![]), (0.025, vec![]), (0.06, vec![Part::Base]), (0.3, vec![])] {
            robot.see_base(&odometry(0.3, turn));
            assert_eq!(robot.take_accepted(), expected, "{turn} rad/s");
        }
        // The acceptance of a stop is detected too.
        robot.drive(Twist::ZERO);
        robot.see_base(&odometry(0.2, 0.2));
        assert_eq!(robot.take_accepted(), [Part::Base]);
    }

    #[test]
    fn speeds_that_are_no_numbers_stop() {
        let mut rig = Rig::new();
        rig.bridge = Some(FORWARD);
        rig.run(100);
        rig.bridge = Some(Twist { linear_m_s: f64::NAN, angular_rad_s: 0.0 });
        assert_eq!(rig.run(30).last().unwrap().1, 0.0);
    }
}
