//! `/robot_description`: the simulated robot as URDF, with the published names of frames and joints.
//! The description contains the shapes that the planner uses, and no meshes.

use std::fmt::Write as _;

use super::config::Ros2Config;
use host_robot::shape::Capsule;
use host_robot::{DMat3, DVec3, EulerRot, RobotSetting};
use host_topics::messages::Frames;

impl Ros2Config {
    /// Returns the names of the frames on the graph.
    ///
    /// # Errors
    /// Fails if two frames would have the same name.
    pub fn frames(&self, setting: &RobotSetting) -> Result<Frames, String> {
        let mut frames = Frames {
            odom: self.odom_frame.clone(),
            base: self.base_frame.clone(),
            arm_root: self.arm_base_frame.clone(),
            arm_prefix: self.arm_prefix.clone(),
        };
        if frames.arm_root.is_empty() {
            frames.arm_root = frames.link(&setting.arm_root);
        }
        let mut names = vec![frames.odom.clone(), frames.base.clone(), frames.arm_root.clone()];
        names.extend(setting.joints.iter().map(|joint| frames.link(&joint.link)));
        names.push(frames.link(&setting.flange_link));
        names.sort();
        if let Some(two) = names.windows(2).find(|two| two[0] == two[1]) {
            return Err(format!(
                "ros2: two frames would be called '{}': set arm_prefix, arm_base_frame or base_frame to others",
                two[0]
            ));
        }
        Ok(frames)
    }
}

/// The text of the description.
pub fn urdf(setting: &RobotSetting, frames: &Frames, config: &Ros2Config) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n<robot name=\"bimanual_simulator\">\n");
    let body = setting.body;
    let size = 2.0 * body.half_m;
    let shape = format!("<box size=\"{}\"/>", numbers(size));
    link(&mut text, &frames.base, &[(body.center_m, DMat3::from_rotation_z(body.yaw_rad), shape)]);
    let mount = Joint {
        name: "arm_mount",
        kind: "fixed",
        parent: &frames.base,
        child: &frames.arm_root,
        origin: (setting.mount_m, DMat3::IDENTITY),
    };
    mount.write(&mut text, "");
    link(&mut text, &frames.arm_root, &capsules(&setting.foot));
    let mut parent = frames.arm_root.clone();
    for (joint, name) in setting.joints.iter().zip(&config.joint_names) {
        let child = frames.link(&joint.link);
        let bounds = joint.limit_rad.map(|(low, high)| format!(" lower=\"{low}\" upper=\"{high}\""));
        let more = format!(
            "<axis xyz=\"{}\"/><limit effort=\"100\" velocity=\"{}\"{}/>",
            numbers(joint.axis),
            joint.velocity_max_rad_s,
            bounds.as_deref().unwrap_or_default()
        );
        let turns = Joint {
            name,
            kind: match (&bounds, joint.slides) {
                (_, true) => "prismatic",
                (Some(_), false) => "revolute",
                (None, false) => "continuous",
            },
            parent: &parent,
            child: &child,
            origin: (joint.origin_m, joint.origin_rotation),
        };
        turns.write(&mut text, &more);
        link(&mut text, &child, &capsules(&joint.shapes));
        parent = child;
    }
    let flange = frames.link(&setting.flange_link);
    let end = Joint {
        name: "arm_flange",
        kind: "fixed",
        parent: &parent,
        child: &flange,
        origin: (setting.flange_m, setting.flange_rotation),
    };
    end.write(&mut text, "");
    link(&mut text, &flange, &[]);
    text + "</robot>\n"
}

/// A joint in the terms of URDF.
struct Joint<'a> {
    name: &'a str,
    kind: &'a str,
    parent: &'a str,
    child: &'a str,
    origin: (DVec3, DMat3),
}

impl Joint<'_> {
    fn write(&self, text: &mut String, more: &str) {
        let _ = writeln!(
            text,
            "<joint name=\"{}\" type=\"{}\"><parent link=\"{}\"/><child link=\"{}\"/>{}{more}</joint>",
            escaped(self.name),
            self.kind,
            escaped(self.parent),
            escaped(self.child),
            origin(self.origin)
        );
    }
}

/// Writes a link with these shapes, both visible and for collisions.
fn link(text: &mut String, name: &str, shapes: &[(DVec3, DMat3, String)]) {
    let _ = write!(text, "<link name=\"{}\">", escaped(name));
    for kind in ["visual", "collision"] {
        for (at, turned, shape) in shapes {
            let _ = write!(text, "<{kind}>{}<geometry>{shape}</geometry></{kind}>", origin((*at, *turned)));
        }
    }
    *text += "</link>\n";
}

/// Converts each capsule to a cylinder and two spheres.
fn capsules(capsules: &[Capsule]) -> Vec<(DVec3, DMat3, String)> {
    let mut shapes = Vec::new();
    for &Capsule { a_m, b_m, radius_m } in capsules {
        let way = b_m - a_m;
        let turned = DMat3::from_rotation_z(way.y.atan2(way.x))
            * DMat3::from_rotation_y(way.truncate().length().atan2(way.z));
        let length = way.length();
        if length > 0.0 {
            let shape = format!("<cylinder radius=\"{radius_m}\" length=\"{length}\"/>");
            shapes.push((0.5 * (a_m + b_m), turned, shape));
        }
        for end in [a_m, b_m] {
            shapes.push((end, DMat3::IDENTITY, format!("<sphere radius=\"{radius_m}\"/>")));
        }
    }
    shapes
}

fn origin((at, turned): (DVec3, DMat3)) -> String {
    let (yaw, pitch, roll) = turned.to_euler(EulerRot::ZYX);
    format!("<origin xyz=\"{}\" rpy=\"{}\"/>", numbers(at), numbers(DVec3::new(roll, pitch, yaw)))
}

fn numbers(DVec3 { x, y, z }: DVec3) -> String {
    format!("{x} {y} {z}")
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;").replace('>', "&gt;")
}
