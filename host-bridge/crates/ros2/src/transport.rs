//! The middleware that carries the node: DDS or Zenoh. The node itself does not depend on the choice.

use super::advice::{Graph, Probe};
use super::answer::Answer;
use super::config::{Carrier, Connection, Ros2Config};
use super::gripper::GripAnswer;
use host_topics::message as ros;
use serde::{Deserialize, Deserializer, Serialize};

/// The reason why there is no node.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("ROS 2: {0}")]
pub struct NodeError(pub(super) String);

impl NodeError {
    pub(super) fn of(what: &str, error: &dyn std::fmt::Debug) -> Self {
        NodeError(format!("{what} failed: {error:?}"))
    }
}

/// Something that was received.
pub enum Came {
    /// A simulation's time.
    Clock(ros::Clock),
    /// A value on the topic of the e-stop or the fault flag.
    Flag {
        /// The number of the flag among the configured ones.
        input: usize,
        /// The participant that sent the value.
        writer: String,
        /// Whether the robot must stop.
        stop: bool,
    },
    /// Angles, and the participant that reports them.
    Arm(ros::JointState, String),
    /// Where the base is.
    Base(Box<ros::Odometry>),
    /// The arm controller's set point and state.
    Controller(Box<ToldState>),
    /// The pose of an object, with the index of its topic in the configured list and the name of its publisher.
    Thing(usize, Box<ros::PoseStamped>, String),
    /// The number of active goals on the arm's action server that are not ours.
    ForeignGoals(usize),
}

/// The interface by which the arm's motions are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmWay {
    /// Not at all.
    None,
    /// On the controller's topic.
    Topic,
    /// As goals.
    Action,
}

/// The result of sending a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The message is on its way.
    Yes,
    /// The message replaces an older message that had not been sent yet and will not be sent.
    Instead,
    /// It cannot be sent.
    No,
}

impl Sent {
    /// Returns the result for a message that is sent at once or not at all.
    pub fn at_once(is_sent: bool) -> Self {
        if is_sent { Sent::Yes } else { Sent::No }
    }
}

/// Messages that were accepted for sending but not sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unsent {
    /// Goals that were cancelled or became too old before they were sent.
    pub withdrawn: u64,
    /// Messages and requests that failed.
    pub failed: u64,
}

/// The node's entities on the graph. **No function waits**.
/// A message that cannot be accepted at once is refused.
pub trait Transport: Send {
    /// Returns all other participants on the graph.
    fn graph(&mut self) -> Graph;
    /// Returns whether the middleware's threads are alive.
    fn is_alive(&self) -> bool;
    /// Returns the messages that were received.
    fn take(&mut self, came: &mut dyn FnMut(Came));
    /// Whether speeds are stamped.
    fn is_stamped(&self) -> bool;
    /// From now on, publishes speeds with the other message type.
    ///
    /// # Errors
    /// Fails if the topic cannot be created.
    fn set_stamped(&mut self, config: &Ros2Config, stamped: bool) -> Result<(), NodeError>;
    /// Sends a speed with the selected type. The plain type omits the header.
    fn send_speed(&mut self, speed: ros::TwistStamped) -> Sent;
    /// Returns the interface by which the arm's motions are sent.
    fn arm_way(&self) -> ArmWay;
    /// Sends a trajectory, or a piece of one, on the controller's topic.
    fn send_trajectory(&mut self, trajectory: ros::JointTrajectory) -> Sent;
    /// Looks for the arm's action server. Returns whether goals may be sent.
    ///
    /// # Errors
    /// Fails if the client cannot be created.
    fn look_for_server(&mut self, graph: &Graph) -> Result<bool, NodeError>;
    /// Sends a goal; `ours` is our number for it.
    fn send_goal(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool;
    /// Requests the end of a goal. `Instead` means that the same request is already waiting.
    fn cancel(&mut self, ours: u32) -> Sent;
    /// Requests (once) the end of a goal that does not exist.
    fn ask(&mut self);
    /// Returns the result of [`Transport::ask`] so far.
    fn probe(&self) -> Probe;
    /// Returns the number of active goals on the action's server that other programs sent.
    fn foreign(&self) -> usize;
    /// Returns the server's answers, each with our number of the goal.
    fn answers(&mut self) -> Vec<(u32, Answer)>;
    /// Looks for the gripper's action server. Returns why none can be used, or `None` if one can be used.
    fn look_for_gripper(&mut self, graph: &Graph) -> Option<String>;
    /// Describes the chosen gripper for users.
    fn about_gripper(&self) -> Option<String>;
    /// Sends a goal to the gripper; `ours` is our number for it.
    fn send_grip(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool;
    /// Requests the end of the gripper's goal.
    fn cancel_grip(&mut self, ours: u32) -> Sent;
    /// Returns the answers of the gripper's server.
    fn grip_answers(&mut self) -> Vec<(u32, GripAnswer)>;
    /// Returns the counts of messages that were accepted but not sent since the last call.
    fn take_unsent(&mut self) -> Unsent {
        Unsent::default()
    }
}

/// Publishes data other than commands.
pub trait Voice: Send {
    /// Publishes the state of the hands.
    fn diagnose(&mut self, message: ros::DiagnosticArray);
    /// Publishes whether the operator has stopped this program.
    /// Returns whether the message was accepted for sending.
    fn say_stopped(&mut self, stopped: bool) -> bool;
    /// Returns whether the simulator's state is published.
    fn has_simulator(&self) -> bool;
    /// Ceases to publish the simulator's state.
    fn end_simulator(&mut self);
    /// Publishes the simulator's URDF, also for late subscribers.
    /// This happens at the first call, or over as many calls as necessary.
    fn describe(&mut self, urdf: &str);
    /// The simulator's state.
    fn simulate(&mut self, joints: ros::JointState, odometry: ros::Odometry, frames: ros::TfMessage);
}

/// A node on the graph, and its publisher of other data.
pub type Opened = (Box<dyn Transport>, Box<dyn Voice>);

/// Joins the graph as configured. With `publish_sim`, it also publishes the simulator's state.
///
/// # Errors
/// Returns [`NodeError`] if the domain, the router or a topic is not available.
pub fn open(config: &Ros2Config, connection: &Connection, publish_sim: bool) -> Result<Opened, NodeError> {
    match config.transport {
        Carrier::Dds => {
            let (joined, published) = super::joined::Joined::open(config, connection, publish_sim)?;
            Ok((Box::new(joined), Box::new(published)))
        }
        #[cfg(feature = "zenoh")]
        Carrier::Zenoh => super::zenoh::open(config, connection, publish_sim),
        #[cfg(not(feature = "zenoh"))]
        Carrier::Zenoh => Err(NodeError(
            "this program was built without Zenoh: `cargo install --path host-bridge --features zenoh`, or set transport \
             = \"dds\" in [ros2]"
                .to_owned(),
        )),
    }
}

/// A controller's state with Jazzy's later fields. In other releases the message ends differently;
/// unreadable fields are omitted.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ToldState {
    /// The part that all releases share.
    pub state: ros::ControllerState,
    rest: Tail,
}

impl ros2_client::Message for ToldState {}

impl ToldState {
    /// The factor by which the controller scales speeds, if this is reported.
    pub fn scaling(&self) -> Option<f64> {
        self.rest.0.as_ref().map(|rest| rest.speed_scaling_factor)
    }
}

/// Reads the end of a message, if it has the expected form.
#[derive(Clone, Debug, Serialize)]
struct Tail(Option<Rest>);

impl<'de> Deserialize<'de> for Tail {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // No further field follows that could be read incorrectly.
        Ok(Tail(Rest::deserialize(deserializer).ok()))
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Rest {
    error: ros::JointTrajectoryPoint,
    output: ros::JointTrajectoryPoint,
    multi_dof_joint_names: Vec<String>,
    multi_dof: [ros::MultiDofPoint; 4],
    speed_scaling_factor: f64,
}

#[cfg(all(test, not(feature = "zenoh")))]
mod tests {
    use super::*;
    use crate::config::RosEnvironment;

    #[test]
    fn without_zenoh_built_in_its_transport_is_refused_with_how_to_build_it() {
        let config = Ros2Config { transport: Carrier::Zenoh, ..Ros2Config::default() };
        let connection = config.connection(&RosEnvironment::default()).unwrap();
        let refused = open(&config, &connection, false).map(|_| ()).unwrap_err().to_string();
        assert!(refused.contains("--features zenoh") && refused.contains("\"dds\""), "{refused}");
    }
}
