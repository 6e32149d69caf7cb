//! Tests that the cap applies to the robot's outermost point: the base is slower, the further the arm reaches.
//! All tests run in virtual time.

mod support;

use host_bridge::arm::model::SerialArm;
use host_bridge::arm::things::{ObjectPose, Things, in_scene};
use host_bridge::base::{Odometry, Twist};
use host_bridge::bridge::EventKind;
use host_bridge::plan::{Placement, Planner};
use host_bridge::robot::{DVec3, Door as _, Pose, Random, Report};
use host_bridge::safety::{Hand, State};
use host_bridge::scene::Scene;
use shared_proto::message::Heading;
use support::{Rig, Robot, Virtual as _, moving};

/// A cup before the robot, and motions that stretch the arm out.
const SCENE: &str = r#"
[arm]
velocity_scaling = 0.35
acceleration_scaling = 0.15
[[tool]]
name = "2f-85"
[[box]]
name = "table"
center_m = [0.9, 0.0, 0.225]
size_m = [0.6, 0.9, 0.45]
[[box]]
name = "post"
center_m = [-1.2, 1.6, 0.8]
size_m = [0.2, 0.2, 1.6]
[[box]]
name = "wall"
center_m = [-2.6, 0.0, 0.6]
size_m = [0.1, 5.0, 1.2]
[[box]]
name = "lamp"
center_m = [-0.4, -1.7, 1.1]
size_m = [0.4, 0.4, 0.4]
[[object]]
name = "cup"
at_m = [0.7, 0.0, 0.45]
height_m = 0.1
radius_m = 0.03
[[pose]]
name = "carry"
position_m = [0.45, 0.0, 0.75]
quaternion_wxyz = [0, 1, 0, 0]
[[pose]]
name = "out"
joints_rad = [0.0, 1.3, 0.0, 0.1, 0.0, 0.17, 0.0]
[[motion]]
name = "pick-up"
steps = [
    { gripper = "open" },
    { position_m = [0.7, 0.0, 0.66], quaternion_wxyz = [0, 1, 0, 0] },
    { move_m = [0, 0, -0.14] },
    { gripper = "close", effort_n = 20 },
    { move_m = [0, 0, 0.15] },
    { to = "carry" },
]
[[motion]]
name = "place"
steps = [{ to = "carry" }]
[[motion]]
name = "place-top-right"
steps = [{ to = "out" }]
[[motion]]
name = "place-bottom-right"
steps = [{ to = "out" }]
"#;

/// Labels of the rig's right hand.
const TO_FRO: u8 = 2;
const LEFT_RIGHT: u8 = 3;
const RECTANGLE: u8 = 4;

fn planner() -> Planner {
    Planner::new(SerialArm::gen3(), Scene::parse(SCENE).unwrap()).unwrap()
}

/// Waits for the end of the current motion.
fn finish(robot: &mut Robot) -> Vec<Report> {
    let mut reports = Vec::new();
    while robot.arm().running.is_some() {
        robot.drive(Twist::ZERO);
        robot.pass(20);
        reports.extend(robot.take_reports());
        assert!(robot.now_ms() < 120_000, "{reports:?}");
    }
    reports
}

/// The cup in the robot's hand, relative to the flange.
fn cup_in_hand(robot: &Robot, planner: &Planner) -> Things {
    let picture = robot.picture();
    let mount_m = planner.world().scene().base.mount_m;
    let flange = in_scene(Placement::from(picture.odometry), mount_m, &picture.flange);
    let (cup, inverse) = (picture.objects[0].pose, flange.rotation.transpose());
    let on_flange =
        Pose { position_m: inverse * (cup.position_m - flange.position_m), rotation: inverse * cup.rotation };
    Things { opening_m: picture.opening_m, poses: vec![ObjectPose::Held(on_flange)], ..Things::default() }
}

/// The speed of the cup's fastest point because of the base alone, computed from the picture.
fn cup_m_s(robot: &Robot) -> f64 {
    let picture = robot.picture();
    let Odometry { x_m, y_m, twist, .. } = picture.odometry;
    let cup = &picture.objects[0];
    let rim = |k: u32| {
        let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_8).sin_cos();
        let radius_m = cup.radius_m.unwrap();
        [0.0, cup.height_m].map(|z| cup.pose.at(DVec3::new(radius_m * c, radius_m * s, z)))
    };
    let speed = |point_m: DVec3| {
        // v along the heading, plus ω around the middle of the base.
        let (s, c) = picture.odometry.heading_rad.sin_cos();
        let off = point_m - DVec3::new(x_m, y_m, 0.0);
        (twist.linear_m_s * c - twist.angular_rad_s * off.y)
            .hypot(twist.linear_m_s * s + twist.angular_rad_s * off.x)
    };
    (0..16).flat_map(rim).map(speed).fold(0.0, f64::max)
}

/// Turns for 3 s, with this cap and a turn rate of the same number.
fn turn_rate_rad_s(robot: &mut Robot, cap: f64) -> f64 {
    for _ in 0..150 {
        robot.cap(cap);
        robot.drive(Twist { linear_m_s: 0.0, angular_rad_s: cap });
        robot.pass(20);
    }
    robot.odometry().twist.angular_rad_s
}

#[test]
fn the_further_the_arm_and_the_cup_reach_the_slower_the_base_turns() {
    let empty = SCENE.replace("at_m = [0.7", "at_m = [9.7");
    let empty = Planner::new(SerialArm::gen3(), Scene::parse(&empty).unwrap()).unwrap();
    let mut folded = moving::in_scene(empty.clone());
    assert!((turn_rate_rad_s(&mut folded, 0.4) - 0.4).abs() < 1e-9, "a folded arm costs nothing");

    let mut out = moving::in_scene(empty);
    // Away from the table.
    while out.odometry().x_m > -1.0 {
        out.drive(Twist { linear_m_s: -0.5, angular_rad_s: 0.0 });
        out.pass(20);
    }
    finish(&mut out);
    out.start("place-top-right").unwrap();
    finish(&mut out);
    let _ = out.take_reports();
    let bare_rad_s = turn_rate_rad_s(&mut out, 0.4);
    let notes = out.take_reports();
    println!("stretched out: {bare_rad_s:.3} rad/s of 0.4; {notes:?}");
    // The fingertips are 1.2 m from the middle of the base.
    assert!((0.4 / 1.3..0.4 / 1.1).contains(&bare_rad_s), "{bare_rad_s}");
    let told = |text: &str| text.starts_with("the base is slowed to") && text.contains("gripper");
    assert!(matches!(&notes[..], [Report::Note(text)] if told(text)), "{notes:?}");
}

#[test]
fn a_folded_gen3_turns_at_the_cap_and_an_arc_is_slowed_for_the_corners_of_the_body() {
    let mut folded = moving::bare();
    assert!((turn_rate_rad_s(&mut folded, 0.5) - 0.5).abs() < 1e-9);
    // An arc at full speed and full turn rate, which proportional driving permits: the corners of the body are faster.
    folded.cap(0.5);
    for _ in 0..100 {
        folded.drive(Twist { linear_m_s: 0.5, angular_rad_s: 0.5 });
        folded.pass(20);
    }
    let Twist { linear_m_s, angular_rad_s } = folded.odometry().twist;
    assert!((linear_m_s - angular_rad_s).abs() < 1e-9, "the base stays on its arc");
    assert!((0.3..0.45).contains(&linear_m_s), "{linear_m_s}");
}

#[test]
fn with_hands_at_random_the_cup_touches_nothing_and_is_never_faster_than_the_cap() {
    let planner = planner();
    let runs = if std::env::var_os("BIMANUAL_FULL").is_some() { 40 } else { 2 };
    let headings = [Heading::Forward, Heading::Backward, Heading::Left, Heading::Right, Heading::Neutral];
    let (mut fastest, mut nearest_m, mut path_m) = (0.0_f64, f64::INFINITY, 0.0);
    let (mut slowed, mut stops, mut motions) = (0, 0, 0);
    for seed in 0..runs {
        let mut rig = Rig::empty();
        rig.robot = moving::in_scene(planner.clone());
        let ahead_ms = rig.now_ms;
        rig.robot.pass(ahead_ms);
        rig.connect(Hand::Left, 1);
        rig.connect(Hand::Right, 1);
        rig.run(200);
        assert_eq!(rig.state(), State::Armed);
        rig.gesture(TO_FRO);
        while rig.robot.arm().running.is_some() {
            rig.run(20);
        }
        let things = cup_in_hand(&rig.robot, &planner);
        rig.point(Heading::Backward, 3000);
        let mut random = Random::new(seed);
        let mut caps = std::collections::VecDeque::new();
        for _ in 0..40 {
            match random.below(6) {
                0 => rig.left.index_bends = rig.left.index_bends.wrapping_add(random.below(4) as u8),
                1 => rig.left.middle_bends = rig.left.middle_bends.wrapping_add(random.below(3) as u8),
                2 => rig.gesture([RECTANGLE, LEFT_RIGHT][random.below(2)]),
                _ => {}
            }
            rig.left.heading = headings[random.below(5)];
            for _ in 0..random.below(150) {
                rig.run(10);
                let cap = rig.bridge.caps().linear_m_s;
                caps.push_back(cap);
                // A base that was allowed to be faster needs up to a second to slow down.
                if caps.len() > 100 {
                    caps.pop_front();
                }
                let (cup_m_s, most) = (cup_m_s(&rig.robot), caps.iter().copied().fold(0.0, f64::max));
                assert!(cup_m_s <= most + 1e-9, "seed {seed}: {cup_m_s} m/s of {most}");
                fastest = fastest.max(cup_m_s / most);
                let around = planner.world().around_with(Placement::from(rig.robot.odometry()), &things);
                let joints_rad = rig.robot.arm().joints_rad;
                nearest_m = nearest_m.min(around.arm_clearance(&joints_rad).distance_m);
                assert!(nearest_m > 0.0, "seed {seed}");
            }
        }
        let held = cup_in_hand(&rig.robot, &planner);
        let [ObjectPose::Held(before), ObjectPose::Held(after)] = [things.poses[0], held.poses[0]] else {
            panic!("{held:?}")
        };
        assert!(before.position_m.abs_diff_eq(after.position_m, 1e-9), "it is in the hand to the end");
        path_m += rig.robot.odometry().path_m;
        stops += rig.robot.picture().guard_stops;
        let count = |what: fn(&EventKind) -> bool| rig.events.iter().filter(|event| what(event)).count();
        slowed += count(|event| matches!(event, EventKind::Robot { text } if text.contains("slowed")));
        motions += count(|event| matches!(event, EventKind::MotionEnded { reached: true, .. }));
    }
    println!(
        "{runs} runs: {path_m:.1} m, {motions} motions, slowed {slowed} times, {stops} ticks held back; the cup at most at \
         {:.1} % of the cap, nearest {:.1} mm",
        100.0 * fastest,
        1000.0 * nearest_m
    );
    assert!(path_m > 5.0 && slowed > 0 && stops > 0 && motions > 2);
}
