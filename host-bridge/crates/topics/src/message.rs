//! The ROS 2 messages that are spoken here, field by field as in the Jazzy packages: over DDS, in the files of
//! sessions and to Foxglove ([`crate::Topic`]).
//!
//! Arrays of 36 are written as 6 × 6, which is the same on the wire.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use host_robot::{Picture, base};

/// `builtin_interfaces/Time`, also used for `Duration`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Seconds.
    pub sec: i32,
    /// Nanoseconds on top.
    pub nanosec: u32,
}

impl Time {
    /// A wall-clock time.
    pub fn at(time: SystemTime) -> Self {
        let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
        Time { sec: i32::try_from(since.as_secs()).unwrap_or(i32::MAX), nanosec: since.subsec_nanos() }
    }

    /// A duration of so many seconds; negative ones become zero.
    pub fn after_s(seconds: f64) -> Self {
        let nanoseconds = (seconds.max(0.0) * 1e9).round() as u64;
        Time::at_ns(nanoseconds)
    }

    /// So many nanoseconds since 1970.
    pub fn at_ns(nanoseconds: u64) -> Self {
        Time {
            sec: i32::try_from(nanoseconds / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (nanoseconds % 1_000_000_000) as u32,
        }
    }

    /// The same in nanoseconds.
    pub fn nanoseconds(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }

    /// In seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) * 1e-9
    }
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Wall clock.
    pub stamp: Time,
    /// Coordinate frame.
    pub frame_id: String,
}

/// `rosgraph_msgs/Clock`: a simulation's time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Now.
    pub clock: Time,
}

/// `geometry_msgs/Vector3` and `Point`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Forward.
    pub x: f64,
    /// Left.
    pub y: f64,
    /// Up.
    pub z: f64,
}

impl From<[f64; 3]> for Vector3 {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Vector3 { x, y, z }
    }
}

/// `geometry_msgs/Quaternion`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Quaternion {
    /// How far it is turned to the left about the vertical, in rad.
    pub fn yaw_rad(&self) -> f64 {
        (2.0 * (self.w * self.z + self.x * self.y)).atan2(1.0 - 2.0 * (self.y * self.y + self.z * self.z))
    }

    /// A turn to the left about the vertical.
    pub fn yaw(angle_rad: f64) -> Self {
        Quaternion { x: 0.0, y: 0.0, z: (0.5 * angle_rad).sin(), w: (0.5 * angle_rad).cos() }
    }
}

/// `geometry_msgs/Twist`, m/s and rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

impl From<base::Twist> for Twist {
    fn from(twist: base::Twist) -> Self {
        Twist {
            linear: Vector3 { x: twist.linear_m_s, ..Vector3::default() },
            angular: Vector3 { z: twist.angular_rad_s, ..Vector3::default() },
        }
    }
}

/// `geometry_msgs/TwistStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// When it was decided, and in which frame.
    pub header: Header,
    /// Speed.
    pub twist: Twist,
}

/// `geometry_msgs/Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// m.
    pub position: Vector3,
    /// Unit quaternion.
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseWithCovariance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// Pose.
    pub pose: Pose,
    /// x, y, z, about x, about y, about z.
    pub covariance: [[f64; 6]; 6],
}

/// `geometry_msgs/TwistWithCovariance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// Speed.
    pub twist: Twist,
    /// As for the pose.
    pub covariance: [[f64; 6]; 6],
}

/// `nav_msgs/Odometry`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Frame of the pose.
    pub header: Header,
    /// Frame of the speed.
    pub child_frame_id: String,
    /// Where the base is.
    pub pose: PoseWithCovariance,
    /// How it moves.
    pub twist: TwistWithCovariance,
}

impl Odometry {
    /// Where the base is, how it moves, and how sure that is.
    pub fn of(robot: &Picture, header: Header, child_frame_id: String) -> Self {
        let odometry = robot.odometry;
        // x, y, z and the turns about them; of ours, 0, 1 and 5.
        let (mut covariance, ours) = ([[0.0; 6]; 6], [0, 1, 5]);
        for (row, values) in robot.covariance.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                covariance[ours[row]][ours[column]] = *value;
            }
        }
        let Transform { translation, rotation } = Transform::of_base(robot);
        Odometry {
            header,
            child_frame_id,
            pose: PoseWithCovariance {
                pose: Pose { position: translation, orientation: rotation },
                covariance,
            },
            twist: TwistWithCovariance { twist: odometry.twist.into(), covariance: [[0.0; 6]; 6] },
        }
    }
}

/// `geometry_msgs/Transform`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// m.
    pub translation: Vector3,
    /// Unit quaternion.
    pub rotation: Quaternion,
}

impl Transform {
    /// The base in the frame in which it started.
    pub fn of_base(robot: &Picture) -> Self {
        let odometry = robot.odometry;
        Transform {
            translation: Vector3 { x: odometry.x_m, y: odometry.y_m, z: 0.0 },
            rotation: Quaternion::yaw(odometry.heading_rad),
        }
    }
}

/// `geometry_msgs/TransformStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Parent frame.
    pub header: Header,
    /// Child frame.
    pub child_frame_id: String,
    /// Child in parent.
    pub transform: Transform,
}

/// `tf2_msgs/TFMessage`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TfMessage {
    /// All of them.
    pub transforms: Vec<TransformStamped>,
}

/// `sensor_msgs/JointState`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// When.
    pub header: Header,
    /// Joints in the order of the values.
    pub name: Vec<String>,
    /// rad.
    pub position: Vec<f64>,
    /// rad/s; may be empty.
    pub velocity: Vec<f64>,
    /// Nm; may be empty.
    pub effort: Vec<f64>,
}

/// `sensor_msgs/Imu`. A covariance that begins with -1 says that there is no such reading.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// When, and of which part.
    pub header: Header,
    /// Unit quaternion.
    pub orientation: Quaternion,
    /// Row by row.
    pub orientation_covariance: [f64; 9],
    /// rad/s.
    pub angular_velocity: Vector3,
    /// Row by row.
    pub angular_velocity_covariance: [f64; 9],
    /// m/s².
    pub linear_acceleration: Vector3,
    /// Row by row.
    pub linear_acceleration_covariance: [f64; 9],
}

/// `sensor_msgs/MagneticField`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MagneticField {
    /// When, and of which part.
    pub header: Header,
    /// Tesla.
    pub magnetic_field: Vector3,
    /// Row by row.
    pub magnetic_field_covariance: [f64; 9],
}

/// `rcl_interfaces/Log`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Log {
    /// When.
    pub stamp: Time,
    /// 20 = to know, 30 = a warning.
    pub level: u8,
    /// Who says it.
    pub name: String,
    /// What.
    pub msg: String,
    /// Source file; empty here.
    pub file: String,
    /// Function; empty here.
    pub function: String,
    /// Line; 0 here.
    pub line: u32,
}

/// `trajectory_msgs/JointTrajectoryPoint`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// rad.
    pub positions: Vec<f64>,
    /// rad/s.
    pub velocities: Vec<f64>,
    /// rad/s².
    pub accelerations: Vec<f64>,
    /// Nm.
    pub effort: Vec<f64>,
    /// When, from the start.
    pub time_from_start: Time,
}

/// `trajectory_msgs/JointTrajectory`. A stamp of zero means that it starts on arrival.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// Start.
    pub header: Header,
    /// Joints in the order of the values.
    pub joint_names: Vec<String>,
    /// In order of time; the last one rests.
    pub points: Vec<JointTrajectoryPoint>,
}

/// `trajectory_msgs/MultiDOFJointTrajectoryPoint`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofPoint {
    /// Poses.
    pub transforms: Vec<Transform>,
    /// Speeds.
    pub velocities: Vec<Twist>,
    /// Accelerations.
    pub accelerations: Vec<Twist>,
    /// When, from the start.
    pub time_from_start: Time,
}

/// `trajectory_msgs/MultiDOFJointTrajectory`; empty here.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofTrajectory {
    /// Start.
    pub header: Header,
    /// Joints.
    pub joint_names: Vec<String>,
    /// Points.
    pub points: Vec<MultiDofPoint>,
}

/// `control_msgs/JointTolerance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTolerance {
    /// Joint.
    pub name: String,
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// rad/s².
    pub acceleration: f64,
}

/// `control_msgs/JointComponentTolerance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointComponentTolerance {
    /// Joint.
    pub joint_name: String,
    /// Which of its components.
    pub component: u16,
    /// m or rad.
    pub position: f64,
    /// Per second.
    pub velocity: f64,
    /// Per second squared.
    pub acceleration: f64,
}

/// Goal of `control_msgs/action/FollowJointTrajectory`. Empty tolerances leave them to the controller.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowGoal {
    /// The motion.
    pub trajectory: JointTrajectory,
    /// Unused.
    pub multi_dof_trajectory: MultiDofTrajectory,
    /// On the way.
    pub path_tolerance: Vec<JointTolerance>,
    /// Unused.
    pub component_path_tolerance: Vec<JointComponentTolerance>,
    /// At the end.
    pub goal_tolerance: Vec<JointTolerance>,
    /// Unused.
    pub component_goal_tolerance: Vec<JointComponentTolerance>,
    /// How late the end may be reached.
    pub goal_time_tolerance: Time,
}

/// Its result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowResult {
    /// 0 = successful.
    pub error_code: i32,
    /// What went wrong.
    pub error_string: String,
}

/// Its feedback, as far as it is used: what follows differs between releases and is not read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowFeedback {
    /// When.
    pub header: Header,
    /// Joints.
    pub joint_names: Vec<String>,
    /// Where the arm should be.
    pub desired: JointTrajectoryPoint,
    /// Where it is.
    pub actual: JointTrajectoryPoint,
}

/// `control_msgs/JointTrajectoryControllerState`, as far as it is used: what follows differs between releases and is not
/// read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ControllerState {
    /// When.
    pub header: Header,
    /// Joints.
    pub joint_names: Vec<String>,
    /// Where the controller wants the arm to be now.
    pub reference: JointTrajectoryPoint,
    /// Where it is.
    pub feedback: JointTrajectoryPoint,
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Text.
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// One of [`DiagnosticStatus::OK`] and so on.
    pub level: u8,
    /// `node: part`.
    pub name: String,
    /// In a few words.
    pub message: String,
    /// Which board.
    pub hardware_id: String,
    /// Details.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// Something to know.
    pub const WARN: u8 = 1;
    /// Something is wrong.
    pub const ERROR: u8 = 2;
    /// Nothing is heard.
    pub const STALE: u8 = 3;
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// When.
    pub header: Header,
    /// One per part.
    pub status: Vec<DiagnosticStatus>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_round_to_nanoseconds_and_never_go_below_zero() {
        assert_eq!(Time::after_s(1.25), Time { sec: 1, nanosec: 250_000_000 });
        assert_eq!(Time::after_s(0.999_999_999_9), Time { sec: 1, nanosec: 0 });
        assert_eq!(Time::after_s(-1.0), Time::default());
        let wall = UNIX_EPOCH + std::time::Duration::new(1_790_000_000, 7);
        assert_eq!(Time::at(wall), Time { sec: 1_790_000_000, nanosec: 7 });
    }

    #[test]
    fn a_quarter_turn_to_the_left_is_half_the_angle_about_z() {
        let q = Quaternion::yaw(std::f64::consts::FRAC_PI_2);
        assert!((q.z - 0.5_f64.sqrt()).abs() < 1e-12 && (q.w - 0.5_f64.sqrt()).abs() < 1e-12);
    }
}

/// What ros2-client wants of a type that it sends.
#[cfg(feature = "ros2")]
mod graph {
    use super::*;
    use ros2_client::Message;

    macro_rules! messages {
        ($($name:ty),*) => { $(impl Message for $name {})* };
    }
    messages!(
        Clock,
        ControllerState,
        Twist,
        TwistStamped,
        JointState,
        JointTrajectory,
        Odometry,
        TfMessage,
        DiagnosticArray,
        FollowGoal,
        FollowResult,
        FollowFeedback
    );
}
