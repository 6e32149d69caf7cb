//! Tests the simulator's URDF on a ROS 2 graph: it must match the frames that the bridge publishes.
#![cfg(feature = "urdf")]

use std::collections::BTreeSet;

use host_bridge::arm::gen3::COUNT;
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::urdf::{Missing, parse};
use host_bridge::config::Config;
use host_bridge::robot::{Door, Random, RobotSetting};
use host_bridge::robots::Stage;
use host_bridge::ros2::Ros2Config;
use host_bridge::ros2::description::urdf;
use host_bridge::topics::message::Time;
use host_bridge::topics::messages::transforms;

fn setting() -> RobotSetting {
    Stage::bare().simulated(&Config::default()).setting()
}

/// Returns every part of the text between `before` and `after`.
fn between<'a>(text: &'a str, before: &str, after: &str) -> Vec<&'a str> {
    text.split(before).skip(1).filter_map(|rest| rest.split(after).next()).collect()
}

#[test]
fn the_description_read_back_is_the_arm_on_its_base_and_moves_as_it_does() {
    let (setting, config) = (setting(), Ros2Config::default());
    let text = urdf(&setting, &config.frames(&setting).unwrap(), &config);
    let missing =
        Missing { acceleration_rad_s2: 8.6, ..Missing::of(&host_bridge::scene::ArmTable::default()) };
    let (read, arm) = (parse(&text, &missing).unwrap(), SerialArm::gen3());
    assert_eq!(read.root_link, "base_link");
    assert_eq!(read.flange_link, "arm_end_effector_link");
    let mut random = Random::new(7);
    for _ in 0..50 {
        let joints = std::array::from_fn(|_| random.between(-2.0, 2.0));
        let (there, here) = (read.flange_pose(&joints), arm.flange_pose(&joints));
        assert!(there.position_m.abs_diff_eq(here.position_m + setting.mount_m, 1e-9));
        assert!(there.rotation.abs_diff_eq(here.rotation, 1e-9));
    }
    for (one, two) in read.joints.iter().zip(&arm.joints) {
        assert_eq!((&one.name, one.limit_rad), (&two.name, two.limit_rad));
        // The shape consists of a cylinder and two spheres. Together, they reach from one end to the other.
        let ends = one.shapes.iter().map(|shape| (shape.a_m - two.shapes[0].b_m).length());
        assert!(ends.fold(f64::INFINITY, f64::min) < 1e-9, "{}", one.name);
    }
}

#[test]
fn every_frame_that_is_published_is_a_link_of_the_description_and_every_joint_has_its_name() {
    let simulator = Stage::bare().simulated(&Config::default());
    let config = Ros2Config {
        base_frame: "base_footprint".to_owned(),
        arm_prefix: "left_".to_owned(),
        joint_names: (1..=COUNT).map(|i| format!("left_joint_{i}")).collect(),
        ..Ros2Config::default()
    };
    let frames = config.frames(&simulator.setting()).unwrap();
    let text = urdf(&simulator.setting(), &frames, &config);
    let links: BTreeSet<&str> = between(&text, "<link name=\"", "\"").into_iter().collect();
    let told = transforms(&simulator, &simulator.picture(), &simulator.setting(), &frames, Time::default())
        .transforms;
    let children: BTreeSet<&str> = told.iter().map(|t| t.child_frame_id.as_str()).collect();
    assert_eq!(links, children);
    // These are link names as in ros2_kortex, including its prefix.
    for name in ["base_footprint", "left_base_link", "left_shoulder_link", "left_bracelet_link"] {
        assert!(links.contains(name), "{name} in {links:?}");
    }
    for name in &config.joint_names {
        assert!(text.contains(&format!("<joint name=\"{name}\"")), "{name}");
    }
    assert_eq!(told[0].header.frame_id, "odom");
    assert!(told[1..].iter().all(|t| links.contains(t.header.frame_id.as_str())));
    assert_eq!(between(&text, "type=\"continuous\"", "/>").len(), COUNT - 3, "joints 2, 4 and 6 have ends");
}

#[test]
fn two_frames_of_one_name_are_refused_with_the_keys_that_help() {
    let same = Ros2Config { arm_prefix: String::new(), ..Ros2Config::default() };
    let error = same.frames(&setting()).unwrap_err();
    assert!(error.contains("'base_link'") && error.contains("arm_prefix"), "{error}");
    let apart = Ros2Config { arm_base_frame: "arm_foot".to_owned(), ..same };
    assert_eq!(apart.frames(&setting()).unwrap().arm_root, "arm_foot");
}

#[test]
fn a_name_with_signs_of_xml_in_it_stays_a_name() {
    let config = Ros2Config { base_frame: "a<b&\"c\"".to_owned(), ..Ros2Config::default() };
    let text = urdf(&setting(), &config.frames(&setting()).unwrap(), &config);
    assert!(text.contains("<link name=\"a&lt;b&amp;&quot;c&quot;\">"));
}
