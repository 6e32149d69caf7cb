//! Checks that all numbers of a URDF are valid for geometry.
//!
//! A NaN or a negative radius would silently disable the collision check.
//! Every comparison with such a value is false.

use urdf_rs::{Collision, Geometry, Joint, Pose, Robot};

/// Returns the problem with the robot's numbers, with the name of the joint or link and the necessary change.
pub fn check(robot: &Robot) -> Result<(), String> {
    for joint in &robot.joints {
        check_joint(joint).map_err(|what| format!("joint '{}': {what}", joint.name))?;
    }
    for link in &robot.links {
        for collision in &link.collision {
            check_collision(collision).map_err(|what| format!("link '{}': {what}", link.name))?;
        }
    }
    Ok(())
}

fn finite(what: &str, values: &[f64]) -> Result<(), String> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("{what} holds {value}, which is no number; correct it")),
        None => Ok(()),
    }
}

fn positive(what: &str, values: &[f64]) -> Result<(), String> {
    match values.iter().find(|value| !(value.is_finite() && **value > 0.0)) {
        Some(value) => Err(format!("{what} is {value}; it must be above 0")),
        None => Ok(()),
    }
}

fn check_pose(pose: &Pose) -> Result<(), String> {
    finite("origin", &[pose.xyz.0, pose.rpy.0].concat())
}

fn check_joint(joint: &Joint) -> Result<(), String> {
    check_pose(&joint.origin)?;
    finite("axis", &joint.axis.xyz.0)?;
    let limit = &joint.limit;
    finite("limit", &[limit.lower, limit.upper, limit.velocity, limit.effort])
}

fn check_collision(collision: &Collision) -> Result<(), String> {
    check_pose(&collision.origin)?;
    match &collision.geometry {
        Geometry::Box { size } => positive("a box's size", &size.0),
        Geometry::Sphere { radius } => positive("a sphere's radius", &[*radius]),
        Geometry::Cylinder { radius, length } => {
            positive("a cylinder's radius or length", &[*radius, *length])
        }
        Geometry::Capsule { radius, length } => positive("a capsule's radius or length", &[*radius, *length]),
        Geometry::Mesh { scale, .. } => {
            scale.as_ref().map_or(Ok(()), |scale| finite("a mesh's scale", &scale.0))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(joint: &str, collision: &str) -> Result<(), String> {
        let text = format!(
            "<robot name=\"r\"><link name=\"a\"><collision>{collision}</collision></link><link name=\"b\"/>\
             <joint name=\"j\" type=\"revolute\">{joint}<parent link=\"a\"/><child link=\"b\"/></joint></robot>"
        );
        check(&urdf_rs::read_from_string(&text).unwrap())
    }

    #[test]
    fn numbers_that_are_none_and_sizes_that_are_none_are_refused_by_name() {
        const LIMIT: &str = "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>";
        const BALL: &str = "<geometry><sphere radius=\"0.1\"/></geometry>";
        assert_eq!(told(LIMIT, BALL), Ok(()));
        for limit in [
            "<limit lower=\"nan\" upper=\"1\" effort=\"1\" velocity=\"1\"/>",
            "<limit lower=\"-1\" upper=\"inf\" effort=\"1\" velocity=\"1\"/>",
        ] {
            let text = told(limit, BALL).unwrap_err();
            assert!(text.contains("joint 'j'") && text.contains("limit"), "{text}");
        }
        for ball in ["nan", "-1", "0", "inf"] {
            let text = told(LIMIT, &BALL.replace("0.1", ball)).unwrap_err();
            assert!(text.contains("link 'a'") && text.contains("radius"), "{text}");
        }
        let text = told(&format!("<origin xyz=\"0 nan 0\"/>{LIMIT}"), BALL).unwrap_err();
        assert!(text.contains("origin"), "{text}");
    }
}
