//! Converts a session to messages for files and live viewers, with topics and types in the form of ROS 2.
//!
//! ```text
//! Tap ──► Teller (an Observer) ──► Outlet: a file (`journal`), or Foxglove over the network (`foxglove`)
//! ```
//!
//! * this file: the streams,
//! * [`message`], [`bimanual`]: the types of ROS 2 and our own types,
//! * [`values`]: times, rotations and odometry in the form of ROS 2,
//! * [`messages`]: the construction of each message from observed data,
//! * [`tell`]: the schedule of messages,
//! * [`schema`], [`cdr`]: ROS 2's type descriptions and message encoding.

pub mod bimanual;
pub mod cdr;
pub mod diagnostics;
pub mod message;
pub mod messages;
pub mod schema;
pub mod tell;
pub mod values;

pub use messages::{Entry, Origin};
pub use tell::{Outlet, Teller};

use schema::Field as _;

/// The encoding of messages, as named by MCAP and Foxglove.
pub const ENCODING: &str = "cdr";
/// The format of type descriptions, as named by MCAP and Foxglove.
pub const SCHEMA_ENCODING: &str = "ros2msg";

macro_rules! topics {
    ($($(#[doc = $about:literal])* $topic:ident: $kind:ty = $name:literal,)*) => {
        /// A stream of messages of one type.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum Topic { $($(#[doc = $about])* $topic,)* }

        impl Topic {
            /// All topics in the order of their channels.
            pub const ALL: [Topic; [$($name),*].len()] = [$(Topic::$topic),*];

            /// Its name.
            pub fn name(self) -> &'static str {
                match self { $(Topic::$topic => $name,)* }
            }

            /// The topic's type: `package/msg/Name`.
            pub fn kind(self) -> String {
                let kind = match self { $(Topic::$topic => <$kind>::TYPE,)* };
                kind.replace('/', "/msg/")
            }

            /// Returns the complete description of the topic's type, including all types that it contains.
            pub fn schema(self) -> String {
                match self { $(Topic::$topic => schema::schema::<$kind>(),)* }
            }
        }
    };
}

topics! {
    /// Bytes from the left hand's board, unchanged.
    LeftReceived: bimanual::Bytes = "/bridge/left/received",
    /// Frames to the left hand's board.
    LeftSent: bimanual::Bytes = "/bridge/left/sent",
    /// Bytes from the right hand's board, unchanged.
    RightReceived: bimanual::Bytes = "/bridge/right/received",
    /// Frames to the right hand's board.
    RightSent: bimanual::Bytes = "/bridge/right/sent",
    /// Keys of the operator.
    Operated: bimanual::Operated = "/bridge/operated",
    /// Steps of bridge and robot between the inputs.
    Turns: bimanual::Turns = "/bridge/turns",
    /// Readings of the left hand's converter.
    LeftSample: bimanual::LeftSample = "/hands/left/sample",
    /// Readings of the right hand's IMU in the units of recordings.
    RightSample: bimanual::RightSample = "/hands/right/sample",
    /// The same readings in ROS's units: rad/s and m/s².
    Imu: message::Imu = "/hands/right/imu",
    /// The same readings in ROS's unit: tesla.
    Magnetic: message::MagneticField = "/hands/right/mag",
    /// The state of both hands.
    Hands: bimanual::Hands = "/hands/state",
    /// All events.
    Events: bimanual::Event = "/events",
    /// Only the commands of the hands.
    Intents: bimanual::Intent = "/intents",
    /// Only halts and releases.
    Stops: bimanual::Stop = "/stops",
    /// All events as lines in a log.
    Log: message::Log = "/rosout",
    /// The commanded speed of the base.
    Twist: message::TwistStamped = "/cmd_vel",
    /// The arm's and the wheels' joints.
    Joints: message::JointState = "/joint_states",
    /// Where the base is.
    Odometry: message::Odometry = "/odom",
    /// Frames of the base and the arm.
    Transforms: message::TfMessage = "/tf",
    /// The number of messages that were lost because the disk was too slow.
    Lost: bimanual::Lost = "/bridge/lost",
    /// The start or the end of a refusal of motion by the robot itself.
    Refused: bimanual::Refused = "/bridge/refused",
    /// Starts and ends of episodes, as marked by the operator.
    Marks: bimanual::Mark = "/episodes/marks",
}

impl Topic {
    /// Returns the topic with this name.
    pub fn named(name: &str) -> Option<Topic> {
        Topic::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

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
            assert!(!schema.is_empty(), "{topic:?} has fields");
        }
        assert_eq!(Topic::Odometry.kind(), "nav_msgs/msg/Odometry");
        assert_eq!(Topic::Turns.schema().lines().last(), Some("uint64 ms"));
        let odometry = Topic::Odometry.schema();
        for field in
            ["float64[36] covariance\n", "MSG: geometry_msgs/Point\n", "\ngeometry_msgs/Point position\n"]
        {
            assert!(odometry.contains(field), "{field}");
        }
    }
}
