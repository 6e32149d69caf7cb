//! The node on the graph: DDS in, DDS out. Nothing is decided here.
//!
//! RustDDS runs its own threads; everything here returns at once. Needs the feature `ros2`.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ros2_client::action::{ActionClient, ActionClientQosPolicies, GoalId};
use ros2_client::action_msgs::GoalStatusEnum;
use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder, GUID, RTPSEntity, policy};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    ActionTypeName, Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
    RmwRequestId, ServiceMapping, Subscription,
};
use serde::Serialize;

use super::advice::{Endpoint, Graph, topics, wire};
use super::arm::Answer;
use super::config::{ArmInterface, Connection, Ros2Config};
use super::robot::{Counts, Output, RosRobot};
use host_robot::{Picture, Robot as _};
use host_topics::message as ros;

/// The graph is looked at this often: discovery takes far longer.
const LOOK_INTERVAL_MS: u64 = 250;
/// The simulator's state is published this often.
const SIM_INTERVAL_MS: u64 = 20;

/// Why there is no node.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("ROS 2: {0}")]
pub struct NodeError(String);

impl NodeError {
    fn of(what: &str, error: &dyn std::fmt::Debug) -> Self {
        NodeError(format!("{what} failed: {error:?}"))
    }
}

enum Speed {
    Plain(Publisher<ros::Twist>),
    Stamped(Publisher<ros::TwistStamped>),
}

type Follow = ActionClient<ros::FollowGoal, ros::FollowResult, ros::FollowFeedback>;

/// A goal on its way; kept until its result is known.
struct Goal {
    ours: u32,
    request: RmwRequestId,
    id: GoalId,
    result: Option<RmwRequestId>,
}

enum Arm {
    None,
    Topic(Box<Publisher<ros::JointTrajectory>>),
    Action(Box<Follow>, Vec<Goal>),
}

/// The simulator's own topics.
struct SimTopics {
    joint_states: Publisher<ros::JointState>,
    odom: Publisher<ros::Odometry>,
    tf: Publisher<ros::TfMessage>,
    published_ms: u64,
}

/// What the program publishes beside its commands: diagnostics, and the simulator where that is the robot.
pub struct RosPublisher {
    config: Ros2Config,
    diagnostics: Publisher<ros::DiagnosticArray>,
    sim: Option<(SimTopics, Arc<AtomicBool>)>,
}

/// See the module.
pub struct RosNode {
    config: Ros2Config,
    speed: Speed,
    arm: Arm,
    joint_states: Option<Subscription<ros::JointState>>,
    odometry: Option<Subscription<ros::Odometry>>,
    /// The simulator's topics are ours alone, so far.
    sim_is_ours: Option<Arc<AtomicBool>>,
    looked_ms: Option<u64>,
    readers: usize,
    counts: Counts,
    participant: DomainParticipant,
    // Last: whatever is above belongs to it.
    _node: Node,
}

/// The participant of a connection.
fn join(connection: &Connection) -> Result<Context, NodeError> {
    let mut builder = DomainParticipantBuilder::new(connection.domain_id);
    if !connection.interfaces.is_empty() {
        builder = builder.with_only_networks(connection.interfaces.iter().copied());
    }
    let participant = builder.build().map_err(|error| {
        NodeError(format!("domain {} cannot be joined: {error:?}; is a network up?", connection.domain_id))
    })?;
    Context::from_domain_participant(participant).map_err(|error| NodeError::of("the context", &error))
}

fn qos(config: &Ros2Config) -> QosProfile {
    let depth = config.depth as usize;
    QosProfile::publisher_default()
        .history(History::KeepLast { depth })
        .durability(Durability::Volatile)
        .reliability_reliable(WhenFull::Fail)
}

impl RosNode {
    /// Joins the graph. With `publish_sim` the simulator's state is to be published; look at [`RosNode::rivals`] before the first [`RosPublisher::publish_sim`].
    ///
    /// # Errors
    /// [`NodeError`]: the domain or a topic cannot be had.
    pub fn open(
        config: &Ros2Config,
        connection: &Connection,
        publish_sim: bool,
    ) -> Result<(Self, RosPublisher), NodeError> {
        let context = join(connection)?;
        let namespace = if config.namespace.is_empty() { "/" } else { &config.namespace };
        let name =
            NodeName::new(namespace, &config.node).map_err(|e| NodeError::of("the node's name", &e))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let mut node = context.new_node(name, options).map_err(|e| NodeError::of("the node", &e))?;

        let reliable = qos(config);
        let lifespan = (config.lifespan_ms > 0).then(|| Duration::from_millis(config.lifespan_ms));
        let mut speed_qos = reliable.clone().lifespan(lifespan);
        if !config.reliable {
            speed_qos = speed_qos.reliability_best_effort();
        }
        let cmd_vel = config.resolve(&config.cmd_vel);
        let speed = if config.stamped {
            Speed::Stamped(publisher(&mut node, &cmd_vel, ("geometry_msgs", "TwistStamped"), &speed_qos)?)
        } else {
            Speed::Plain(publisher(&mut node, &cmd_vel, ("geometry_msgs", "Twist"), &speed_qos)?)
        };
        let diagnostics = config.resolve(&config.diagnostics);
        let diagnostics =
            publisher(&mut node, &diagnostics, ("diagnostic_msgs", "DiagnosticArray"), &reliable)?;
        let controller = config.resolve(&config.arm_controller);
        let arm = match config.arm {
            ArmInterface::None => Arm::None,
            ArmInterface::Topic | ArmInterface::Stream => {
                let name = format!("{controller}/joint_trajectory");
                Arm::Topic(Box::new(publisher(
                    &mut node,
                    &name,
                    ("trajectory_msgs", "JointTrajectory"),
                    // A piece that waits is of no use once the next one is there.
                    &reliable.clone().history(History::KeepLast { depth: 1 }),
                )?))
            }
            ArmInterface::Action => {
                Arm::Action(Box::new(follow(&mut node, &controller, connection, &reliable)?), Vec::new())
            }
        };
        let states = config.resolve(&config.joint_states);
        let joint_states = if matches!(arm, Arm::None) {
            None
        } else {
            // Best effort listens to every writer.
            let wanted = QosProfile::subscription_default().history(History::KeepLast { depth: 10 });
            let topic = topic(&mut node, &states, ("sensor_msgs", "JointState"), &wanted)?;
            Some(node.create_subscription(&topic, Some(wanted)).map_err(|e| NodeError::of(&states, &e))?)
        };
        let odometry = if publish_sim {
            None
        } else {
            let (name, wanted) = (
                config.resolve(&config.odom),
                QosProfile::subscription_default().history(History::KeepLast { depth: 10 }),
            );
            let topic = topic(&mut node, &name, ("nav_msgs", "Odometry"), &wanted)?;
            Some(node.create_subscription(&topic, Some(wanted)).map_err(|e| NodeError::of(&name, &e))?)
        };
        let sim_is_ours = publish_sim.then(|| Arc::new(AtomicBool::new(true)));
        let sim = if let Some(is_ours) = &sim_is_ours {
            let (odom, tf) = (config.resolve(&config.odom), config.resolve(&config.tf));
            let topics = SimTopics {
                joint_states: publisher(&mut node, &states, ("sensor_msgs", "JointState"), &reliable)?,
                odom: publisher(&mut node, &odom, ("nav_msgs", "Odometry"), &reliable)?,
                tf: publisher(&mut node, &tf, ("tf2_msgs", "TFMessage"), &reliable)?,
                published_ms: 0,
            };
            Some((topics, Arc::clone(is_ours)))
        } else {
            None
        };
        let publisher = RosPublisher { config: config.clone(), diagnostics, sim };
        let node = RosNode {
            config: config.clone(),
            speed,
            arm,
            joint_states,
            odometry,
            sim_is_ours,
            looked_ms: None,
            readers: 0,
            counts: Counts::default(),
            participant: context.domain_participant(),
            _node: node,
        };
        Ok((node, publisher))
    }

    /// What was sent and heard.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Everybody else on the graph.
    pub fn graph(&self) -> Graph {
        let own = self.participant.guid().prefix;
        let who = |guid: &GUID| format!("{:?}", guid.prefix);
        let reliable =
            |qos: Option<policy::Reliability>| matches!(qos, Some(policy::Reliability::Reliable { .. }));
        let durable =
            |qos: Option<policy::Durability>| !matches!(qos, None | Some(policy::Durability::Volatile));
        let mut graph = Graph { participants: BTreeSet::new(), ..Graph::default() };
        for reader in self.participant.discovered_readers() {
            let guid = reader.reader_proxy.remote_reader_guid;
            if guid.prefix == own {
                continue;
            }
            graph.participants.insert(who(&guid));
            let data = reader.subscription_topic_data;
            let qos = data.qos();
            graph.readers.push(Endpoint {
                topic: data.topic_name().clone(),
                type_name: data.type_name().clone(),
                reliable: reliable(qos.reliability()),
                transient_local: durable(qos.durability()),
            });
        }
        for writer in self.participant.discovered_writers() {
            let guid = writer.writer_proxy.remote_writer_guid;
            if guid.prefix == own {
                continue;
            }
            graph.participants.insert(who(&guid));
            let data = writer.publication_topic_data;
            let qos = data.qos();
            graph.writers.push(Endpoint {
                topic: data.topic_name().clone(),
                type_name: data.type_name.clone(),
                // Left out on the wire where it is a writer's default.
                reliable: qos.reliability().is_none() || reliable(qos.reliability()),
                transient_local: durable(qos.durability()),
            });
        }
        graph
    }

    /// Topics of the simulator that somebody else publishes.
    pub fn rivals(&self) -> Vec<String> {
        let graph = self.graph();
        let names = [&self.config.joint_states, &self.config.odom, &self.config.tf];
        let names = names.map(|name| self.config.resolve(name));
        let taken = |name: &String| graph.writers.iter().any(|writer| writer.topic == wire::topic(name));
        names.into_iter().filter(taken).collect()
    }

    /// Takes what came in. Returns what a person should know.
    pub fn receive(&mut self, robot: &mut RosRobot, now_ms: u64) -> Vec<String> {
        robot.at(now_ms);
        if let Some(subscription) = &self.joint_states {
            // What cannot be read is dropped.
            while let Ok(Some((state, _))) = subscription.take() {
                self.counts.joint_states += 1;
                robot.see(&state);
            }
        }
        if let Some(subscription) = &self.odometry {
            while let Ok(Some((odometry, _))) = subscription.take() {
                robot.see_base(&odometry);
            }
        }
        self.answers(robot);
        let mut notes = robot.take_notes();
        if self.looked_ms.is_none_or(|at| now_ms.saturating_sub(at) >= LOOK_INTERVAL_MS) {
            self.looked_ms = Some(now_ms);
            self.look(robot, &mut notes);
        }
        notes
    }

    fn look(&mut self, robot: &mut RosRobot, notes: &mut Vec<String>) {
        let graph = self.graph();
        let ours = topics(&self.config);
        let count = |key: &str| {
            let Some(topic) = ours.iter().find(|topic| topic.key == key) else { return 0 };
            let match_of = |r: &&Endpoint| r.topic == topic.topic && r.type_name == topic.type_name;
            graph.readers.iter().filter(match_of).count()
        };
        robot.set_arm_listened_to(count("arm_controller") > 0);
        let readers = count("cmd_vel");
        if readers != self.readers {
            let name = self.config.resolve(&self.config.cmd_vel);
            notes.push(match readers {
                0 => format!("nobody listens to {name} any more"),
                1 => format!("1 reader on {name}"),
                n => format!("{n} readers on {name}; all of them move"),
            });
            self.readers = readers;
        }
        if self.sim_is_ours.as_ref().is_some_and(|ours| ours.load(Ordering::Relaxed)) {
            let rivals = self.rivals();
            if !rivals.is_empty() {
                if let Some(ours) = self.sim_is_ours.take() {
                    ours.store(false, Ordering::Relaxed);
                }
                notes.push(format!(
                    "somebody else publishes {}: the simulator's state is no longer published",
                    rivals.join(", ")
                ));
            }
        }
    }

    fn answers(&mut self, robot: &mut RosRobot) {
        let Arm::Action(client, goals) = &mut self.arm else { return };
        while let Ok(Some((request, response))) = client.goal_client().receive_response() {
            let Some(goal) = goals.iter_mut().find(|goal| goal.request == request) else { continue };
            if response.accepted {
                goal.result = client.request_result(goal.id).ok();
                robot.answer(goal.ours, Answer::Accepted);
            } else {
                robot.answer(goal.ours, Answer::Rejected);
                goals.retain(|goal| goal.request != request);
            }
        }
        while let Ok(Some((message, _))) = client.feedback_subscription().take() {
            if let Some(goal) = goals.iter().find(|goal| goal.id == message.goal_id) {
                robot.answer(goal.ours, Answer::Progress(message.feedback.desired.time_from_start.seconds()));
            }
        }
        while let Ok(Some((request, response))) = client.result_client().receive_response() {
            let Some(place) = goals.iter().position(|goal| goal.result == Some(request)) else { continue };
            let goal = goals.swap_remove(place);
            let answer = match response.status {
                GoalStatusEnum::Succeeded => Answer::Succeeded,
                GoalStatusEnum::Canceled => Answer::Ended("cancelled".to_owned()),
                other => {
                    let ros::FollowResult { error_code, error_string } = &response.result;
                    Answer::Ended(format!("{other:?}, error {error_code} {error_string}"))
                }
            };
            robot.answer(goal.ours, answer);
        }
        // The result tells what became of a cancellation; its own answers and the statuses are not needed.
        while let Ok(Some(_)) = client.cancel_client().receive_response() {}
        while let Ok(Some(_)) = client.receive_status() {}
    }

    /// Sends what the robot wants sent, decided at `stamp`.
    pub fn send(&mut self, robot: &mut RosRobot, stamp: ros::Time) {
        for output in robot.take_outputs() {
            let sent = match output {
                Output::Twist(twist) => {
                    self.counts.twists += 1;
                    let twist = ros::Twist::from(twist);
                    match &self.speed {
                        Speed::Plain(publisher) => publisher.publish(twist).is_ok(),
                        Speed::Stamped(publisher) => {
                            let header = ros::Header { stamp, frame_id: self.config.base_frame.clone() };
                            publisher.publish(ros::TwistStamped { header, twist }).is_ok()
                        }
                    }
                }
                Output::Trajectory(trajectory) => match &self.arm {
                    Arm::Topic(publisher) => {
                        self.counts.motions += 1;
                        publisher.publish(trajectory).is_ok()
                    }
                    _ => false,
                },
                Output::Goal { goal, trajectory } => match &mut self.arm {
                    Arm::Action(client, goals) => {
                        self.counts.motions += 1;
                        let message = ros::FollowGoal { trajectory, ..ros::FollowGoal::default() };
                        let sent = client.send_goal(message);
                        if let Ok((request, id)) = sent {
                            goals.push(Goal { ours: goal, request, id, result: None });
                        }
                        sent.is_ok()
                    }
                    _ => false,
                },
                Output::Cancel { goal } => match &self.arm {
                    Arm::Action(client, goals) => {
                        let known = goals.iter().find(|known| known.ours == goal);
                        known.is_some_and(|known| client.cancel_goal(known.id).is_ok())
                    }
                    _ => false,
                },
            };
            self.counts.failed += u64::from(!sent);
        }
    }
}

impl RosPublisher {
    /// Publishes what the hands do.
    pub fn diagnose(&mut self, message: ros::DiagnosticArray) {
        // A message that cannot be handed over is late by the next one.
        let _ = self.diagnostics.publish(message);
    }

    /// Publishes the simulator's state, if that is wanted and due.
    pub fn publish_sim(&mut self, simulator: &Picture, now_ms: u64, stamp: ros::Time) {
        let Some((topics, is_ours)) = &mut self.sim else { return };
        if !is_ours.load(Ordering::Relaxed) {
            return;
        }
        if now_ms.saturating_sub(topics.published_ms) < SIM_INTERVAL_MS {
            return;
        }
        topics.published_ms = now_ms;
        let header = |frame: &str| ros::Header { stamp, frame_id: frame.to_owned() };
        let arm = &simulator.arm;
        let joint_state = ros::JointState {
            header: header(""),
            name: self.config.joint_names.to_vec(),
            position: arm.joints_rad.to_vec(),
            velocity: arm.velocity_rad_s.to_vec(),
            effort: Vec::new(),
        };
        let base_frame = || self.config.base_frame.clone();
        let odom = ros::Odometry::of(simulator, header(&self.config.odom_frame), base_frame());
        let transform = ros::TransformStamped {
            header: header(&self.config.odom_frame),
            child_frame_id: base_frame(),
            transform: ros::Transform::of_base(simulator),
        };
        let _ = topics.joint_states.publish(joint_state);
        let _ = topics.odom.publish(odom);
        let _ = topics.tf.publish(ros::TfMessage { transforms: vec![transform] });
    }
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

fn follow(
    node: &mut Node,
    controller: &str,
    connection: &Connection,
    services: &QosProfile,
) -> Result<Follow, NodeError> {
    let mapping =
        if connection.cyclone_services { ServiceMapping::Cyclone } else { ServiceMapping::Enhanced };
    let name = format!("{controller}/follow_joint_trajectory");
    let parsed = Name::parse(&name).map_err(|error| NodeError::of(&name, &error))?;
    let status = services.clone().durability(Durability::TransientLocal);
    let qos = ActionClientQosPolicies {
        goal_service: services.clone(),
        result_service: services.clone(),
        cancel_service: services.clone(),
        feedback_subscription: services.clone(),
        status_subscription: status,
    };
    let type_name = ActionTypeName::new("control_msgs", "FollowJointTrajectory");
    node.create_action_client(mapping, &parsed, &type_name, qos).map_err(|error| NodeError::of(&name, &error))
}
