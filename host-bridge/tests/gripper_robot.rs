//! Tests a gripper on the ROS 2 graph that does not execute its commands.
//! Also tests halts during a motion of several steps.
//! In both cases, the remaining steps must be cancelled and reported.
//! The tests run in virtual time, with a robot whose replies the test provides.

use host_bridge::arm::Director;
use host_bridge::arm::gen3::{COUNT, HOME, JOINT_NAMES};
use host_bridge::arm::model::SerialArm;
use host_bridge::base::Twist;
use host_bridge::config::Config;
use host_bridge::plan::Planner;
use host_bridge::robot::{Door as _, Joints, MotionName, NotStarted, Report, joints};
use host_bridge::robots::Stage;
use host_bridge::ros2::answer::Answer;
use host_bridge::ros2::gripper::GripAnswer;
use host_bridge::ros2::{ArmInterface, Output, Ros2Config, RosRobot};
use host_bridge::scene::Scene;
use host_bridge::topics::message::{self as ros, JointState};

/// The joint of the gripper: 0 is open, and 0.8 is closed.
const KNUCKLE: &str = "knuckle";

fn joints_of(positions: &[f64]) -> Option<Joints> {
    Some(joints::<COUNT>(positions.try_into().ok()?))
}

struct Site {
    door: Director<RosRobot>,
    now_ms: u64,
    joints_rad: Joints,
    /// The position of the gripper; `None` if no message contains it.
    knuckle: Option<f64>,
    tells_base: bool,
    commands: bool,
    sent: Vec<Output>,
    reports: Vec<Report>,
}

impl Site {
    fn new(scene: &str) -> Self {
        let config = Config::default();
        let text = format!("{scene}\n[[tool]]\nname = \"2f-85\"\n");
        let planner = Planner::new(SerialArm::gen3(), Scene::parse(&text).unwrap()).unwrap();
        let stage = Stage::new(&config, Some(planner)).unwrap();
        // The action interface sends complete goals, so the test sees complete plans.
        let ros2 = Ros2Config {
            arm: ArmInterface::Action,
            gripper_joint: KNUCKLE.to_owned(),
            ..Ros2Config::default()
        };
        let mut robot = RosRobot::new(&ros2, stage.limits, config.base);
        robot.set_arm_listened_to(true);
        robot.set_gripper_missing(None);
        let mut site = Site {
            door: stage.before(robot),
            now_ms: 0,
            joints_rad: HOME,
            knuckle: Some(0.0),
            tells_base: true,
            commands: true,
            sent: Vec::new(),
            reports: Vec::new(),
        };
        site.run(500);
        site
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ms += 1;
            if self.now_ms.is_multiple_of(10) {
                let robot = self.door.robot_mut();
                robot.at(self.now_ms);
                let knuckle = self.knuckle.map(|position| (KNUCKLE.to_owned(), position));
                let arm = JOINT_NAMES.iter().map(|name| (*name).to_owned()).zip(self.joints_rad);
                let (name, position): (Vec<_>, Vec<_>) = arm.chain(knuckle).unzip();
                robot.see(&JointState { name, position, ..JointState::default() });
                if self.tells_base {
                    robot.see_base(&ros::Odometry::default());
                }
            }
            self.door.step(self.now_ms);
            if self.commands && self.now_ms.is_multiple_of(20) {
                self.door.drive(Twist::ZERO);
            }
            self.reports.extend(self.door.take_reports());
            self.sent.extend(self.door.robot_mut().take_outputs());
        }
    }

    fn start(&mut self, motion: &str) -> Result<(), NotStarted> {
        self.reports.clear();
        self.sent.clear();
        let started = self.door.start_motion(&MotionName::from(motion));
        self.sent.extend(self.door.robot_mut().take_outputs());
        started
    }

    /// Returns the newest goal of the gripper.
    fn grip(&self) -> Option<u32> {
        self.sent.iter().rev().find_map(|sent| match sent {
            Output::Grip { goal, .. } => Some(*goal),
            _ => None,
        })
    }

    /// Returns the newest goal of the arm: its number and its target.
    fn goal(&self) -> Option<(u32, Joints)> {
        self.sent.iter().rev().find_map(|sent| match sent {
            Output::Goal { goal, trajectory } => {
                Some((*goal, joints_of(&trajectory.points.last()?.positions)?))
            }
            _ => None,
        })
    }

    /// Moves the arm to the target of its newest goal, and lets its controller report success.
    fn arrive(&mut self) {
        let (goal, there) = self.goal().unwrap();
        self.answer_arm(goal, Answer::Accepted);
        // The arm moves at a realistic speed. A jump in its position would be rejected.
        let from = self.joints_rad;
        for k in 1..=100 {
            let share = f64::from(k) / 100.0;
            self.joints_rad = std::array::from_fn(|i| from[i] + share * (there[i] - from[i]));
            self.run(30);
        }
        self.answer_arm(goal, Answer::Succeeded);
        self.run(20);
    }

    fn answer_arm(&mut self, goal: u32, answer: Answer) {
        self.door.robot_mut().answer(goal, answer);
    }

    fn answer(&mut self, answer: GripAnswer) {
        let goal = self.grip().unwrap();
        self.door.robot_mut().grip_answer(goal, answer);
    }

    fn ended(&self) -> Option<bool> {
        self.reports.iter().find_map(|report| match report {
            Report::MotionEnded { reached, .. } => Some(*reached),
            _ => None,
        })
    }

    fn notes(&self) -> String {
        let note = |report: &Report| match report {
            Report::Note(text) => Some(text.clone()),
            _ => None,
        };
        self.reports.iter().filter_map(note).collect::<Vec<_>>().join("\n")
    }

    fn cancels(&self) -> usize {
        self.sent.iter().filter(|sent| matches!(sent, Output::CancelGrip { .. })).count()
    }
}

fn done(position: f64, stalled: bool, reached: bool) -> GripAnswer {
    GripAnswer::Done { position, stalled, reached, status: "Aborted".to_owned() }
}

/// Returns the configuration of a motion that closes or opens the gripper and then moves the arm.
fn grips_and_moves(word: &str) -> String {
    format!("[[motion]]\nname = \"own\"\nsteps = [{{ gripper = \"{word}\" }}, {{ to = \"ready\" }}]\n")
}

#[test]
fn a_gripper_that_fails_ends_the_motion_and_is_named_and_nothing_of_the_rest_is_sent() {
    type Does = fn(&mut Site);
    let failures: [(&str, &str, Does, bool); 6] = [
        ("close", "did not answer within 1000 ms", |_| {}, true),
        ("close", "told nothing of the goal within 5000 ms", |site| site.answer(GripAnswer::Accepted), true),
        ("close", "its controller refused the goal", |site| site.answer(GripAnswer::Rejected), false),
        (
            "close",
            "its controller gave up (Aborted)",
            |site| {
                site.answer(GripAnswer::Accepted);
                site.run(300);
                site.answer(done(0.3, false, false));
            },
            false,
        ),
        (
            "open",
            "something keeps it from opening",
            |site| {
                site.answer(GripAnswer::Accepted);
                site.answer(done(0.7, true, false));
            },
            false,
        ),
        (
            "close",
            "two controllers have accepted the gripper's goal",
            |site| {
                site.answer(GripAnswer::Accepted);
                site.answer(GripAnswer::Accepted);
                site.run(100);
                site.answer(done(0.2, false, false));
            },
            true,
        ),
    ];
    for (word, told, does, is_cancelled) in failures {
        let mut site = Site::new(&grips_and_moves(word));
        site.knuckle = Some(if word == "open" { 0.8 } else { 0.0 });
        site.run(50);
        site.start("own").unwrap();
        assert!(site.grip().is_some());
        does(&mut site);
        site.run(8000);
        let notes = site.notes();
        assert!(
            notes.contains(told) && notes.contains("part 1 of 2; the rest is not done"),
            "{told}: {notes}"
        );
        assert_eq!(site.ended(), Some(false), "{told}");
        assert_eq!(site.goal(), None, "{told}: the arm was sent nowhere");
        assert_eq!(site.cancels() > 0, is_cancelled, "{told}: {:?}", site.sent);
    }
}

#[test]
fn a_stall_on_a_thing_is_success_and_the_motion_goes_on() {
    let mut site = Site::new(&grips_and_moves("close"));
    site.start("own").unwrap();
    site.answer(GripAnswer::Accepted);
    site.run(500);
    site.knuckle = Some(0.3);
    site.answer(done(0.3, true, false));
    site.run(50);
    assert!(site.notes().contains("the gripper has something (53 mm)"), "{}", site.notes());
    site.arrive();
    assert_eq!(site.ended(), Some(true), "{}", site.notes());
}

/// An event that halts the motion.
type Hold = fn(&mut Site);

#[test]
fn whatever_holds_the_hand_back_within_a_sequence_ends_all_of_it_and_nothing_goes_on_when_it_is_over() {
    let steps = "[[motion]]\nname = \"own\"\nsteps = [{ to = \"ready\" }, { gripper = \"close\" }, { wait_s = 2 }, \
                 { to = \"home\" }]\n";
    let holds: [(&str, Hold); 3] = [
        // The guard no longer has the position of the base, and therefore stops everything.
        ("its base is lost", |site| site.tells_base = false),
        ("a stop", |site| site.door.halt()),
        ("the arm's own end", |site| site.door.halt_arm()),
    ];
    for (what, hold) in holds {
        // The four phases are the arm's first move, the grip, the wait and the arm's last move.
        for part in 1..=4 {
            let mut site = Site::new(steps);
            site.start("own").unwrap();
            if part > 1 {
                site.arrive();
                site.sent.retain(|sent| matches!(sent, Output::Grip { .. }));
            }
            if part > 2 {
                site.answer(GripAnswer::Accepted);
                site.run(200);
                site.answer(done(0.8, false, true));
                site.knuckle = Some(0.8);
                site.run(500);
            }
            if part > 3 {
                site.run(2000);
            }
            assert_eq!(site.goal().is_some(), part == 1 || part == 4, "{what}, {part}");
            site.sent.clear();
            hold(&mut site);
            site.run(400);
            let is_told = |cancel: fn(&Output) -> bool| site.sent.iter().any(cancel);
            match part {
                1 | 4 => assert!(is_told(|sent| matches!(sent, Output::Cancel { .. })), "{what}, {part}"),
                2 => assert!(is_told(|sent| matches!(sent, Output::CancelGrip { .. })), "{what}, {part}"),
                _ => {}
            }
            // Both cancellations are confirmed, and a new motion may start.
            site.answer_arm(1, Answer::Ended("cancelled".to_owned()));
            site.answer_arm(2, Answer::Ended("cancelled".to_owned()));
            site.door.robot_mut().grip_answer(1, done(0.4, false, false));
            site.tells_base = true;
            site.sent.clear();
            site.run(5000);
            assert_eq!(site.ended(), Some(false), "{what}, {part}: {}", site.notes());
            assert!(site.notes().contains("the rest is not done"), "{what}, {part}: {}", site.notes());
            let on = site.sent.iter().any(|sent| matches!(sent, Output::Goal { .. } | Output::Grip { .. }));
            assert!(!on, "{what}, {part}: it goes on: {:?}", site.sent);
        }
    }
}

#[test]
fn fingers_of_which_nobody_tells_count_open_and_shut() {
    // Closed fingertips reach 13 mm further than open fingertips. The shelf lies between these two positions.
    let arm = SerialArm::gen3();
    let flange = arm.flange_pose(&HOME);
    let tip = |z_m: f64| {
        flange.at(host_bridge::robot::DVec3::new(0.0, 0.0, z_m))
            + host_bridge::robot::DVec3::new(0.1, 0.0, 0.4)
    };
    // Open fingers end 161 mm from the flange, and closed fingers 175 mm.
    // The post stands in front of the arm's target.
    let at = tip(0.183).to_array();
    let mut beside = HOME;
    beside[0] += 0.7;
    let scene = format!(
        "[[box]]\nname = \"post\"\ncenter_m = {at:?}\nsize_m = [0.02, 0.02, 0.02]\n[[pose]]\nname = \"shelf\"\njoints_rad = {:?}\n",
        &HOME[..COUNT]
    );
    let mut site = Site::new(&scene);
    site.joints_rad = beside;
    // An impossible jump of the arm blocks motions for 2 s.
    site.run(2500);
    site.start("shelf").unwrap();
    assert!(site.goal().is_some(), "open fingers have room");
    for (knuckle, about) in [(Some(0.8), "shut"), (None, "anywhere")] {
        let mut site = Site::new(&scene);
        site.joints_rad = beside;
        site.knuckle = knuckle;
        site.run(2500);
        let refused = site.start("shelf").unwrap_err().to_string();
        assert!(refused.contains("fingers") && refused.contains("post"), "{about}: {refused}");
        assert_eq!(site.goal(), None);
    }
}
