//! Prints the table of motions for all ordered pairs of named poses.
//! Each row compares two paths, the paper's path via home and the planned path.
//! It contains the shortest clearance and the end-point error of each.

use host_bridge::arm::gen3::MAX_JERK_RAD_S3;
use host_bridge::arm::model::SerialArm;
use host_bridge::config::Config;
use host_bridge::plan::{Kind, Placement, Planner};
use host_bridge::robot::{Door as _, JOINTS, JointLimits, Joints, Leg, Motion, Random};
use host_bridge::robots::Stage;
use host_bridge::scene::Scene;

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, pose};

fn planner(scene: &str) -> Planner {
    Planner::new(SerialArm::gen3(), Scene::parse(scene).unwrap()).unwrap()
}

fn starting_at(joints: Joints) -> String {
    format!("[[pose]]\nname = \"ready\"\njoints_rad = {:?}", &joints[..7])
}

/// Checks the limits between two executed samples.
fn assert_within(limits: &JointLimits, before: &Motion, now: &Motion, dt_s: f64) {
    for i in 0..JOINTS {
        let (v, a, j) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i], limits.jerk_rad_s3[i]);
        assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
        assert!(now.acceleration_rad_s2[i].abs() <= a * (1.0 + 1e-9));
        assert!((now.joints_rad[i] - before.joints_rad[i]).abs() <= v * dt_s * (1.0 + 1e-6) + 1e-9);
        assert!((now.velocity_rad_s[i] - before.velocity_rad_s[i]).abs() <= a * dt_s * (1.0 + 1e-6) + 1e-9);
        let change = (now.acceleration_rad_s2[i] - before.acceleration_rad_s2[i]).abs();
        assert!(change <= j * dt_s * (1.0 + 1e-6) + 1e-9, "joint {i}: {change} of {}", j * dt_s);
    }
}

fn run_to_rest_s(robot: &mut Robot) -> f64 {
    let from_ms = robot.now_ms();
    while robot.arm().running.is_some() {
        robot.drive(host_bridge::base::Twist::ZERO);
        robot.pass(1);
        assert!(robot.now_ms() < from_ms + 60_000);
    }
    (robot.now_ms() - from_ms) as f64 / 1000.0
}

#[test]
fn all_pairs_of_motions_via_home_and_direct() {
    let (via_home, direct) = (planner("[arm]\nroute = \"via-home\""), planner(""));
    let smooth = planner("[arm]\njerk_limited = true");
    assert_eq!(smooth.limits().jerk_rad_s3, [MAX_JERK_RAD_S3; JOINTS]);
    let around = direct.world().around(Placement::default());
    let names = ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "top-1", "ready"];
    let poses: Vec<(&str, Joints)> = names.map(|name| (name, pose(name))).into();
    println!(
        "{:<19}{:<19}{:>11}{:>10}{:>15}{:>13}{:>11}{:>11}",
        "from", "to", "via home s", "direct s", "jerk-limited s", "via home mm", "direct mm", "error rad"
    );
    let (mut sum_home_s, mut sum_direct_s, mut sum_smooth_s) = (0.0, 0.0, 0.0);
    for (from_name, from) in &poses {
        for (to_name, to) in poses.iter().filter(|(name, _)| name != from_name) {
            let there = via_home.plan(from, to, Placement::default(), 1).unwrap();
            let plan = direct.plan(from, to, Placement::default(), 1).unwrap();
            let smoothly = smooth.plan(from, to, Placement::default(), 1).unwrap();
            assert_eq!((there.kind, plan.kind), (Kind::ViaHome, Kind::Straight));
            assert_eq!(smoothly.path_rad, plan.path_rad);

            // Executes every trajectory as the simulator does.
            let mut ends = Vec::new();
            let mut clearances_m = Vec::new();
            for (plan, limits) in
                [(there, direct.limits()), (plan, direct.limits()), (smoothly, smooth.limits())]
            {
                let mut clearance_m = f64::INFINITY;
                let expected_s = plan.trajectory.duration_s();
                let mut here = Motion::at_rest(*from);
                for step in 1..=(expected_s * 100.0).ceil() as u32 {
                    let next = plan.trajectory.motion(f64::from(step) * 0.01);
                    assert_within(limits, &here, &next, 0.01);
                    clearance_m = around.arm_clearance(&next.joints_rad).distance_m.min(clearance_m);
                    here = next;
                }
                let joints = here.joints_rad;
                let error = joints.iter().zip(to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(error <= 1e-6);
                ends.push((expected_s, error));
                clearances_m.push(clearance_m);
            }
            println!(
                "{from_name:<19}{to_name:<19}{:>11.2}{:>10.2}{:>15.2}{:>13.1}{:>11.1}{:>11.1e}",
                ends[0].0,
                ends[1].0,
                ends[2].0,
                clearances_m[0] * 1000.0,
                clearances_m[1] * 1000.0,
                ends.iter().map(|end| end.1).fold(0.0, f64::max)
            );
            assert!(ends[1].0 <= ends[0].0 + 1e-9, "the direct way is never slower");
            // For a move that reaches cruise speed, the jerk limit adds a fixed time.
            // It is the time in which 0.43 rad/s² builds up.
            assert!((ends[2].0 - ends[1].0 - 0.43 / MAX_JERK_RAD_S3).abs() < 0.02, "{ends:?}");
            assert!(clearances_m.iter().all(|clearance_m| *clearance_m > 0.02));
            sum_home_s += ends[0].0;
            sum_direct_s += ends[1].0;
            sum_smooth_s += ends[2].0;
        }
    }
    println!(
        "sum of all pairs: via home {sum_home_s:.1} s, direct {sum_direct_s:.1} s, \
         direct and jerk-limited {sum_smooth_s:.1} s"
    );
    assert!(sum_direct_s < 0.75 * sum_home_s);
}

#[test]
fn without_a_scene_the_arm_goes_home_first_and_with_one_it_need_not() {
    let mut papers = moving::bare();
    papers.start("place").unwrap();
    run_to_rest_s(&mut papers);
    papers.start("place-top-right").unwrap();
    let papers_s = run_to_rest_s(&mut papers);

    let mut robot = moving::in_scene(planner(&starting_at(pose("place"))));
    robot.start("place-top-right").unwrap();
    let direct_s = run_to_rest_s(&mut robot);
    println!("place → place-top-right: via home {papers_s:.2} s, direct {direct_s:.2} s");
    assert_eq!(robot.arm().joints_rad, pose("place-top-right"));
    assert_eq!(papers.arm().joints_rad, robot.arm().joints_rad);
    // The two parts of the path via home take 6.1 s and 6.4 s. On the straight path, joint 1 turns by 1.654 rad.
    assert!((12.3..12.7).contains(&papers_s) && (12.0..12.3).contains(&direct_s));
    assert_eq!(robot.picture().guard_stops, 0);
}

#[test]
fn without_a_scene_the_arm_goes_straight_if_the_configuration_asks_for_it_and_nothing_is_in_the_way() {
    // The paper's six motions stay as they are; the route is a setting.
    let config = Config::parse("[arm]\nroute = \"direct\"\n").unwrap();
    let mut robot = Stage::new(&config, None).unwrap().simulated(&config);
    for (motion, expected_s) in [("place", 4.0..7.0), ("place-top-right", 12.0..12.3)] {
        robot.start(motion).unwrap();
        assert_eq!(robot.arm().running.map(|(_, leg)| leg), Some(Leg::ToGoal), "not to home first");
        let took_s = run_to_rest_s(&mut robot);
        println!("{motion}: straight in {took_s:.2} s");
        assert!(expected_s.contains(&took_s), "{motion}: {took_s}");
        assert_eq!(robot.arm().joints_rad, pose(motion));
    }

    // Poses at random, all of which are clear. If the straight way to the next one is not, the arm moves through home.
    let around_world = planner("");
    let around = around_world.world().around(Placement::default());
    let mut random = Random::new(21);
    let mut poses: Vec<Joints> = Vec::new();
    while poses.len() < 12 {
        let mut joints_rad = pose("home");
        for (i, wide) in [(0, 2.5), (1, 2.0), (3, 2.3), (5, 1.8)] {
            joints_rad[i] = random.between(-wide, wide);
        }
        if around.arm_clearance(&joints_rad).distance_m > 0.03 {
            poses.push(joints_rad);
        }
    }
    let mut text =
        "[arm]\nroute = \"direct\"\nvelocity_scaling = 1.0\nacceleration_scaling = 0.5\n".to_owned();
    for (i, joints_rad) in poses.iter().enumerate() {
        text += &format!("[[pose]]\nname = \"p{i}\"\njoints_rad = {:?}\n", &joints_rad[..7]);
        text += &format!("[[motion]]\nname = \"m{i}\"\nsteps = [{{ to = \"p{i}\" }}]\n");
    }
    let config = Config::parse(&text).unwrap();
    let mut robot = Stage::new(&config, None).unwrap().simulated(&config);
    let (mut straight, mut via_home, mut nearest_m) = (0, 0, f64::INFINITY);
    for (i, there) in poses.iter().enumerate() {
        let from_rad = robot.arm().joints_rad;
        robot.start(&format!("m{i}")).unwrap();
        let is_straight = robot.arm().running.is_some_and(|(_, leg)| leg == Leg::ToGoal);
        while robot.arm().running.is_some() {
            robot.drive(host_bridge::base::Twist::ZERO);
            robot.pass(10);
            if is_straight {
                nearest_m = nearest_m.min(around.arm_clearance(&robot.arm().joints_rad).distance_m);
            }
        }
        // Continuous joints take the shorter way round.
        let there = around_world.world().arm().unwound(there, &from_rad);
        let tau = std::f64::consts::TAU;
        let off = |(a, b): (&f64, &f64)| ((a - b) / tau - ((a - b) / tau).round()).abs() * tau;
        assert!(robot.arm().joints_rad.iter().zip(&there).map(off).all(|off| off < 1e-9), "m{i}");
        assert_eq!(is_straight, around.way_is_clear(&from_rad, &there, 0.01), "m{i}");
        if is_straight { straight += 1 } else { via_home += 1 }
    }
    println!("{straight} straight, nearest {:.1} mm, {via_home} via home", 1000.0 * nearest_m);
    assert!(straight > 2 && nearest_m > 0.0);
}
