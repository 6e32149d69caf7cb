//! The node on DDS: its participant, its publications and subscriptions, and the other participants.

use std::collections::BTreeMap;
use std::time::Duration;

use ros2_client::action_msgs::GoalStatusArray;
use ros2_client::dds::rustdds::dds::statusevents::DomainParticipantStatusEvent;
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, RTPSEntity, StatusEvented as _, policy,
};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Subscription,
};
use serde::Serialize;

use super::advice::{Endpoint, Graph, Participant};
use super::config::{ArmInterface, Connection, Ros2Config};
use super::estop::Inputs;
use super::follow::{Follow, STATUS};
use super::grip::Gripper;
use super::transport::{NodeError, ToldState};
use super::vendor::Vendor;
use super::watch::Watch;
use host_topics::message as ros;

/// The publisher of the base's speed.
pub enum Speed {
    /// `geometry_msgs/Twist`.
    Plain(Publisher<ros::Twist>),
    /// `geometry_msgs/TwistStamped`.
    Stamped(Publisher<ros::TwistStamped>),
}

/// The interface for the arm's motions.
pub enum Arm {
    /// Not at all.
    None,
    /// On the controller's topic.
    Topic(Box<Publisher<ros::JointTrajectory>>),
    /// As goals.
    Action(Box<Follow>),
}

/// The topics published in addition to the commands.
pub struct Published {
    /// Diagnostics of the hands.
    pub diagnostics: Publisher<ros::DiagnosticArray>,
    /// Whether the operator has stopped this program.
    pub stopped: Publisher<ros::Bool>,
    /// The simulator's state, if it was requested and no other node publishes it.
    pub sim: Option<SimTopics>,
}

/// The simulator's own topics.
pub struct SimTopics {
    /// Angles.
    pub joint_states: Publisher<ros::JointState>,
    /// Where the base is.
    pub odom: Publisher<ros::Odometry>,
    /// The base's position as a transform, and the transforms of the arm's links.
    pub tf: Publisher<ros::TfMessage>,
    /// The robot description, which late subscribers also receive.
    pub description: Option<Publisher<ros::Text>>,
    /// Whether the description was published.
    pub is_described: bool,
}

/// See the module.
pub struct Joined {
    /// The base's speed.
    pub speed: Speed,
    /// The arm.
    pub arm: Arm,
    /// The gripper, if one is configured.
    pub gripper: Option<Gripper>,
    /// Angles that the robot reports.
    pub joint_states: Option<Subscription<ros::JointState>>,
    /// The base's odometry, whose stamps show the robot's clock.
    pub odom: Option<Subscription<ros::Odometry>>,
    /// The arm controller's set point and state. The topic is silent while the controller is inactive.
    pub controller_state: Option<Subscription<ToldState>>,
    /// The status of the goals on the arm's action server.
    /// The status is read only if we have no client for that server.
    pub goals: Option<Subscription<GoalStatusArray>>,
    /// The poses of objects. Each object has its own topic.
    pub things: Vec<Subscription<ros::PoseStamped>>,
    /// E-stop and fault flag, each with a subscription for latched messages and one for new messages.
    pub flags: Vec<[Subscription<ros::Bool>; 2]>,
    /// The time of a simulation.
    pub clock: Subscription<ros::Clock>,
    participants: BTreeMap<String, Participant>,
    speed_qos: QosProfile,
    /// Its threads.
    pub watch: Watch,
    participant: DomainParticipant,
    // This field must be the last field, because all fields above belong to the node.
    /// The node itself.
    pub node: Node,
}

/// The participant of a connection.
fn join(connection: &Connection) -> Result<Context, NodeError> {
    let mut builder = DomainParticipantBuilder::new(connection.domain_id);
    if !connection.interfaces.is_empty() {
        builder = builder.with_only_networks(connection.interfaces.iter().copied());
    }
    #[cfg(target_os = "linux")]
    let before = super::device::sockets();
    let participant = builder.build().map_err(|error| {
        NodeError(format!("domain {} cannot be joined: {error:?}; is a network up?", connection.domain_id))
    })?;
    #[cfg(target_os = "linux")]
    if connection.is_loopback_only() {
        super::device::tie_to_loopback(&before).map_err(|error| {
            NodeError(format!("its sockets cannot be tied to loopback ({error}): needs Linux 5.7 or later"))
        })?;
    }
    Context::from_domain_participant(participant).map_err(|error| NodeError::of("the context", &error))
}

fn reliable(config: &Ros2Config) -> QosProfile {
    let depth = config.depth as usize;
    QosProfile::publisher_default()
        .history(History::KeepLast { depth })
        .durability(Durability::Volatile)
        .reliability_reliable(WhenFull::Fail)
}

/// Maximum number of participants whose announcements are stored.
const PARTICIPANTS_MAX: usize = 1024;

/// The last message is kept for late subscribers.
pub(super) fn latched() -> QosProfile {
    QosProfile::publisher_default()
        .history(History::KeepLast { depth: 1 })
        .durability(Durability::TransientLocal)
        .reliability_reliable(WhenFull::Fail)
}

/// Best effort, which matches every writer.
fn listening(depth: usize) -> QosProfile {
    QosProfile::subscription_default().history(History::KeepLast { depth })
}

/// Creates a node that does not publish or read anything yet.
pub(super) fn bare(config: &Ros2Config, connection: &Connection) -> Result<(Context, Node), NodeError> {
    let context = join(connection)?;
    let namespace = if config.namespace.is_empty() { "/" } else { &config.namespace };
    let name = NodeName::new(namespace, &config.node).map_err(|e| NodeError::of("the node's name", &e))?;
    let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
    let node = context.new_node(name, options).map_err(|e| NodeError::of("the node", &e))?;
    Ok((context, node))
}

impl Joined {
    /// Joins the graph. With `publish_sim`, it also publishes the simulator's state.
    ///
    /// # Errors
    /// Returns [`NodeError`] if the domain or a topic is not available.
    pub fn open(
        config: &Ros2Config,
        connection: &Connection,
        publish_sim: bool,
    ) -> Result<(Self, Published), NodeError> {
        let others = Watch::running();
        let (context, mut node) = bare(config, connection)?;

        let qos = reliable(config);
        let lifespan = (config.lifespan_ms > 0).then(|| Duration::from_millis(config.lifespan_ms));
        let mut speed_qos = qos.clone().lifespan(lifespan);
        if !config.reliable {
            speed_qos = speed_qos.reliability_best_effort();
        }
        let speed = speed(&mut node, config, config.stamped.fixed().unwrap_or(true), &speed_qos)?;
        let diagnostics = config.resolve(&config.diagnostics);
        let diagnostics = publisher(&mut node, &diagnostics, ("diagnostic_msgs", "DiagnosticArray"), &qos)?;
        let controller = config.resolve(&config.arm_controller);
        let controller_state = match config.arm {
            ArmInterface::None => None,
            _ => Some(subscription(
                &mut node,
                &format!("{controller}/controller_state"),
                ("control_msgs", "JointTrajectoryControllerState"),
                10,
            )?),
        };
        let goals = match config.arm {
            // An action's client receives the status of all goals itself.
            ArmInterface::None | ArmInterface::Action => None,
            ArmInterface::Topic | ArmInterface::Stream => Some(subscription_with(
                &mut node,
                &format!("{controller}{STATUS}"),
                ("action_msgs", "GoalStatusArray"),
                &latched(),
            )?),
        };
        let things = config
            .watched
            .topics
            .iter()
            .map(|topic| subscription(&mut node, topic, ("geometry_msgs", "PoseStamped"), 1));
        let things = things.collect::<Result<_, _>>()?;
        let mut flags = Vec::new();
        for topic in Inputs::new(config).topics() {
            let kind = ("std_msgs", "Bool");
            flags.push([
                subscription_with(&mut node, topic, kind, &latched())?,
                subscription(&mut node, topic, kind, 10)?,
            ]);
        }
        let stopped =
            publisher(&mut node, &config.resolve(&config.stopped), ("std_msgs", "Bool"), &latched())?;
        let arm = match config.arm {
            ArmInterface::None => Arm::None,
            ArmInterface::Topic | ArmInterface::Stream => {
                let name = format!("{controller}/joint_trajectory");
                // A waiting piece is useless once the next piece exists.
                let qos = qos.clone().history(History::KeepLast { depth: 1 });
                Arm::Topic(Box::new(publisher(
                    &mut node,
                    &name,
                    ("trajectory_msgs", "JointTrajectory"),
                    &qos,
                )?))
            }
            ArmInterface::Action => Arm::Action(Box::new(Follow::new(controller, qos.clone()))),
        };
        let (states, odom) = (config.resolve(&config.joint_states), config.resolve(&config.odom));
        let clock = subscription(&mut node, "/clock", ("rosgraph_msgs", "Clock"), 1)?;
        // Messages from this program itself are not read.
        let (joint_states, odom_read, sim) = if publish_sim {
            let description = config.resolve(&config.robot_description);
            let description = (!config.robot_description.is_empty())
                .then(|| publisher(&mut node, &description, ("std_msgs", "String"), &latched()))
                .transpose()?;
            let sim = SimTopics {
                description,
                is_described: false,
                joint_states: publisher(&mut node, &states, ("sensor_msgs", "JointState"), &qos)?,
                odom: publisher(&mut node, &odom, ("nav_msgs", "Odometry"), &qos)?,
                tf: publisher(&mut node, &config.resolve(&config.tf), ("tf2_msgs", "TFMessage"), &qos)?,
            };
            (None, None, Some(sim))
        } else {
            let states = match arm {
                Arm::None => None,
                _ => Some(subscription(&mut node, &states, ("sensor_msgs", "JointState"), 10)?),
            };
            (states, Some(subscription(&mut node, &odom, ("nav_msgs", "Odometry"), 10)?), None)
        };
        let joined = Joined {
            speed,
            arm,
            gripper: Gripper::new(config, qos.clone()),
            joint_states,
            odom: odom_read,
            controller_state,
            goals,
            things,
            flags,
            clock,
            participants: BTreeMap::new(),
            speed_qos,
            watch: Watch::since(&others),
            participant: context.domain_participant(),
            node,
        };
        Ok((joined, Published { diagnostics, stopped, sim }))
    }

    /// Returns the name of our own participant, in the form in which [`Joined::look_around`] names others.
    pub fn own_name(&self) -> String {
        name_of(&self.participant.guid().to_bytes())
    }

    /// From now on, publishes speeds with the other message type.
    ///
    /// # Errors
    /// Returns [`NodeError`] if the topic cannot be created.
    pub fn restamp(&mut self, config: &Ros2Config, stamped: bool) -> Result<(), NodeError> {
        self.speed = speed(&mut self.node, config, stamped, &self.speed_qos)?;
        Ok(())
    }

    /// Returns all other participants on the graph.
    pub fn look_around(&mut self) -> Graph {
        let own = self.participant.guid().prefix;
        let name = |guid: &GUID| {
            let bytes = guid.to_bytes();
            (name_of(&bytes), Vendor::of_prefix(&bytes).unwrap_or(Vendor([0, 0])))
        };
        let listener = self.participant.status_listener();
        while let Some(event) = listener.try_recv_status() {
            if let DomainParticipantStatusEvent::ParticipantDiscovered { dpd } = event
                && dpd.guid.prefix != own
            {
                let (id, vendor) = name(&dpd.guid);
                let version = format!("{:?}", dpd.protocol_version);
                if self.participants.len() >= PARTICIPANTS_MAX {
                    // Only the participant's own description is lost;
                    // the participant's end points still show that the participant exists.
                    self.participants.pop_first();
                }
                self.participants.insert(id, Participant { vendor, version, name: dpd.entity_name });
            }
        }
        let mut graph = Graph::default();
        let reliable =
            |qos: Option<policy::Reliability>| matches!(qos, Some(policy::Reliability::Reliable { .. }));
        let durable =
            |qos: Option<policy::Durability>| !matches!(qos, None | Some(policy::Durability::Volatile));
        for reader in self.participant.discovered_readers() {
            let guid = reader.reader_proxy.remote_reader_guid;
            if guid.prefix == own {
                continue;
            }
            let (participant, vendor) = name(&guid);
            let data = reader.subscription_topic_data;
            let qos = data.qos();
            graph.readers.push(Endpoint {
                topic: data.topic_name().clone(),
                type_name: data.type_name().clone(),
                reliable: reliable(qos.reliability()),
                transient_local: durable(qos.durability()),
                vendor,
                participant,
                type_hash: type_hash(&reader.user_data),
            });
        }
        for writer in self.participant.discovered_writers() {
            let guid = writer.writer_proxy.remote_writer_guid;
            if guid.prefix == own {
                continue;
            }
            let (participant, vendor) = name(&guid);
            let data = writer.publication_topic_data;
            let qos = data.qos();
            graph.writers.push(Endpoint {
                topic: data.topic_name().clone(),
                type_name: data.type_name.clone(),
                // A writer's default is omitted on the wire.
                reliable: qos.reliability().is_none() || reliable(qos.reliability()),
                transient_local: durable(qos.durability()),
                vendor,
                participant,
                type_hash: type_hash(&writer.user_data),
            });
        }
        // Participants that have disappeared have no end points.
        for end in graph.readers.iter().chain(&graph.writers) {
            let known = self.participants.get(&end.participant).cloned();
            let participant =
                known.unwrap_or_else(|| Participant { vendor: end.vendor, ..Participant::default() });
            graph.participants.insert(end.participant.clone(), participant);
        }
        graph
    }
}

/// Returns a participant's name on the graph, which is the beginning of each end point's GUID.
pub fn name_of(guid: &[u8]) -> String {
    guid.iter().take(12).map(|byte| format!("{byte:02x}")).collect()
}

/// Returns REP-2016's hash of a type, from the data that its end point announces.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(user_data);
    // The data begins with its length in bytes.
    let (_, rest) = text.split_once("typehash=")?;
    Some(rest.split(';').next().unwrap_or(rest).to_owned())
}

fn speed(node: &mut Node, config: &Ros2Config, stamped: bool, qos: &QosProfile) -> Result<Speed, NodeError> {
    let name = config.resolve(&config.cmd_vel);
    Ok(if stamped {
        Speed::Stamped(publisher(node, &name, ("geometry_msgs", "TwistStamped"), qos)?)
    } else {
        Speed::Plain(publisher(node, &name, ("geometry_msgs", "Twist"), qos)?)
    })
}

fn topic(
    node: &mut Node,
    name: &str,
    (package, type_name): (&str, &str),
    qos: &QosProfile,
) -> Result<ros2_client::dds::rustdds::Topic, NodeError> {
    let parsed = Name::parse(name).map_err(|error| NodeError::of(name, &error))?;
    node.create_topic(&parsed, MessageTypeName::new(package, type_name), qos)
        .map_err(|error| NodeError::of(name, &error))
}

fn publisher<M: Serialize>(
    node: &mut Node,
    name: &str,
    type_name: (&str, &str),
    qos: &QosProfile,
) -> Result<Publisher<M>, NodeError> {
    let topic = topic(node, name, type_name, qos)?;
    node.create_publisher(&topic, Some(qos.clone())).map_err(|error| NodeError::of(name, &error))
}

fn subscription<M: Message + 'static>(
    node: &mut Node,
    name: &str,
    type_name: (&str, &str),
    depth: usize,
) -> Result<Subscription<M>, NodeError> {
    subscription_with(node, name, type_name, &listening(depth))
}

pub(super) fn subscription_with<M: Message + 'static>(
    node: &mut Node,
    name: &str,
    type_name: (&str, &str),
    qos: &QosProfile,
) -> Result<Subscription<M>, NodeError> {
    let topic = topic(node, name, type_name, qos)?;
    node.create_subscription(&topic, Some(qos.clone())).map_err(|error| NodeError::of(name, &error))
}
