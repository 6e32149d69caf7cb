//! Tests inverse kinematics: which poses it solves or rejects.
//! The test also measures how many steps the solver takes in each case.
//! The test prints the processor times of this thread, but does not check them:
//! `cargo test --release -p host-bridge --test plan_ik -- --nocapture`.

#[path = "support/cpu.rs"]
mod cpu;

use cpu::timed;
use host_bridge::arm::gen3::HOME;
use host_bridge::arm::ik::{self, Budget, Solution, Unreachable};
use host_bridge::arm::model::SerialArm;
use host_bridge::plan::{Placement, World};
use host_bridge::robot::Random;
use host_bridge::robot::{DVec3, Joints, Pose};
use host_bridge::scene::Scene;

/// The former budget in steps, which was replaced with a time budget of 0.2 s.
const FORMER: Budget = Budget { steps: 10_000, looks: usize::MAX };

fn anywhere(arm: &SerialArm, random: &mut Random) -> Pose {
    let joints: Joints = std::array::from_fn(|i| {
        let limits = arm.joints.get(i).map(|joint| joint.limit_rad.unwrap_or((-3.1, 3.1)));
        limits.map_or(0.0, |(low, high)| random.between(low, high))
    });
    arm.flange_pose(&joints)
}

fn show(name: &str, spent: &[usize], times_ms: &[f64]) {
    let mean = |sum: f64| sum / times_ms.len() as f64;
    println!(
        "{name:<36}{:>6} tries; steps: mean {:>6.0}, most {:>6}; processor time: mean {:>8.3} ms, most {:>8.3} ms",
        times_ms.len(),
        mean(spent.iter().sum::<usize>() as f64),
        spent.iter().max().unwrap(),
        mean(times_ms.iter().sum()),
        times_ms.iter().copied().fold(0.0, f64::max)
    );
}

#[test]
fn places_within_reach_are_found_with_their_orientation_within_the_budget() {
    let arm = SerialArm::gen3();
    let (mut random, mut spent, mut times_ms) = (Random::new(4), Vec::new(), Vec::new());
    let count = 300;
    for seed in 0..count {
        let target = anywhere(&arm, &mut random);
        let (found, took_ms) = timed(|| ik::solve(&arm, &target, &HOME, seed, |_| true));
        times_ms.push(took_ms);
        let Ok(Solution { joints_rad, steps }) = found else { continue };
        assert!(steps <= Budget::DEFAULT.steps);
        spent.push(steps);
        arm.check(&joints_rad).unwrap();
        let pose = arm.flange_pose(&joints_rad);
        assert!(pose.position_m.abs_diff_eq(target.position_m, 1e-8));
        assert!(pose.rotation.abs_diff_eq(target.rotation, 1e-8));
    }
    show("within reach", &spent, &times_ms);
    println!("{} of {count} solved", spent.len());
    assert!(spent.len() * 100 >= count as usize * 99);
}

#[test]
fn a_place_beyond_reach_is_refused_without_a_step_and_the_search_would_not_have_found_it() {
    let arm = SerialArm::gen3();
    let (mut random, mut refused) = (Random::new(5), 0);
    let (mut times_ms, mut before_ms, mut before_steps) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..40 {
        let mut target = anywhere(&arm, &mut random);
        target.position_m *= 1.6;
        let (answer, took_ms) = timed(|| ik::solve(&arm, &target, &HOME, seed, |_| true));
        if let Err(Unreachable::Beyond { beyond_mm }) = answer {
            assert!(beyond_mm > 0.0);
            refused += 1;
            times_ms.push(took_ms);
            let (searched, took_ms) = timed(|| ik::search(&arm, &target, &HOME, seed, FORMER, |_| true));
            before_ms.push(took_ms);
            let Err(Unreachable::NotFound { steps, position_mm, .. }) = searched else {
                panic!("{searched:?}")
            };
            before_steps.push(steps);
            assert!(position_mm > 0.0);
        }
    }
    assert!(refused >= 20, "{refused}");
    show("beyond reach, refused at once", &vec![0; times_ms.len()], &times_ms);
    show("beyond reach, as before", &before_steps, &before_ms);
    let mut far = arm.flange_pose(&HOME);
    far.position_m = DVec3::new(2.0, 0.0, 0.5);
    let told = ik::solve(&arm, &far, &HOME, 1, |_| true).unwrap_err().to_string();
    assert!(told.contains("beyond the arm's reach"), "{told}");
}

#[test]
fn a_place_that_no_angles_reach_or_that_is_blocked_ends_with_the_budget_and_always_alike() {
    let arm = SerialArm::gen3();
    // The position is within reach, but the tool's orientation would require the elbow to pass through the arm.
    let folded = Pose { position_m: DVec3::new(0.05, 0.0, 0.42), rotation: arm.flange_pose(&HOME).rotation };
    // This position is within reach, but it is inside a box that every solution touches.
    let scene = "[[box]]\nname = \"crate\"\ncenter_m = [0.65, 0.0, 0.75]\nsize_m = [0.5, 0.5, 0.5]";
    let world = World::new(arm.clone(), Scene::parse(scene).unwrap());
    let around = world.around(Placement::default());
    let clear = |joints: &Joints| around.arm_clearance(joints).distance_m >= 0.02;
    let mut inside = arm.flange_pose(&HOME);
    inside.position_m = DVec3::new(0.55, 0.0, 0.35);
    let none: &dyn Fn(&Joints) -> bool = &|_| false;
    for (name, target, accept) in [
        ("within the length, but not reached", &folded, none),
        ("in a box", &inside, &clear as &dyn Fn(&Joints) -> bool),
        ("never accepted", &arm.flange_pose(&HOME), none),
    ] {
        assert!(arm.beyond_reach_m(target) <= 0.0, "{name}");
        let (mut times_ms, mut spent) = (Vec::new(), Vec::new());
        for seed in 0..10 {
            let (answer, took_ms) = timed(|| ik::solve(&arm, target, &HOME, seed, accept));
            let Err(Unreachable::NotFound { steps, looks, .. }) = answer else {
                panic!("{name}: {answer:?}")
            };
            assert!(steps <= Budget::DEFAULT.steps && looks <= Budget::DEFAULT.looks);
            assert!(
                steps == Budget::DEFAULT.steps || looks == Budget::DEFAULT.looks,
                "{name}: it gave up early"
            );
            assert_eq!(ik::solve(&arm, target, &HOME, seed, accept), answer, "{name}");
            times_ms.push(took_ms);
            spent.push(steps);
        }
        show(name, &spent, &times_ms);
        let (mut times_ms, mut spent) = (Vec::new(), Vec::new());
        for seed in 0..3 {
            let (answer, took_ms) = timed(|| ik::search(&arm, target, &HOME, seed, FORMER, accept));
            let Err(Unreachable::NotFound { steps, .. }) = answer else { panic!("{name}: {answer:?}") };
            times_ms.push(took_ms);
            spent.push(steps);
        }
        show(&format!("{name}, as before"), &spent, &times_ms);
    }
}
