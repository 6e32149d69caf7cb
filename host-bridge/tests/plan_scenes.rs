//! Plans motions whose straight path is blocked: three scenes, six poses each, all ordered pairs, many seeds.
//! The arm executes each plan in virtual time, and the test checks it every 10 ms.
//!
//! `BIMANUAL_FULL=1` runs 34 seeds per pair. Processor times are printed but not checked.
//! `tests/mujoco/check.py` checks the same motions with an independent physics engine.

#[path = "support/cpu.rs"]
mod cpu;

use cpu::timed;
use host_bridge::arm::ik;
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::things::Things;
use host_bridge::plan::planner::COMPARING_CHECKS_MAX;
use host_bridge::plan::purse::MOTION_CHECKS_MAX;
use host_bridge::plan::{Case, Kind, Placement, Plan, Planner, Purse, Refusal};
use host_bridge::robot::Motion;
use host_bridge::robot::{JOINTS, Joints, Pose, joints};
use host_bridge::scene::Scene;

const SCENES: [(&str, &str); 3] = [
    ("posts", include_str!("../scenes/posts.toml")),
    ("shelf", include_str!("../scenes/shelf.toml")),
    ("bins", include_str!("../scenes/bins.toml")),
];

fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

fn seeds() -> u64 {
    if is_full() { 34 } else { 2 }
}

fn planner(scene: &str) -> Planner {
    Planner::new(SerialArm::gen3(), Scene::parse(scene).unwrap()).unwrap()
}

/// Executes a motion at 100 Hz, checks every sample, and returns the shortest clearance.
fn execute(planner: &Planner, plan: &Plan, from: &Joints, to: &Joints) -> f64 {
    let around = planner.world().around(Placement::default());
    let (limits, dt_s) = (planner.limits(), 0.01);
    let mut before = plan.trajectory.motion(0.0);
    assert_eq!(before.joints_rad, *from);
    let mut nearest = f64::INFINITY;
    let steps = (plan.trajectory.duration_s() / dt_s).ceil() as usize + 1;
    for k in 1..=steps {
        let now = plan.trajectory.motion(k as f64 * dt_s);
        planner.world().arm().check(&now.joints_rad).unwrap();
        for i in 0..JOINTS {
            let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
            assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
            assert!(now.acceleration_rad_s2[i].abs() <= a * (1.0 + 1e-9));
            let moved = now.joints_rad[i] - before.joints_rad[i];
            assert!(moved.abs() <= v * dt_s * (1.0 + 1e-6) + 1e-9);
            let change = now.velocity_rad_s[i] - before.velocity_rad_s[i];
            assert!(change.abs() <= a * dt_s * (1.0 + 1e-6) + 1e-9);
        }
        nearest = nearest.min(around.arm_clearance(&now.joints_rad).distance_m);
        before = now;
    }
    // Complete turns of continuous joints are ignored.
    let there = planner.world().arm().unwound(to, &before.joints_rad);
    assert_eq!(before, Motion::at_rest(before.joints_rad), "ends at rest");
    assert!((0..JOINTS).all(|i| (before.joints_rad[i] - there[i]).abs() < 1e-9), "ends at the pose");
    nearest
}

fn median<T: Copy + PartialOrd>(values: &mut [T]) -> T {
    values.sort_by(|a, b| a.partial_cmp(b).unwrap());
    values[values.len() / 2]
}

#[test]
fn blocked_ways_are_gone_around_without_touching_anything() {
    for (name, text) in SCENES {
        let planner = planner(text);
        let around = planner.world().around(Placement::default());
        let poses = planner.goals();
        assert_eq!(poses.len(), 6, "thirty ordered pairs");
        let (mut blocked, mut tried, mut solved, mut via_home) = (0, 0, 0, 0);
        let (mut checks, mut times_ms, mut nearest_m) = (Vec::new(), Vec::new(), f64::INFINITY);
        for (i, (_, from)) in poses.iter().enumerate() {
            for (j, (_, to)) in poses.iter().enumerate() {
                if i == j {
                    continue;
                }
                blocked += usize::from(!around.way_is_clear(from, to, 1e-4));
                for seed in 0..seeds() {
                    let (plan, took_ms) = timed(|| planner.plan(from, to, Placement::default(), seed));
                    times_ms.push(took_ms);
                    tried += 1;
                    let Ok(plan) = plan else { continue };
                    solved += 1;
                    via_home += usize::from(plan.kind == Kind::ViaHome);
                    checks.push(plan.checks);
                    nearest_m = nearest_m.min(execute(&planner, &plan, from, to));
                }
            }
        }
        let (most_ms, checks) = (times_ms.iter().copied().fold(0.0, f64::max), median(&mut checks));
        let mean_ms = times_ms.iter().sum::<f64>() / times_ms.len() as f64;
        println!(
            "{name}: {blocked}/30 straight ways blocked; {solved}/{tried} solved ({via_home} via home); \
             median {checks} checks; planning mean {mean_ms:.1} ms, median {:.1} ms, longest {most_ms:.1} ms; clearance {:.1} mm",
            median(&mut times_ms),
            nearest_m * 1000.0
        );
        assert!(blocked * 3 >= 30, "the scene is too easy");
        assert!(solved * 100 >= tried * 99);
        assert!(checks <= 4000);
        assert!(nearest_m >= 0.005, "half the margin");
    }
}

#[test]
fn the_best_of_several_plans_is_never_slower_and_costs_no_more_than_its_checks() {
    for (name, text) in SCENES {
        let planner = planner(text);
        let poses = planner.goals();
        let (mut single_s, mut best_s, mut times_ms, mut most) = (0.0, 0.0, Vec::new(), 0);
        for (i, (_, from)) in poses.iter().enumerate() {
            for (j, (_, to)) in poses.iter().enumerate() {
                if i == j || !(is_full() || (i + j) % 3 == 0) {
                    continue;
                }
                let purse = Purse::default();
                let case =
                    Case { placement: Placement::default(), things: planner.world().start(), purse: &purse };
                let single = planner.plan(from, to, Placement::default(), 1).unwrap();
                let (best, took_ms) = timed(|| planner.plan_best(from, to, case, 1).unwrap());
                times_ms.push(took_ms);
                most = most.max(purse.spent());
                assert!(best.trajectory.duration_s() <= single.trajectory.duration_s());
                assert!(purse.spent() <= COMPARING_CHECKS_MAX.max(single.checks) + 8, "{}", purse.spent());
                assert!(execute(&planner, &best, from, to) >= 0.005);
                single_s += single.trajectory.duration_s();
                best_s += best.trajectory.duration_s();
                let again = Purse::default();
                let again = planner.plan_best(from, to, Case { purse: &again, ..case }, 1).unwrap();
                assert_eq!(again.path_rad, best.path_rad, "equal seeds, equal plans");
            }
        }
        println!(
            "{name}: best of several {:.0} % shorter than single plans, at most {most} checks, median {:.1} ms",
            100.0 * (1.0 - best_s / single_s),
            median(&mut times_ms)
        );
        assert!(best_s < 0.97 * single_s, "{best_s} {single_s}");
    }
}

#[test]
fn equal_seeds_give_equal_plans_and_other_seeds_others() {
    let planner = planner(SCENES[0].1);
    let poses = planner.goals();
    let plan = |seed| planner.plan(&poses[0].1, &poses[1].1, Placement::default(), seed).unwrap();
    assert_eq!(plan(5), plan(5));
    assert_ne!(plan(5).path_rad, plan(6).path_rad);
}

#[test]
fn goals_that_cannot_be_reached_safely_are_refused_with_the_reason() {
    for (_, text) in SCENES {
        let planner = planner(text);
        let poses = planner.goals();
        let from = &poses[0].1;
        let refused = |to: &Joints| planner.plan(from, to, Placement::default(), 1).unwrap_err();

        let mut beyond = *from;
        beyond[3] = 3.0;
        assert!(matches!(refused(&beyond), Refusal::GoalBeyondLimit(_)));
        beyond[3] = f64::NAN;
        assert!(matches!(refused(&beyond), Refusal::GoalBeyondLimit(_)));

        // Returns poses with the flange in the middle of each box that the arm can reach.
        let scene = planner.world().scene();
        let mut inside = 0;
        for shape in &scene.boxes {
            let position_m = shape.center_m - scene.base.mount_m;
            for (_, joints) in poses {
                let rotation = planner.world().arm().flange_pose(joints).rotation;
                let Ok(found) =
                    ik::solve(planner.world().arm(), &Pose { position_m, rotation }, joints, 1, |_| true)
                else {
                    continue;
                };
                let refusal = refused(&found.joints_rad);
                assert!(matches!(refusal, Refusal::GoalBlocked { .. }), "{refusal}");
                inside += 1;
            }
        }
        assert!(inside >= 6, "{inside}");
    }
}

/// Returns a wall through the arm's mount, with an opening only around the shoulder.
const WALLS: &str = r#"
[[box]]
name = "right wall"
center_m = [0.1, -0.77, 0.95]
size_m = [0.02, 1.3, 1.9]
[[box]]
name = "left wall"
center_m = [0.1, 0.77, 0.95]
size_m = [0.02, 1.3, 1.9]
[[box]]
name = "lintel"
center_m = [0.1, 0.0, 1.375]
size_m = [0.02, 0.24, 1.05]
"#;

/// Returns joint angles in front of the wall and behind it.
fn before_and_behind() -> (Joints, Joints) {
    let front = joints([0.0, 1.2, std::f64::consts::PI, -1.5, 0.0, 0.5, 1.57]);
    let mut back = front;
    back[0] = std::f64::consts::PI;
    (front, back)
}

#[test]
fn a_goal_behind_closed_walls_is_refused_after_a_bounded_search() {
    let planner = planner(WALLS);
    let (front, back) = before_and_behind();
    let around = planner.world().around(Placement::default());
    assert!(around.arm_clearance(&front).distance_m > 0.01);
    assert!(around.arm_clearance(&back).distance_m > 0.01);
    let refusal = planner.plan(&front, &back, Placement::default(), 1).unwrap_err();
    println!("{refusal}");
    let Refusal::NoWay { checks } = refusal else { panic!("{refusal}") };
    assert!(checks < 31_000, "{checks}");
}

#[test]
fn a_motion_is_planned_or_refused_within_its_checks_and_what_is_planned_with_few_touches_nothing() {
    let few = [0, 1, 2, 5, 20, 100, 300, 1000, 3000, 10_000];
    let planner = planner(SCENES[0].1);
    let (mut planned, mut refused, mut over) = (0, 0, 0);
    for checks in few {
        for (i, (_, from)) in planner.goals().iter().enumerate() {
            for (_, to) in planner.goals().iter().skip(i + 1) {
                let purse = Purse::of(checks);
                let (placement, things) = (Placement::default(), planner.world().start());
                let case = Case { placement, things, purse: &purse };
                match planner.plan_among(from, to, case, 1) {
                    Ok(plan) => {
                        planned += 1;
                        assert!(execute(&planner, &plan, from, to) >= 0.005);
                    }
                    Err(_) => refused += 1,
                }
                over = over.max(purse.spent().saturating_sub(checks));
                assert_eq!(purse.refusal().is_some(), purse.spent() >= checks);
            }
        }
    }
    println!("{planned} planned, {refused} refused, at most {over} checks more than there were");
    assert!(planned > 20 && refused > 20 && over <= 8);

    // The longest possible delay of a stop occurs while a plan uses its whole budget.
    let gripper = format!("{WALLS}\n[[tool]]\nname = \"2f-85\"\n[[tool]]\nname = \"gen3-vision\"\n");
    for (name, scene) in [("bare", WALLS), ("with gripper and vision module", &gripper)] {
        let planner = self::planner(scene);
        let (front, back) = before_and_behind();
        for opening_m in [Some(0.085), None] {
            let purse = Purse::default();
            let things = Things { opening_m, ..planner.world().start().clone() };
            let case = Case { placement: Placement::default(), things: &things, purse: &purse };
            let mut searches = 0;
            let ((), took_ms) = timed(|| {
                while !purse.is_empty() {
                    planner.plan_among(&front, &back, case, searches).unwrap_err();
                    searches += 1;
                }
            });
            println!("{name}, fingers {opening_m:?}: {} checks in {took_ms:.0} ms", purse.spent());
            assert!(purse.spent() <= MOTION_CHECKS_MAX + 8 && searches >= 1);
        }
    }
}
