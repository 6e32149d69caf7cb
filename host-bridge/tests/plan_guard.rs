//! Moves base and arm at random in a scene. Neither may touch an obstacle.
//! Both must stop within the time that follows from their limits.

use host_bridge::arm::model::SerialArm;
use host_bridge::base::Twist;
use host_bridge::plan::{Placement, Planner};
use host_bridge::robot::Door as _;
use host_bridge::robot::JointLimits;
use host_bridge::robot::Random;
use host_bridge::robot::{JOINTS, Joints};
use host_bridge::scene::Scene;

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, pose};

fn in_scene(text: &str, arm_start_rad: Joints) -> (Robot, Planner) {
    let text = format!("[[pose]]\nname = \"ready\"\njoints_rad = {:?}\n{text}", &arm_start_rad[..7]);
    let planner = Planner::new(SerialArm::gen3(), Scene::parse(&text).unwrap()).unwrap();
    (moving::in_scene(planner.clone()), planner)
}

/// Minimum distance from every obstacle, in m.
fn clearance_m(robot: &Robot, planner: &Planner) -> f64 {
    let around = planner.world().around(Placement::from(robot.odometry()));
    around.arm_clearance(&robot.arm().joints_rad).distance_m.min(around.base_clearance().distance_m)
}

/// Computes the change of acceleration of the joints from their speeds in each millisecond.
struct Jerks([[f64; JOINTS]; 2]);

impl Jerks {
    fn new(robot: &Robot) -> Self {
        Jerks([robot.arm().velocity_rad_s; 2])
    }

    fn look(&mut self, robot: &Robot, limits: &JointLimits) {
        let now = robot.arm().velocity_rad_s;
        let [before, last] = self.0;
        for i in 0..JOINTS {
            let bend = (now[i] - 2.0 * last[i] + before[i]).abs() / 1e-6;
            assert!(bend <= limits.jerk_rad_s3[i] * (1.0 + 1e-6) + 1e-6, "joint {i}: {bend} rad/s³");
        }
        self.0 = [last, now];
    }
}

const WALL: &str = r#"
[[box]]
name = "wall"
center_m = [2.0, 0.0, 0.25]
size_m = [0.2, 4.0, 0.5]
"#;

#[test]
fn a_base_driven_at_a_wall_stops_before_it_and_can_leave() {
    let (mut robot, planner) = in_scene(WALL, pose("ready"));
    let forward = Twist { linear_m_s: 1.0, angular_rad_s: 0.0 };
    for _ in 0..1000 {
        robot.drive(forward);
        robot.pass(20);
        assert!(clearance_m(&robot, &planner) > 0.0);
    }
    // The wall's surface is at 1.9 m. The base's front is 0.3 m ahead of its centre.
    let stopped_m = robot.odometry().x_m;
    assert!((1.57..1.6).contains(&stopped_m), "{stopped_m}");
    assert!(robot.at_rest());
    for _ in 0..100 {
        robot.drive(Twist { linear_m_s: -0.5, angular_rad_s: 0.0 });
        robot.pass(20);
    }
    assert!(robot.odometry().x_m < stopped_m - 0.5);
}

#[test]
fn an_arm_that_reaches_out_keeps_the_base_from_a_wall_that_the_base_would_not_touch() {
    // A shelf board is at the height of the arm, above the base.
    let board = WALL.replace("center_m = [2.0, 0.0, 0.25]", "center_m = [2.0, 0.0, 0.9]");
    let mut reaching = [0.0; JOINTS];
    reaching[1] = 1.5;
    let (mut robot, planner) = in_scene(&board, reaching);
    for _ in 0..1000 {
        robot.drive(Twist { linear_m_s: 1.0, angular_rad_s: 0.0 });
        robot.pass(20);
        assert!(clearance_m(&robot, &planner) > 0.0);
    }
    // The arm extends 0.9 m from its mount at 0.1 m, towards a shelf board at 1.9 m.
    assert!((0.75..0.95).contains(&robot.odometry().x_m), "{}", robot.odometry().x_m);
}

#[test]
fn a_goal_behind_the_scenes_boxes_is_refused_and_nothing_moves() {
    let pick_up_blocked = r#"
        [[box]]
        name = "crate"
        center_m = [0.7, 0.0, 0.45]
        size_m = [0.5, 0.5, 0.5]
    "#;
    let (mut robot, _) = in_scene(pick_up_blocked, pose("ready"));
    let refusal = robot.start("pick-up").unwrap_err().to_string();
    println!("{refusal}");
    assert!(refusal.contains("crate"), "{refusal}");
    robot.pass(100);
    assert!(robot.at_rest() && robot.arm().joints_rad == pose("ready"));
}

#[test]
fn base_and_arm_at_random_never_touch_anything_and_always_stop_in_time() {
    let clutter = r#"
        [[box]]
        name = "table"
        center_m = [1.3, 0.3, 0.35]
        size_m = [0.6, 1.0, 0.7]
        [[box]]
        name = "post"
        center_m = [0.4, -1.0, 0.8]
        size_m = [0.1, 0.1, 1.6]
        yaw_rad = 0.4
        [[box]]
        name = "lamp"
        center_m = [-0.5, 0.8, 1.3]
        size_m = [0.3, 0.3, 0.3]
        [[box]]
        name = "wall"
        center_m = [-1.5, 0.0, 0.5]
        size_m = [0.1, 3.0, 1.0]
    "#;
    let motion_names = ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "random-top"];
    let runs = if std::env::var_os("BIMANUAL_FULL").is_some() { 200 } else { 12 };
    let smooth = format!("[arm]\njerk_limited = true\n{clutter}");
    let (mut nearest_m, mut stops, mut motions, mut refused) = (f64::INFINITY, 0, 0, 0);
    let (mut slowest_ms, mut way_m) = (0, 0.0);
    for seed in 0..runs {
        // Every third run uses a limit for jerk.
        let (mut robot, planner) = in_scene(if seed % 3 == 2 { &smooth } else { clutter }, pose("ready"));
        let limits = *planner.limits();
        let mut jerks = Jerks::new(&robot);
        let mut random = Random::new(seed);
        for _ in 0..10 {
            let twist =
                Twist { linear_m_s: random.between(-1.0, 1.0), angular_rad_s: random.between(-1.0, 1.0) };
            if robot.arm().running.is_none() {
                match robot.start(motion_names[random.below(6)]) {
                    Ok(()) => motions += 1,
                    Err(_) => refused += 1,
                }
            }
            for _ in 0..random.below(200) {
                let before = robot.arm();
                let wheels = robot.wheels_rad_s();
                robot.drive(twist);
                for _ in 0..10 {
                    robot.pass(1);
                    jerks.look(&robot, &limits);
                }
                nearest_m = nearest_m.min(clearance_m(&robot, &planner));
                assert!(nearest_m > 0.0, "seed {seed}");
                let now = robot.arm();
                for i in 0..JOINTS {
                    assert!(now.velocity_rad_s[i].abs() <= limits.velocity_rad_s[i] * (1.0 + 1e-9));
                    let change = (now.velocity_rad_s[i] - before.velocity_rad_s[i]).abs();
                    assert!(change <= limits.acceleration_rad_s2[i] * 0.01 * (1.0 + 1e-6) + 1e-9);
                }
                for (a, b) in wheels.into_iter().zip(robot.wheels_rad_s()) {
                    assert!((a - b).abs() <= 10.0 * 0.01 + 1e-9);
                }
            }
            if random.below(3) == 0 {
                robot.halt();
                let mut ms = 0;
                while !robot.at_rest() {
                    robot.pass(1);
                    ms += 1;
                    jerks.look(&robot, &limits);
                    assert!(
                        ms <= 1210,
                        "1.2 m/s at 1 m/s² take 1.2 s, the arm 0.33 s, or 0.6 s with limited jerk"
                    );
                    nearest_m = nearest_m.min(clearance_m(&robot, &planner));
                    assert!(nearest_m > 0.0, "seed {seed}");
                }
                slowest_ms = slowest_ms.max(ms);
            }
        }
        stops += robot.picture().guard_stops;
        way_m += robot.odometry().path_m;
    }
    println!(
        "{runs} runs, {way_m:.0} m driven, {motions} arm motions started, {refused} refused; held back in \
         {stops} ticks; nearest {:.1} mm; slowest stop {slowest_ms} ms",
        nearest_m * 1000.0
    );
    assert!(stops > 0 && motions > 20 && way_m > 10.0);
}
