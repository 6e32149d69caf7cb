//! Tests a robot that refuses commands, the end of only the arm's motion, and a restricted session.
//! The tests use frames of both hands in virtual time and check every output.
//!
//! Labels by number: 1 up-down (home, releases), 2 to-fro (pick-up), 3 left-right (here: end arm).

mod support;

use std::sync::{Arc, Mutex};

use host_bridge::arm::Director;
use host_bridge::arm::gen3::{HOME, paper_limits};
use host_bridge::base::{BaseConfig, Twist};
use host_bridge::bridge::GestureOutcome::{EndedArm, NotArmed, Refused, Released, Started};
use host_bridge::bridge::{Bridge, EventKind};
use host_bridge::config::{Config, HandInput};
use host_bridge::describe;
use host_bridge::intent::MotionMap;
use host_bridge::keyboard::HandKey;
use host_bridge::observe::{Now, Observer, SessionEvent, Snapshot};
use host_bridge::robot::{
    BaseState, Door as _, End, Following, JointLimits, Joints, Motion, Reading, Robot, Trajectory,
};
use host_bridge::robots::{Echoed, Stage};
use host_bridge::safety::{HaltReason, Hand, State};
use host_bridge::taught::with_pose;
use host_bridge::teach::{Play, Played, SEARCH_MS};
use host_bridge::topics::diagnostics::Diagnostics;
use host_bridge::topics::message::Time;
use host_bridge::topics::{Entry, Origin, Outlet, Teller, Topic};
use shared_proto::message::Heading;
use support::{Rig, Virtual as _};

/// Braking from 0.5 m/s at 1 m/s² takes 0.5 s, and the arm brakes within 0.33 s.
/// The remaining time is a margin for the frame in transit.
const REST_MS: u64 = 520;

fn refuse(rig: &mut Rig, why: Option<&str>) {
    rig.bridge.robot_refuses(why.map(str::to_owned), rig.now_ms, &mut rig.robot);
}

fn halts(rig: &Rig) -> Vec<HaltReason> {
    let halt = |event: &EventKind| match event {
        EventKind::Halt { reason } => Some(*reason),
        _ => None,
    };
    rig.events.iter().filter_map(halt).collect()
}

#[test]
fn a_robot_that_refuses_halts_base_and_arm_and_needs_neutral_when_it_does_not_any_more() {
    let mut rig = Rig::armed();
    rig.gesture(2);
    rig.point(Heading::Forward, 1000);
    assert!(rig.arm_moves() && rig.speed_m_s() > 0.4);
    refuse(&mut rig, Some("the e-stop is pressed"));
    assert_eq!((rig.state(), rig.bridge.twist()), (State::Refused, Twist::ZERO));
    rig.run(REST_MS);
    assert!(rig.robot.at_rest());
    assert_eq!(halts(&rig), [HaltReason::RobotRefuses]);
    // During the refusal, a neutral hand does not arm, and gestures have no effect.
    rig.take_moved();
    rig.point(Heading::Neutral, 2000);
    assert_eq!(rig.state(), State::Refused);
    rig.take_outcomes();
    rig.gesture(2);
    assert_eq!(rig.take_outcomes(), [NotArmed]);
    // The refusal ends while the hand is tilted. The robot must not move until the hand has been neutral.
    rig.point(Heading::Forward, 200);
    refuse(&mut rig, None);
    rig.run(1000);
    assert_eq!(rig.state(), State::Waiting);
    assert!(!rig.take_moved());
    rig.point(Heading::Neutral, 200);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn neutral_from_before_the_end_of_a_refusal_does_not_count() {
    let mut rig = Rig::armed();
    refuse(&mut rig, Some("a fault"));
    rig.run(1000);
    refuse(&mut rig, None);
    rig.run(95);
    assert_eq!(rig.state(), State::Waiting);
    rig.run(60);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn no_release_goes_past_a_robot_that_refuses_and_the_operators_stop_outlives_it() {
    let mut rig = Rig::armed();
    rig.stop();
    refuse(&mut rig, Some("the e-stop is pressed"));
    rig.run(1500);
    rig.take_outcomes();
    rig.gesture(1);
    assert_eq!((rig.state(), rig.take_outcomes()), (State::Stopped, vec![NotArmed]));
    refuse(&mut rig, None);
    rig.run(500);
    assert_eq!(rig.state(), State::Stopped);
    rig.run(1500);
    rig.gesture(1);
    assert_eq!((rig.state(), rig.take_outcomes()), (State::Armed, vec![Released]));
}

#[test]
fn a_hand_that_falls_silent_during_a_refusal_is_waited_for_and_the_refusal_still_holds() {
    let mut rig = Rig::armed();
    refuse(&mut rig, Some("a fault"));
    rig.talking.left = false;
    rig.run(400);
    assert_eq!(rig.state(), State::Stale);
    rig.talking.left = true;
    rig.run(1000);
    assert_eq!(rig.state(), State::Refused);
    assert!(!rig.take_moved());
}

/// Creates a rig in which the left-right gesture ends the arm's motion.
fn with_end_arm() -> Rig {
    let mut map = MotionMap::default();
    map.assign("left-right=end arm").unwrap();
    let mut rig = Rig::empty();
    rig.bridge = Bridge::new(map).known_to(|motion| *motion != *"end-arm");
    armed(rig)
}

/// Returns the rig with both hands connected and armed.
fn armed(mut rig: Rig) -> Rig {
    rig.connect(Hand::Left, 1);
    rig.connect(Hand::Right, 1);
    rig.run(200);
    assert_eq!(rig.state(), State::Armed);
    rig
}

#[test]
fn a_gesture_of_ones_choice_ends_the_arms_motion_alone() {
    let mut rig = with_end_arm();
    rig.gesture(2);
    rig.point(Heading::Forward, 1500);
    assert!(rig.arm_moves() && rig.speed_m_s() > 0.4);
    rig.gesture(3);
    assert_eq!(rig.take_outcomes(), [Started("pick-up".into()), EndedArm]);
    rig.run(REST_MS);
    assert!(!rig.arm_moves());
    assert!(rig.speed_m_s() > 0.4, "the base goes on");
    assert_eq!(rig.state(), State::Armed);
    let ended = |event: &EventKind| matches!(event, EventKind::MotionEnded { reached: false, .. });
    assert!(rig.events.iter().any(ended), "{:?}", rig.events);
    // The next motion may start immediately.
    rig.gesture(2);
    assert_eq!(rig.take_outcomes(), [Started("pick-up".into())]);
}

#[test]
fn a_key_ends_the_arms_motion_alone_also_where_nothing_moves() {
    let mut rig = Rig::armed();
    rig.gesture(2);
    rig.point(Heading::Forward, 1500);
    rig.bridge.end_arm_key(rig.now_ms, &mut rig.robot);
    rig.run(REST_MS);
    assert!(!rig.arm_moves() && rig.speed_m_s() > 0.4);
    assert!(rig.events.contains(&EventKind::ArmEnded));
    rig.bridge.end_arm_key(rig.now_ms, &mut rig.robot);
    rig.run(100);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn where_boards_need_not_be_bonded_the_base_is_slow_and_the_arm_still() {
    let config = Config::parse("[ports]\nallow_unbonded = true\n[speed]\nstart = 0.9\n").unwrap();
    let mut rig = Rig::empty();
    rig.bridge = config.bridge(config.motion_map());
    rig.connect(Hand::Left, 1);
    rig.connect(Hand::Right, 1);
    rig.run(200);
    let told =
        |event: &EventKind| matches!(event, EventKind::Restricted { text } if text.contains("0.2 m/s"));
    assert!(rig.events.iter().any(told), "{:?}", rig.events);
    for _ in 0..20 {
        rig.left.index_bends = rig.left.index_bends.wrapping_add(1);
        rig.point(Heading::Forward, 100);
    }
    rig.run(1000);
    assert!((rig.speed_m_s() - 0.2).abs() < 1e-9, "{}", rig.speed_m_s());
    rig.take_outcomes();
    rig.gesture(2);
    assert!(!rig.arm_moves());
    assert_eq!(rig.take_outcomes(), [Refused("pick-up".into())]);
}

/// The reason of a refusal, set by the test.
type Mood = Arc<Mutex<Option<String>>>;

/// A robot that ignores commands and reports the reason of its refusal.
struct Moody {
    limits: JointLimits,
    base: BaseConfig,
    refusal: Mood,
}

impl Robot for Moody {
    fn step(&mut self, _now_ms: u64) {}
    fn arm(&self) -> Option<Reading<Motion>> {
        None
    }
    fn base(&self) -> Option<Reading<BaseState>> {
        None
    }
    fn joint_limits(&self) -> &JointLimits {
        &self.limits
    }
    fn base_limits(&self) -> &BaseConfig {
        &self.base
    }
    fn drive(&mut self, _twist: Twist) {}
    fn can_follow(&self) -> Result<(), String> {
        Ok(())
    }
    fn follow(&mut self, _trajectory: Arc<Trajectory>) -> Result<(), String> {
        Ok(())
    }
    fn following(&self) -> Following {
        Following::Idle
    }
    fn take_end(&mut self) -> Option<End> {
        None
    }
    fn halt_arm(&mut self) {}
    fn halt(&mut self) {}
    fn refusal(&self) -> Option<String> {
        self.refusal.lock().unwrap().clone()
    }
}

/// Returns the newest state in two forms: as observers receive it, and as a Foxglove client receives it.
#[derive(Clone, Default)]
struct Surfaces {
    snapshot: Arc<Mutex<Option<Snapshot>>>,
    diagnostics: Arc<Mutex<String>>,
    entries: Arc<Mutex<Vec<Entry>>>,
}

impl Observer for Surfaces {
    fn state(&mut self, now: &Now<'_>) {
        *self.snapshot.lock().unwrap() = Some(Snapshot::of(now));
        let message = Diagnostics::default().take("bimanual", now.bridge, now.time_ms, Time::default());
        *self.diagnostics.lock().unwrap() = format!("{:?}", message.unwrap().status[0]);
    }
}

impl Outlet for Surfaces {
    fn put(&mut self, entry: Entry) {
        self.entries.lock().unwrap().push(entry);
    }
}

#[test]
fn every_surface_says_what_refuses_and_when_it_does_not_any_more() {
    let config = Config::default();
    let stage = Stage::bare();
    let refusal = Arc::new(Mutex::new(None));
    let graph = Moody { limits: paper_limits(), base: BaseConfig::default(), refusal: Arc::clone(&refusal) };
    let robot = stage.before(Echoed { simulator: stage.simulator(&config), graph });
    let mut live = support::moving::live_before(robot, &config, HandInput::Keyboard, HandInput::Nobody, 0);
    let surfaces = Surfaces::default();
    live.tap_mut().add(Box::new(surfaces.clone()));
    live.tap_mut().add(Box::new(Teller::new(Origin { nanoseconds: 0 }, surfaces.clone())));
    let mut now_ms = 0;
    let mut run = |live: &mut host_bridge::engine::Engine<'static, _>, ms: u64| {
        let mut said = Vec::new();
        for _ in 0..ms {
            now_ms += 1;
            said.extend(live.advance(now_ms, [true; 2]));
            // The hand is first neutral.
            if now_ms > 1000 && now_ms % 100 == 0 {
                live.press(HandKey::Arrow(Heading::Forward), now_ms);
            }
        }
        let json = |event: &SessionEvent| match event {
            SessionEvent::Bridge(event) => serde_json::to_string(event).unwrap(),
            _ => String::new(),
        };
        let both: Vec<String> = said.iter().flat_map(|event| [describe::text(event), json(event)]).collect();
        both.join("\n")
    };
    run(&mut live, 1000);
    assert_eq!(live.bridge().safety().state(), State::Armed);
    *refusal.lock().unwrap() = Some("the clocks are 2.00 s apart".to_owned());
    let text = run(&mut live, 20);
    for words in
        ["the robot refuses to move: the clocks", "\"event\":\"robot-refuses\"", "robot-refuses\"", "HALT"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    let snapshot = surfaces.snapshot.lock().unwrap().clone().unwrap();
    assert_eq!((snapshot.safety, snapshot.refusal.is_some()), (State::Refused, true));
    let page = serde_json::to_string(&snapshot).unwrap();
    assert!(page.contains("\"safety\":\"refused\"") && page.contains("2.00 s apart"), "{page}");
    assert!(surfaces.diagnostics.lock().unwrap().contains("2.00 s apart"));
    // If only a number in the reason changes, there is no new report.
    *refusal.lock().unwrap() = Some("the clocks are 2.01 s apart".to_owned());
    assert!(!run(&mut live, 100).contains("refuses"));
    let entries = std::mem::take(&mut *surfaces.entries.lock().unwrap());
    let said = |topic: Topic, words: &str| {
        entries.iter().any(|e| e.topic == topic && String::from_utf8_lossy(&e.data).contains(words))
    };
    assert!(said(Topic::Hands, "refused; the clocks are 2.00 s apart"), "Foxglove's state");
    assert!(said(Topic::Refused, "2.00 s apart") && said(Topic::Events, "2.00 s apart"));
    *refusal.lock().unwrap() = None;
    assert!(run(&mut live, 20).contains("neutral first"));
    assert_eq!(surfaces.snapshot.lock().unwrap().clone().unwrap().refusal, None);
}

/// Returns a stage with its own pose, and a simulated robot whose refusals the test sets.
fn taught() -> (Director<Echoed<Moody>>, Mood, Joints) {
    let mut there = HOME;
    there[1] += 0.6;
    let config = with_pose("", "shelf", &there[..7]).unwrap();
    let config = Config::parse(&config).unwrap();
    let stage = Stage::new(&config, None).unwrap();
    let refusal = Arc::new(Mutex::new(None));
    let graph = Moody { limits: paper_limits(), base: BaseConfig::default(), refusal: Arc::clone(&refusal) };
    (stage.before(Echoed { simulator: stage.simulator(&config), graph }), refusal, there)
}

/// Plays the pose until its end, and calls `each` with the time in ms.
fn play(door: &mut Director<Echoed<Moody>>, mut each: impl FnMut(u64) -> bool) -> (Played, u64, Vec<String>) {
    let (mut play, mut notes) = (Play::new("shelf".into(), 300), Vec::new());
    for now_ms in (0..60_000).step_by(5) {
        let interrupted = each(now_ms);
        if let Some(outcome) = play.turn(door, now_ms, interrupted, |text| notes.push(text.to_owned())) {
            return (outcome, now_ms, notes);
        }
    }
    panic!("it does not end: {notes:?}");
}

#[test]
fn a_taught_pose_is_written_read_and_played_to_where_it_was() {
    let (mut door, _, there) = taught();
    let (outcome, took_ms, notes) = play(&mut door, |_| false);
    assert_eq!((outcome, notes), (Played::Reached, Vec::new()));
    let here = door.robot().simulator.motion();
    println!("there after {took_ms} ms");
    assert!(here.joints_rad.iter().zip(there).all(|(a, b)| (a - b).abs() < 1e-6), "{here:?}");
    assert!(door.robot().simulator.at_rest());
}

#[test]
fn a_taught_pose_is_played_neither_against_a_robot_that_refuses_nor_on_when_it_begins_to() {
    // The robot refuses from the start and during the whole waiting time.
    let (mut door, refusal, _) = taught();
    *refusal.lock().unwrap() = Some("the e-stop is pressed".to_owned());
    let before = door.robot().simulator.motion();
    let (outcome, took_ms, _) = play(&mut door, |_| false);
    assert_eq!(outcome, Played::Not("the robot refuses to move: the e-stop is pressed".to_owned()));
    assert!(took_ms >= SEARCH_MS);
    assert_eq!(door.robot().simulator.motion(), before, "nothing has moved");
    // The robot refuses during the motion.
    // The robot stops within the braking time, and the rest of the motion is cancelled.
    let (mut door, refusal, there) = taught();
    let (outcome, ended_ms, _) = play(&mut door, |now_ms| {
        if now_ms == 2000 {
            *refusal.lock().unwrap() = Some("the e-stop is pressed".to_owned());
        }
        false
    });
    assert_eq!(outcome, Played::Not("the robot refuses to move on: the e-stop is pressed".to_owned()));
    assert!((2300..2320).contains(&ended_ms), "{ended_ms}");
    door.step(2000 + REST_MS);
    let rested = door.robot().simulator.motion();
    assert!(door.robot().simulator.at_rest());
    assert!(rested.joints_rad.iter().zip(there).any(|(a, b)| (a - b).abs() > 0.05));
    door.step(20_000);
    assert_eq!(door.robot().simulator.motion(), rested);
    // Ctrl-C has the same effect.
    let (mut door, _, _) = taught();
    let (outcome, ended_ms, _) = play(&mut door, |now_ms| now_ms >= 2000);
    assert_eq!((outcome, ended_ms), (Played::Interrupted, 2300));
    door.step(2000 + REST_MS);
    assert!(door.robot().simulator.at_rest());
}

/// The motion has three steps: a move, a wait and another move.
const OF_THREE: &str = "[[motion]]\nname = \"own\"\nsteps = [{ to = \"pick-up\" }, { wait_s = 4 }, { to = \"place\" }]\n\
                        [motions]\nto-fro = \"own\"\n";

fn with_steps() -> Rig {
    let config = Config::parse(OF_THREE).unwrap();
    let mut rig = Rig::empty();
    rig.bridge = Bridge::new(config.motion_map());
    rig.robot = Stage::new(&config, None).unwrap().simulated(&config);
    armed(rig)
}

#[test]
fn a_hand_or_robot_that_holds_it_back_within_a_sequence_ends_all_of_it_and_neutral_revives_none() {
    // Executes the entire motion to determine when the arm moves and when it waits.
    let mut rig = with_steps();
    rig.gesture(2);
    let from_ms = rig.now_ms;
    let mut rests = Vec::new();
    while rig.robot.arm().running.is_some() {
        rig.run(100);
        rests.push(!rig.arm_moves());
        assert!(rests.len() < 1200);
    }
    let takes_ms = rig.now_ms - from_ms;
    let first_rest = rests.iter().skip(20).position(|rest| *rest).unwrap() as u64 + 20;
    println!("the whole takes {takes_ms} ms, it waits from {} ms on", 100 * first_rest);
    // These times lie in the first move, in the wait, and in the last move.
    let moments_ms = [2000, 100 * first_rest + 1500, takes_ms - 3000];
    type Holds = fn(&mut Rig);
    let holds: [(&str, Holds, Holds); 5] = [
        ("the left hand is silent", |rig| rig.talking.left = false, |rig| rig.talking.left = true),
        ("the right hand is silent", |rig| rig.talking.right = false, |rig| rig.talking.right = true),
        ("the left hand is in doubt", |rig| rig.left.health = 1, |rig| rig.left.health = 0),
        ("e-stop", |rig| refuse(rig, Some("the e-stop is pressed")), |rig| refuse(rig, None)),
        ("the arm's end", |rig| rig.bridge.end_arm_key(rig.now_ms, &mut rig.robot), |_| {}),
    ];
    for (what, hold, is_over) in holds {
        for moment_ms in moments_ms {
            let mut rig = with_steps();
            rig.gesture(2);
            rig.run(moment_ms);
            assert!(rig.robot.arm().running.is_some(), "{what} at {moment_ms} ms");
            rig.events.clear();
            hold(&mut rig);
            // A hand counts as silent after 250 ms.
            rig.run(300 + REST_MS);
            assert!(!rig.arm_moves() && rig.robot.arm().running.is_none(), "{what} at {moment_ms} ms");
            let of = |wanted: fn(&EventKind) -> bool| rig.events.iter().filter(|event| wanted(event)).count();
            assert_eq!(of(|e| matches!(e, EventKind::MotionEnded { reached: false, .. })), 1, "{what}");
            assert_eq!(
                of(|e| matches!(e, EventKind::Robot { text } if text.contains("the rest is not done"))),
                1
            );
            is_over(&mut rig);
            rig.take_moved();
            rig.run(6000);
            assert_eq!(rig.state(), State::Armed, "{what}");
            assert!(!rig.take_moved(), "{what} at {moment_ms} ms: it goes on");
        }
    }
}
