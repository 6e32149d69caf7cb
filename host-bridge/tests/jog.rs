//! Tests jogging, in which a hand moves the tool: the clutch, the dead-man, the limits and the guard.
//! The board's rules evaluate the tilt of the hand at 100 Hz, and states are sent at 50 Hz.
//! All tests run in virtual time.

mod support;

use host_bridge::arm::model::SerialArm;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::plan::{Placement, Planner, World};
use host_bridge::robot::{DVec3, Door as _, JOINTS, JointLimits, Joints, Leg, Pose, Random, Robot as _};
use host_bridge::safety::{Hand, State};
use host_bridge::scene::Scene;
use shared_dsp::left::tilt::{Tilt, TiltDetector};
use shared_proto::message::TiltThresholds;
use support::{Rig, Virtual as _, moving};

/// The label of the clutch among the rig's.
const CIRCLE: u8 = 6;
/// The braking time v/a with the paper's speed and acceleration limits, plus the transit time of one frame.
const BRAKING_MS: u64 = 326 + 20;

struct Wearer {
    rig: Rig,
    detector: TiltDetector,
}

impl Wearer {
    /// Creates a wearer with both hands neutral and armed, in front of this robot.
    fn before(robot: support::Robot, jog: &str) -> Self {
        let config = Config::parse(&format!("[jog]\nlabel = 'circle'\nkey = 'j'\n{jog}")).unwrap();
        let mut rig = Rig::empty();
        rig.bridge = config.bridge(config.motion_map());
        rig.robot = robot;
        let ahead_ms = rig.now_ms;
        rig.robot.pass(ahead_ms);
        rig.connect(Hand::Left, 1);
        rig.connect(Hand::Right, 1);
        let mut wearer = Wearer { rig, detector: TiltDetector::new(TiltThresholds::DEFAULT) };
        wearer.hold(0, 0, 300);
        assert_eq!(wearer.rig.state(), State::Armed);
        wearer
    }

    fn new() -> Self {
        Wearer::before(support::bare(), "")
    }

    /// Creates the same wearer with the left hand lent to the arm, and armed.
    fn jogging() -> Self {
        let mut wearer = Wearer::new();
        wearer.clutch();
        wearer.hold(0, 0, 300);
        assert!(wearer.rig.bridge.is_jogging() && wearer.rig.state() == State::Armed);
        wearer
    }

    /// The right hand draws the gesture of the clutch, and rests again.
    fn clutch(&mut self) {
        self.rig.gesture(CIRCLE);
    }

    /// Keeps this tilt, in milliradians, for this duration in ms.
    fn hold(&mut self, pitch_mrad: i16, roll_mrad: i16, ms: u64) {
        for _ in 0..ms / 10 {
            self.tilt(pitch_mrad, roll_mrad);
            self.rig.run(10);
        }
    }

    fn tilt(&mut self, pitch_mrad: i16, roll_mrad: i16) {
        let heading = self.detector.step(Tilt { pitch_mrad, roll_mrad });
        let left = &mut self.rig.left;
        (left.pitch_mrad, left.roll_mrad, left.heading) = (pitch_mrad, roll_mrad, heading);
    }

    fn flange(&self) -> Pose {
        self.rig.robot.picture().flange
    }

    fn arm_rests(&self) -> bool {
        self.rig.robot.arm().at_rest()
    }
}

#[test]
fn the_clutch_lends_the_left_hand_after_neutral_and_tilts_move_the_tool_while_the_base_stands() {
    let mut wearer = Wearer::new();
    wearer.hold(600, 0, 1000);
    assert!(wearer.rig.robot.odometry().path_m > 0.2, "the base drives");
    wearer.clutch();
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::Lent]);
    wearer.hold(600, 0, 2000);
    assert!(wearer.rig.robot.at_rest(), "neutral first");
    wearer.hold(0, 0, 500);
    let (before, driven_m) = (wearer.flange(), wearer.rig.robot.odometry().path_m);
    // A full tilt forward is 5 cm/s.
    wearer.hold(698, 0, 1500);
    assert_eq!(wearer.rig.robot.arm().running.unwrap().1, Leg::Jogging);
    wearer.hold(0, 0, 1000);
    let forward = wearer.flange();
    let way = forward.position_m - before.position_m;
    println!("forward for 1.5 s: {way:.4} m");
    assert!((0.04..0.08).contains(&way.x) && way.y.abs() < 0.005 && way.z.abs() < 0.005, "{way}");
    wearer.hold(0, 698, 1500);
    wearer.hold(0, 0, 1000);
    let way = wearer.flange().position_m - forward.position_m;
    assert!((0.04..0.08).contains(&way.y) && way.x.abs() < 0.005 && way.z.abs() < 0.005, "{way}");
    let turned = (wearer.flange().rotation * before.rotation.transpose()) * DVec3::X;
    assert!((turned - DVec3::X).length() < 0.02, "the tool keeps its orientation");
    assert_eq!(wearer.rig.robot.odometry().path_m, driven_m, "the base stood still");
    assert!(wearer.arm_rests() && wearer.rig.robot.picture().jog_held.is_none());

    // The hand is returned: first it is neutral, and then the base drives again.
    wearer.clutch();
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::TakenBack]);
    let there = wearer.rig.robot.arm().joints_rad;
    wearer.hold(600, 0, 1000);
    assert_eq!(wearer.rig.robot.odometry().path_m, driven_m);
    wearer.hold(0, 0, 500);
    wearer.hold(600, 0, 1000);
    assert!(wearer.rig.robot.odometry().path_m > driven_m + 0.2);
    assert_eq!(wearer.rig.robot.arm().joints_rad, there);
}

#[test]
fn bends_move_the_tool_up_and_down_and_change_no_cap() {
    let mut wearer = Wearer::jogging();
    let (before, cap) = (wearer.flange().position_m, wearer.rig.bridge.caps().linear_m_s);
    wearer.rig.left.index_bends += 2;
    wearer.hold(0, 0, 2000);
    let up = wearer.flange().position_m;
    // The expected distance is twice half a second at 3 cm/s, minus the loss until that speed is reached.
    let way = up - before;
    println!("two bends: {way:.4} m");
    assert!((0.015..0.035).contains(&way.z) && way.x.hypot(way.y) < 0.003, "{way}");
    wearer.rig.left.middle_bends += 1;
    wearer.hold(0, 0, 2000);
    let way = wearer.flange().position_m - up;
    assert!((-0.018..-0.006).contains(&way.z), "{way}");
    assert_eq!(wearer.rig.bridge.caps().linear_m_s, cap);
    assert!(wearer.arm_rests());
}

#[test]
fn whatever_holds_a_hand_or_the_robot_back_brakes_the_arm_within_its_limits_and_needs_neutral() {
    type Step = fn(&mut Wearer);
    let nothing: Step = |_| {};
    // Each fault: its start, its end, the time until it is noticed, and whether the hand is still lent then.
    let faults: [(&str, Step, Step, u64, bool); 11] = [
        ("the right hand does not rest", |w| w.rig.right.top = 2, |w| w.rig.right.top = 0, 0, true),
        ("the left hand is silent", |w| w.rig.talking.left = false, |w| w.rig.talking.left = true, 250, true),
        (
            "the right hand is silent",
            |w| w.rig.talking.right = false,
            |w| w.rig.talking.right = true,
            250,
            true,
        ),
        ("doubt", |w| w.rig.left.health = 1, |w| w.rig.left.health = 0, 0, true),
        ("no answers", |w| w.rig.answering.left = false, |w| w.rig.answering.left = true, 600, true),
        ("both fingers", |w| w.rig.left.stop = true, |w| w.rig.left.stop = false, 0, false),
        ("the clutch's key", |w| w.rig.bridge.clutch_key(w.rig.now_ms, &mut w.rig.robot), nothing, 0, false),
        ("the arm's end", |w| w.rig.bridge.end_arm_key(w.rig.now_ms, &mut w.rig.robot), nothing, 0, false),
        (
            "the robot refuses",
            |w| w.rig.bridge.robot_refuses(Some("e-stop".into()), w.rig.now_ms, &mut w.rig.robot),
            |w| w.rig.bridge.robot_refuses(None, w.rig.now_ms, &mut w.rig.robot),
            0,
            true,
        ),
        ("the right hand starts anew", |w| w.rig.connect(Hand::Right, 2), nothing, 0, true),
        ("the left hand starts anew", |w| w.rig.connect(Hand::Left, 2), nothing, 0, true),
    ];
    for (what, begins, ends, noticed_ms, stays_lent) in faults {
        let mut wearer = Wearer::jogging();
        wearer.hold(600, 300, 1500);
        assert!(!wearer.arm_rests(), "{what}");
        begins(&mut wearer);
        wearer.hold(600, 300, noticed_ms + BRAKING_MS);
        assert!(wearer.arm_rests(), "{what}");
        wearer.hold(600, 300, 1000);
        let there = wearer.rig.robot.arm().joints_rad;
        ends(&mut wearer);
        wearer.hold(600, 300, 2000);
        assert_eq!(wearer.rig.robot.arm().joints_rad, there, "{what}: it moves before neutral");
        assert_eq!(wearer.rig.bridge.is_jogging(), stays_lent, "{what}");
        if stays_lent {
            wearer.hold(0, 0, 500);
            wearer.hold(600, 300, 1000);
            assert!(!wearer.arm_rests(), "{what}");
            assert_eq!(wearer.rig.robot.odometry().path_m, 0.0, "{what}");
        }
    }
}

#[test]
fn an_arm_that_the_clutch_lets_go_of_brakes_at_once() {
    // Times from the decision to the first millisecond in which the arm is slower, and to rest.
    let (mut worst_ms, mut rest_ms) = (0, 0);
    for tilted_ms in (300..1500).step_by(130) {
        let mut wearer = Wearer::jogging();
        wearer.hold(698, -400, tilted_ms);
        let speed = |w: &Wearer| w.rig.robot.arm().velocity_rad_s.iter().map(|v| v * v).sum::<f64>();
        let (from_ms, mut last) = (wearer.rig.now_ms, speed(&wearer));
        assert!(last > 0.0);
        let now_ms = wearer.rig.now_ms;
        wearer.rig.bridge.clutch_key(now_ms, &mut wearer.rig.robot);
        loop {
            wearer.rig.run(1);
            let now = speed(&wearer);
            if now < last {
                break;
            }
            last = now;
        }
        worst_ms = worst_ms.max(wearer.rig.now_ms - from_ms);
        while !wearer.arm_rests() {
            wearer.rig.run(1);
        }
        rest_ms = rest_ms.max(wearer.rig.now_ms - from_ms);
    }
    println!("clutch opens: the arm brakes after {worst_ms} ms at most, rests after {rest_ms} ms at most");
    assert!(worst_ms <= 2 && rest_ms <= BRAKING_MS, "{worst_ms} {rest_ms}");
}

#[test]
fn without_a_dead_man_or_before_a_busy_arm_the_hand_is_not_lent() {
    let refusal = |wearer: &Wearer| {
        wearer.rig.events.iter().find_map(|event| match event {
            EventKind::MotionRefused { reason, .. } => Some(reason.clone()),
            _ => None,
        })
    };
    // No right hand.
    let config = Config::parse("[jog]\nkey = 'j'\n").unwrap();
    let mut rig = Rig::empty();
    rig.bridge = config.bridge(config.motion_map());
    rig.connect(Hand::Left, 1);
    let mut alone = Wearer { rig, detector: TiltDetector::new(TiltThresholds::DEFAULT) };
    alone.hold(0, 0, 300);
    let now_ms = alone.rig.now_ms;
    alone.rig.bridge.clutch_key(now_ms, &mut alone.rig.robot);
    alone.hold(0, 0, 100);
    assert!(!alone.rig.bridge.is_jogging() && refusal(&alone).unwrap().contains("dead-man"));
    assert_eq!(alone.rig.state(), State::Armed, "and nothing is halted");

    // An arm whose motion is already running continues.
    let mut wearer = Wearer::new();
    wearer.rig.gesture(2);
    wearer.hold(0, 0, 1000);
    wearer.clutch();
    assert!(!wearer.rig.bridge.is_jogging() && refusal(&wearer).unwrap().contains("busy with pick-up"));
    assert!(!wearer.arm_rests());

    // Without a clutch in the configuration, the clutch has no effect.
    let mut rig = Rig::armed();
    let now_ms = rig.now_ms;
    rig.bridge.clutch_key(now_ms, &mut rig.robot);
    assert!(!rig.bridge.is_jogging() && rig.state() == State::Armed);
}

#[test]
fn other_gestures_start_nothing_while_the_hand_is_lent() {
    let mut wearer = Wearer::jogging();
    wearer.rig.events.clear();
    wearer.rig.gesture(2);
    assert_eq!(wearer.rig.take_outcomes(), [GestureOutcome::NotArmed]);
    wearer.hold(0, 0, 1000);
    assert!(wearer.rig.bridge.is_jogging() && wearer.arm_rests());
    assert!(wearer.rig.robot.arm().running.is_none());
}

/// Checks the robot from one millisecond to the next.
struct Watch {
    limits: JointLimits,
    joints_rad: Joints,
    velocity_rad_s: Joints,
    acceleration_rad_s2: Joints,
    jumps: u32,
    moved_ms: u32,
}

impl Watch {
    fn new(wearer: &Wearer) -> Self {
        let robot = wearer.rig.robot.robot();
        let motion = robot.motion();
        Watch {
            limits: *robot.joint_limits(),
            joints_rad: motion.joints_rad,
            velocity_rad_s: motion.velocity_rad_s,
            acceleration_rad_s2: motion.acceleration_rad_s2,
            jumps: 0,
            moved_ms: 0,
        }
    }

    fn look(&mut self, wearer: &Wearer, arm: &SerialArm) {
        let now = wearer.rig.robot.robot().motion();
        let (limits, dt_s) = (&self.limits, 0.001);
        for i in 0..JOINTS {
            let (v, a, j) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i], limits.jerk_rad_s3[i]);
            assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-6), "{now:?}");
            let faster = (now.velocity_rad_s[i] - self.velocity_rad_s[i]).abs();
            let way = (now.joints_rad[i] - self.joints_rad[i]).abs();
            self.jumps += u32::from(faster > a * dt_s + 1e-9) + u32::from(way > v * dt_s + 1e-9);
            if j.is_finite() {
                let change = (now.acceleration_rad_s2[i] - self.acceleration_rad_s2[i]).abs();
                self.jumps += u32::from(change > j * dt_s + 1e-6);
            }
        }
        arm.check(&now.joints_rad).unwrap();
        self.moved_ms += u32::from(now.velocity_rad_s.iter().any(|v| *v != 0.0));
        (self.joints_rad, self.velocity_rad_s) = (now.joints_rad, now.velocity_rad_s);
        self.acceleration_rad_s2 = now.acceleration_rad_s2;
    }
}

#[test]
fn hands_at_random_jog_in_a_scene_within_all_limits_and_touch_nothing() {
    // The tool starts in a box that is open towards the arm.
    let mount_m = DVec3::new(0.1, 0.0, 0.4);
    let [x, y, z] = (support::bare().picture().flange.position_m + mount_m).to_array();
    let side = |name: &str, [dx, dy, dz]: [f64; 3], size: [f64; 3]| {
        let center = [x + dx, y + dy, z + dz];
        format!("[[box]]\nname = \"{name}\"\ncenter_m = {center:?}\nsize_m = {size:?}\n")
    };
    let around = [
        side("floor", [0.15, 0.0, -0.22], [0.4, 0.6, 0.04]),
        side("lid", [0.15, 0.0, 0.22], [0.4, 0.6, 0.04]),
        side("left side", [0.15, 0.3, 0.0], [0.4, 0.04, 0.4]),
        side("right side", [0.15, -0.3, 0.0], [0.4, 0.04, 0.4]),
        side("back", [0.25, 0.0, 0.0], [0.04, 0.6, 0.4]),
    ]
    .concat();
    let faster = "[arm]\nvelocity_scaling = 0.3\nacceleration_scaling = 0.15\n";
    let arm = SerialArm::gen3();
    let seconds = if std::env::var_os("BIMANUAL_FULL").is_some() { 600 } else { 30 };
    let (mut nearest_m, mut jumps, mut moved_ms, mut held, mut path_m) = (f64::INFINITY, 0, 0, 0_u32, 0.0);
    let mut farthest_m: f64 = 0.0;
    // Half of the time with limited jerk.
    for (seed, jerk) in [(1, ""), (2, "jerk_limited = true\n")] {
        let scene = Scene::parse(&format!("{faster}{jerk}{around}")).unwrap();
        let planner = Planner::new(arm.clone(), scene).unwrap();
        let robot = moving::in_scene(planner.clone());
        let mut wearer = Wearer::before(robot, "speed_m_s = 0.3\nlift_m_s = 0.2\nbend_ms = 800\n");
        let mut watch = Watch::new(&wearer);
        let start_m = wearer.flange().position_m;
        let mut random = Random::new(seed);
        let until_ms = wearer.rig.now_ms + seconds * 500;
        let run = |wearer: &mut Wearer, watch: &mut Watch, tilt: [i16; 2], ms: usize| {
            let (mut nearest_m, mut path_m, mut held) = (f64::INFINITY, 0.0, 0);
            let mut last = wearer.flange().position_m;
            for k in 0..ms {
                if k.is_multiple_of(10) {
                    wearer.tilt(tilt[0], tilt[1]);
                }
                wearer.rig.run(1);
                watch.look(wearer, &arm);
                if k.is_multiple_of(20) {
                    let picture = wearer.rig.robot.picture();
                    let around = planner.world().around(Placement::from(picture.odometry));
                    nearest_m = f64::min(nearest_m, around.arm_clearance(&picture.arm.joints_rad).distance_m);
                    path_m += picture.flange.position_m.distance(last);
                    last = picture.flange.position_m;
                    held += u32::from(picture.jog_held.is_some());
                    assert_eq!(picture.odometry.path_m, 0.0, "the base stands still");
                }
            }
            (nearest_m, path_m, held)
        };
        while wearer.rig.now_ms < until_ms {
            let tilt = [random.between(-900.0, 900.0) as i16, random.between(-900.0, 900.0) as i16];
            match random.below(24) {
                0 => wearer.rig.right.top = 3,
                1 => wearer.rig.talking.left = false,
                2..=5 => wearer.rig.left.index_bends = wearer.rig.left.index_bends.wrapping_add(1),
                6..=9 => wearer.rig.left.middle_bends = wearer.rig.left.middle_bends.wrapping_add(1),
                10 => {
                    let now_ms = wearer.rig.now_ms;
                    wearer.rig.bridge.clutch_key(now_ms, &mut wearer.rig.robot);
                }
                _ => {}
            }
            let seen = [run(&mut wearer, &mut watch, tilt, 100 + random.below(4000)), {
                // The fault is over, and the hands are neutral.
                wearer.rig.right.top = 0;
                wearer.rig.talking = [true; 2].into();
                run(&mut wearer, &mut watch, [0, 0], 160)
            }];
            for (near_m, way_m, holds) in seen {
                (nearest_m, path_m, held) = (f64::min(nearest_m, near_m), path_m + way_m, held + holds);
            }
            if !wearer.rig.bridge.is_jogging() && wearer.rig.state() == State::Armed {
                let now_ms = wearer.rig.now_ms;
                wearer.rig.bridge.clutch_key(now_ms, &mut wearer.rig.robot);
                run(&mut wearer, &mut watch, [0, 0], 200);
            }
            farthest_m = farthest_m.max(wearer.flange().position_m.distance(start_m));
        }
        (jumps, moved_ms) = (jumps + watch.jumps, moved_ms + watch.moved_ms);
    }
    println!(
        "{seconds} s of hands at random: the arm moved for {:.1} s and {path_m:.1} m, {farthest_m:.2} m from its start at most; {jumps} jumps over \
         a step's limit; {:.1} mm from the nearest thing at least; held in {held} looks",
        f64::from(moved_ms) / 1000.0,
        1000.0 * nearest_m
    );
    assert_eq!(jumps, 0);
    assert!(nearest_m > 0.001, "{nearest_m}");
    // The hands moved the tool, and came close to an obstacle.
    assert!(
        u64::from(moved_ms) > seconds * 150 && nearest_m < 0.02 && path_m > 0.02 * seconds as f64 && held > 0
    );
}

#[test]
fn without_a_scene_a_hand_cannot_move_the_arm_into_the_robot_itself_or_the_floor_and_is_told_seldom() {
    let world = World::new(SerialArm::gen3(), Scene::default());
    let around = world.around(Placement::default());
    let mut held_by = Vec::new();
    // The tool first moves out of the way, and then down and back towards the robot.
    for (first, then) in [([0, 698], [-300, 0]), ([0, 698], [-300, -300]), ([0, -698], [0, 500])] {
        let mut wearer = Wearer::before(support::bare(), "speed_m_s = 0.2\nlift_m_s = 0.2\nbend_ms = 1000\n");
        wearer.clutch();
        wearer.hold(0, 0, 300);
        wearer.rig.events.clear();
        let (mut nearest_m, mut held_ms) = (f64::INFINITY, 0_u64);
        for k in 0..2500 {
            let [pitch_mrad, roll_mrad] = if k < 150 { first } else { then };
            if k > 150 && k % 50 == 0 {
                wearer.rig.left.middle_bends = wearer.rig.left.middle_bends.wrapping_add(1);
            }
            wearer.hold(pitch_mrad, roll_mrad, 20);
            let picture = wearer.rig.robot.picture();
            nearest_m = nearest_m.min(around.arm_clearance(&picture.arm.joints_rad).distance_m);
            held_ms += if picture.jog_held.is_some() { 20 } else { 0 };
        }
        let notes: Vec<&String> = wearer
            .rig
            .events
            .iter()
            .filter_map(|event| match event {
                EventKind::Robot { text } if text.contains("the tool is held") => Some(text),
                _ => None,
            })
            .collect();
        println!(
            "{:.1} mm, held for {held_ms} ms, at {:.2}: {notes:?}",
            1000.0 * nearest_m,
            wearer.flange().position_m
        );
        assert!(nearest_m > 0.001, "{nearest_m}");
        assert!(notes.len() <= 50, "one a second at most: {}", notes.len());
        held_by.extend(notes.into_iter().cloned());
    }
    // Obstacles held the tool too, and not only the joints' limits. The message names the obstacle.
    assert!(held_by.iter().any(|text| text.contains(" m from the base")), "{held_by:?}");
    assert!(!held_by.iter().any(|text| text.contains("inf")), "{held_by:?}");
}
