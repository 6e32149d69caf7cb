//! A serial arm from a URDF file (feature `urdf`, by the crate `urdf-rs`).
//!
//! Boxes, cylinders, capsules and spheres of `<collision>` become capsules that enclose them. Meshes are not
//! read: a link that has nothing else gets a capsule of a given radius along the line to its next joint.

use super::model::{ArmJoint, SerialArm};
use host_robot::shape::{Capsule, Point};
use host_robot::{DMat3, DVec3, JOINTS, Pose};
use urdf_rs::{Collision, Geometry, JointType};

/// What a URDF file does not say.
#[derive(Clone, Debug, PartialEq)]
pub struct Missing {
    /// Last link of the arm; `None` = the only end there is.
    pub tip: Option<String>,
    /// Around the bones of links without simple shapes.
    pub link_radius_m: f64,
    /// For joints without one (URDF 1.2 has it).
    pub acceleration_rad_s2: f64,
}

/// The file describes no arm that can be used.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// It is no URDF.
    #[error("{0}")]
    Form(#[from] urdf_rs::UrdfError),
    /// It is, but not of such an arm.
    #[error("{0}")]
    Kind(String),
}

/// Reads an arm. Its home pose is all zeros, or the nearest to that within the limits.
///
/// # Errors
/// Says what is wrong and what to change.
pub fn parse(text: &str, missing: &Missing) -> Result<SerialArm, UrdfError> {
    let robot = urdf_rs::read_from_string(text)?;
    let kind = |text: String| UrdfError::Kind(text);
    crate::urdf_numbers::check(&robot).map_err(kind)?;
    let tip = match &missing.tip {
        Some(tip) => tip.clone(),
        None => {
            let ends = robot.links.iter().filter(|l| robot.joints.iter().all(|j| j.parent.link != l.name));
            let ends: Vec<&str> = ends.map(|link| link.name.as_str()).collect();
            let [tip] = ends.as_slice() else {
                let ends = ends.join(", ");
                return Err(kind(format!("the robot has several ends ({ends}); name the arm's as tip")));
            };
            (*tip).to_owned()
        }
    };
    // From the tip back to the root.
    let mut chain = Vec::new();
    let mut link = tip.as_str();
    while let Some(joint) = robot.joints.iter().find(|joint| joint.child.link == link) {
        chain.push(joint);
        link = &joint.parent.link;
        if chain.len() > robot.joints.len() {
            return Err(kind("the joints form a circle".to_owned()));
        }
    }
    if chain.is_empty() {
        return Err(kind(format!("no joint leads to the tip '{tip}'; name another link")));
    }
    chain.reverse();
    let collisions = |name: &str| -> &[Collision] {
        robot.links.iter().find(|link| link.name == name).map_or(&[], |link| &link.collision)
    };

    let mut arm = SerialArm {
        name: robot.name.clone(),
        root_link: link.to_owned(),
        joints: Vec::new(),
        flange_m: DVec3::ZERO,
        flange_rotation: Pose::IDENTITY.rotation,
        flange_link: tip.clone(),
        foot: Vec::new(),
        home_rad: [0.0; JOINTS],
    };
    // The frame that has been reached, as seen from the last joint that turns.
    let mut here = Pose::IDENTITY;
    arm.foot.extend(shapes(collisions(link), &here));
    for joint in chain {
        here = here.then(DVec3::from(joint.origin.xyz.0), rotation(joint.origin.rpy.0));
        match joint.joint_type {
            JointType::Fixed => {}
            JointType::Revolute | JointType::Continuous => {
                let name = joint.name.clone();
                if arm.joints.len() == JOINTS {
                    return Err(kind(format!("'{name}' is joint 8; an arm may have {JOINTS} that turn")));
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
                if !(limit.velocity.is_finite() && limit.velocity > 0.0) {
                    return Err(kind(format!("'{name}' has no velocity limit; give it one above 0")));
                }
                let turns_on = joint.joint_type == JointType::Continuous;
                if !turns_on && limit.lower >= limit.upper {
                    return Err(kind(format!(
                        "'{name}' has no range: its lower limit is not below its upper"
                    )));
                }
                bone(&mut arm, here.position_m, missing.link_radius_m);
                let acceleration = limit.acceleration;
                let limit_rad = (!turns_on).then_some((limit.lower, limit.upper));
                let index = arm.joints.len();
                arm.home_rad[index] = limit_rad.map_or(0.0, |(low, high)| 0.0_f64.clamp(low, high));
                arm.joints.push(ArmJoint {
                    name,
                    link: joint.child.link.clone(),
                    origin_m: here.position_m,
                    origin_rotation: here.rotation,
                    axis: axis / length,
                    limit_rad,
                    velocity_rad_s: limit.velocity,
                    acceleration_rad_s2: if acceleration.is_finite() && acceleration > 0.0 {
                        acceleration
                    } else {
                        missing.acceleration_rad_s2
                    },
                    shapes: Vec::new(),
                });
                here = Pose::IDENTITY;
            }
            _ => {
                let name = &joint.name;
                return Err(kind(format!(
                    "'{name}' neither turns nor is fixed; only turning joints can be planned"
                )));
            }
        }
        let found = shapes(collisions(&joint.child.link), &here);
        match arm.joints.last_mut() {
            Some(last) => last.shapes.extend(found),
            None => arm.foot.extend(found),
        }
    }
    if arm.joints.is_empty() {
        return Err(kind(format!("no joint turns on the way to '{tip}'; name another tip")));
    }
    bone(&mut arm, here.position_m, missing.link_radius_m);
    (arm.flange_m, arm.flange_rotation) = (here.position_m, here.rotation);
    Ok(arm)
}

/// A capsule to the next joint, for a link that has no simple shape of its own.
fn bone(arm: &mut SerialArm, next_m: Point, radius_m: f64) {
    if let Some(last) = arm.joints.last_mut()
        && last.shapes.is_empty()
    {
        last.shapes.push(Capsule { a_m: DVec3::ZERO, b_m: next_m, radius_m });
    }
}

fn shapes(collisions: &[Collision], here: &Pose) -> Vec<Capsule> {
    let enclosing = |collision: &Collision| {
        let pose = here.then(collision.origin.xyz.0.into(), rotation(collision.origin.rpy.0));
        let (half, radius_m) = match &collision.geometry {
            Geometry::Sphere { radius } => (DVec3::ZERO, *radius),
            // A capsule as long as the cylinder, with round ends beyond it.
            Geometry::Cylinder { radius, length } | Geometry::Capsule { radius, length } => {
                (0.5 * *length * DVec3::Z, *radius)
            }
            Geometry::Box { size } => {
                let half = 0.5 * DVec3::from(size.0);
                let line = DVec3::AXES[half.max_position()] * half.max_element();
                (line, (half - line).length())
            }
            Geometry::Mesh { .. } => return None,
        };
        Some(Capsule { a_m: pose.at(-half), b_m: pose.at(half), radius_m })
    };
    collisions.iter().filter_map(enclosing).collect()
}

/// Roll about x, then pitch about y, then yaw about z, all about the fixed axes.
fn rotation([roll, pitch, yaw]: [f64; 3]) -> DMat3 {
    DMat3::from_rotation_z(yaw) * DMat3::from_rotation_y(pitch) * DMat3::from_rotation_x(roll)
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::Random;
    use std::fmt::Write as _;

    fn missing() -> Missing {
        Missing { tip: None, link_radius_m: 0.05, acceleration_rad_s2: 8.6 }
    }

    /// The Gen3 written as URDF, from the built-in description.
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
        // Without shapes in the file, bones from joint to joint.
        for (one, two) in read.joints.iter().zip(&built_in.joints) {
            assert_eq!((one.shapes[0].b_m, one.shapes[0].radius_m), (two.shapes[0].b_m, 0.05));
        }
    }

    #[test]
    fn a_file_that_is_no_such_arm_is_refused_with_the_reason() {
        let slides = gen3_urdf().replacen("type=\"revolute\"", "type=\"prismatic\"", 1);
        let two_ends = gen3_urdf().replace("</robot>", "<link name=\"x\"/><joint name=\"c\" type=\"fixed\"><parent link=\"link3\"/><child link=\"x\"/></joint></robot>");
        let still = gen3_urdf().replacen("velocity=\"1.3963\"", "velocity=\"0\"", 1);
        for (text, told) in [
            (slides, "'joint_2' neither turns"),
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
        let [cylinder, bar] = arm.joints[0].shapes.as_slice() else { panic!("{:?}", arm.joints[0].shapes) };
        assert!((cylinder.b_m.y + 0.1).abs() < 1e-12 && (cylinder.b_m.z - 0.1).abs() < 1e-12);
        assert_eq!(cylinder.radius_m, 0.03);
        assert_eq!((bar.b_m, bar.radius_m), (0.2 * DVec3::Y, 0.05));
    }
}
