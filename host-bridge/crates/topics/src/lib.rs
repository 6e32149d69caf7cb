//! What a session says, for files and for live viewers: topics, and their types as ROS 2 describes them.
//!
//! ```text
//! Tap ──► Teller (an Observer) ──► Outlet: a file (`journal`), or Foxglove over the network (`foxglove`)
//! ```
//!
//! * this file: the streams and their types, the only definition of both,
//! * [`messages`]: each message made from what observers are shown,
//! * [`tell`]: which message is due when,
//! * [`cdr`]: how ROS 2 lays out a message.

pub mod cdr;
pub mod diagnostics;
pub mod message;
pub mod messages;
pub mod tell;

pub use messages::{Entry, Origin};
pub use tell::{Outlet, Teller};

/// How messages are laid out, as MCAP and Foxglove name it.
pub const ENCODING: &str = "cdr";
/// How types are described, as MCAP and Foxglove name it.
pub const SCHEMA_ENCODING: &str = "ros2msg";

/// A stream of messages of one type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u16)]
pub enum Topic {
    /// Bytes from the left hand's board, as they came.
    LeftReceived,
    /// Frames to the left hand's board.
    LeftSent,
    /// Bytes from the right hand's board, as they came.
    RightReceived,
    /// Frames to the right hand's board.
    RightSent,
    /// Keys of the operator.
    Operated,
    /// Steps of bridge and robot between what came in.
    Turns,
    /// Readings of the left hand's converter.
    LeftSample,
    /// Readings of the right hand's IMU in the units of recordings.
    RightSample,
    /// The same as ROS has it: rad/s, m/s².
    Imu,
    /// The same as ROS has it: tesla.
    Magnetic,
    /// What the hands say.
    Hands,
    /// All events.
    Events,
    /// Of these, what the hands ask for.
    Intents,
    /// Of these, halts and releases.
    Stops,
    /// All events as lines of a log.
    Log,
    /// What the base is asked for.
    Twist,
    /// The arm's and the wheels' joints.
    Joints,
    /// Where the base is.
    Odometry,
    /// Frames of base and arm.
    Transforms,
    /// What could not be kept, because the disk was too slow.
    Lost,
}

impl Topic {
    /// All, in the order of their channels.
    pub const ALL: [Topic; 20] = [
        Topic::LeftReceived,
        Topic::LeftSent,
        Topic::RightReceived,
        Topic::RightSent,
        Topic::Operated,
        Topic::Turns,
        Topic::LeftSample,
        Topic::RightSample,
        Topic::Imu,
        Topic::Magnetic,
        Topic::Hands,
        Topic::Events,
        Topic::Intents,
        Topic::Stops,
        Topic::Log,
        Topic::Twist,
        Topic::Joints,
        Topic::Odometry,
        Topic::Transforms,
        Topic::Lost,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Topic::LeftReceived => "/bridge/left/received",
            Topic::LeftSent => "/bridge/left/sent",
            Topic::RightReceived => "/bridge/right/received",
            Topic::RightSent => "/bridge/right/sent",
            Topic::Operated => "/bridge/operated",
            Topic::Turns => "/bridge/turns",
            Topic::LeftSample => "/hands/left/sample",
            Topic::RightSample => "/hands/right/sample",
            Topic::Imu => "/hands/right/imu",
            Topic::Magnetic => "/hands/right/mag",
            Topic::Hands => "/hands/state",
            Topic::Events => "/events",
            Topic::Intents => "/intents",
            Topic::Stops => "/stops",
            Topic::Log => "/rosout",
            Topic::Twist => "/cmd_vel",
            Topic::Joints => "/joint_states",
            Topic::Odometry => "/odom",
            Topic::Transforms => "/tf",
            Topic::Lost => "/bridge/lost",
        }
    }

    /// Its type.
    pub fn kind(self) -> &'static str {
        match self {
            Topic::LeftReceived | Topic::LeftSent | Topic::RightReceived | Topic::RightSent => {
                "bimanual_msgs/msg/Bytes"
            }
            Topic::Operated => "bimanual_msgs/msg/Operated",
            Topic::Turns => "bimanual_msgs/msg/Turns",
            Topic::LeftSample => "bimanual_msgs/msg/LeftSample",
            Topic::RightSample => "bimanual_msgs/msg/RightSample",
            Topic::Imu => "sensor_msgs/msg/Imu",
            Topic::Magnetic => "sensor_msgs/msg/MagneticField",
            Topic::Hands => "bimanual_msgs/msg/Hands",
            Topic::Events => "bimanual_msgs/msg/Event",
            Topic::Intents => "bimanual_msgs/msg/Intent",
            Topic::Stops => "bimanual_msgs/msg/Stop",
            Topic::Log => "rcl_interfaces/msg/Log",
            Topic::Twist => "geometry_msgs/msg/TwistStamped",
            Topic::Joints => "sensor_msgs/msg/JointState",
            Topic::Odometry => "nav_msgs/msg/Odometry",
            Topic::Transforms => "tf2_msgs/msg/TFMessage",
            Topic::Lost => "bimanual_msgs/msg/Lost",
        }
    }

    /// The topic of that name.
    pub fn named(name: &str) -> Option<Topic> {
        Topic::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Its type in full: the message, then every other one that it is made of.
    pub fn schema(self) -> String {
        let mut parts = vec![self.kind()];
        let mut text = String::new();
        let mut next = 0;
        while let Some(&part) = parts.get(next) {
            if next > 0 {
                text += &format!("{}\nMSG: {}\n", "=".repeat(80), part.replace("/msg/", "/"));
            }
            next += 1;
            let Some((_, fields)) = TYPES.iter().find(|(name, _)| *name == part) else { continue };
            text += fields;
            for field in fields.lines() {
                let used = field.split([' ', '[']).next().unwrap_or_default().replacen('/', "/msg/", 1);
                if let Some((name, _)) = TYPES.iter().find(|(name, _)| *name == used)
                    && !parts.contains(name)
                {
                    parts.push(*name);
                }
            }
        }
        text
    }
}

/// Every type with its fields. Those of `bimanual_msgs` are our own.
const TYPES: [(&str, &str); 29] = [
    (
        "bimanual_msgs/msg/Bytes",
        "# Bytes of one hand's link, and when the bridge handled them on its own clock.\n\
         builtin_interfaces/Time stamp\nuint64 time_ms\nuint8[] data\n",
    ),
    (
        "bimanual_msgs/msg/Operated",
        "uint8 STOP=0\nuint8 RELEASE=1\nbuiltin_interfaces/Time stamp\nuint64 time_ms\nuint8 key\n",
    ),
    (
        "bimanual_msgs/msg/Turns",
        "# Steps since the message before this one, in their order.\nbimanual_msgs/Turn[] turns\n",
    ),
    (
        "bimanual_msgs/msg/Turn",
        "# The bridge lets this time come (in ms).\nuint8 DECIDED=0\n\
         # The robot moves on by so much (in ms).\nuint8 MOVED=1\nuint8 kind\nuint64 ms\n",
    ),
    (
        "bimanual_msgs/msg/LeftSample",
        "# Conversions (10 bits): x, y, z, index, middle; bends: 0 = straight, 1000 = as far as calibrated.\n\
         std_msgs/Header header\nuint16[5] counts\nint16[2] bends_permille\n",
    ),
    (
        "bimanual_msgs/msg/RightSample",
        "# Accelerometer (m/s2), gyroscope (deg/s), magnetometer (uT), as far as there.\n\
         std_msgs/Header header\nfloat32[] values\n",
    ),
    (
        "bimanual_msgs/msg/Hands",
        "std_msgs/Header header\nstring safety\nfloat64 pitch_rad\nfloat64 roll_rad\nstring heading\n\
         bool both_fingers\nstring[] labels\nfloat32[] scores\nfloat64 cap_m_s\nfloat64 cap_rad_s\n",
    ),
    (
        "bimanual_msgs/msg/Event",
        "std_msgs/Header header\nuint64 time_ms\n# As people read it.\nstring text\n\
         # With all its values.\nstring json\n",
    ),
    (
        "bimanual_msgs/msg/Intent",
        "# What a hand asks for, and what follows.\nstd_msgs/Header header\nstring hand\nstring name\n\
         string outcome\nfloat32 confidence\nuint64 age_ms\nfloat64 linear_m_s\nfloat64 angular_rad_s\n",
    ),
    (
        "bimanual_msgs/msg/Stop",
        "# Base and arm were halted (and why), or the operator's stop was released.\n\
         std_msgs/Header header\nbool halted\nstring reason\n",
    ),
    (
        "bimanual_msgs/msg/Lost",
        "# So many messages before this one are missing.\nstd_msgs/Header header\nuint64 messages\n",
    ),
    (
        "rcl_interfaces/msg/Log",
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n\
         string function\nuint32 line\n",
    ),
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/msg/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("geometry_msgs/msg/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/msg/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/msg/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    ("geometry_msgs/msg/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"),
    ("geometry_msgs/msg/TwistStamped", "std_msgs/Header header\ngeometry_msgs/Twist twist\n"),
    ("geometry_msgs/msg/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n"),
    ("geometry_msgs/msg/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/msg/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
    (
        "geometry_msgs/msg/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    ("tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "nav_msgs/msg/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
    ),
    (
        "sensor_msgs/msg/JointState",
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    ),
    (
        "sensor_msgs/msg/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    ),
    (
        "sensor_msgs/msg/MagneticField",
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance\n",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_topic_has_a_type_with_all_its_parts() {
        for (n, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!((topic as usize, Topic::named(topic.name())), (n, Some(topic)));
            let schema = topic.schema();
            for line in schema.lines().filter(|line| line.contains('/') && !line.starts_with(['#', 'M'])) {
                let part = line.split([' ', '[']).next().unwrap();
                assert!(schema.contains(&format!("MSG: {part}\n")), "{topic:?}: {part}");
            }
            assert!(!schema.starts_with('='), "{topic:?} has a type");
            assert!(!schema.is_empty(), "{topic:?} has fields");
        }
        assert!(Topic::Odometry.schema().contains("MSG: geometry_msgs/Vector3\nfloat64 x\n"));
    }
}
