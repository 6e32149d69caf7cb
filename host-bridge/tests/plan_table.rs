//! The table of motions: for all ordered pairs of the named poses, via home as in the paper beside the
//! planned way, with the shortest clearance and the end-point error. And inverse kinematics.

use std::time::Instant;

use host_bridge::arm::gen3::{HOME, Joints};
use host_bridge::arm::ik;
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::motions::{ALL_MOTIONS, READY};
use host_bridge::arm::{ArmMotion, Sequencer};
use host_bridge::plan::random::Random;
use host_bridge::plan::{Kind, Placement, Planner};
use host_bridge::robot::Robot;
use host_bridge::scene::Scene;
use host_bridge::sim::Simulator;

fn planner(scene: &str) -> Planner {
    Planner::new(SerialArm::gen3(), Scene::parse(scene).unwrap()).unwrap()
}

fn starting_at(joints: Joints) -> String {
    format!("[[pose]]\nname = \"ready\"\njoints_rad = {joints:?}")
}

fn run_to_rest_s(arm: &mut Sequencer) -> f64 {
    let mut time_s = 0.0;
    while arm.state().running.is_some() {
        arm.step(0.001);
        time_s += 0.001;
        assert!(time_s < 60.0);
    }
    time_s
}

#[test]
fn all_pairs_of_motions_via_home_and_direct() {
    let (via_home, direct) = (planner("[arm]\nroute = \"via-home\""), planner(""));
    let around = direct.world().around(Placement::default());
    let poses: Vec<(&str, Joints)> =
        ALL_MOTIONS.map(|m| (m.name(), m.goal(0))).into_iter().chain([("ready", READY)]).collect();
    println!(
        "{:<19}{:<19}{:>11}{:>10}{:>13}{:>11}{:>11}",
        "from", "to", "via home s", "direct s", "via home mm", "direct mm", "error rad"
    );
    let (mut sum_home_s, mut sum_direct_s) = (0.0, 0.0);
    for (from_name, from) in &poses {
        for (to_name, to) in poses.iter().filter(|(name, _)| name != from_name) {
            let there = via_home.plan(from, to, Placement::default(), 1).unwrap();
            let plan = direct.plan(from, to, Placement::default(), 1).unwrap();
            assert_eq!((there.kind, plan.kind), (Kind::ViaHome, Kind::Straight));

            // Both executed, as the simulator does.
            let mut ends = Vec::new();
            let mut clearances_m = Vec::new();
            for plan in [there, plan] {
                let mut clearance_m = f64::INFINITY;
                let mut arm = Sequencer::new(*from, *direct.limits());
                let expected_s = plan.trajectory.duration_s();
                arm.start_planned(ArmMotion::Home, plan).unwrap();
                let mut time_s = 0.0;
                while arm.state().running.is_some() {
                    arm.step(0.01);
                    time_s += 0.01;
                    clearance_m = around.arm_clearance(&arm.state().joints_rad).distance_m.min(clearance_m);
                }
                assert!((time_s - expected_s).abs() < 0.0101, "{time_s} {expected_s}");
                let joints = arm.state().joints_rad;
                let error = joints.iter().zip(to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(error <= 1e-6);
                ends.push((expected_s, error));
                clearances_m.push(clearance_m);
            }
            println!(
                "{from_name:<19}{to_name:<19}{:>11.2}{:>10.2}{:>13.1}{:>11.1}{:>11.1e}",
                ends[0].0,
                ends[1].0,
                clearances_m[0] * 1000.0,
                clearances_m[1] * 1000.0,
                ends[0].1.max(ends[1].1)
            );
            assert!(ends[1].0 <= ends[0].0 + 1e-9, "the direct way is never slower");
            assert!(clearances_m.iter().all(|clearance_m| *clearance_m > 0.02));
            sum_home_s += ends[0].0;
            sum_direct_s += ends[1].0;
        }
    }
    println!("sum of all pairs: via home {sum_home_s:.1} s, direct {sum_direct_s:.1} s");
    assert!(sum_direct_s < 0.75 * sum_home_s);
}

#[test]
fn without_a_scene_the_arm_goes_home_first_and_with_one_it_need_not() {
    let mut papers = Sequencer::new(ArmMotion::Place.goal(0), *planner("").limits());
    papers.start(ArmMotion::PlaceTopRight).unwrap();
    let papers_s = run_to_rest_s(&mut papers);

    let mut robot = Simulator::in_scene(planner(&starting_at(ArmMotion::Place.goal(0))).into());
    robot.start_motion(ArmMotion::PlaceTopRight).unwrap();
    let mut direct_s = 0.0;
    while robot.arm().running.is_some() {
        robot.drive(host_bridge::base::Twist::ZERO);
        robot.step(10);
        direct_s += 0.01;
    }
    println!("place → place-top-right: via home {papers_s:.2} s, direct {direct_s:.2} s");
    assert_eq!(robot.arm().joints_rad, ArmMotion::PlaceTopRight.goal(0));
    assert_eq!(papers.state().joints_rad, robot.arm().joints_rad);
    // 6.1 s to home and 6.4 s on; straight, joint 1 turns by 1.654 rad.
    assert!((12.3..12.7).contains(&papers_s) && (12.0..12.3).contains(&direct_s));
    assert_eq!(robot.guard_stops(), 0);
}

#[test]
fn inverse_kinematics_finds_the_place_and_the_orientation() {
    let arm = SerialArm::gen3();
    let (mut random, mut solved, mut steps_s, mut slowest_s) = (Random::new(4), 0, 0.0, 0.0_f64);
    let count = 300;
    for seed in 0..count {
        let joints: Joints = std::array::from_fn(|i| {
            let (low, high) = arm.joints[i].limit_rad.unwrap_or((-3.1, 3.1));
            random.between(low, high)
        });
        let target = arm.flange_pose(&joints);
        let start = Instant::now();
        let found = ik::solve(&arm, &target, &HOME, seed, |_| true);
        let took_s = start.elapsed().as_secs_f64();
        (steps_s, slowest_s) = (steps_s + took_s, slowest_s.max(took_s));
        let Ok(found) = found else { continue };
        arm.check(&found).unwrap();
        let pose = arm.flange_pose(&found);
        for k in 0..3 {
            assert!((pose.position_m[k] - target.position_m[k]).abs() <= 1e-8);
            assert!((0..3).all(|c| (pose.rotation[k][c] - target.rotation[k][c]).abs() <= 1e-8));
        }
        solved += 1;
    }
    println!(
        "{solved} of {count} solved; mean {:.2} ms, slowest {:.2} ms",
        steps_s * 1000.0 / count as f64,
        slowest_s * 1000.0
    );
    assert!(solved * 100 >= count * 99);
}

#[test]
fn a_place_out_of_reach_is_refused_after_the_whole_budget() {
    let arm = SerialArm::gen3();
    let mut target = arm.flange_pose(&HOME);
    target.position_m = [2.0, 0.0, 0.5];
    let start = Instant::now();
    let error = ik::solve(&arm, &target, &HOME, 1, |_| true).unwrap_err();
    println!("{error} ({} steps in {:.0} ms)", ik::STEPS_MAX, start.elapsed().as_secs_f64() * 1000.0);
    assert!(error.position_mm > 500.0, "{error:?}");
    assert!(error.to_string().contains("choose another place"));
    assert_eq!(ik::solve(&arm, &target, &HOME, 1, |_| true).unwrap_err(), error);
}
