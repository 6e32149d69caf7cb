//! Tests goals that move: a step goes to the current position of an object.
//! If the step is impossible, nothing moves, and the program gives the reason.
//! The tests run in virtual time, with the simulator and with a ROS 2 robot whose replies come from the test.

use host_bridge::arm::Director;
use host_bridge::arm::gen3::{COUNT, HOME, JOINT_NAMES};
use host_bridge::arm::model::SerialArm;
use host_bridge::base::Twist;
use host_bridge::config::Config;
use host_bridge::plan::Planner;
use host_bridge::robot::{DVec3, Door as _, Joints, MotionName, NotStarted, Report, joints};
use host_bridge::robots::Stage;
use host_bridge::ros2::answer::Answer;
use host_bridge::ros2::{ArmInterface, Output, Ros2Config, RosRobot};
use host_bridge::scene::Scene;
use host_bridge::topics::message::{self as ros, JointState, Time};

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, in_scene};

const TABLE: &str = r#"
    [[tool]]
    name = "2f-85"
    [[box]]
    name = "table"
    center_m = [0.9, 0.0, 0.225]
    size_m = [0.6, 0.9, 0.45]
"#;

/// Position of the arm's base on the robot in the default scene.
const MOUNT_M: [f64; 3] = [0.1, 0.0, 0.4];

fn simulated(scene: &str) -> Robot {
    in_scene(Planner::new(SerialArm::gen3(), Scene::parse(scene).unwrap()).unwrap())
}

fn with_cup(at_m: [f64; 3]) -> String {
    format!(
        "{TABLE}
        [arm]
        velocity_scaling = 0.35
        acceleration_scaling = 0.15
        [[object]]
        name = \"cup\"
        at_m = {at_m:?}
        height_m = 0.1
        radius_m = 0.03
        [[motion]]
        name = \"fetch\"
        steps = [
            {{ gripper = \"open\" }},
            {{ position_m = [0, 0, 0.21], quaternion_wxyz = [0, 1, 0, 0], frame = \"cup\" }},
            {{ move_m = [0, 0, -0.14] }},
            {{ gripper = \"close\" }},
            {{ move_m = [0, 0, 0.15] }},
        ]"
    )
}

fn drive(robot: &mut Robot, twist: Twist, ms: u64) {
    for _ in 0..ms / 20 {
        robot.drive(twist);
        robot.pass(20);
    }
}

#[test]
fn the_arm_picks_an_object_up_where_it_stands_and_wherever_the_base_then_is() {
    for (at_m, back_ms) in [([0.7, 0.0, 0.45], 0), ([0.68, 0.12, 0.45], 0), ([0.66, -0.1, 0.45], 400)] {
        let mut robot = simulated(&with_cup(at_m));
        drive(&mut robot, Twist { linear_m_s: -0.1, angular_rad_s: 0.0 }, back_ms);
        drive(&mut robot, Twist::ZERO, 1000);
        robot.start("fetch").unwrap_or_else(|error| panic!("{at_m:?}: {error}"));
        let mut notes = Vec::new();
        let mut has_ended = None;
        for _ in 0..4000 {
            drive(&mut robot, Twist::ZERO, 20);
            for report in robot.take_reports() {
                match report {
                    Report::Note(text) => notes.push(text),
                    Report::MotionEnded { reached, .. } => has_ended = Some(reached),
                    _ => {}
                }
            }
            if has_ended.is_some() {
                break;
            }
        }
        assert_eq!(
            (has_ended, notes),
            (Some(true), vec!["the gripper has cup (60 mm)".to_owned()]),
            "{at_m:?}"
        );
        // The arm cannot move to an object that is in its own gripper.
        let held = robot.start("fetch").map_err(|error| error.to_string());
        assert!(robot.odometry().x_m <= 0.0);
        match held {
            // The motion may begin, because it first opens the gripper, and the cup then falls to a known place.
            Ok(()) => robot.halt(),
            Err(why) => assert!(why.starts_with("step "), "{why}"),
        }
    }
}

#[test]
fn an_object_that_does_not_exist_is_an_error_of_the_file_and_a_topic_is_refused_on_the_simulator() {
    let wrong = with_cup([0.7, 0.0, 0.45]).replace("frame = \"cup\"", "frame = \"mug\"");
    let planner = Planner::new(SerialArm::gen3(), Scene::parse(&wrong).unwrap()).unwrap();
    let error = Stage::new(&Config::default(), Some(planner)).unwrap_err().to_string();
    assert!(error.contains("'fetch', step 2") && error.contains("no object 'mug'"), "{error}");
    let mut robot = simulated(&with_cup([0.7, 0.0, 0.45]).replace("frame = \"cup\"", "frame = \"/cup\""));
    let refused = robot.start("fetch").unwrap_err().to_string();
    assert!(refused.contains("step 2: nobody reads /cup here"), "{refused}");
}

/// Unix time at the start of a test.
const START_S: f64 = 1_790_000_000.0;

const SCENE: &str = r#"
    [[motion]]
    name = "above"
    steps = [{ position_m = [0, 0, 0.2], quaternion_wxyz = [0, 1, 0, 0], frame = "/cup" }]
    [[motion]]
    name = "lower"
    steps = [
        { position_m = [0, 0, 0.2], quaternion_wxyz = [0, 1, 0, 0], frame = "/cup", age_max_s = 0.4 },
        { move_m = [0, 0, -0.05] },
    ]
"#;

/// Creates the robot with this configuration, in the scene with the table.
fn ros2_robot(mut ros2: Ros2Config) -> Director<RosRobot> {
    let config = Config::default();
    let scene = Scene::parse(&format!("{TABLE}{SCENE}")).unwrap();
    let planner = Planner::new(SerialArm::gen3(), scene).unwrap();
    let stage = Stage::new(&config, Some(planner)).unwrap();
    ros2.arm = ArmInterface::Action;
    stage.tell(&mut ros2);
    assert_eq!(ros2.watched.topics, ["/cup"]);
    let mut robot = RosRobot::new(&ros2, stage.limits, config.base);
    robot.set_arm_listened_to(true);
    stage.before(robot)
}

/// `teach --play` waits until the director has seen everything, because a graph brings the topics in any order.
#[test]
fn a_motion_in_a_scene_has_not_been_seen_before_the_robots_odometry_and_the_objects_pose_have_come() {
    let (lower, start_s) = (MotionName::from("lower"), START_S);
    let mut door = ros2_robot(Ros2Config::default());
    door.robot_mut().at(10);
    door.robot_mut().set_clock(start_s);
    let name = JOINT_NAMES.map(str::to_owned).to_vec();
    door.robot_mut().see(&JointState { name, position: HOME[..COUNT].to_vec(), ..JointState::default() });
    let stamp = Time::at_ns((start_s * 1e9) as u64);
    let header = ros::Header { stamp, frame_id: "arm_base_link".to_owned() };
    let mut pose = ros::PoseStamped { header, ..ros::PoseStamped::default() };
    (pose.pose.position.x, pose.pose.orientation.w) = (0.55, 1.0);
    door.robot_mut().see_thing("/cup", &pose);
    assert!(!door.has_seen(&lower), "the object alone is not enough");
    let mut base = ros::Odometry::default();
    base.pose.pose.orientation.w = 1.0;
    door.robot_mut().see_base(&base);
    assert!(door.has_seen(&lower));

    let mut door = ros2_robot(Ros2Config::default());
    door.robot_mut().at(10);
    door.robot_mut().set_clock(start_s);
    door.robot_mut().see_base(&base);
    assert!(!door.has_seen(&lower), "the base alone is not enough");
}

/// A ROS 2 robot in virtual time, and a camera that measures the cup's position every 100 ms.
struct Site {
    door: Director<RosRobot>,
    now_ms: u64,
    joints_rad: Joints,
    base: ros::Odometry,
    /// The cup's position in the frame of the arm's base. With `None`, the camera sends nothing.
    cup_m: Option<[f64; 3]>,
    frame: &'static str,
    wanted: Twist,
    sent: Vec<Output>,
    reports: Vec<Report>,
}

impl Site {
    fn new() -> Self {
        Self::with(|door| door)
    }

    fn with(plans: impl FnOnce(Director<RosRobot>) -> Director<RosRobot>) -> Self {
        let mut site = Site {
            door: plans(ros2_robot(Ros2Config::default())),
            now_ms: 0,
            joints_rad: HOME,
            base: ros::Odometry::default(),
            cup_m: Some([0.55, 0.1, 0.1]),
            frame: "arm_base_link",
            wanted: Twist::ZERO,
            sent: Vec::new(),
            reports: Vec::new(),
        };
        site.base.pose.pose.orientation.w = 1.0;
        site.run(500);
        site
    }

    /// Creates the camera's message with a measurement of this age.
    fn message(&self, age_s: f64) -> ros::PoseStamped {
        let stamp_s = START_S + self.now_ms as f64 / 1000.0 - age_s;
        let mut pose = ros::PoseStamped::default();
        pose.header.stamp = Time::at_ns((stamp_s * 1e9).round() as u64);
        pose.header.frame_id = self.frame.to_owned();
        let [x, y, z] = self.cup_m.unwrap_or_default();
        pose.pose.position = ros::Point { x, y, z };
        pose.pose.orientation.w = 1.0;
        pose
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ms += 1;
            let pose = self.message(0.03);
            let robot = self.door.robot_mut();
            robot.at(self.now_ms);
            robot.set_clock(START_S + self.now_ms as f64 / 1000.0);
            if self.now_ms.is_multiple_of(10) {
                let name = JOINT_NAMES.map(str::to_owned).to_vec();
                let position = self.joints_rad[..COUNT].to_vec();
                robot.see(&JointState { name, position, ..JointState::default() });
                robot.see_base(&self.base);
            }
            if self.now_ms.is_multiple_of(100) && self.cup_m.is_some() {
                robot.see_thing("/cup", &pose);
            }
            self.door.step(self.now_ms);
            if self.now_ms.is_multiple_of(20) {
                self.door.drive(self.wanted);
            }
            self.reports.extend(self.door.take_reports());
            self.sent.extend(self.door.robot_mut().take_outputs());
        }
    }

    fn see(&mut self, pose: &ros::PoseStamped) {
        self.door.robot_mut().see_thing("/cup", pose);
    }

    fn start(&mut self, motion: &str) -> Result<(), NotStarted> {
        self.reports.clear();
        self.sent.clear();
        let started = self.door.start_motion(&MotionName::from(motion));
        self.sent.extend(self.door.robot_mut().take_outputs());
        started
    }

    /// Checks that a motion is refused for this reason, and that the robot receives no goal.
    fn refuses(&mut self, motion: &str, told: &str) {
        let refused = self.start(motion).unwrap_err().to_string();
        assert!(refused.contains(told), "{refused}");
        self.run(100);
        assert!(self.goals().is_empty(), "{:?}", self.sent);
    }

    fn goals(&self) -> Vec<(u32, Joints)> {
        let goal = |sent: &Output| match sent {
            Output::Goal { goal, trajectory } => {
                let last: [f64; COUNT] = trajectory.points.last()?.positions.as_slice().try_into().ok()?;
                Some((*goal, joints(last)))
            }
            _ => None,
        };
        self.sent.iter().filter_map(goal).collect()
    }

    /// Returns the position of the tool's point at these joint angles, in the frame of the arm's base.
    fn tool_m(&self, joints_rad: &Joints) -> DVec3 {
        let tool = self.door.picture();
        assert!(!tool.tool.is_empty());
        let world = Planner::new(SerialArm::gen3(), Scene::parse(TABLE).unwrap()).unwrap();
        SerialArm::gen3().flange_pose(joints_rad).at(world.world().tool().point_m())
    }

    /// Moves the arm to its newest goal at a realistic speed, and reports success to the program.
    fn arrive(&mut self) {
        let (goal, there) = *self.goals().last().unwrap();
        self.door.robot_mut().answer(goal, Answer::Accepted);
        let from = self.joints_rad;
        for k in 1..=100 {
            let share = f64::from(k) / 100.0;
            self.joints_rad = std::array::from_fn(|i| from[i] + share * (there[i] - from[i]));
            self.run(30);
        }
        self.door.robot_mut().answer(goal, Answer::Succeeded);
        self.run(20);
    }

    fn ended(&self) -> Option<bool> {
        self.reports.iter().find_map(|report| match report {
            Report::MotionEnded { reached, .. } => Some(*reached),
            _ => None,
        })
    }

    fn told(&self, words: &str) -> bool {
        self.reports.iter().any(|report| match report {
            Report::Note(text) => text.contains(words),
            Report::MotionRefused { reason, .. } => reason.contains(words),
            _ => false,
        })
    }
}

#[test]
fn the_arm_goes_to_where_the_thing_is_in_either_frame() {
    for (frame, off_m) in [("arm_base_link", [0.0; 3]), ("mobile_base", MOUNT_M)] {
        for cup_m in [[0.55, 0.1, 0.1], [0.6, -0.15, 0.15]] {
            let mut site = Site::new();
            if frame == "mobile_base" {
                // The configuration gives the mobile base a frame name that differs from the name of the arm's root.
                site.door = ros2_robot(Ros2Config { base_frame: frame.to_owned(), ..Ros2Config::default() });
            }
            site.frame = frame;
            site.cup_m = Some(std::array::from_fn(|i| cup_m[i] + off_m[i]));
            site.run(500);
            site.start("above").unwrap_or_else(|error| panic!("{frame} {cup_m:?}: {error}"));
            let (_, there) = site.goals()[0];
            let wanted_m = DVec3::from(cup_m) + 0.2 * DVec3::Z;
            let off_m = (site.tool_m(&there) - wanted_m).length();
            assert!(off_m < 1e-3, "{frame} {cup_m:?}: {off_m}");
            site.arrive();
            assert_eq!(site.ended(), Some(true));
        }
    }
}

#[test]
fn stale_unreachable_and_unsafe_goals_are_refused_before_anything_moves() {
    let mut site = Site::new();
    site.cup_m = None;
    // Each step has its own maximum age. A pose that is 0.43 s old is too old for step 1, but not for the other step.
    site.run(400);
    let refused = site.start("lower").unwrap_err().to_string();
    assert!(
        refused.contains("step 1: the newest pose on /cup is 0.43 s old, and may be 0.40 s"),
        "{refused}"
    );
    assert!(site.goals().is_empty());
    site.start("above").unwrap();

    let mut site = Site::new();
    site.cup_m = Some([1.6, 0.0, 0.1]);
    site.run(200);
    site.refuses("above", "beyond the arm's reach");
    // At this position of the cup, the tool would be inside the table.
    site.cup_m = Some([0.7, 0.0, -0.2]);
    site.run(200);
    site.refuses("above", "no joint angles were found");
    site.frame = "camera_link";
    site.run(200);
    site.refuses("above", "its frame is 'camera_link'");
    site.frame = "arm_base_link";
    site.cup_m = Some([f64::NAN, 0.0, 0.1]);
    site.run(200);
    site.refuses("lower", "its position is (NaN, 0, 0.1) m");
}

#[test]
fn a_message_from_long_ago_that_comes_now_is_as_old_as_it_says() {
    let mut site = Site::new();
    let old = site.message(30.0);
    site.cup_m = None;
    site.see(&old);
    site.refuses("above", "30.0");
    let ahead = site.message(-30.0);
    site.see(&ahead);
    site.refuses("above", "30.00 s ahead");
}

#[test]
fn a_base_that_has_moved_since_the_measurement_makes_the_pose_useless() {
    let mut site = Site::new();
    site.wanted = Twist { linear_m_s: -0.2, angular_rad_s: 0.0 };
    site.run(100);
    site.wanted = Twist::ZERO;
    site.cup_m = None;
    site.run(20);
    site.refuses("above", "the base has moved since");
    // A pose that is measured after the base has stopped is accepted.
    site.cup_m = Some([0.55, 0.1, 0.1]);
    site.run(200);
    site.start("above").unwrap();
    // Somebody pushes the base, and the program notices this in the odometry.
    let mut site = Site::new();
    site.base.twist.twist.linear.x = 0.05;
    site.run(30);
    site.base.twist.twist.linear.x = 0.0;
    site.run(20);
    site.refuses("above", "the base has moved since");
}

#[test]
fn a_thing_that_moves_while_the_way_to_it_is_planned_is_not_gone_to() {
    for (moved_m, begins) in [(0.005, true), (0.02, false)] {
        let mut site = Site::with(Director::planning_held);
        site.start("above").unwrap();
        site.cup_m = Some([0.55 + moved_m, 0.1, 0.1]);
        site.run(200);
        site.door.begin_planned();
        site.run(20);
        assert_eq!(!site.goals().is_empty(), begins, "{moved_m}: {:?}", site.reports);
        assert_eq!(site.told("what /cup shows has moved by 0.020 m"), !begins);
    }
    // The plan is also discarded if the topic falls silent during planning.
    let mut site = Site::with(Director::planning_held);
    site.start("above").unwrap();
    site.cup_m = None;
    site.run(700);
    site.door.begin_planned();
    site.run(20);
    assert!(site.goals().is_empty() && site.told("the newest pose on /cup is"), "{:?}", site.reports);
}

#[test]
fn between_two_parts_a_thing_that_moved_ends_the_motion_and_one_that_is_hidden_does_not() {
    let mut site = Site::new();
    site.start("lower").unwrap();
    // The hand hides the cup from the camera.
    site.cup_m = None;
    site.arrive();
    assert_eq!(site.goals().len(), 2, "{:?}", site.reports);
    site.arrive();
    assert_eq!(site.ended(), Some(true));

    let mut site = Site::new();
    site.start("lower").unwrap();
    site.cup_m = Some([0.55, 0.13, 0.1]);
    site.arrive();
    assert_eq!((site.goals().len(), site.ended()), (1, Some(false)));
    assert!(site.told("what /cup shows has moved by 0.030 m"), "{:?}", site.reports);

    // The motion also ends if the camera's pose becomes unusable.
    let mut site = Site::new();
    site.start("lower").unwrap();
    site.frame = "map";
    site.arrive();
    assert_eq!((site.goals().len(), site.ended()), (1, Some(false)));
    assert!(site.told("its frame is 'map'"), "{:?}", site.reports);
}

#[test]
fn the_base_stands_still_from_the_first_step_to_a_thing_on() {
    let mut site = Site::new();
    site.start("lower").unwrap();
    site.wanted = Twist { linear_m_s: -0.3, angular_rad_s: 0.0 };
    site.run(500);
    let drives = |sent: &Output| matches!(sent, Output::Twist(twist) if *twist != Twist::ZERO);
    assert!(!site.sent.iter().any(drives), "{:?}", site.sent.len());
    assert!(site.door.picture().held.is_some_and(|held| held.contains("at work")));
}
