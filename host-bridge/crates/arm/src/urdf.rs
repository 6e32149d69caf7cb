//! Reads a serial arm from a URDF file (feature `urdf`, with the crate `urdf-rs`). Its joints turn or slide.
//!
//! Shapes of `<collision>` (boxes, cylinders, capsules and spheres) become capsules that enclose them.
//! These shapes include links that are fixed to the arm beside its chain,
//! and meshes that [`crate::urdf_meshes`] could read.
//! Other meshes are reported ([`SerialArm::notes`]).
//! For meshes that were not read, lines of a given radius lead to the next joints.
//! If no joint follows, a ball replaces such a mesh.
//! Moving links without shapes are treated in the same way. Fixed links only add shapes.
//! Moving links outside the chain are ignored, and the program reports this.

use super::model::{ArmJoint, SerialArm};
use crate::scene::ArmTable;
use crate::solid::Solid;
use crate::urdf_shapes::{Shapes, at};
use host_robot::shape::{Capsule, Point};
use host_robot::{DVec3, JOINTS, Pose};
use urdf_rs::{Joint, JointType, Robot};

/// No lift or rail of an arm is longer. Angles above this value would be taken for whole turns elsewhere.
const SLIDE_MAX_M: f64 = 3.0;

/// Settings that a URDF file does not contain.
#[derive(Clone, Debug, PartialEq)]
pub struct Missing {
    /// First link of the arm, whose frame is its base frame; `None` selects the robot's own first link.
    pub root: Option<String>,
    /// Last link of the arm; `None` selects the only tip.
    pub tip: Option<String>,
    /// Radius of the lines that replace links without simple shapes.
    pub link_radius_m: f64,
    /// Acceleration of joints for which the file gives no acceleration (URDF 1.2 permits one).
    pub acceleration_rad_s2: f64,
    /// Speed of continuous joints for which the file specifies no limits.
    pub velocity_rad_s: f64,
}

impl Missing {
    /// Returns the options that a scene specifies.
    pub fn of(table: &ArmTable) -> Self {
        Missing {
            root: table.root.clone(),
            tip: table.tip.clone(),
            link_radius_m: table.link_radius_m,
            acceleration_rad_s2: table.acceleration_rad_s2,
            velocity_rad_s: table.velocity_rad_s,
        }
    }
}

/// The reason why the file does not describe a usable arm.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// It is no URDF.
    #[error("{0}")]
    Form(#[from] urdf_rs::UrdfError),
    /// The file is valid, but describes another kind of robot.
    #[error("{0}")]
    Kind(String),
}

/// Parses an arm. Its home pose is all zeros, or the closest values within the limits.
///
/// # Errors
/// Returns the problem and the necessary change.
pub fn parse(text: &str, missing: &Missing) -> Result<SerialArm, UrdfError> {
    let kind = |text: String| UrdfError::Kind(text);
    if is_xacro(text) {
        return Err(kind(
            "this is a xacro file that was not expanded; `xacro FILE > arm.urdf` writes the URDF".to_owned(),
        ));
    }
    let robot = urdf_rs::read_from_string(text)?;
    crate::urdf_numbers::check(&robot).map_err(kind)?;
    let (chain, link, tip) = chain_of(&robot, missing)?;
    let mut arm = SerialArm {
        name: robot.name.clone(),
        root_link: link.to_owned(),
        joints: Vec::new(),
        flange_m: DVec3::ZERO,
        flange_rotation: Pose::IDENTITY.rotation,
        flange_link: tip.clone(),
        foot: Vec::new(),
        foot_solids: Vec::new(),
        home_rad: [0.0; JOINTS],
        notes: Vec::new(),
    };
    let mut shapes = Shapes::new(&robot, &chain, missing.link_radius_m);
    // Whether the last joint's link has its own shape that was read completely.
    let mut has_shape = true;
    // The current frame, relative to the last moving joint.
    let mut here = Pose::IDENTITY;
    let (capsules, solids) = shapes.of(link, &here, false);
    arm.foot.extend(capsules);
    arm.foot_solids.extend(solids);
    for joint in &chain {
        here = at(&here, joint);
        match joint.joint_type {
            JointType::Fixed => {}
            JointType::Revolute | JointType::Continuous | JointType::Prismatic => {
                let name = joint.name.clone();
                if arm.joints.len() == JOINTS {
                    return Err(kind(format!(
                        "'{name}' is joint {}; an arm may have {JOINTS} that move",
                        JOINTS + 1
                    )));
                }
                if joint.mimic.is_some() {
                    return Err(kind(format!("'{name}' follows another joint; name a tip before it")));
                }
                let axis = DVec3::from(joint.axis.xyz.0);
                let length = axis.length();
                if !(length.is_finite() && length > 0.0) {
                    return Err(kind(format!("'{name}' has no axis")));
                }
                let limit = &joint.limit;
                let turns_on = joint.joint_type == JointType::Continuous;
                // A continuous joint needs no limits, but any given limits must be valid.
                let unlimited = turns_on && limit.velocity == 0.0 && limit.effort == 0.0;
                let velocity_rad_s = if unlimited { missing.velocity_rad_s } else { limit.velocity };
                if !(velocity_rad_s.is_finite() && velocity_rad_s > 0.0) {
                    return Err(kind(format!("'{name}' has no velocity limit; give it one above 0")));
                }
                let (low, high) = within_soft(joint);
                if !turns_on && low >= high {
                    return Err(kind(format!(
                        "'{name}' has no range: its lower limit is not below its upper"
                    )));
                }
                let slides = joint.joint_type == JointType::Prismatic;
                if slides && low.abs().max(high.abs()) > SLIDE_MAX_M {
                    return Err(kind(format!(
                        "'{name}' slides further than {SLIDE_MAX_M} m; give it nearer limits"
                    )));
                }
                if !has_shape {
                    bone(&mut arm, here.position_m, missing.link_radius_m);
                }
                let acceleration = limit.acceleration;
                let limit_rad = (!turns_on).then_some((low, high));
                let index = arm.joints.len();
                arm.home_rad[index] = limit_rad.map_or(0.0, |(low, high)| 0.0_f64.clamp(low, high));
                arm.joints.push(ArmJoint {
                    name,
                    link: joint.child.link.clone(),
                    origin_m: here.position_m,
                    origin_rotation: here.rotation,
                    axis: axis / length,
                    slides,
                    limit_rad,
                    velocity_rad_s,
                    acceleration_rad_s2: if acceleration.is_finite() && acceleration > 0.0 {
                        acceleration
                    } else {
                        missing.acceleration_rad_s2
                    },
                    shapes: Vec::new(),
                    solids: Vec::new(),
                });
                here = Pose::IDENTITY;
                has_shape = shapes.are_whole(&joint.child.link);
            }
            _ => {
                let name = &joint.name;
                return Err(kind(format!(
                    "'{name}' neither turns, slides nor is fixed; only such joints can be planned"
                )));
            }
        }
        let (capsules, solids) = shapes.of(&joint.child.link, &here, joint.joint_type != JointType::Fixed);
        let (into, of) = match arm.joints.last_mut() {
            Some(last) => (&mut last.shapes, &mut last.solids),
            None => (&mut arm.foot, &mut arm.foot_solids),
        };
        into.extend(capsules);
        of.extend(solids);
    }
    if arm.joints.is_empty() {
        return Err(kind(format!("no joint moves on the way to '{tip}'; name another tip")));
    }
    if !has_shape {
        bone(&mut arm, here.position_m, missing.link_radius_m);
    }
    arm.notes.extend(shapes.notes());
    (arm.flange_m, arm.flange_rotation) = (here.position_m, here.rotation);
    Ok(arm)
}

/// Returns the joints from the root to the tip, the root's link, and the tip's link.
pub(crate) fn chain_of<'r>(
    robot: &'r Robot,
    missing: &Missing,
) -> Result<(Vec<&'r Joint>, &'r str, String), UrdfError> {
    let tip = match &missing.tip {
        Some(tip) => tip.clone(),
        None => {
            let ends = robot.links.iter().filter(|l| robot.joints.iter().all(|j| j.parent.link != l.name));
            let ends: Vec<&str> = ends.map(|link| link.name.as_str()).collect();
            let [tip] = ends.as_slice() else {
                let ends = ends.join(", ");
                return Err(UrdfError::Kind(format!(
                    "the robot has several ends ({ends}); name the arm's as tip"
                )));
            };
            (*tip).to_owned()
        }
    };
    // The joints are collected from the tip back to the root.
    let mut chain = Vec::new();
    let mut link = tip.as_str();
    let begins = |link: &str| missing.root.as_deref() == Some(link);
    while let Some(joint) = robot.joints.iter().find(|joint| joint.child.link == link && !begins(link)) {
        chain.push(joint);
        link = &joint.parent.link;
        if chain.len() > robot.joints.len() {
            return Err(UrdfError::Kind("the joints form a circle".to_owned()));
        }
    }
    if let Some(root) = missing.root.as_deref().filter(|root| *root != link) {
        return Err(UrdfError::Kind(format!(
            "'{root}' does not lead to the tip '{tip}'; name a link before it as root"
        )));
    }
    if chain.is_empty() {
        return Err(UrdfError::Kind(format!("no joint leads to the tip '{tip}'; name another link")));
    }
    chain.reverse();
    let root = chain.first().map_or("", |joint| joint.parent.link.as_str());
    Ok((chain, root, tip))
}

/// Adds a capsule that reaches to the next joint to the shapes that were read.
fn bone(arm: &mut SerialArm, next_m: Point, radius_m: f64) {
    if let Some(last) = arm.joints.last_mut() {
        let line = Capsule { a_m: DVec3::ZERO, b_m: next_m, radius_m };
        last.shapes.insert(0, line);
        last.solids.push(Solid::of(&line));
    }
}

/// Returns a joint's limits, restricted by its soft limits.
fn within_soft(joint: &Joint) -> (f64, f64) {
    let (low, high) = (joint.limit.lower, joint.limit.upper);
    match &joint.safety_controller {
        Some(soft) if soft.soft_lower_limit < soft.soft_upper_limit => {
            (low.max(soft.soft_lower_limit), high.min(soft.soft_upper_limit))
        }
        _ => (low, high),
    }
}

/// Returns whether the text contains macros of xacro outside its comments.
pub(crate) fn is_xacro(text: &str) -> bool {
    let mut rest = text;
    let mut live = String::new();
    while let Some((before, comment)) = rest.split_once("<!--") {
        live += before;
        rest = comment.split_once("-->").map_or("", |(_, after)| after);
    }
    live += rest;
    live.contains("<xacro:") || live.contains("=\"${") || live.contains("=\"$(")
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::Random;
    use std::fmt::Write as _;

    fn missing() -> Missing {
        Missing { root: None, tip: None, link_radius_m: 0.05, acceleration_rad_s2: 8.6, velocity_rad_s: 0.5 }
    }

    /// The Gen3 as URDF, generated from the built-in description.
    fn gen3_urdf() -> String {
        let arm = SerialArm::gen3();
        let mut text = String::from("<robot name=\"gen3\"><link name=\"base\"/>");
        for (i, joint) in arm.joints.iter().enumerate() {
            let DVec3 { x, y, z } = joint.origin_m;
            let roll = joint.origin_rotation.y_axis.z.atan2(joint.origin_rotation.z_axis.z);
            let parent = if i == 0 { "base".to_owned() } else { format!("link{i}") };
            let (kind, (low, high)) = match joint.limit_rad {
                Some(limit) => ("revolute", limit),
                None => ("continuous", (0.0, 0.0)),
            };
            let (name, child, v) = (&joint.name, i + 1, joint.velocity_rad_s);
            write!(
                text,
                "<link name=\"link{child}\"/><joint name=\"{name}\" type=\"{kind}\">\
                 <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} 0 0\"/><parent link=\"{parent}\"/>\
                 <child link=\"link{child}\"/><axis xyz=\"0 0 1\"/>\
                 <limit lower=\"{low}\" upper=\"{high}\" effort=\"9\" velocity=\"{v}\"/></joint>"
            )
            .unwrap();
        }
        let pi = std::f64::consts::PI;
        write!(
            text,
            "<link name=\"flange\"/><joint name=\"tool\" type=\"fixed\"><parent link=\"link7\"/>\
             <child link=\"flange\"/><origin xyz=\"0 0 -0.061525\" rpy=\"{pi} 0 0\"/></joint></robot>"
        )
        .unwrap();
        text
    }

    /// The same arm on a lift, whose first joint slides down by 0.6 m from its foot.
    fn lift_urdf() -> String {
        gen3_urdf().replacen("type=\"continuous\"", "type=\"prismatic\"", 1).replacen(
            "lower=\"0\" upper=\"0\" effort=\"9\" velocity=\"1.3963\"",
            "lower=\"0\" upper=\"0.6\" effort=\"9\" velocity=\"0.2\"",
            1,
        )
    }

    #[test]
    fn a_joint_that_slides_moves_everything_beyond_it_along_its_axis_and_nothing_further_than_levers_say() {
        let arm = parse(&lift_urdf(), &missing()).unwrap();
        let lift = &arm.joints[0];
        assert_eq!((lift.slides, lift.limit_rad, lift.velocity_rad_s), (true, Some((0.0, 0.6)), 0.2));
        assert!(arm.joints[1..].iter().all(|joint| !joint.slides));
        let lever_m = arm.lever_m();
        assert_eq!(lever_m[0], 1.0);
        let mut random = Random::new(3);
        for _ in 0..1000 {
            let mut joints: [f64; JOINTS] = std::array::from_fn(|_| random.between(-2.0, 2.0));
            joints[0] = random.between(0.0, 0.5);
            let mut slid = joints;
            slid[0] += 0.1;
            let (one, two) = (arm.flange_pose(&joints), arm.flange_pose(&slid));
            // The axis points down, so the frame is upside down.
            assert!(two.position_m.abs_diff_eq(one.position_m - 0.1 * DVec3::Z, 1e-12));
            assert!(two.rotation.abs_diff_eq(one.rotation, 1e-12));
            let i = random.below(JOINTS);
            let mut moved = joints;
            moved[i] += 0.01;
            let way_m = arm.flange_pose(&moved).position_m.distance(one.position_m);
            assert!(way_m <= 0.01 * lever_m[i] + 1e-12, "joint {i}: {way_m}");
        }
        let beyond = arm.check(&host_robot::joints([0.7])).unwrap_err().to_string();
        assert_eq!(beyond, "joint_1 at 0.700 m is beyond its limits of 0.000 to 0.600 m");
    }

    #[test]
    fn places_of_an_arm_on_a_lift_are_found_and_its_plans_touch_nothing() {
        use crate::plan::{Case, Placement, Planner, Purse};
        let arm = parse(&lift_urdf(), &Missing { link_radius_m: 0.03, ..missing() }).unwrap();
        let (mut random, mut found) = (Random::new(9), 0);
        for seed in 0..100 {
            let joints: [f64; JOINTS] = std::array::from_fn(|i| {
                let limits = arm.joints.get(i).map(|joint| joint.limit_rad.unwrap_or((-3.1, 3.1)));
                limits.map_or(0.0, |(low, high)| random.between(low, high))
            });
            let target = arm.flange_pose(&joints);
            let Ok(solution) = crate::ik::solve(&arm, &target, &arm.home_rad, seed, |_| true) else {
                continue;
            };
            assert_eq!(arm.check(&solution.joints_rad), Ok(()));
            assert!(arm.flange_pose(&solution.joints_rad).position_m.abs_diff_eq(target.position_m, 1e-8));
            found += 1;
        }
        println!("{found} of 100 places found");
        assert!(found >= 95);

        // The arm's foot hangs at a height of 1.6 m, with a bar in front of it.
        // One pose is below the bar and one above it.
        let scene = "[base]\nmount_m = [0.1, 0.0, 1.6]\n[[box]]\nname = \"bar\"\ncenter_m = [0.65, 0.0, 1.2]\nsize_m = [0.3, 1.0, 0.04]\n";
        let planner = Planner::new(arm, crate::scene::Scene::parse(scene).unwrap()).unwrap();
        let world = planner.world();
        let around = world.around(Placement::default());
        let poses: Vec<[f64; JOINTS]> = (0..4000)
            .map(|_| {
                let mut joints: [f64; JOINTS] = std::array::from_fn(|_| random.between(-1.5, 1.5));
                joints[0] = random.between(0.0, 0.6);
                joints[7] = 0.0;
                joints
            })
            .filter(|joints| {
                let near = world.arm().flange_pose(joints).position_m;
                world.arm().check(joints).is_ok()
                    && around.arm_clearance(joints).distance_m > 0.03
                    && (0.3..0.8).contains(&near.x)
            })
            .take(12)
            .collect();
        let (mut planned, mut slid_m, mut nearest_m) = (0, 0.0_f64, f64::INFINITY);
        for two in poses.windows(2) {
            let purse = Purse::default();
            let case = Case { placement: Placement::default(), things: world.start(), purse: &purse };
            let Ok(plan) = planner.plan_among(&two[0], &two[1], case, 1) else { continue };
            planned += 1;
            slid_m = slid_m.max((two[0][0] - two[1][0]).abs());
            for k in 0..=(plan.trajectory.duration_s() / 0.02) as u32 {
                let now = plan.trajectory.motion(f64::from(k) * 0.02);
                assert_eq!(world.arm().check(&now.joints_rad), Ok(()));
                assert!(now.velocity_rad_s[0].abs() <= planner.limits().velocity_rad_s[0] * (1.0 + 1e-9));
                nearest_m = nearest_m.min(around.arm_clearance(&now.joints_rad).distance_m);
            }
        }
        println!(
            "{planned} of {} planned, slid {slid_m:.2} m, {:.1} mm near",
            poses.len() - 1,
            1000.0 * nearest_m
        );
        assert!(poses.len() == 12 && planned >= 10 && slid_m > 0.1 && nearest_m >= 0.005);
    }

    #[test]
    fn the_gen3_as_a_file_is_the_built_in_one() {
        let (read, built_in) = (parse(&gen3_urdf(), &missing()).unwrap(), SerialArm::gen3());
        assert_eq!(read.limits(1.0, 1.0), built_in.limits(1.0, 1.0));
        let mut random = Random::new(1);
        for _ in 0..100 {
            let joints = std::array::from_fn(|_| random.between(-2.0, 2.0));
            let (a, b) = (read.flange_pose(&joints), built_in.flange_pose(&joints));
            assert!(
                a.position_m.abs_diff_eq(b.position_m, 1e-12) && a.rotation.abs_diff_eq(b.rotation, 1e-12)
            );
            assert_eq!(read.check(&joints).is_ok(), built_in.check(&joints).is_ok());
        }
        // If the file contains no shapes, capsules from joint to joint replace them.
        for (i, joint) in read.joints.iter().enumerate() {
            let next_m = read.joints.get(i + 1).map_or(read.flange_m, |next| next.origin_m);
            assert_eq!(joint.shapes, [Capsule { a_m: DVec3::ZERO, b_m: next_m, radius_m: 0.05 }]);
        }
    }

    #[test]
    fn a_file_that_is_no_such_arm_is_refused_with_the_reason() {
        let floats = gen3_urdf().replacen("type=\"revolute\"", "type=\"floating\"", 1);
        let no_range = gen3_urdf().replacen("type=\"continuous\"", "type=\"prismatic\"", 1);
        let too_far = lift_urdf().replacen("upper=\"0.6\"", "upper=\"60\"", 1);
        let two_ends = gen3_urdf().replace("</robot>", "<link name=\"x\"/><joint name=\"c\" type=\"fixed\"><parent link=\"link3\"/><child link=\"x\"/></joint></robot>");
        let still = gen3_urdf().replacen("velocity=\"1.3963\"", "velocity=\"0\"", 1);
        for (text, told) in [
            (floats, "'joint_2' neither turns"),
            (no_range, "'joint_1' has no range"),
            (too_far, "'joint_1' slides further than 3 m"),
            (two_ends.clone(), "several ends (flange, x)"),
            (still, "'joint_1' has no velocity limit"),
        ] {
            let error = parse(&text, &missing()).unwrap_err().to_string();
            assert!(error.contains(told), "{error}");
        }
        assert!(parse("<robot", &missing()).is_err());
        let named = Missing { tip: Some("flange".to_owned()), ..missing() };
        assert_eq!(parse(&two_ends, &named).unwrap().joints.len(), 7);
        let shorter = Missing { tip: Some("x".to_owned()), ..missing() };
        assert_eq!(parse(&two_ends, &shorter).unwrap().joints.len(), 3);
    }

    #[test]
    fn simple_shapes_become_capsules_that_enclose_them() {
        let text = gen3_urdf().replace(
            "<link name=\"link1\"/>",
            "<link name=\"link1\"><collision><origin xyz=\"0 0 0.1\" rpy=\"1.5707963267948966 0 0\"/>\
             <geometry><cylinder radius=\"0.03\" length=\"0.2\"/></geometry></collision>\
             <collision><geometry><box size=\"0.06 0.4 0.08\"/></geometry></collision></link>",
        );
        let arm = parse(&text, &missing()).unwrap();
        assert!(arm.notes.is_empty(), "{:?}", arm.notes);
        let [cylinder, bar] = arm.joints[0].shapes.as_slice() else { panic!("{:?}", arm.joints[0].shapes) };
        assert!((cylinder.b_m.y + 0.1).abs() < 1e-12 && (cylinder.b_m.z - 0.1).abs() < 1e-12);
        assert_eq!(cylinder.radius_m, 0.03);
        assert_eq!((bar.b_m, bar.radius_m), (0.2 * DVec3::Y, 0.05));
    }

    #[test]
    fn what_is_fixed_to_a_link_takes_nothing_away_and_a_mesh_is_told() {
        let mesh = "<collision><geometry><mesh filename=\"package://a/b.stl\"/></geometry></collision>";
        let camera = "<collision><geometry><box size=\"0.02 0.02 0.02\"/></geometry></collision>";
        let text = gen3_urdf()
            .replace("<link name=\"link4\"/>", &format!("<link name=\"link4\">{mesh}{camera}</link>"))
            .replace("<link name=\"flange\"/>", &format!("<link name=\"flange\">{camera}</link>"));
        let arm = parse(&text, &missing()).unwrap();
        // Link 4 keeps its small box and a line in place of its mesh. The same is true of link 7.
        assert_eq!(arm.joints[3].shapes.len(), 2);
        assert!((arm.joints[3].shapes[0].b_m.length() - 0.2085).abs() < 1e-3);
        assert_eq!(arm.joints[6].shapes.len(), 2);
        assert!(arm.notes[0].contains("link4") && arm.notes[0].contains("50 mm"), "{:?}", arm.notes);
    }

    #[test]
    fn a_root_and_what_is_fixed_beside_the_chain_are_counted_and_what_moves_there_is_said() {
        let mesh = "<collision><geometry><mesh filename=\"package://a/b.stl\"/></geometry></collision>";
        let bar = "<collision><geometry><box size=\"0.02 0.02 0.3\"/></geometry></collision>";
        let beside = |name: &str, kind: &str, parent: &str, shape: &str| {
            format!(
                "<link name=\"{name}\">{shape}</link><joint name=\"to-{name}\" type=\"{kind}\"><origin xyz=\"0 0.1 0\"/>\
                 <parent link=\"{parent}\"/><child link=\"{name}\"/><limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
            )
        };
        let more = [
            beside("mast", "fixed", "link2", bar),
            beside("lamp", "fixed", "mast", mesh),
            beside("bumper", "fixed", "base", mesh),
            beside("finger", "prismatic", "flange", bar),
        ];
        let text = gen3_urdf()
            .replace("<link name=\"base\"/>", &format!("<link name=\"base\">{mesh}</link>"))
            .replace("<link name=\"flange\"/>", &format!("<link name=\"flange\">{mesh}</link>"))
            .replace("</robot>", &format!("{}</robot>", more.concat()));
        let arm = parse(&text, &Missing { tip: Some("flange".to_owned()), ..missing() }).unwrap();
        let line = |b_m: [f64; 3]| Capsule { a_m: DVec3::ZERO, b_m: b_m.into(), radius_m: 0.05 };
        let ball = |at: [f64; 3]| Capsule { a_m: at.into(), ..line(at) };
        // The root's mesh is replaced by lines to the first joint and to its fixed link.
        // The mesh of that fixed link is replaced by a ball.
        assert_eq!(arm.foot, [line([0.0, 0.0, 0.15643]), line([0.0, 0.1, 0.0]), ball([0.0, 0.1, 0.0])]);
        // Link 2 has no shape of its own, so it has a line. The mast and its lamp follow.
        let [own, mast, lamp] = arm.joints[1].shapes.as_slice() else { panic!("{:?}", arm.joints[1].shapes) };
        assert!((own.b_m.length() - 0.2105).abs() < 1e-3);
        let half_m = mast.a_m.distance(mast.b_m) / 2.0;
        assert!(
            (half_m - 0.15).abs() < 1e-12 && mast.a_m.lerp(mast.b_m, 0.5).abs_diff_eq(0.1 * DVec3::Y, 1e-12)
        );
        assert_eq!(*lamp, ball([0.0, 0.2, 0.0]));
        // A line replaces the flange's mesh. It leads to the start of the finger, which moves independently.
        assert_eq!(arm.joints[6].shapes.len(), 2, "{:?}", arm.joints[6].shapes);
        let [meshes, moving] = arm.notes.as_slice() else { panic!("{:?}", arm.notes) };
        assert!(meshes.contains("base, bumper, lamp, flange") && meshes.contains("50 mm"), "{meshes}");
        assert!(moving.contains("to-finger"), "{moving}");
    }

    #[test]
    fn links_joined_in_a_circle_beside_the_chain_are_read_once() {
        let joint = |name: &str, parent: &str, child: &str| {
            format!(
                "<joint name=\"{name}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/></joint>"
            )
        };
        let circle = [joint("p", "link2", "x"), joint("q", "x", "y"), joint("r", "y", "x")].concat();
        let text =
            gen3_urdf().replace("</robot>", &format!("<link name=\"x\"/><link name=\"y\"/>{circle}</robot>"));
        let arm = parse(&text, &Missing { tip: Some("flange".to_owned()), ..missing() }).unwrap();
        assert_eq!(arm.joints[1].shapes.len(), 1);
    }

    #[test]
    fn a_file_with_macros_is_refused_and_one_with_macros_in_comments_is_not() {
        let text = gen3_urdf();
        let told = |text: &str| parse(text, &missing()).map(|_| ()).unwrap_err().to_string();
        assert!(
            told(&text.replace("</robot>", "<xacro:gripper parent=\"flange\"/></robot>"))
                .contains("xacro FILE")
        );
        assert!(told(&text.replace("velocity=\"1.3963\"", "velocity=\"${fast}\"")).contains("xacro FILE"));
        let commented = text.replace("</robot>", "<!-- <xacro:gripper/> x=\"${y}\" --></robot>");
        assert!(parse(&commented, &missing()).is_ok());
    }

    #[test]
    fn soft_limits_hold_and_a_joint_without_end_needs_no_limit() {
        let text = gen3_urdf().replacen("velocity=\"1.3963\"/>", "/>", 1);
        let without = text.replacen("<limit lower=\"0\" upper=\"0\" effort=\"9\" />", "", 1);
        let soft =
            "<safety_controller soft_lower_limit=\"-1.5\" soft_upper_limit=\"9\" k_velocity=\"1\"/></joint>";
        // Joint 2 is the first revolute joint.
        let (before, after) = without.split_once("name=\"joint_2\"").unwrap();
        let text = format!("{before}name=\"joint_2\"{}", after.replacen("</joint>", soft, 1));
        let arm = parse(&text, &missing()).unwrap();
        assert_eq!((arm.joints[0].limit_rad, arm.joints[0].velocity_rad_s), (None, 0.5));
        assert_eq!(arm.joints[1].limit_rad, Some((-1.5, 2.24)));
    }

    #[test]
    fn an_arm_may_begin_at_a_link_of_ones_choice() {
        let from = |root: &str| Missing { root: Some(root.to_owned()), ..missing() };
        let arm = parse(&gen3_urdf(), &from("link2")).unwrap();
        assert_eq!((arm.joints.len(), arm.joints[0].name.as_str()), (5, "joint_3"));
        assert!(
            parse(&gen3_urdf(), &from("nowhere"))
                .unwrap_err()
                .to_string()
                .contains("'nowhere' does not lead")
        );
    }
}
