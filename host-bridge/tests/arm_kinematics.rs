//! Compares the arm with the reference table, and the table of motions with the paper.

use host_bridge::arm::gen3::{HOME, MAX_JERK_RAD_S3, paper_limits};
use host_bridge::arm::model::SerialArm;
use host_bridge::intent::{Caps, MotionMap};
use host_bridge::robot::Trajectory;
use host_bridge::robot::{DQuat, DVec3, Door as _, JOINTS, Joints, Pose, Twist, joints};
use shared_proto::message::Heading;

#[path = "support/moving.rs"]
mod moving;

use moving::{Virtual as _, bare, pose};

const MOTIONS: [&str; 6] =
    ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "random-top"];

fn flange_pose(joints_rad: &Joints) -> Pose {
    SerialArm::gen3().flange_pose(joints_rad)
}

fn random_top_poses() -> [Joints; 8] {
    std::array::from_fn(|i| pose(&format!("top-{}", i + 1)))
}

/// Angle between two orientations. The formula is accurate near zero, unlike the arc cosine.
fn angle_rad(a: DQuat, b: DQuat) -> f64 {
    4.0 * ((a - b).length().min((a + b).length()) / 2.0).asin()
}

#[test]
fn forward_kinematics_equals_the_reference_on_all_rows() {
    let table = include_str!("data/kinova_gen3_fk.csv");
    let (mut rows, mut worst_m, mut worst_rad) = (0, 0.0_f64, 0.0_f64);
    for line in table.lines().skip(1) {
        let values: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
        let joints: Joints = joints::<7>(values[..7].try_into().unwrap());
        let pose = flange_pose(&joints);
        worst_m = worst_m.max(pose.position_m.distance(DVec3::from_slice(&values[7..10])));
        worst_rad = worst_rad.max(angle_rad(
            pose.quaternion(),
            DQuat::from_xyzw(values[11], values[12], values[13], values[10]),
        ));
        rows += 1;
    }
    println!("{rows} rows: worst {worst_m:.1e} m, {worst_rad:.1e} rad");
    assert_eq!(rows, 200);
    assert!(worst_m <= 1e-6 && worst_rad <= 1e-6);
}

/// Returns two durations of a move: one with the paper's limits, and one with limited jerk as well.
fn move_s(from: Joints, to: Joints) -> [f64; 2] {
    let papers = paper_limits();
    [papers, papers.with_jerk(MAX_JERK_RAD_S3)]
        .map(|limits| Trajectory::through(&[from, to], &[], &limits).duration_s())
}

#[test]
fn single_moves_take_the_papers_times_within_5_per_cent() {
    let circles: Vec<[f64; 2]> = random_top_poses().iter().map(|pose| move_s(HOME, *pose)).collect();
    let mean = |k: usize| circles.iter().map(|times_s| times_s[k]).sum::<f64>() / circles.len() as f64;
    let circle_mean = [mean(0), mean(1)];
    let rows = [
        ("ready → home (up-down)", move_s(pose("ready"), HOME), 3.3),
        ("home → pick-up (to-fro)", move_s(HOME, pose("pick-up")), 5.7),
        ("home → place (left-right)", move_s(HOME, pose("place")), 6.1),
        ("home → place-top-right (rectangle)", move_s(HOME, pose("place-top-right")), 6.4),
        ("home → place-bottom-right (rectangle-flat)", move_s(HOME, pose("place-bottom-right")), 7.1),
        ("home → random-top (circle), mean of 8", circle_mean, 5.9),
    ];
    println!("{:<45}{:>8}{:>8}{:>8}{:>15}", "move", "paper s", "here s", "off %", "jerk-limited s");
    for (name, [here_s, smooth_s], paper_s) in rows {
        let off = (here_s / paper_s - 1.0) * 100.0;
        println!("{name:<45}{paper_s:>8.1}{here_s:>8.2}{off:>8.1}{smooth_s:>15.2}");
        println!("paper: {name} | {paper_s:.1} s | {here_s:.2} s");
        assert!(off.abs() <= 5.0, "{name}");
    }
    println!("random-top poses one by one, s: {circles:.2?}");
    for name in ["ready", "pick-up", "place", "place-top-right", "place-bottom-right", "top-1"] {
        let path = Trajectory::through(&[HOME, pose(name)], &[], &paper_limits());
        for step in 0..=20 {
            let joints_rad = path.motion(path.duration_s() * f64::from(step) / 20.0).joints_rad;
            let DVec3 { x, y, z } = flange_pose(&joints_rad).position_m;
            println!("figure: path | {name} | {x:.4} | {y:.4} | {z:.4}");
        }
    }
}

/// Checks the paper's table II and the motion that each gesture starts.
#[test]
fn tilts_bends_and_gestures_mean_what_the_paper_says() {
    let caps = Caps::default();
    let tilts = [
        ("forward", Heading::Forward, (0.5, 0.0)),
        ("backward", Heading::Backward, (-0.5, 0.0)),
        ("left", Heading::Left, (0.0, 0.5)),
        ("right", Heading::Right, (0.0, -0.5)),
        ("neutral", Heading::Neutral, (0.0, 0.0)),
    ];
    for (name, heading, (linear, angular)) in tilts {
        let Twist { linear_m_s, angular_rad_s } = caps.twist(heading);
        println!(
            "paper: mapping: tilt {name} | {linear:.1} m/s, {angular:.1} rad/s | {linear_m_s:.1} m/s, {angular_rad_s:.1} rad/s"
        );
        assert_eq!((linear_m_s, angular_rad_s), (linear, angular), "{name}");
    }
    for (name, bends, factor) in [("index", (1, 0), 1.1), ("middle", (0, 1), 0.9)] {
        let mut bent = caps;
        bent.bend(bends.0, bends.1);
        let here = bent.linear_m_s / caps.linear_m_s;
        println!("paper: mapping: a bend of the {name} finger | speed × {factor} | speed × {here:.1}");
        assert!((here - factor).abs() < 1e-9, "{name}: {here}");
    }
    let gestures = [
        ("up-down", "home"),
        ("to-fro", "pick-up"),
        ("left-right", "place"),
        ("rectangle", "place-top-right"),
        ("rectangle-flat", "place-bottom-right"),
        ("circle", "random-top"),
    ];
    let map = MotionMap::default();
    for (label, motion) in gestures {
        let here = map.motion(label).expect("the paper's gestures are mapped");
        println!("paper: mapping: gesture {label} | {motion} | {here}");
        assert_eq!(*here, motion);
    }
}

#[test]
fn poses_are_where_their_names_say_within_limits_and_above_the_table() {
    let at = |joints: &Joints| flange_pose(joints).position_m;
    let home = at(&HOME);
    let show = |name: &str, joints: &Joints| {
        let (DVec3 { x, y, z }, tool) = (at(joints), flange_pose(joints).rotation.z_axis);
        println!(
            "{name:<20} x {x:>6.3}  y {y:>6.3}  z {z:>6.3} m, tool points ({:.2}, {:.2}, {:.2})  {joints:.3?}",
            tool.x, tool.y, tool.z
        );
    };
    show("ready", &pose("ready"));
    for name in &MOTIONS[..5] {
        show(name, &pose(name));
    }
    // x forward, y left, z up.
    let down = |joints: &Joints| flange_pose(joints).rotation.z_axis.z < -0.3;
    let pick = pose("pick-up");
    assert!(at(&pick)[2] < home[2] - 0.2 && at(&pick)[0] > 0.3 && at(&pick)[1].abs() < 0.05 && down(&pick));
    let place = pose("place");
    assert!(at(&place)[1] > 0.25 && at(&place)[2] < home[2] - 0.2 && down(&place));
    let top_right = at(&pose("place-top-right"));
    assert!(top_right[1] < -0.25 && top_right[2] > home[2] + 0.1);
    let bottom_right = pose("place-bottom-right");
    assert!(at(&bottom_right)[1] < -0.25 && at(&bottom_right)[2] < home[2] - 0.2 && down(&bottom_right));
    for pose in random_top_poses() {
        show("random-top", &pose);
        assert!(at(&pose)[2] > home[2] + 0.2, "{:?}", at(&pose));
    }
    let named = MOTIONS[..5].iter().map(|name| pose(name));
    let all = named.chain(random_top_poses()).chain([pose("ready")]);
    for joints in all {
        assert_eq!(SerialArm::gen3().check(&joints), Ok(()));
        let lowest = SerialArm::gen3()
            .link_poses(&joints)
            .iter()
            .map(|pose: &Pose| pose.position_m[2])
            .fold(1.0, f64::min);
        assert!(lowest > 0.1 - 1e-9, "{lowest} {joints:?}");
    }
}

#[test]
fn every_pair_of_motions_keeps_joint_limits_all_the_way() {
    for first in MOTIONS {
        for second in MOTIONS {
            let mut robot = bare();
            for motion in [first, second] {
                robot.start(motion).unwrap();
                while robot.arm().running.is_some() {
                    robot.drive(Twist::ZERO);
                    robot.pass(5);
                    let state = robot.arm();
                    assert_eq!(SerialArm::gen3().check(&state.joints_rad), Ok(()));
                    for i in 0..JOINTS {
                        let limit = paper_limits().velocity_rad_s[i];
                        assert!(state.velocity_rad_s[i].abs() <= limit * (1.0 + 1e-9));
                    }
                }
            }
        }
    }
}
