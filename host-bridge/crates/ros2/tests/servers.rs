//! Tests two action servers, late and forged answers, and false joint states. A stop must end every motion.
//!
//! Each server executes accepted goals, like joint_trajectory_controller, until they finish or are cancelled.
//! The answers may be late, and other participants' messages may arrive in between.

use std::sync::Arc;

use host_robot::{Grip, JOINTS, JointLimits, Joints, Random, Trajectory, joints};
use host_ros2::answer::Answer;
use host_ros2::arm::ArmLink;
use host_ros2::gripper::{GripAnswer, GripperLink};
use host_ros2::{ArmInterface, Output, Ros2Config};
use host_topics::message::JointState;

const HOME: Joints = joints([0.0, 0.26, 3.1, -2.27, 0.0, 0.96, 1.57]);
const GOAL: Joints = joints([0.0, 1.01, 3.1, -1.72, 0.0, 0.41, 1.57]);
/// Time from the stop, or from the later acceptance, to the cancellation.
const LIMIT_MS: u64 = 300;

fn limits() -> JointLimits {
    JointLimits {
        velocity_rad_s: [0.13963; JOINTS],
        acceleration_rad_s2: [0.43; JOINTS],
        jerk_rad_s3: [f64::INFINITY; JOINTS],
    }
}

fn angles(joints: Joints) -> JointState {
    JointState {
        name: (1..=7).map(|i| format!("joint_{i}")).collect(),
        position: joints[..7].to_vec(),
        velocity: vec![0.0; 7],
        ..JointState::default()
    }
}

/// A goal on one server.
struct Executing {
    goal: u32,
    since_ms: u64,
    cancelled_ms: Option<u64>,
}

/// The possible answers of one kind of action server, and of a forger.
struct Words<A> {
    accepted: A,
    rejected: A,
    done: A,
    cancelled: A,
    forged: [A; 5],
}

/// Two servers that execute accepted goals, and a forger.
struct Servers<A> {
    words: Words<A>,
    takes_ms: u64,
    /// Time, sender (2 = the forger), goal and content of each answer.
    answers: Vec<(u64, usize, u32, A)>,
    running: Vec<Executing>,
}

impl<A: Clone + PartialEq> Servers<A> {
    fn new(words: Words<A>, takes_ms: u64) -> Self {
        Servers { words, takes_ms, answers: Vec::new(), running: Vec::new() }
    }

    /// Each server accepts the goal, rejects it or is silent, with or without delay.
    /// The forger sends any message.
    fn ask(&mut self, goal: u32, now_ms: u64, random: &mut Random) {
        for server in 0..2 {
            let at_ms = now_ms + [1, 30, 1200, 6000][random.below(4)];
            match random.below(3) {
                0 => self.answers.push((at_ms, server, goal, self.words.rejected.clone())),
                1 => self.answers.push((at_ms, server, goal, self.words.accepted.clone())),
                _ => {}
            }
        }
        let at_ms = now_ms + random.below(3000) as u64;
        let forged = self.words.forged[random.below(self.words.forged.len())].clone();
        self.answers.push((at_ms, 2, goal, forged));
    }

    fn cancel(&mut self, goal: u32, now_ms: u64) {
        for it in self.running.iter_mut().filter(|it| it.goal == goal && it.cancelled_ms.is_none()) {
            it.cancelled_ms = Some(now_ms);
            self.answers.push((now_ms + 5, 0, goal, self.words.cancelled.clone()));
        }
    }

    /// Returns the answers that are due, with their goals.
    fn take_due(&mut self, now_ms: u64) -> Vec<(u32, A)> {
        let (due, later): (Vec<_>, Vec<_>) = self.answers.drain(..).partition(|answer| answer.0 <= now_ms);
        self.answers = later;
        for (_, server, goal, answer) in &due {
            if *server < 2 && *answer == self.words.accepted {
                self.running.push(Executing { goal: *goal, since_ms: now_ms, cancelled_ms: None });
                self.answers.push((now_ms + self.takes_ms, *server, *goal, self.words.done.clone()));
            }
        }
        due.into_iter().map(|(_, _, goal, answer)| (goal, answer)).collect()
    }

    /// Returns how long a goal has run since the stop without a cancellation.
    fn open_ms(&self, stopped_ms: Option<u64>, now_ms: u64) -> u64 {
        let Some(stopped_ms) = stopped_ms else { return 0 };
        let runs = self.running.iter().filter(|it| now_ms < it.since_ms + self.takes_ms);
        let open = runs.filter(|it| it.cancelled_ms.is_none());
        open.map(|it| now_ms - stopped_ms.max(it.since_ms)).max().unwrap_or(0)
    }
}

/// Runs random sessions of 16 s.
fn sessions() -> u64 {
    if std::env::var_os("BIMANUAL_FULL").is_some() { 20_000 } else { 300 }
}

#[test]
fn whatever_two_servers_and_a_forger_answer_a_stop_ends_every_motion() {
    let (mut worst_ms, mut stops, mut motions) = (0, 0, 0);
    for seed in 0..sessions() {
        let mut random = Random::new(seed);
        let config = Ros2Config { arm: ArmInterface::Action, ..Ros2Config::default() };
        let mut arm = ArmLink::new(&config, limits());
        arm.set_listened_to(true);
        let trajectory = Arc::new(Trajectory::through(&[HOME, GOAL], &[], &limits()));
        let words = Words {
            accepted: Answer::Accepted,
            rejected: Answer::Rejected,
            done: Answer::Succeeded,
            cancelled: Answer::Ended("cancelled".to_owned()),
            forged: [
                Answer::Accepted,
                Answer::Rejected,
                Answer::Succeeded,
                Answer::Ended("forged".to_owned()),
                Answer::Progress(1e9),
            ],
        };
        let mut servers = Servers::new(words, (trajectory.duration_s() * 1000.0) as u64);
        let mut outputs = Vec::new();
        let mut stopped_ms = None;
        let stop_ms = 500 + random.below(9000) as u64;
        for now_ms in 1..16_000_u64 {
            if now_ms % 10 == 0 {
                arm.see(&angles(HOME), now_ms);
            }
            if now_ms % 700 == 0 && now_ms < stop_ms {
                // The arm refuses the trajectory while another one is running.
                let _ = arm.follow(Arc::clone(&trajectory), now_ms, &mut outputs);
            }
            if now_ms == stop_ms {
                arm.halt(now_ms, &mut outputs);
                stopped_ms = Some(now_ms);
                stops += 1;
            }
            arm.step(now_ms, &mut outputs);
            for output in outputs.drain(..) {
                match output {
                    Output::Goal { goal, .. } => servers.ask(goal, now_ms, &mut random),
                    Output::Cancel { goal } => servers.cancel(goal, now_ms),
                    other => panic!("{other:?}"),
                }
            }
            for (goal, answer) in servers.take_due(now_ms) {
                arm.answer(goal, answer, now_ms, &mut outputs);
            }
            arm.take_end();
            // Everything that moves after a stop must have been cancelled.
            let open_ms = servers.open_ms(stopped_ms, now_ms);
            assert!(open_ms <= LIMIT_MS, "seed {seed}: a goal runs {open_ms} ms after the stop");
            worst_ms = worst_ms.max(open_ms);
        }
        motions += servers.running.len() as u64;
    }
    println!(
        "row: v two servers, late and forged replies: a stop cancels | {stops} stops, {motions} motions | {worst_ms} ms | {LIMIT_MS} ms"
    );
    assert!(motions > sessions());
}

/// Duration of a grip in this test.
const GRIP_TAKES_MS: u64 = 3000;

fn done(reached: bool) -> GripAnswer {
    GripAnswer::Done { position: 0.3, stalled: !reached, reached, status: "forged, perhaps".to_owned() }
}

#[test]
fn whatever_two_servers_and_a_forger_answer_a_stop_ends_every_motion_of_the_gripper() {
    let (mut worst_ms, mut stops, mut motions, mut doubted) = (0, 0, 0, 0);
    for seed in 0..sessions() {
        let mut random = Random::new(seed);
        let mut gripper = GripperLink::new(&Ros2Config::default());
        gripper.set_missing(None);
        let words = Words {
            accepted: GripAnswer::Accepted,
            rejected: GripAnswer::Rejected,
            done: done(true),
            cancelled: done(false),
            forged: [
                GripAnswer::Accepted,
                GripAnswer::Rejected,
                done(true),
                done(false),
                GripAnswer::At(f64::NAN),
            ],
        };
        let mut servers = Servers::new(words, GRIP_TAKES_MS);
        let mut outputs = Vec::new();
        let mut stopped_ms = None;
        let stop_ms = 500 + random.below(9000) as u64;
        for now_ms in 1..16_000_u64 {
            if now_ms % 700 == 0 && now_ms < stop_ms {
                let opening_m = [0.0, 0.085][random.below(2)];
                // The goal is refused while another one may be running.
                let _ =
                    gripper.grip(Grip { opening_m, effort_n: None, between_m: None }, now_ms, &mut outputs);
            }
            if now_ms == stop_ms {
                gripper.halt(now_ms, &mut outputs);
                stopped_ms = Some(now_ms);
                stops += 1;
            }
            gripper.step(now_ms, &mut outputs);
            for output in outputs.drain(..) {
                match output {
                    Output::Grip { goal, .. } => {
                        assert!(stopped_ms.is_none(), "seed {seed}: a stop sends no goal");
                        servers.ask(goal, now_ms, &mut random);
                    }
                    Output::CancelGrip { goal } => servers.cancel(goal, now_ms),
                    other => panic!("{other:?}"),
                }
            }
            for (goal, answer) in servers.take_due(now_ms) {
                gripper.answer(goal, answer, now_ms, &mut outputs);
            }
            doubted += usize::from(gripper.take_end().is_some() && !servers.running.is_empty());
            let open_ms = servers.open_ms(stopped_ms, now_ms);
            assert!(
                open_ms <= LIMIT_MS,
                "seed {seed}: a goal of the gripper runs {open_ms} ms after the stop"
            );
            worst_ms = worst_ms.max(open_ms);
        }
        motions += servers.running.len() as u64;
    }
    println!(
        "row: v two servers, late and forged replies: a stop cancels the gripper | {stops} stops, {motions} motions | {worst_ms} ms | {LIMIT_MS} ms"
    );
    assert!(motions > sessions() && doubted > 0, "{motions} motions, {doubted}");
}

#[test]
fn lying_joint_states_start_nothing_and_end_what_moves() {
    let (mut count, mut worst_ms) = (0, 0);
    type Lie = fn(&mut JointState);
    let lies: [(&str, &str, Lie, &str); 4] = [
        ("a jump", "robot", |state| state.position[1] += 1.5, "jumped"),
        ("far away", "robot", |state| state.position[0] = 1e6, "is told to"),
        ("another writer", "liar", |_| {}, "writers"),
        ("another writer, elsewhere", "liar", |state| state.position[3] -= 0.5, "writers"),
    ];
    for interface in [ArmInterface::Action, ArmInterface::Topic] {
        for (what, teller, lie, named) in lies {
            for at_ms in (100..4000).step_by(300) {
                let config = Ros2Config { arm: interface, ..Ros2Config::default() };
                let mut arm = ArmLink::new(&config, limits());
                arm.set_listened_to(true);
                let trajectory = Arc::new(Trajectory::through(&[HOME, GOAL], &[], &limits()));
                let mut outputs = Vec::new();
                let mut ended_ms = None;
                for now_ms in 0..6000_u64 {
                    if now_ms % 10 == 0 {
                        let here = trajectory.motion(now_ms.saturating_sub(50) as f64 / 1000.0).joints_rad;
                        arm.see_from("robot", &angles(here), now_ms);
                    }
                    if now_ms >= at_ms && now_ms % 20 == 5 {
                        let mut state = angles(HOME);
                        lie(&mut state);
                        arm.see_from(teller, &state, now_ms);
                    }
                    if now_ms == 50 {
                        arm.follow(Arc::clone(&trajectory), now_ms, &mut outputs).unwrap();
                        if interface == ArmInterface::Action {
                            arm.answer(1, Answer::Accepted, now_ms, &mut outputs);
                        }
                        outputs.clear();
                    }
                    arm.step(now_ms, &mut outputs);
                    if now_ms > 50 && !outputs.is_empty() && ended_ms.is_none() {
                        ended_ms = Some(now_ms);
                    }
                    outputs.clear();
                }
                let ended_ms = ended_ms.unwrap_or_else(|| panic!("{what} at {at_ms} ms: it moves on"));
                assert!(ended_ms >= at_ms, "{what}");
                worst_ms = worst_ms.max(ended_ms - at_ms);
                let told = arm.take_notes().join("\n");
                assert!(told.contains(named), "{what}: {told}");
                assert!(arm.follow(trajectory, 6000, &mut outputs).is_err(), "{what}");
                count += 1;
            }
        }
    }
    println!("row: v lying joint states: the arm is stopped | {count} | {worst_ms} ms | {LIMIT_MS} ms");
    assert!(worst_ms <= LIMIT_MS);
}

#[test]
fn forty_thousand_joint_names_take_no_time() {
    let mut arm = ArmLink::new(&Ros2Config::default(), limits());
    let many = 40_000;
    let state = JointState {
        name: (0..many).map(|n| format!("joint_{n}")).collect(),
        position: vec![0.1; many],
        velocity: vec![0.0; many],
        ..JointState::default()
    };
    let began = std::time::Instant::now();
    for now_ms in 0..100 {
        arm.see(&state, now_ms);
    }
    let per_message_ms = began.elapsed().as_millis() as u64 / 100;
    println!("row: 40,000 joint names in a message | 100 | {per_message_ms} ms | 5 ms");
    // With quadratic complexity, this would take seconds on any machine.
    assert!(per_message_ms < 100, "{per_message_ms} ms");
}
