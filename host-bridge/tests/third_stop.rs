//! Tests the third stop: how arm and base behave after this program dies or freezes, or its cable is cut.
//! The failures occur during each motion and while driving.
//! The tests run in virtual time with simulated controllers that follow the rules of ROS 2 Jazzy.
//!
//! joint_trajectory_controller (ros2_controllers, `joint_trajectory_controller.cpp`, `trajectory.cpp`):
//! the last message on the topic replaces all others. The controller samples it in its own time with cubics.
//! The controller holds the last point of the message.
//! diff_drive_controller (`diff_drive_controller.cpp`): it replaces a stamp of zero by the time of arrival.
//! The controller brakes if a command is older than 0.5 s.

use host_bridge::arm::gen3::COUNT;
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::{Director, Motions};
use host_bridge::base::{BaseConfig, Twist};
use host_bridge::config::Config;
use host_bridge::plan::Planner;
use host_bridge::robot::{
    BaseState, DVec3, Door as _, End, Following, JOINTS, JointLimits, Joints, Motion, MotionName, Reading,
    Report, Robot, Trajectory, brake,
};
use host_bridge::ros2::{Output, Ros2Config, RosRobot};
use host_bridge::scene::Scene;
use host_bridge::topics::message::{Header, JointState, JointTrajectory, Odometry, Time};
use std::sync::Arc;

/// The controllers' cycle.
const CYCLE_MS: u64 = 10;
/// Timeout of diff_drive_controller.
const BASE_TIMEOUT_MS: u64 = 500;
/// Maximum time from the death of the program until the arm begins to brake.
const ARM_LIMIT_MS: u64 = 300;
const BOOT_NS: i64 = 1_700_000_000_000_000_000;

fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

fn robot_ns(now_ms: u64) -> i64 {
    BOOT_NS + now_ms as i64 * 1_000_000
}

/// An arm that immediately moves to the positions of its controller.
struct Controller {
    message: Option<JointTrajectory>,
    joints: [f64; JOINTS],
    speed: [f64; JOINTS],
    /// Largest acceleration in one cycle, in rad/s².
    worst_rad_s2: f64,
}

impl Controller {
    fn cycle(&mut self, now_ms: u64) {
        let before = (self.joints, self.speed);
        if let Some(message) = &self.message {
            let at_s = (robot_ns(now_ms) - message.header.stamp.nanoseconds()) as f64 / 1e9;
            assert_ne!(message.header.stamp, Time::default(), "a stamp of zero would jump");
            let points = &message.points;
            let times: Vec<f64> = points.iter().map(|p| p.time_from_start.seconds()).collect();
            assert!(times[0] <= at_s, "a point in the past, or the controller would blend");
            let next = times.partition_point(|time_s| *time_s <= at_s);
            for joint in 0..COUNT {
                let (p, v) = (points[next - 1].positions[joint], points[next - 1].velocities[joint]);
                let Some(after) = points.get(next) else {
                    self.joints[joint] = p;
                    continue;
                };
                let h = times[next] - times[next - 1];
                let (q, w) = (after.positions[joint], after.velocities[joint]);
                let s = (at_s - times[next - 1]) / h;
                self.joints[joint] = p * (1.0 + 2.0 * s) * (1.0 - s).powi(2)
                    + v * h * s * (1.0 - s).powi(2)
                    + q * s * s * (3.0 - 2.0 * s)
                    + w * h * s * s * (s - 1.0);
            }
        }
        for joint in 0..COUNT {
            self.speed[joint] = (self.joints[joint] - before.0[joint]) * 1000.0 / CYCLE_MS as f64;
            let change = (self.speed[joint] - before.1[joint]).abs() * 1000.0 / CYCLE_MS as f64;
            self.worst_rad_s2 = self.worst_rad_s2.max(change);
        }
    }

    fn rests(&self) -> bool {
        self.speed.iter().all(|speed| speed.abs() < 1e-6)
    }

    fn state(&self, now_ms: u64) -> JointState {
        JointState {
            header: Header { stamp: Time::at_ns(robot_ns(now_ms) as u64), ..Header::default() },
            name: (1..=COUNT).map(|i| format!("joint_{i}")).collect(),
            position: self.joints[..COUNT].to_vec(),
            velocity: self.speed[..COUNT].to_vec(),
            effort: Vec::new(),
        }
    }
}

/// Failure of the program or the cable.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// kill -9, a permanent SIGSTOP, or a laptop that is switched off.
    Dead,
    /// Messages are lost in both directions.
    Cut,
    /// For 2 s, no message passes.
    CutForAWhile,
}

/// The program before a controller.
struct Rig {
    door: Director<RosRobot>,
    controller: Controller,
    now_ms: u64,
    ended: Option<bool>,
}

impl Rig {
    fn new(limits: JointLimits) -> Self {
        let robot = RosRobot::new(&Ros2Config::default(), limits, BaseConfig::default());
        let motions = Motions::paper();
        let joints = motions.pose("home").unwrap();
        let controller = Controller { message: None, joints, speed: [0.0; JOINTS], worst_rad_s2: 0.0 };
        let mut rig = Rig { door: Director::new(robot, motions), controller, now_ms: 1000, ended: None };
        rig.door.robot_mut().at(rig.now_ms);
        rig.door.robot_mut().set_arm_listened_to(true);
        rig.run(100, true, true);
        rig
    }

    /// `alive`: the program runs; `through`: messages pass in both directions.
    fn run(&mut self, ms: u64, alive: bool, through: bool) {
        for _ in 0..ms {
            self.now_ms += 1;
            let now_ms = self.now_ms;
            if now_ms.is_multiple_of(CYCLE_MS) {
                self.controller.cycle(now_ms);
                if alive && through {
                    let state = self.controller.state(now_ms);
                    self.door.robot_mut().at(now_ms);
                    self.door.robot_mut().see(&state);
                }
            }
            if alive && now_ms.is_multiple_of(2) {
                self.door.step(now_ms);
                for report in self.door.take_reports() {
                    if let Report::MotionEnded { reached, .. } = report {
                        self.ended = Some(reached);
                    }
                }
                for output in self.door.robot_mut().take_outputs() {
                    if let (Output::Trajectory(message), true) = (output, through) {
                        self.controller.message = Some(message);
                    }
                }
            }
        }
    }

    fn start(&mut self, motion: &str) {
        self.ended = None;
        self.door.start_motion(&MotionName::from(motion)).unwrap();
    }
}

const MOTIONS: [&str; 6] =
    ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "random-top"];

/// Duration of each motion, starting from the end of the previous one.
fn durations_ms(limits: JointLimits) -> Vec<u64> {
    let mut rig = Rig::new(limits);
    let mut durations = Vec::new();
    for motion in MOTIONS {
        rig.start(motion);
        let from_ms = rig.now_ms;
        while rig.ended.is_none() {
            rig.run(10, true, true);
            assert!(rig.now_ms - from_ms < 60_000, "{motion}");
        }
        assert_eq!(rig.ended, Some(true), "{motion}");
        rig.run(500, true, true);
        durations.push(rig.now_ms - 500 - from_ms);
    }
    durations
}

#[test]
fn a_dead_program_or_a_cut_cable_is_an_arm_at_rest_without_a_jerk_at_every_moment_of_every_motion() {
    let config = Config::default();
    let mut jerk_limited = config.clone();
    jerk_limited.arm.jerk_limited = true;
    let moments = if is_full() { 10 } else { 2 };
    for (name, limits) in [("", config.arm_limits()), (", jerk-limited", jerk_limited.arm_limits())] {
        let braking_ms = (brake::longest_s(&limits) * 1000.0).ceil() as u64;
        let (mut worst_ms, mut count) = (0, 0);
        let durations = durations_ms(limits);
        for (n, motion) in MOTIONS.iter().enumerate() {
            for moment in 0..moments {
                for fault in [Fault::Dead, Fault::Cut, Fault::CutForAWhile] {
                    let mut rig = Rig::new(limits);
                    // The arm is not at its goal yet.
                    rig.controller.joints[1] += 0.2;
                    rig.run(200, true, true);
                    rig.start(motion);
                    rig.run(durations[n].min(13_000) * (2 * moment + 1) / (2 * moments), true, true);
                    let (from_ms, mut moved_ms) = (rig.now_ms, rig.now_ms);
                    let away_ms = if fault == Fault::CutForAWhile { 2000 } else { 4000 };
                    for _ in 0..away_ms / CYCLE_MS {
                        rig.run(CYCLE_MS, fault != Fault::Dead, false);
                        if !rig.controller.rests() {
                            moved_ms = rig.now_ms;
                        }
                    }
                    // The cable is connected again, and the cancelled motion does not continue.
                    let there = rig.controller.joints;
                    if fault == Fault::CutForAWhile {
                        rig.run(2000, true, true);
                        assert_eq!(rig.controller.joints, there, "{motion} goes on by itself");
                    }
                    assert!(rig.controller.rests());
                    let took_ms = moved_ms - from_ms;
                    assert!(
                        took_ms <= ARM_LIMIT_MS + braking_ms,
                        "{motion}, {moment}, {fault:?}: {took_ms} ms"
                    );
                    worst_ms = worst_ms.max(took_ms);
                    count += 1;
                    let most = limits.acceleration_rad_s2.iter().copied().fold(0.0, f64::max);
                    assert!(rig.controller.worst_rad_s2 < 1.15 * most, "{motion}, {moment}, {fault:?}");
                }
            }
        }
        println!(
            "row: v program dead, frozen or cut off: arm at rest{name} | {count} | {worst_ms} ms | {ARM_LIMIT_MS} ms + {braking_ms} ms of \
             braking"
        );
    }
}

#[test]
fn a_hand_moves_the_tool_in_pieces_and_a_clutch_or_a_dead_program_is_an_arm_at_rest_without_a_jerk() {
    const TOOL_M_S: DVec3 = DVec3::new(0.06, -0.03, 0.02);
    let config = Config::default();
    let mut smooth = config.clone();
    smooth.arm.jerk_limited = true;
    for (name, limits) in [("", config.arm_limits()), (", jerk-limited", smooth.arm_limits())] {
        let braking_ms = (brake::longest_s(&limits) * 1000.0).ceil() as u64;
        let most = limits.acceleration_rad_s2.iter().copied().fold(0.0, f64::max);
        let (mut dead_ms, mut open_ms, mut brakes_ms) = (0, 0, 0);
        for moment_ms in (300..2300).step_by(if is_full() { 50 } else { 400 }) {
            for dies in [true, false] {
                let mut rig = Rig::new(limits);
                let jog = |rig: &mut Rig, ms: u64| {
                    for _ in 0..ms / 20 {
                        rig.door.drive(Twist::ZERO);
                        rig.door.jog(TOOL_M_S);
                        rig.run(20, true, true);
                    }
                };
                jog(&mut rig, moment_ms);
                assert!(!rig.controller.rests(), "{moment_ms}");
                let (from_ms, mut last) = (rig.now_ms, rig.controller.speed);
                let (mut slower_ms, mut moved_ms) = (None, rig.now_ms);
                if !dies {
                    // The bridge also halts where the clutch opens.
                    rig.door.halt();
                }
                while rig.now_ms < from_ms + 3000 {
                    rig.run(CYCLE_MS, !dies, !dies);
                    let size = |speed: &[f64; JOINTS]| speed.iter().map(|v| v * v).sum::<f64>();
                    if size(&rig.controller.speed) < size(&last) {
                        slower_ms.get_or_insert(rig.now_ms - from_ms);
                    }
                    last = rig.controller.speed;
                    if !rig.controller.rests() {
                        moved_ms = rig.now_ms;
                    }
                }
                let took_ms = moved_ms - from_ms;
                assert!(rig.controller.rests() && rig.controller.worst_rad_s2 < 1.15 * most, "{moment_ms}");
                if dies {
                    dead_ms = dead_ms.max(took_ms);
                } else {
                    open_ms = open_ms.max(took_ms);
                    brakes_ms = brakes_ms.max(slower_ms.unwrap_or(u64::MAX));
                }
            }
        }
        // With limited jerk, a joint that still gains speed must first lose its acceleration.
        let loses_ms = (0..JOINTS).map(|i| limits.acceleration_rad_s2[i] / limits.jerk_rad_s3[i] * 1000.0);
        let brakes_max_ms = 50 + loses_ms.fold(0.0, f64::max) as u64;
        println!(
            "row: v jogging, the clutch opens: the arm brakes{name} | | {brakes_ms} ms, at rest after {open_ms} ms | {brakes_max_ms} ms\n\
             row: v jogging, program dead: arm at rest{name} | | {dead_ms} ms | {ARM_LIMIT_MS} ms + {braking_ms} ms of braking"
        );
        assert!(brakes_ms <= brakes_max_ms && open_ms <= 50 + braking_ms, "{brakes_ms} {open_ms}");
        assert!(dead_ms <= ARM_LIMIT_MS + braking_ms, "{dead_ms}");
    }
}

/// Like a robot on a graph: its messages wait until this program reads them.
struct Waiting {
    robot: RosRobot,
    said: Vec<JointState>,
}

impl Robot for Waiting {
    fn hear(&mut self, now_ms: u64) {
        self.robot.hear(now_ms);
        for state in self.said.drain(..) {
            self.robot.see(&state);
        }
        self.robot.see_base(&Odometry::default());
    }
    fn step(&mut self, now_ms: u64) {
        self.robot.step(now_ms);
    }
    fn arm(&self) -> Option<Reading<Motion>> {
        self.robot.arm()
    }
    fn held_rad(&self) -> Option<Joints> {
        self.robot.held_rad()
    }
    fn base(&self) -> Option<Reading<BaseState>> {
        self.robot.base()
    }
    fn joint_limits(&self) -> &JointLimits {
        self.robot.joint_limits()
    }
    fn base_limits(&self) -> &BaseConfig {
        self.robot.base_limits()
    }
    fn drive(&mut self, twist: Twist) {
        self.robot.drive(twist);
    }
    fn can_follow(&self) -> Result<(), String> {
        self.robot.can_follow()
    }
    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.robot.follow(trajectory)
    }
    fn ahead_ms(&self) -> Result<u64, String> {
        self.robot.ahead_ms()
    }
    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        self.robot.follow_on(trajectory, from_s)
    }
    fn following(&self) -> Following {
        self.robot.following()
    }
    fn take_end(&mut self) -> Option<End> {
        self.robot.take_end()
    }
    fn halt_arm(&mut self) {
        self.robot.halt_arm();
    }
    fn halt(&mut self) {
        self.robot.halt();
    }
    fn reaction_ms(&self) -> u64 {
        self.robot.reaction_ms()
    }
}

#[test]
fn in_a_scene_a_pause_of_this_program_does_not_set_the_robots_clock_ahead_and_the_arm_brakes_as_soon_after_it()
 {
    let limits = Config::default().arm_limits();
    for pause_ms in [10, 100, 200] {
        let robot = RosRobot::new(&Ros2Config::default(), limits, BaseConfig::default());
        let motions = Motions::paper();
        let joints = motions.pose("home").unwrap();
        let mut controller = Controller { message: None, joints, speed: [0.0; JOINTS], worst_rad_s2: 0.0 };
        let planner = Arc::new(Planner::new(SerialArm::gen3(), Scene::default()).unwrap());
        let mut door = Director::in_scene(Waiting { robot, said: Vec::new() }, motions, planner);
        door.robot_mut().robot.set_arm_listened_to(true);
        let mut now_ms = 1000;
        door.robot_mut().robot.at(now_ms);
        door.step(now_ms);
        let cycle = |door: &mut Director<Waiting>, controller: &mut Controller, now_ms: u64, alive: bool| {
            controller.cycle(now_ms);
            door.robot_mut().said.push(controller.state(now_ms));
            if alive {
                door.step(now_ms);
                for output in door.robot_mut().robot.take_outputs() {
                    if let Output::Trajectory(message) = output {
                        controller.message = Some(message);
                    }
                }
            }
        };
        for k in 0..150 {
            now_ms += CYCLE_MS;
            cycle(&mut door, &mut controller, now_ms, true);
            if k > 20 && k % 2 == 0 {
                door.drive(Twist::ZERO);
                door.jog(DVec3::new(0.06, -0.03, 0.02));
            }
        }
        assert!(!controller.rests(), "the tool moves");
        for _ in 0..pause_ms / CYCLE_MS - 1 {
            now_ms += CYCLE_MS;
            cycle(&mut door, &mut controller, now_ms, false);
        }
        // The clock is estimated from the messages of the last two seconds.
        // The pause therefore still has an effect here.
        for k in 0..50 {
            now_ms += CYCLE_MS;
            cycle(&mut door, &mut controller, now_ms, true);
            if k % 2 == 0 {
                door.drive(Twist::ZERO);
                door.jog(DVec3::new(0.06, -0.03, 0.02));
            }
        }
        assert!(!controller.rests(), "{pause_ms}: the tool moves on");
        // The bridge also halts where the clutch opens.
        door.halt();
        let size = |speed: &[f64; JOINTS]| speed.iter().map(|v| v * v).sum::<f64>();
        let (from_ms, mut last) = (now_ms, size(&controller.speed));
        loop {
            now_ms += CYCLE_MS;
            cycle(&mut door, &mut controller, now_ms, true);
            let now = size(&controller.speed);
            if now < last - 1e-9 {
                break;
            }
            last = now;
        }
        println!(
            "after a pause of {pause_ms} ms: the arm brakes {} ms after the clutch opens",
            now_ms - from_ms
        );
        assert!(now_ms - from_ms <= 50, "{pause_ms}: {} ms", now_ms - from_ms);
    }
}

#[test]
fn a_dead_program_is_a_base_at_rest_after_the_robots_timeout() {
    let (mut worst_ms, mut count) = (0, 0);
    for fault in [Fault::Dead, Fault::Cut] {
        for dies_ms in 0..if is_full() { 400 } else { 40 } {
            let limits = Config::default().arm_limits();
            let mut robot = RosRobot::new(&Ros2Config::default(), limits, BaseConfig::default());
            let dies_ms = 2000 + dies_ms;
            let (mut speed, mut command, mut rests_ms) = (0.0, None, 0);
            for now_ms in 1000..4000 {
                let alive = now_ms < dies_ms || fault == Fault::Cut;
                if alive {
                    host_bridge::robot::Robot::step(&mut robot, now_ms);
                    if now_ms.is_multiple_of(20) {
                        let twist = Twist { linear_m_s: 0.5, angular_rad_s: 0.0 };
                        host_bridge::robot::Robot::drive(&mut robot, twist);
                    }
                }
                for output in robot.take_outputs() {
                    if let (Output::Twist(twist), true) = (output, now_ms < dies_ms) {
                        command = Some((now_ms, twist.linear_m_s));
                    }
                }
                if now_ms.is_multiple_of(CYCLE_MS) {
                    speed =
                        command.map_or(0.0, |(at, v)| if now_ms - at > BASE_TIMEOUT_MS { 0.0 } else { v });
                    if speed != 0.0 {
                        rests_ms = now_ms + CYCLE_MS;
                    }
                }
            }
            assert_eq!(speed, 0.0);
            worst_ms = worst_ms.max(rests_ms - dies_ms);
            count += 1;
        }
    }
    println!(
        "row: v program dead or cut off: base at rest | {count} | {worst_ms} ms | {BASE_TIMEOUT_MS} ms + {CYCLE_MS} ms of cycle"
    );
    assert!(worst_ms <= BASE_TIMEOUT_MS + CYCLE_MS, "{worst_ms} ms");
}

#[test]
fn a_change_of_pace_reaches_the_controller_without_a_jerk_and_the_program_may_die_at_any_moment_of_it() {
    let limits = Config::default().arm_limits();
    let braking_ms = (brake::longest_s(&limits) * 1000.0).ceil() as u64;
    let most = limits.acceleration_rad_s2.iter().copied().fold(0.0, f64::max);
    let fastest = |rig: &Rig| rig.controller.speed.iter().fold(0.0_f64, |most, speed| most.max(speed.abs()));
    // From home, the arm moves to the pose in 5.7 s.
    let started = || {
        let mut rig = Rig::new(limits);
        rig.start("pick-up");
        rig.run(1500, true, true);
        rig
    };
    let mut rig = started();
    let full = fastest(&rig);
    rig.door.pace(0.5);
    rig.run(400, true, true);
    let half = fastest(&rig);
    assert!((half - 0.5 * full).abs() < 0.01 * full, "{half} {full}");
    rig.door.pace(0.81);
    while rig.ended.is_none() {
        rig.run(10, true, true);
        assert!(rig.now_ms < 30_000);
    }
    let there = Motions::paper().pose("pick-up").unwrap();
    assert_eq!(rig.ended, Some(true));
    assert!(rig.controller.joints.iter().zip(there).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!(rig.controller.worst_rad_s2 < 1.15 * most, "{}", rig.controller.worst_rad_s2);
    println!("{full:.3} rad/s, then {half:.3}; rests after {} ms", rig.now_ms - 1100);

    let mut worst_ms = 0;
    for after_ms in (0..300).step_by(if is_full() { 10 } else { 60 }) {
        let mut rig = started();
        rig.door.pace(0.3);
        rig.run(after_ms, true, true);
        let (from_ms, mut moved_ms) = (rig.now_ms, rig.now_ms);
        for _ in 0..200 {
            rig.run(CYCLE_MS, false, false);
            if !rig.controller.rests() {
                moved_ms = rig.now_ms;
            }
        }
        assert!(rig.controller.worst_rad_s2 < 1.15 * most, "{after_ms}");
        worst_ms = worst_ms.max(moved_ms - from_ms);
    }
    println!("dead in a change of pace: at rest after {worst_ms} ms at most");
    assert!(worst_ms <= ARM_LIMIT_MS + braking_ms);
}
