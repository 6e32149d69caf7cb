//! Replaces the meshes of a URDF by convex hulls (feature `urdf`).
//!
//! The corners of the hulls are written into the URDF itself, in place of the file names.
//! A recorded session therefore needs no mesh files.

use std::collections::BTreeMap;

use urdf_rs::{Collision, Geometry, JointType, Robot};

use crate::hull::corners;
use crate::urdf::{Missing, UrdfError, chain_of, is_xacro};
use crate::urdf_shapes::{HULL, hull_name};
use host_robot::DVec3;

/// A URDF that stands alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alone {
    /// The URDF.
    pub text: String,
    /// The number of meshes that were read, and notes for users about meshes that were not read.
    pub notes: Vec<String>,
}

/// Replaces the meshes of the arm's links, and of all links fixed to them, by hulls.
/// `read` returns a mesh by its name in the file, or the reason for a failure.
/// A failed mesh stays and gets a note.
///
/// # Errors
/// Returns the errors of [`crate::urdf::parse`] about the joints from root to tip.
pub fn stand_alone(
    text: &str,
    missing: &Missing,
    read: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<Alone, UrdfError> {
    let as_it_is = || Alone { text: text.to_owned(), notes: Vec::new() };
    if is_xacro(text) {
        return Ok(as_it_is());
    }
    let mut robot = urdf_rs::read_from_string(text)?;
    // This check comes before any computation with the file's numbers.
    crate::urdf_numbers::check(&robot).map_err(UrdfError::Kind)?;
    let wanted = links_of(&robot, missing)?;
    let mut known: BTreeMap<(String, [u64; 3]), Result<String, String>> = BTreeMap::new();
    let mut meshes = 0;
    let mut unread: Vec<String> = Vec::new();
    for link in robot.links.iter_mut().filter(|link| wanted.contains(&link.name)) {
        let mut shapes = Vec::new();
        for collision in std::mem::take(&mut link.collision) {
            let Geometry::Mesh { filename, scale } = &collision.geometry else {
                shapes.push(collision);
                continue;
            };
            if filename.starts_with(HULL) {
                shapes.push(collision);
                continue;
            }
            let scale = scale.map_or(DVec3::ONE, |scale| scale.0.into());
            let key = (filename.clone(), scale.to_array().map(f64::to_bits));
            let found = known.entry(key).or_insert_with(|| {
                let bytes = read(filename)?;
                Ok(hull_name(&corners(&crate::mesh::points(filename, &bytes, scale)?)))
            });
            match found {
                Ok(hull) => {
                    meshes += 1;
                    let geometry = Geometry::Mesh { filename: hull.clone(), scale: None };
                    shapes.push(Collision { geometry, ..collision });
                }
                Err(why) => {
                    let why = format!("{filename} is not read: {why}");
                    if !unread.contains(&why) {
                        unread.push(why);
                    }
                    shapes.push(collision);
                }
            }
        }
        link.collision = shapes;
    }
    let mut alone = as_it_is();
    if meshes > 0 {
        for link in &mut robot.links {
            link.visual.clear();
        }
        alone.text = urdf_rs::write_to_string(&robot)?;
        alone.notes.push(format!("{meshes} meshes count: capsules enclose their convex hulls"));
    }
    alone.notes.extend(unread);
    Ok(alone)
}

/// Returns the links of the chain, and all links that are fixed to them.
fn links_of(robot: &Robot, missing: &Missing) -> Result<Vec<String>, UrdfError> {
    let (chain, root, _) = chain_of(robot, missing)?;
    let mut links = vec![root.to_owned()];
    links.extend(chain.iter().map(|joint| joint.child.link.clone()));
    let mut looked = 0;
    while let Some(link) = links.get(looked).cloned() {
        looked += 1;
        for joint in robot.joints.iter().filter(|joint| joint.parent.link == link) {
            if joint.joint_type == JointType::Fixed && !links.contains(&joint.child.link) {
                links.push(joint.child.link.clone());
            }
        }
    }
    Ok(links)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::urdf::parse;
    use host_robot::shape::Capsule;
    use host_robot::{DMat3, Random};
    use std::fmt::Write as _;

    fn missing() -> Missing {
        Missing {
            root: None,
            tip: Some("hand".to_owned()),
            link_radius_m: 0.05,
            acceleration_rad_s2: 2.0,
            velocity_rad_s: 0.5,
        }
    }

    /// The arm has a lift, an endless joint, and a joint within soft limits.
    /// Beside the chain, a lamp is fixed and a finger moves.
    const ARM: &str = r#"<robot name="three"><link name="foot"/>
        <joint name="lift" type="prismatic"><origin xyz="0 0 0.2" rpy="0.1 -0.2 0.3"/><parent link="foot"/><child link="a"/>
        <axis xyz="0 0 2"/><limit lower="-0.1" upper="0.5" effort="9" velocity="0.2"/></joint>
        <link name="a"><visual><geometry><mesh filename="nice.dae"/></geometry></visual><collision>
        <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><geometry><mesh filename="a.obj" scale="0.001 0.002 -0.001"/></geometry></collision></link>
        <joint name="turn" type="continuous"><origin xyz="0.3 0 0"/><parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint>
        <link name="b"><collision><geometry><mesh filename="gone.stl"/></geometry></collision>
        <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
        <joint name="bend" type="revolute"><origin xyz="0.3 0 0"/><parent link="b"/><child link="hand"/><axis xyz="0 1 0"/>
        <limit lower="-2" upper="2" effort="9" velocity="1.5"/><safety_controller soft_lower_limit="-1" soft_upper_limit="1.2"
        k_position="1" k_velocity="1"/></joint><link name="hand"/>
        <joint name="on" type="fixed"><origin xyz="0 0.05 0"/><parent link="hand"/><child link="lamp"/></joint>
        <link name="lamp"><collision><geometry><mesh filename="a.obj" scale="0.001 0.002 -0.001"/></geometry></collision></link>
        <joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/><axis xyz="1 0 0"/>
        <limit lower="0" upper="0.1" effort="9" velocity="0.2"/></joint>
        <link name="finger"><collision><geometry><mesh filename="never-asked-for.stl"/></geometry></collision></link></robot>"#;

    fn corners() -> Vec<DVec3> {
        let mut random = Random::new(11);
        (0..400)
            .map(|_| {
                DVec3::new(random.between(-60.0, 60.0), random.between(0.0, 20.0), random.between(0.0, 300.0))
            })
            .collect()
    }

    fn read(name: &str) -> Result<Vec<u8>, String> {
        assert_ne!(name, "never-asked-for.stl");
        let mut text = String::new();
        for corner in corners() {
            writeln!(text, "v {} {} {}", corner.x, corner.y, corner.z).unwrap();
        }
        if name == "a.obj" { Ok(text.into_bytes()) } else { Err("it is not there".to_owned()) }
    }

    #[test]
    fn every_corner_of_every_mesh_is_within_the_arms_capsules_where_the_file_puts_it() {
        let alone = stand_alone(ARM, &missing(), &read).unwrap();
        let arm = parse(&alone.text, &missing()).unwrap();
        let out_m = |shapes: &[Capsule], point: DVec3| {
            let point = Capsule { a_m: point, b_m: point, radius_m: 0.0 };
            shapes.iter().map(|shape| shape.distance_m(&point)).fold(f64::INFINITY, f64::min)
        };
        let turn = DMat3::from_rotation_z(0.6) * DMat3::from_rotation_y(0.5) * DMat3::from_rotation_x(0.4);
        let mut furthest_m = f64::NEG_INFINITY;
        for corner in corners() {
            let scaled = corner * DVec3::new(0.001, 0.002, -0.001);
            furthest_m =
                furthest_m.max(out_m(&arm.joints[0].shapes, DVec3::new(0.1, 0.2, 0.3) + turn * scaled));
            furthest_m = furthest_m.max(out_m(&arm.joints[2].shapes, DVec3::new(0.0, 0.05, 0.0) + scaled));
        }
        println!("the outermost corner is {:.2} mm within", -1000.0 * furthest_m);
        assert!(furthest_m < -0.0001, "{furthest_m}");
    }

    #[test]
    fn nothing_else_of_the_arm_changes_and_what_was_not_read_is_said() {
        let alone = stand_alone(ARM, &missing(), &read).unwrap();
        let [counted, gone] = alone.notes.as_slice() else { panic!("{:?}", alone.notes) };
        assert!(counted.starts_with("2 meshes count"), "{counted}");
        assert!(gone.contains("gone.stl is not read: it is not there"), "{gone}");
        let (mut before, mut after) =
            (parse(ARM, &missing()).unwrap(), parse(&alone.text, &missing()).unwrap());
        assert!(after.notes[0].contains("the meshes of b are not read"), "{:?}", after.notes);
        assert!(after.notes[1].contains("grip moves beside"), "{:?}", after.notes);
        assert_eq!(before.joints[2].limit_rad, Some((-1.0, 1.2)), "within the soft limits");
        for arm in [&mut before, &mut after] {
            arm.foot.clear();
            arm.notes.clear();
            arm.foot_solids.clear();
            for joint in &mut arm.joints {
                joint.shapes.clear();
                joint.solids.clear();
            }
        }
        assert_eq!(before, after);
    }

    #[test]
    fn a_file_without_meshes_stays_as_it_is_and_one_with_macros_is_left_to_its_refusal() {
        let plain = ARM
            .replace("<mesh filename=\"a.obj\" scale=\"0.001 0.002 -0.001\"/>", "<sphere radius=\"0.1\"/>");
        let alone = stand_alone(&plain, &missing(), &read).unwrap();
        assert_eq!(alone.text, plain);
        let macros = ARM.replace("</robot>", "<xacro:gripper/></robot>");
        assert_eq!(stand_alone(&macros, &missing(), &read).unwrap().text, macros);
    }
}
