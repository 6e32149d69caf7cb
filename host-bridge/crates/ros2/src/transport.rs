//! What carries the node: DDS or Zenoh. The node knows neither.

use super::advice::{Graph, Probe};
use super::answer::Answer;
use super::config::{Carrier, Connection, Ros2Config};
use super::gripper::GripAnswer;
use host_topics::message as ros;
use serde::{Deserialize, Deserializer, Serialize};

/// Why there is no node.
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
    /// What somebody says on the e-stop's or the fault flag's topic.
    Flag {
        /// Its number among the configured ones.
        input: usize,
        /// The participant that says it.
        writer: String,
        /// The robot must stop.
        stop: bool,
    },
    /// Angles, and the participant that reports them.
    Arm(ros::JointState, String),
    /// Where the base is.
    Base(Box<ros::Odometry>),
    /// The arm controller's set point and state.
    Controller(Box<ToldState>),
    /// This many goals of others are active on the arm's action server.
    ForeignGoals(usize),
}

/// How the arm's motions are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmWay {
    /// Not at all.
    None,
    /// On the controller's topic.
    Topic,
    /// As goals.
    Action,
}

/// What became of a message that was to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// It is on its way.
    Yes,
    /// It is on its way in the place of an older one, which had not left yet and never does.
    Instead,
    /// It cannot be sent.
    No,
}

impl Sent {
    /// Of a message that is sent at once or not at all.
    pub fn at_once(is_sent: bool) -> Self {
        if is_sent { Sent::Yes } else { Sent::No }
    }
}

/// What was taken over and not sent after all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unsent {
    /// Goals that were cancelled or too old before they left.
    pub withdrawn: u64,
    /// Messages and requests that failed.
    pub failed: u64,
}

/// The node's entities on the graph. **Nothing here waits for anybody**: what cannot be handed over at once is `false`.
pub trait Transport: Send {
    /// Everybody else on the graph.
    fn graph(&mut self) -> Graph;
    /// What carries it is at work.
    fn is_alive(&self) -> bool;
    /// Hands out what was received.
    fn take(&mut self, came: &mut dyn FnMut(Came));
    /// Whether speeds are stamped.
    fn is_stamped(&self) -> bool;
    /// Publishes speeds as the other type from now on.
    ///
    /// # Errors
    /// The topic cannot be had.
    fn set_stamped(&mut self, config: &Ros2Config, stamped: bool) -> Result<(), NodeError>;
    /// Sends a speed as the type that is set; the plain type leaves the header out.
    fn send_speed(&mut self, speed: ros::TwistStamped) -> Sent;
    /// How the arm's motions are sent.
    fn arm_way(&self) -> ArmWay;
    /// Sends a trajectory, or a piece of one, on the controller's topic.
    fn send_trajectory(&mut self, trajectory: ros::JointTrajectory) -> Sent;
    /// Looks for the arm's action server. Returns whether goals may be sent.
    ///
    /// # Errors
    /// If the client cannot be made.
    fn look_for_server(&mut self, graph: &Graph) -> Result<bool, NodeError>;
    /// Sends a goal; `ours` is our number for it.
    fn send_goal(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool;
    /// Asks for a goal's end. `Instead` = the same request waits already.
    fn cancel(&mut self, ours: u32) -> Sent;
    /// Asks once for the end of a goal that nobody has.
    fn ask(&mut self);
    /// The result of that so far.
    fn probe(&self) -> Probe;
    /// How many goals run on the action's server that are not ours.
    fn foreign(&self) -> usize;
    /// What the server said: our number of the goal, and the answer.
    fn answers(&mut self) -> Vec<(u32, Answer)>;
    /// Looks for the gripper's action server. Returns why none can be used; `None` = one can.
    fn look_for_gripper(&mut self, graph: &Graph) -> Option<String>;
    /// Which gripper is asked, for people.
    fn about_gripper(&self) -> Option<String>;
    /// Sends the gripper a goal; `ours` is our number for it.
    fn send_grip(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool;
    /// Asks for the end of the gripper's goal.
    fn cancel_grip(&mut self, ours: u32) -> Sent;
    /// What the gripper's server said.
    fn grip_answers(&mut self) -> Vec<(u32, GripAnswer)>;
    /// What was taken over, and was not sent after all since the last call.
    fn take_unsent(&mut self) -> Unsent {
        Unsent::default()
    }
}

/// What the program publishes beside its commands.
pub trait Voice: Send {
    /// What the hands do.
    fn diagnose(&mut self, message: ros::DiagnosticArray);
    /// Whether this program's operator has stopped; whether it could be handed over.
    fn say_stopped(&mut self, stopped: bool) -> bool;
    /// The simulator's state is published.
    fn has_simulator(&self) -> bool;
    /// It is not published any more.
    fn end_simulator(&mut self);
    /// The simulator's URDF, also for late subscribers: the first time that this is called, or as often as it takes.
    fn describe(&mut self, urdf: &str);
    /// The simulator's state.
    fn simulate(&mut self, joints: ros::JointState, odometry: ros::Odometry, frames: ros::TfMessage);
}

/// A node on the graph, and what it says beside.
pub type Opened = (Box<dyn Transport>, Box<dyn Voice>);

/// Joins the graph as configured; with `publish_sim` as one who publishes the simulator's state.
///
/// # Errors
/// [`NodeError`]: the domain, the router or a topic cannot be had.
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

/// A controller's state with the fields that follow in Jazzy. Other releases end otherwise; what cannot be read is left out.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ToldState {
    /// The part that all releases share.
    pub state: ros::ControllerState,
    rest: Tail,
}

impl ros2_client::Message for ToldState {}

impl ToldState {
    /// The factor by which it scales speeds, if it reports it.
    pub fn scaling(&self) -> Option<f64> {
        self.rest.0.as_ref().map(|rest| rest.speed_scaling_factor)
    }
}

/// The end of a message, if it is as expected.
#[derive(Clone, Debug, Serialize)]
struct Tail(Option<Rest>);

impl<'de> Deserialize<'de> for Tail {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Nothing follows that a wrong reading could damage.
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
