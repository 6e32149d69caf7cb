//! The node on the graph, which receives and sends messages. It makes no decisions.
//!
//! The node's middleware ([`Transport`]) has its own threads, so all functions here return at once.
//! If these threads end, a separate thread reopens the node. This module needs the feature `ros2`.

use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Arc, Mutex};

use super::advice::{Endpoint, Graph, Heard, topics, wire};
use super::clocks::{Clocks, Source};
use super::config::{Connection, Ros2Config};
use super::estop::Inputs;
use super::follow::{STATUS, named, servers};
use super::publisher::{RosPublisher, Simulator, lock};
use super::robot::{Counts, Output, RosRobot};
use super::transport::{self, ArmWay, Came, NodeError, Opened, Sent, Transport, Voice};
use host_robot::Robot as _;
use host_topics::message as ros;

/// Interval for checking the graph; discovery takes far longer.
const LOOK_INTERVAL_MS: u64 = 250;
/// Interval for checking the node's threads.
const WATCH_INTERVAL_MS: u64 = 100;

/// The publishers of data other than commands; `None` while the node is being reopened.
pub(super) type Shared = Arc<Mutex<Option<Box<dyn Voice>>>>;

/// See the module.
pub struct RosNode {
    config: Ros2Config,
    connection: Connection,
    publish_sim: bool,
    /// `None` while the node is being reopened.
    joined: Option<Box<dyn Transport>>,
    published: Shared,
    opening: Option<Receiver<Result<Opened, NodeError>>>,
    clocks: Clocks,
    heard: Heard,
    /// E-stop and fault flag.
    inputs: Inputs,
    looked_ms: Option<u64>,
    watched_ms: Option<u64>,
    readers: usize,
    /// The last message about each of these topics. It prevents repeated reports.
    said: [Option<String>; 4],
    counts: Counts,
}

/// Places in `said`.
const SPEED: usize = 0;
const SERVERS: usize = 1;
const CLOCKS: usize = 2;
const GRIPPER: usize = 3;

impl RosNode {
    /// Joins the graph. With a `simulator`, its state will be published.
    /// Check [`RosNode::rivals`] before the first [`RosPublisher::publish_sim`].
    ///
    /// # Errors
    /// Returns [`NodeError`] if the domain or a topic is not available.
    pub fn open(
        config: &Ros2Config,
        connection: &Connection,
        simulator: Option<Simulator>,
    ) -> Result<(Self, RosPublisher), NodeError> {
        let publish_sim = simulator.is_some();
        let (joined, published) = transport::open(config, connection, publish_sim)?;
        let published = Arc::new(Mutex::new(Some(published)));
        let publisher = RosPublisher::new(config, Arc::clone(&published), simulator);
        let node = RosNode {
            joined: Some(joined),
            published,
            config: config.clone(),
            connection: connection.clone(),
            publish_sim,
            opening: None,
            clocks: Clocks::default(),
            heard: Heard::default(),
            inputs: Inputs::new(config),
            looked_ms: None,
            watched_ms: None,
            readers: 0,
            said: [None, None, None, None],
            counts: Counts::default(),
        };
        Ok((node, publisher))
    }

    /// Returns counters of sent and received messages.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Returns all other participants and their end points.
    pub fn graph(&mut self) -> Graph {
        self.joined.as_mut().map(|joined| joined.graph()).unwrap_or_default()
    }

    /// Returns topics of the simulator that another node also publishes.
    pub fn rivals(&mut self) -> Vec<String> {
        let graph = self.graph();
        rivals(&self.config, &graph)
    }

    /// Returns the reason why the robot may not be armed, or `None`.
    pub fn refusal(&self, now_ms: u64) -> Option<String> {
        if self.joined.is_none() {
            return Some("the node on the graph is being opened anew".to_owned());
        }
        self.inputs.refusal(now_ms).or_else(|| self.clocks.refusal_of(self.config.stamp, now_ms))
    }

    /// Processes messages received at `wall_s` (seconds since 1970). Returns messages for the user.
    pub fn receive(&mut self, robot: &mut RosRobot, wall_s: f64, now_ms: u64) -> Vec<String> {
        // Everything that arrives gets this time. It is needed to estimate the robot's clock.
        robot.at(now_ms);
        let mut notes = Vec::new();
        self.watch(robot, now_ms, &mut notes);
        // Poses are processed later, because a newer `/clock` message may follow a pose.
        let mut things = Vec::new();
        self.hear(wall_s, now_ms, |came| match came {
            Came::Arm(state, teller) => robot.see_from(teller, state),
            Came::Base(odometry) => robot.see_base(odometry),
            Came::Controller(told) => robot.see_controller(&told.state, told.scaling()),
            Came::ForeignGoals(goals) => robot.set_foreign_goals(*goals),
            Came::Thing(n, pose, writer) => things.push((*n, pose.clone(), writer.clone())),
            Came::Clock(_) | Came::Flag { .. } => {}
        });
        robot.set_clock(self.clocks.reference_s(wall_s, now_ms));
        for (n, pose, writer) in things {
            if let Some(topic) = self.config.watched.topics.get(n) {
                robot.see_thing_from(&writer, topic, &pose);
            }
        }
        if let Some(joined) = self.joined.as_mut().filter(|joined| joined.arm_way() == ArmWay::Action) {
            for (goal, answer) in joined.answers() {
                robot.answer(goal, answer);
            }
            robot.set_foreign_goals(joined.foreign());
        }
        for (goal, answer) in self.joined.as_mut().map(|joined| joined.grip_answers()).unwrap_or_default() {
            robot.grip_answer(goal, answer);
        }
        notes.extend(robot.take_notes());
        if self.looked_ms.is_none_or(|at| now_ms.saturating_sub(at) >= LOOK_INTERVAL_MS) {
            self.looked_ms = Some(now_ms);
            self.look(robot, now_ms, &mut notes);
        }
        notes
    }

    /// Processes the robot's messages about itself.
    fn hear(&mut self, wall_s: f64, now_ms: u64, mut see: impl FnMut(&Came)) {
        let Some(joined) = &mut self.joined else { return };
        let (heard, clocks, inputs) = (&mut self.heard, &mut self.clocks, &mut self.inputs);
        let counts = &mut self.counts;
        joined.take(&mut |came| {
            match &came {
                Came::Clock(clock) => {
                    heard.clocks += 1;
                    clocks.hear_clock(clock.clock.seconds(), now_ms);
                }
                Came::Flag { input, writer, stop } => inputs.hear(*input, writer, *stop, now_ms),
                Came::Arm(state, _) => {
                    counts.joint_states += 1;
                    clocks.hear(Source::JointStates, state.header.stamp.seconds(), wall_s, now_ms);
                }
                Came::Base(odom) => {
                    clocks.hear(Source::Odometry, odom.header.stamp.seconds(), wall_s, now_ms);
                }
                Came::Controller(_) => heard.controller_states += 1,
                Came::ForeignGoals(_) | Came::Thing(..) => {}
            }
            see(&came);
        });
    }

    /// Examines the graph without moving a robot: it listens and sends a harmless request to the arm's server.
    /// Call the function often; it returns the results so far.
    pub fn examine(&mut self, wall_s: f64, now_ms: u64) -> Heard {
        self.hear(wall_s, now_ms, |_| {});
        if self.looked_ms.is_none_or(|at| now_ms.saturating_sub(at) >= LOOK_INTERVAL_MS) {
            self.looked_ms = Some(now_ms);
            if let Some(joined) = &mut self.joined {
                let graph = joined.graph();
                // If the server cannot be asked, the missing answer shows the problem.
                if joined.arm_way() == ArmWay::Action && joined.look_for_server(&graph) == Ok(true) {
                    joined.ask();
                }
            }
        }
        if let Some(joined) = self.joined.as_mut().filter(|joined| joined.arm_way() == ArmWay::Action) {
            let _ = joined.answers();
            self.heard.probe = joined.probe();
        }
        Heard {
            joint_states: self.counts.joint_states,
            difference: self.clocks.difference(now_ms),
            refusal: self.clocks.refusal(now_ms),
            ..self.heard.clone()
        }
    }

    /// Reopens a node whose threads have ended, and halts the robot in the meantime.
    fn watch(&mut self, robot: &mut RosRobot, now_ms: u64, notes: &mut Vec<String>) {
        if self.watched_ms.is_some_and(|at| now_ms.saturating_sub(at) < WATCH_INTERVAL_MS) {
            return;
        }
        self.watched_ms = Some(now_ms);
        if let Some(opening) = &self.opening {
            match opening.try_recv() {
                Ok(Ok((joined, published))) => {
                    *lock(&self.published) = Some(published);
                    notes.push("the node is on the graph again".to_owned());
                    (self.joined, self.opening, self.looked_ms) = (Some(joined), None, None);
                }
                Ok(Err(error)) => {
                    notes.push(format!("{error}; tried again"));
                    self.open_anew();
                }
                Err(TryRecvError::Disconnected) => self.open_anew(),
                Err(TryRecvError::Empty) => {}
            }
            return;
        }
        if self.joined.as_ref().is_some_and(|joined| !joined.is_alive()) {
            notes.push(
                "ALARM: the node's threads have ended (this process was stopped or suspended): no stop reaches the \
                 robot until it is open again; the robot's own timeouts act"
                    .to_owned(),
            );
            robot.halt();
            robot.set_arm_listened_to(false);
            robot.set_gripper_missing(Some("the node is being opened anew".to_owned()));
            self.readers = 0;
            self.clocks = Clocks::default();
            self.inputs.forget();
            self.open_anew();
        }
    }

    fn open_anew(&mut self) {
        let (sender, receiver) = channel();
        let dead = (self.joined.take(), lock(&self.published).take());
        let (config, connection, publish_sim) =
            (self.config.clone(), self.connection.clone(), self.publish_sim);
        // A separate thread closes the dead node, because closing may take time.
        std::thread::spawn(move || {
            drop(sender.send(transport::open(&config, &connection, publish_sim)));
            drop(dead);
        });
        self.opening = Some(receiver);
    }

    /// Reports a message once, and again only after it has changed.
    fn say(&mut self, place: usize, what: Option<String>, notes: &mut Vec<String>) {
        if self.said[place] != what {
            notes.extend(what.clone());
            self.said[place] = what;
        }
    }

    fn look(&mut self, robot: &mut RosRobot, now_ms: u64, notes: &mut Vec<String>) {
        let Some(joined) = &mut self.joined else { return };
        let graph = joined.graph();
        let flags: Vec<String> = self.inputs.topics().map(wire::topic).collect();
        for (n, topic) in flags.iter().enumerate() {
            let ours = |w: &&Endpoint| w.topic == *topic && w.type_name == wire::BOOL;
            self.inputs.see_writers(n, graph.writers.iter().filter(ours).map(|w| w.participant.clone()));
        }
        let cmd_vel = self.config.resolve(&self.config.cmd_vel);
        let topic = wire::topic(&cmd_vel);
        let kinds = [wire::TWIST_STAMPED, wire::TWIST]
            .map(|kind| graph.readers.iter().filter(|r| r.topic == topic && r.type_name == kind).count());
        let mut speed_note = None;
        if self.config.stamped.fixed().is_none() && kinds.iter().sum::<usize>() > 0 {
            let stamped = kinds[0] > 0;
            if stamped != joined.is_stamped()
                && let Err(error) = joined.set_stamped(&self.config, stamped)
            {
                notes.push(error.to_string());
            }
            speed_note = (kinds[0] > 0 && kinds[1] > 0).then(|| {
                format!(
                    "{cmd_vel} has readers of TwistStamped ({}) and of Twist ({}): TwistStamped is sent; set stamped \
                     in [ros2] for the other",
                    kinds[0], kinds[1]
                )
            });
        }
        let readers = kinds[usize::from(!joined.is_stamped())];
        let mut servers_note = None;
        let listened_to = match joined.arm_way() {
            ArmWay::None => false,
            ArmWay::Topic => {
                let topics = topics(&self.config, &graph);
                let ours = topics.iter().find(|topic| topic.key == "arm_controller");
                let match_of = |r: &&Endpoint| {
                    ours.is_some_and(|ours| r.topic == ours.topic && r.type_name == ours.type_name)
                };
                let controllers: Vec<&Endpoint> = graph.readers.iter().filter(match_of).collect();
                let controller = self.config.resolve(&self.config.arm_controller);
                let status = wire::topic(&(controller + STATUS));
                if !graph.writers.iter().any(|w| w.topic == status) {
                    // If the server disappears, its goals disappear too.
                    robot.set_foreign_goals(0);
                }
                servers_note = (controllers.len() > 1).then(|| too_many(&controllers));
                controllers.len() == 1
            }
            ArmWay::Action => {
                let servers = servers(&graph, &self.config.resolve(&self.config.arm_controller));
                servers_note = match servers.as_slice() {
                    [] => None,
                    [one] => Some(format!("goals go to an action server on {}", one.vendor)),
                    several => Some(too_many(several)),
                };
                joined.look_for_server(&graph).unwrap_or_else(|error| {
                    notes.push(error.to_string());
                    false
                })
            }
        };
        robot.set_gripper_missing(joined.look_for_gripper(&graph));
        let gripper_note = joined.about_gripper();
        let rivals = if self.publish_sim { rivals(&self.config, &graph) } else { Vec::new() };
        if !rivals.is_empty() {
            // The setting also applies to a node that is reopened.
            self.publish_sim = false;
            if let Some(published) = &mut *lock(&self.published) {
                published.end_simulator();
            }
            notes.push(format!(
                "somebody else publishes {}: the simulator's state is no longer published",
                rivals.join(", ")
            ));
        }
        robot.set_arm_listened_to(listened_to);
        if readers != self.readers {
            notes.push(match readers {
                0 => format!("nobody listens to {cmd_vel} any more"),
                1 => format!("1 reader on {cmd_vel}"),
                n => format!("{n} readers on {cmd_vel}; all of them move"),
            });
            self.readers = readers;
        }
        self.say(SPEED, speed_note, notes);
        self.say(SERVERS, servers_note, notes);
        self.say(GRIPPER, gripper_note, notes);
        // The comparison ignores numbers, because they change all the time.
        let clocks = self.clocks.refusal_of(self.config.stamp, now_ms);
        if clocks.is_some() != self.said[CLOCKS].is_some() {
            self.say(CLOCKS, clocks.map(|why| format!("the clocks do not agree: {why}")), notes);
        }
    }

    /// Sends the robot's outputs, decided at `wall_s` (seconds since 1970).
    pub fn send(&mut self, robot: &mut RosRobot, wall_s: f64, now_ms: u64) {
        for output in robot.take_outputs() {
            let Some(joined) = &mut self.joined else {
                self.counts.failed += 1;
                continue;
            };
            let is_cancel = matches!(output, Output::Cancel { .. } | Output::CancelGrip { .. });
            let sent = match output {
                Output::Twist(twist) => {
                    self.counts.twists += 1;
                    let stamp = self.clocks.stamp_s(self.config.stamp, wall_s, now_ms);
                    let header = ros::Header {
                        stamp: ros::Time::after_s(stamp),
                        frame_id: self.config.base_frame.clone(),
                    };
                    joined.send_speed(ros::TwistStamped { header, twist: ros::Twist::from(twist) })
                }
                Output::Trajectory(trajectory) => {
                    self.counts.motions += 1;
                    joined.send_trajectory(trajectory)
                }
                Output::Goal { goal, trajectory } => {
                    self.counts.motions += 1;
                    Sent::at_once(joined.send_goal(goal, trajectory))
                }
                Output::Cancel { goal } => joined.cancel(goal),
                Output::Grip { goal, position, effort } => {
                    Sent::at_once(joined.send_grip(goal, position, effort))
                }
                Output::CancelGrip { goal } => joined.cancel_grip(goal),
            };
            self.counts.failed += u64::from(sent == Sent::No);
            if is_cancel {
                self.counts.cancels += u64::from(sent == Sent::Yes);
            } else {
                self.counts.replaced += u64::from(sent == Sent::Instead);
            }
        }
        let unsent = self.joined.as_mut().map(|joined| joined.take_unsent()).unwrap_or_default();
        self.counts.withdrawn += unsent.withdrawn;
        self.counts.failed += unsent.failed;
    }
}

/// Returns topics of the simulator that another node also publishes.
fn rivals(config: &Ros2Config, graph: &Graph) -> Vec<String> {
    let names = [&config.joint_states, &config.odom, &config.tf].map(|name| config.resolve(name));
    let taken = |name: &String| graph.writers.iter().any(|writer| writer.topic == wire::topic(name));
    names.into_iter().filter(taken).collect()
}

fn too_many(controllers: &[&Endpoint]) -> String {
    format!(
        "{} controllers of one name: {}; no motion starts before only one is left",
        controllers.len(),
        named(controllers)
    )
}
