//! Tests motions of several steps, and the gripper.
//! A cup is picked up, carried and put down. Any failure ends the remaining steps, and is reported.

use host_bridge::base::Twist;
use host_bridge::plan::Planner;
use host_bridge::robot::{Door as _, Report};
use host_bridge::scene::Scene;

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, in_scene};

const SCENE: &str = include_str!("../scenes/pick-and-place.toml");

fn robot(scene: &str) -> Robot {
    let scene = Scene::parse(scene).unwrap();
    in_scene(Planner::new(host_bridge::arm::model::SerialArm::gen3(), scene).unwrap())
}

/// Waits for the end of the current motion, and returns the reports received meanwhile.
fn finish(robot: &mut Robot) -> Vec<Report> {
    let mut reports = Vec::new();
    for _ in 0..4000 {
        robot.drive(Twist::ZERO);
        robot.pass(20);
        reports.extend(robot.take_reports());
        if robot.arm().running.is_none() {
            return reports;
        }
    }
    panic!("{reports:?} {:?}", robot.arm());
}

fn notes(reports: &[Report]) -> Vec<&str> {
    let mut notes = Vec::new();
    for report in reports {
        if let Report::Note(text) = report {
            notes.push(text.as_str());
        }
    }
    notes
}

fn ended(reports: &[Report]) -> Option<bool> {
    reports.iter().find_map(|report| match report {
        Report::MotionEnded { reached, .. } => Some(*reached),
        _ => None,
    })
}

/// Position of the cup, in mm.
fn cup_mm(robot: &Robot) -> [f64; 3] {
    (robot.picture().objects[0].pose.position_m * 1000.0).round().to_array()
}

#[test]
fn a_cup_is_picked_up_carried_while_the_base_drives_and_put_down() {
    let mut robot = robot(SCENE);
    robot.start("pick-up").unwrap();
    let reports = finish(&mut robot);
    println!("{reports:?} at {} ms", robot.now_ms());
    assert_eq!(notes(&reports), ["the gripper has cup (60 mm)"]);
    assert_eq!(ended(&reports), Some(true));
    assert!((robot.picture().opening_m.unwrap() - 0.06).abs() < 1e-9);
    // The bottom of the cup was 70 mm below the point between the fingertips.
    // After the motion, the bottom must be there again.
    assert_eq!(cup_mm(&robot), [450.0, 0.0, 680.0]);
    assert_eq!(robot.picture().held, None);
    for _ in 0..100 {
        robot.drive(Twist { linear_m_s: -0.5, angular_rad_s: 0.0 });
        robot.pass(20);
    }
    for _ in 0..60 {
        robot.drive(Twist::ZERO);
        robot.pass(20);
    }
    let back_mm = -1000.0 * robot.odometry().x_m;
    assert!((900.0..1100.0).contains(&back_mm), "{back_mm}");
    assert_eq!(cup_mm(&robot), [(450.0 - back_mm).round(), 0.0, 680.0]);
    robot.start("place").unwrap();
    let reports = finish(&mut robot);
    println!("{reports:?} at {} ms", robot.now_ms());
    assert!(notes(&reports)[0].starts_with("the gripper let cup fall 0.45 m onto the floor"), "{reports:?}");
}

#[test]
fn what_cannot_be_done_is_refused_with_its_step_before_anything_moves() {
    for (steps, told) in [
        ("{ gripper = \"open\" }, { move_m = [0, 0, 1.5] }", "step 2: the straight line ends after"),
        ("{ gripper = 0.5 }, { to = \"carry\" }", "step 1: the gripper opens 0.085 m at most"),
        (
            "{ to = \"carry\" }, { position_m = [0.8, 0, 0.3], quaternion_wxyz = [0, 1, 0, 0] }",
            "step 2: no joint angles were found",
        ),
        // This step does not follow or precede a gripper step, so the arm must not touch anything.
        (
            "{ position_m = [0.7, 0.0, 0.66], quaternion_wxyz = [0, 1, 0, 0] }, { move_m = [0, 0, -0.14] }",
            "step 2: the straight line is not clear: the gripper's fingers would come within",
        ),
    ] {
        let mut robot = robot(&format!("{SCENE}\n[[motion]]\nname = \"own\"\nsteps = [{steps}]\n"));
        let before = robot.arm();
        let refused = robot.start("own").unwrap_err().to_string();
        assert!(refused.contains(told), "{refused}");
        robot.pass(1000);
        assert_eq!((robot.arm(), robot.picture().opening_m), (before, Some(0.085)));
    }
}

#[test]
fn without_a_gripper_a_motion_that_needs_one_is_refused() {
    let mut robot = robot(&SCENE.replace("[[tool]]\nname = \"2f-85\"", "").replace("# Robotiq", "#"));
    let refused = robot.start("pick-up").unwrap_err().to_string();
    assert!(refused.contains("no gripper") && refused.contains("[[tool]]"), "{refused}");
    assert!(robot.at_rest());
}

#[test]
fn a_stop_while_it_puts_down_leaves_the_cup_in_the_hand_or_where_it_was_put() {
    // The cup is put back in its original position.
    for stop_ms in (500..14_000).step_by(700) {
        let mut robot = robot(SCENE);
        robot.start("pick-up").unwrap();
        finish(&mut robot);
        robot.start("place").unwrap();
        for _ in 0..stop_ms / 20 {
            robot.drive(Twist::ZERO);
            robot.pass(20);
        }
        robot.halt();
        let reports = finish(&mut robot);
        let opening_m = robot.picture().opening_m.unwrap();
        for _ in 0..100 {
            robot.drive(Twist::ZERO);
            robot.pass(20);
        }
        assert_eq!(robot.picture().opening_m, Some(opening_m), "at {stop_ms} ms: {reports:?}");
        robot.start("home").unwrap_or_else(|why| panic!("after a stop at {stop_ms} ms: {why}"));
        assert_eq!(ended(&finish(&mut robot)), Some(true));
        let in_hand = opening_m < 0.0621;
        assert_eq!(cup_mm(&robot)[2] != 450.0, in_hand, "at {stop_ms} ms: {:?}", cup_mm(&robot));
    }
}

#[test]
fn a_stop_anywhere_ends_the_rest_says_so_and_never_opens_the_gripper() {
    let mut parts = Vec::new();
    // The motion takes 17 s, and it is stopped at every half second in turn.
    for stop_ms in (500..17_000).step_by(500) {
        let mut robot = robot(SCENE);
        robot.start("pick-up").unwrap();
        for _ in 0..stop_ms / 20 {
            robot.drive(Twist::ZERO);
            robot.pass(20);
        }
        let held = robot.picture().opening_m.unwrap() < 0.0601;
        let cup_before = cup_mm(&robot);
        robot.halt();
        let reports = finish(&mut robot);
        assert_eq!(ended(&reports), Some(false), "at {stop_ms} ms: {reports:?}");
        let said = notes(&reports).into_iter().find(|note| note.contains("the rest is not done")).unwrap();
        parts.push(said.to_owned());
        let opening_m = robot.picture().opening_m.unwrap();
        assert!(opening_m <= 0.085);
        // No further step is executed. The gripper still holds the object.
        let rested = robot.arm();
        for _ in 0..100 {
            robot.drive(Twist::ZERO);
            robot.pass(20);
        }
        assert_eq!((robot.arm().joints_rad, robot.picture().opening_m), (rested.joints_rad, Some(opening_m)));
        if held {
            assert!(opening_m < 0.0601);
        } else {
            assert_eq!(cup_mm(&robot), cup_before);
        }
        // From every position of a stop there is a path to home, with or without the cup.
        robot.start("home").unwrap_or_else(|why| panic!("after a stop at {stop_ms} ms: {why}"));
        assert_eq!(ended(&finish(&mut robot)), Some(true), "home after a stop at {stop_ms} ms");
        let lifted = cup_mm(&robot)[2] > 451.0;
        assert_eq!(lifted, held, "at {stop_ms} ms: {:?}", cup_mm(&robot));
    }
    parts.dedup();
    println!("{parts:#?}");
    assert!(parts.len() >= 4, "{parts:?}");
}

#[test]
fn fingers_that_close_on_nothing_say_so_and_the_base_waits_for_the_hand() {
    let mut robot = robot(&SCENE.replace("at_m = [0.7, 0.0, 0.45]", "at_m = [0.7, 0.3, 0.45]"));
    robot.start("pick-up").unwrap();
    let mut reports = Vec::new();
    let backward = Twist { linear_m_s: -0.5, angular_rad_s: 0.0 };
    let mut first_drove_ms = None;
    for _ in 0..2000 {
        robot.drive(backward);
        robot.pass(20);
        reports.extend(robot.take_reports());
        if robot.odometry().x_m != 0.0 && first_drove_ms.is_none() {
            first_drove_ms = Some(robot.now_ms());
            assert!(notes(&reports).contains(&"the gripper has nothing between its fingers"), "{reports:?}");
        }
        if robot.arm().running.is_none() {
            break;
        }
    }
    let held = reports.iter().find_map(|report| match report {
        Report::BaseHeld { reason } => Some(reason.as_str()),
        _ => None,
    });
    assert_eq!(held, Some("the hand is at work (pick-up)"));
    assert!(first_drove_ms.is_some());
}

#[test]
fn a_motion_starts_only_while_the_base_stands_where_the_hand_works() {
    let mut robot = robot(SCENE);
    for _ in 0..25 {
        robot.drive(Twist { linear_m_s: -0.5, angular_rad_s: 0.0 });
        robot.pass(20);
    }
    assert!(robot.start("pick-up").unwrap_err().to_string().contains("the base still moves"));
}

#[test]
fn without_a_scene_lines_are_straight_and_the_papers_motions_are_one_trajectory_through_home() {
    use host_bridge::config::Config;
    use host_bridge::robots::Stage;
    let own = "[[motion]]\nname = \"lower\"\nsteps = [{ to = \"pick-up\" }, { move_m = [0, 0, -0.05] }]";
    let config = Config::parse(own).unwrap();
    let mut robot = Stage::new(&config, None).unwrap().simulated(&config);
    let mut flange = Vec::new();
    robot.start("lower").unwrap();
    while robot.arm().running.is_some() {
        robot.drive(Twist::ZERO);
        robot.pass(20);
        flange.push(robot.picture().flange.position_m);
    }
    let end = flange[flange.len() - 1];
    let start = end + 0.05 * host_bridge::robot::DVec3::Z;
    let line: Vec<_> = flange.iter().skip_while(|p| p.distance(start) > 5e-4).collect();
    assert!(line.len() > 10, "{} points of the line", line.len());
    let off_mm = line.iter().map(|p| 1000.0 * (p.x - end.x).hypot(p.y - end.y)).fold(0.0, f64::max);
    println!("the tool leaves the line by {off_mm:.3} mm at most");
    assert!(off_mm < 0.5);
    assert!(robot.start("close-gripper").unwrap_err().to_string().contains("no gripper"));
}

#[test]
fn a_motion_that_is_late_for_its_next_part_or_loses_who_commands_does_not_go_on() {
    let own = "{ to = \"carry\" }, { wait_s = 2 }, { move_m = [0, 0, 0.05] }";
    let mut robot = robot(&format!("{SCENE}\n[[motion]]\nname = \"own\"\nsteps = [{own}]\n"));
    robot.start("own").unwrap();
    for _ in 0..2000 {
        robot.drive(Twist::ZERO);
        robot.pass(20);
        if robot.arm().at_rest() && robot.now_ms() > 500 {
            break;
        }
    }
    let rested = robot.arm().joints_rad;
    assert!(robot.arm().running.is_some(), "it waits");
    // Commands are no longer sent. The simulated robot stops by itself after 0.5 s and does not continue later.
    robot.pass(5000);
    let reports = robot.take_reports();
    assert_eq!(ended(&reports), Some(false), "{reports:?}");
    assert!(notes(&reports).iter().any(|note| note.starts_with("nobody has commanded for")), "{reports:?}");
    assert_eq!(robot.arm().joints_rad, rested);
}
