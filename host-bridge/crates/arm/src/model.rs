//! The model of a serial arm: joints, limits, shapes of its links, named poses, and forward kinematics.
//!
//! The Gen3 is built in ([`SerialArm::gen3`]).
//! Any other arm comes from a URDF file (feature `urdf`, see `urdf.rs`).
//! An arm may have up to eight joints that turn or slide.
//! The missing values of [`Joints`] stay at zero.

use std::f64::consts::TAU;

use host_robot::{DMat3, DVec3, JOINTS, Joints, Pose};

use super::gen3::{
    COUNT, FLANGE_LINK, HOME, JOINT_NAMES, LINK_NAMES, MAX_ACCELERATION_RAD_S2, MAX_VELOCITY_RAD_S,
    POSITION_LIMIT_RAD, ROOT_LINK,
};
use crate::solid::Solid;
use host_robot::JointLimits;
use host_robot::shape::{Capsule, Point};

/// Name of the built-in arm.
const GEN3: &str = "Kinova Gen3 (7 joints)";

/// One joint and the link that it moves.
/// For a sliding joint, positions, speeds and limits are in m instead of rad.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmJoint {
    /// Name of the joint in the robot's own description.
    pub name: String,
    /// Name of the moved link in the robot's own description.
    pub link: String,
    /// Position of the joint in its parent's frame, in m.
    pub origin_m: Point,
    /// Rotation of the joint's frame relative to the parent's frame.
    pub origin_rotation: DMat3,
    /// Axis of the joint in the joint's frame, with length 1.
    pub axis: Point,
    /// Whether the joint slides along its axis instead of turning about it. Such a joint has limits.
    pub slides: bool,
    /// Minimum and maximum angle; `None` means that the joint turns without end.
    pub limit_rad: Option<(f64, f64)>,
    /// Fastest turn.
    pub velocity_rad_s: f64,
    /// Largest acceleration.
    pub acceleration_rad_s2: f64,
    /// Shapes that enclose the link moved by this joint, in the joint's frame.
    pub shapes: Vec<Capsule>,
    /// The link's shapes without protruding parts, if these are known; otherwise empty.
    pub solids: Vec<Solid>,
}

/// An arm.
#[derive(Clone, Debug, PartialEq)]
pub struct SerialArm {
    /// For people.
    pub name: String,
    /// The link whose frame is the arm's base frame.
    pub root_link: String,
    /// The joints in order from the foot. An arm has one to eight joints.
    pub joints: Vec<ArmJoint>,
    /// Position of the flange in the last joint's frame, in m.
    pub flange_m: Point,
    /// Rotation of the flange relative to the last joint.
    pub flange_rotation: DMat3,
    /// The flange's link.
    pub flange_link: String,
    /// Shapes of the arm's fixed base, in the arm's base frame.
    pub foot: Vec<Capsule>,
    /// As [`ArmJoint::solids`].
    pub foot_solids: Vec<Solid>,
    /// The home pose, used as the first goal and as the fallback, in rad.
    pub home_rad: Joints,
    /// Contents of the arm's file that were not understood, for users.
    pub notes: Vec<String>,
}

/// The reason why joint values cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JointError {
    /// A value is not a number, or is infinite.
    #[error("{joint} is no finite angle")]
    NotFinite {
        /// Which.
        joint: String,
    },
    /// Beyond the limit.
    #[error("{joint} at {value_rad:.3} {unit} is beyond its limits of {low_rad:.3} to {high_rad:.3} {unit}")]
    BeyondLimit {
        /// Which.
        joint: String,
        /// The value that was requested.
        value_rad: f64,
        /// Least.
        low_rad: f64,
        /// Greatest.
        high_rad: f64,
        /// The unit of all three values: m for a sliding joint, otherwise rad.
        unit: &'static str,
    },
}

impl ArmJoint {
    /// The joint slides by at most this much in either direction; 0 for a joint that turns.
    fn slide_m(&self) -> f64 {
        let far_m = self.limit_rad.map_or(0.0, |(low, high)| low.abs().max(high.abs()));
        if self.slides { far_m } else { 0.0 }
    }
}

impl SerialArm {
    /// Returns the Kinova Gen3 with seven joints and the parameters of [`super::gen3`].
    /// The links are capsules around Kinova's meshes.
    /// Objects on its flange are [tools](crate::tool), for example its vision module.
    pub fn gen3() -> Self {
        let joints = (0..COUNT).map(|i| {
            let (origin_m, origin_rotation) = super::gen3::origin(i);
            ArmJoint {
                name: JOINT_NAMES[i].to_owned(),
                link: LINK_NAMES[i].to_owned(),
                origin_m,
                origin_rotation,
                axis: DVec3::Z,
                slides: false,
                limit_rad: POSITION_LIMIT_RAD[i].map(|limit| (-limit, limit)),
                velocity_rad_s: MAX_VELOCITY_RAD_S[i],
                acceleration_rad_s2: MAX_ACCELERATION_RAD_S2[i],
                shapes: vec![super::gen3::capsule(i + 1)],
                solids: Vec::new(),
            }
        });
        let (flange_m, flange_rotation) = super::gen3::origin(COUNT);
        SerialArm {
            name: GEN3.to_owned(),
            root_link: ROOT_LINK.to_owned(),
            joints: joints.collect(),
            flange_m,
            flange_rotation,
            flange_link: FLANGE_LINK.to_owned(),
            foot: vec![super::gen3::capsule(0)],
            foot_solids: Vec::new(),
            home_rad: HOME,
            notes: Vec::new(),
        }
    }

    /// Returns whether this is the built-in arm, for which poses are bundled.
    pub fn is_gen3(&self) -> bool {
        self.name == GEN3
    }

    /// Returns whether two links are tubes of the same telescope. The foot is link 0.
    /// In a telescope, all joints between the two links slide along the same line.
    /// Such tubes are inside each other by design, and the joint limits prevent collisions between them.
    pub fn is_telescope(&self, one: usize, two: usize) -> bool {
        let Some(between) = self.joints.get(one..two) else { return false };
        let mut turn = DMat3::IDENTITY;
        let mut first = None;
        between.iter().all(|joint| {
            turn *= joint.origin_rotation;
            let axis = turn * joint.axis;
            joint.slides && axis.dot(*first.get_or_insert(axis)) > 0.999_999
        })
    }

    /// Returns the frames of the joints, and of the flange last, in the arm's base frame.
    /// Frames of joints that the arm does not have equal the flange's.
    pub fn link_poses(&self, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
        let mut poses = [Pose::IDENTITY; JOINTS + 1];
        let mut pose = Pose::IDENTITY;
        for (i, joint) in self.joints.iter().enumerate() {
            pose = pose.then(joint.origin_m, joint.origin_rotation);
            if joint.slides {
                pose.position_m = pose.at(joint.axis * joints_rad[i]);
            } else {
                pose.rotation *= DMat3::from_axis_angle(joint.axis, joints_rad[i]);
            }
            poses[i] = pose;
        }
        let flange = pose.then(self.flange_m, self.flange_rotation);
        poses[self.joints.len()..].fill(flange);
        poses
    }

    /// Returns an equivalent pose whose continuous joints are close to their current angles.
    /// The path is therefore short.
    /// Joints never turn by more than one revolution in either direction.
    /// Descriptions of such arms (for example ros2_kortex's) end there.
    pub fn unwound(&self, goal_rad: &Joints, here_rad: &Joints) -> Joints {
        let mut unwound = *goal_rad;
        for (i, joint) in self.joints.iter().enumerate() {
            if joint.limit_rad.is_none() {
                let there = goal_rad[i] + TAU * ((here_rad[i] - goal_rad[i]) / TAU).round();
                let is_beyond = there.abs() > TAU && here_rad[i].abs() <= TAU;
                unwound[i] = if is_beyond { there - TAU * there.signum() } else { there };
            }
        }
        unwound
    }

    /// Returns the flange's pose at these joint angles.
    pub fn flange_pose(&self, joints_rad: &Joints) -> Pose {
        self.link_poses(joints_rad)[JOINTS]
    }

    /// Checks whether all values are within the limits.
    ///
    /// # Errors
    /// Returns an error that names the first joint that is not within its limits.
    pub fn check(&self, joints_rad: &Joints) -> Result<(), JointError> {
        for (joint, &value_rad) in self.joints.iter().zip(joints_rad) {
            let name = || joint.name.clone();
            if !value_rad.is_finite() {
                return Err(JointError::NotFinite { joint: name() });
            }
            if let Some((low_rad, high_rad)) = joint.limit_rad
                && !(low_rad..=high_rad).contains(&value_rad)
            {
                let unit = if joint.slides { "m" } else { "rad" };
                return Err(JointError::BeyondLimit { joint: name(), value_rad, low_rad, high_rad, unit });
            }
        }
        Ok(())
    }

    /// Returns the limits with scaled speeds and accelerations (0 to 1; the paper uses 0.1 and 0.05).
    /// Jerk is not limited.
    pub fn limits(&self, velocity_scaling: f64, acceleration_scaling: f64) -> JointLimits {
        // A missing joint never moves. Its limits must not be zero, because they are used as divisors.
        let mut limits = JointLimits {
            velocity_rad_s: [1.0; JOINTS],
            acceleration_rad_s2: [1.0; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        };
        for (i, joint) in self.joints.iter().enumerate() {
            limits.velocity_rad_s[i] = joint.velocity_rad_s * velocity_scaling;
            limits.acceleration_rad_s2[i] = joint.acceleration_rad_s2 * acceleration_scaling;
        }
        limits
    }

    /// Returns how far the flange's position is beyond the arm's reach.
    /// The reach is calculated as if the middle joints could stretch freely.
    /// If the result is 0 or less, the position may be within reach.
    /// The function also detects positions whose orientation turns the last link away.
    ///
    /// The flange's pose determines the last joint's origin and axis.
    /// Together, they determine a circle on which the previous joint lies.
    /// In the same way, the arm's base determines a circle on which the second joint lies.
    /// The chain is never longer than the sum of its parts.
    pub fn beyond_reach_m(&self, flange: &Pose) -> f64 {
        let (Some(first), Some(last)) = (self.joints.first(), self.joints.last()) else { return 0.0 };
        // For an arm with a sliding joint, no position is refused in advance.
        if self.joints.len() < 3 || self.joints.iter().any(|joint| joint.slides) {
            return 0.0;
        }
        // This step reverses the flange's own offset,
        // which determines the last joint's axis but not its angle.
        let last_turn = flange.rotation * self.flange_rotation.transpose();
        let (offset_m, axis) = (last_turn * self.flange_m, last_turn * last.axis);
        // This vector leads from the previous joint to the last one, in the last joint's own axes.
        let link_m = last.origin_rotation.transpose() * last.origin_m;
        let (along_m, around_m) = along_and_around(link_m, last.axis);
        let hand_m = flange.position_m - offset_m - axis * along_m;

        let foot = Pose::IDENTITY.then(first.origin_m, first.origin_rotation);
        let (rise_m, swing_m) = along_and_around(self.joints[1].origin_m, first.axis);
        let shoulder_m = foot.at(first.axis * rise_m);

        let middle = &self.joints[2..self.joints.len() - 1];
        let length_m = middle.iter().map(|joint| joint.origin_m.length()).sum::<f64>() + swing_m + around_m;
        hand_m.distance(shoulder_m) - length_m
    }

    /// Returns, for each joint, the maximum distance in m from its origin to any further point of the arm.
    /// A turn by an angle moves no point further than the angle times this distance.
    /// For a sliding joint, the value is 1, because each point moves as far as the joint does.
    pub fn lever_m(&self) -> Joints {
        self.lever_with_m(0.0)
    }

    /// Like [`Self::lever_m`], for a tool whose parts are at most `tool_m` from the flange.
    pub fn lever_with_m(&self, tool_m: f64) -> Joints {
        let mut lever = [0.0; JOINTS];
        let mut beyond: f64 = if tool_m > 0.0 { self.flange_m.length() + tool_m } else { 0.0 };
        for (i, joint) in self.joints.iter().enumerate().rev() {
            let shapes = joint.shapes.iter().map(|c| c.a_m.length().max(c.b_m.length()) + c.radius_m);
            beyond = shapes.fold(beyond, f64::max);
            lever[i] = if joint.slides { 1.0 } else { beyond };
            beyond += joint.origin_m.length() + joint.slide_m();
        }
        lever
    }
}

/// Returns a vector's component along a unit axis, and the length of the perpendicular component.
fn along_and_around(vector: DVec3, axis: DVec3) -> (f64, f64) {
    let along = vector.dot(axis);
    (along, (vector - along * axis).length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3;

    #[test]
    fn the_gen3s_zero_pose_is_straight_up_and_its_limits_are_the_papers() {
        let arm = SerialArm::gen3();
        assert!((arm.flange_pose(&[0.0; JOINTS]).position_m[2] - 1.1873).abs() < 1e-3);
        let limits = gen3::paper_limits();
        for i in 0..COUNT {
            let fastest_rad_s = if i < 4 { 1.3963 } else { 1.2218 };
            assert_eq!(limits.velocity_rad_s[i], fastest_rad_s * 0.1);
            assert_eq!(limits.acceleration_rad_s2[i], 8.6 * 0.05);
        }
    }

    #[test]
    fn only_links_that_slide_along_one_line_are_a_telescope() {
        let mut arm = SerialArm::gen3();
        for joint in &mut arm.joints[2..5] {
            (joint.slides, joint.origin_rotation, joint.axis) = (true, DMat3::IDENTITY, DVec3::X);
        }
        assert!(arm.is_telescope(2, 4) && arm.is_telescope(2, 5) && arm.is_telescope(3, 5));
        assert!(!arm.is_telescope(1, 3) && !arm.is_telescope(4, 6), "a joint between them turns");
        arm.joints[3].axis = DVec3::Y;
        assert!(!arm.is_telescope(2, 4) && !arm.is_telescope(3, 5), "along two lines");
        arm.joints[3].axis = DVec3::X;
        arm.joints[3].origin_rotation = DMat3::from_rotation_z(0.1);
        assert!(!arm.is_telescope(2, 4));
        assert!(!arm.is_telescope(6, 9), "there is no such link");
    }

    #[test]
    fn no_point_moves_further_than_the_levers_say() {
        let arm = SerialArm::gen3();
        let lever = arm.lever_m();
        let mut random = host_robot::Random::new(1);
        for _ in 0..2000 {
            let joints: Joints = std::array::from_fn(|_| random.between(-3.0, 3.0));
            let i = random.below(JOINTS);
            let mut turned = joints;
            turned[i] += 0.01;
            let (one, two) = (arm.flange_pose(&joints), arm.flange_pose(&turned));
            let moved = one.position_m.distance(two.position_m);
            assert!(moved <= 0.01 * lever[i], "joint {i}: {moved}");
        }
    }

    #[test]
    fn what_the_arm_does_reach_is_never_called_beyond_reach() {
        let arm = SerialArm::gen3();
        let mut random = host_robot::Random::new(3);
        let mut nearest_m = f64::NEG_INFINITY;
        for _ in 0..20_000 {
            let joints: Joints = std::array::from_fn(|_| random.between(-3.0, 3.0));
            nearest_m = nearest_m.max(arm.beyond_reach_m(&arm.flange_pose(&joints)));
        }
        assert!(nearest_m <= 1e-12, "{nearest_m}");
        // An arm that points straight up can hardly stretch further.
        let mut straight = arm.flange_pose(&[0.0; JOINTS]);
        assert!((-0.01..=1e-12).contains(&arm.beyond_reach_m(&straight)));
        straight.position_m.z += 0.01;
        assert!(arm.beyond_reach_m(&straight) > 0.0);
        // The same position with the tool bent down needs a longer arm.
        let mut down = arm.flange_pose(&[0.0; JOINTS]);
        down.rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        assert!(arm.beyond_reach_m(&down) > 0.3);
    }

    #[test]
    fn joints_without_end_take_the_short_way_and_end_within_one_turn() {
        use host_robot::Trajectory;
        let arm = SerialArm::gen3();
        // Joint 1 is at 3.1 rad, and at -3.1 in the pose.
        // The difference is 0.083 rad, and not 6.2 rad, which would take 44.7 s.
        let (mut here, mut goal) = (arm.home_rad, arm.home_rad);
        (here[0], goal[0]) = (3.1, -3.1);
        let there = arm.unwound(&goal, &here);
        assert!((there[0] - (TAU - 3.1)).abs() < 1e-12, "{}", there[0]);
        let way = Trajectory::through(&[here, there], &[], &arm.limits(0.1, 0.05));
        assert!(way.duration_s() < 1.1, "{} s", way.duration_s());
        // Joint 2 has limits and does not change.
        (here[1], goal[1]) = (2.2, -2.2);
        assert_eq!(arm.unwound(&goal, &here)[1], -2.2);
        // From 6.0 rad, the shortest path to 0.5 rad would end at 6.78 rad.
        // This is more than one turn, so the joint turns back instead.
        (here[0], goal[0]) = (6.0, 0.5);
        assert_eq!(arm.unwound(&goal, &here)[0], 0.5);
        // An arm that has already turned beyond one revolution does not turn further.
        here[0] = 7.0;
        assert!((arm.unwound(&goal, &here)[0] - (TAU + 0.5)).abs() < 1e-12);
    }

    #[test]
    fn values_out_of_limits_are_named() {
        let arm = SerialArm::gen3();
        let mut joints = HOME;
        joints[3] = -2.6;
        assert!(arm.check(&joints).unwrap_err().to_string().contains("joint_4 at -2.600 rad"));
        joints[0] = f64::NAN;
        assert!(matches!(arm.check(&joints), Err(JointError::NotFinite { .. })));
    }
}
