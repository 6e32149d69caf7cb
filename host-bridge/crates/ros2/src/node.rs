//! The node on the graph, which only sends and receives. It makes no decisions.
//!
//! RustDDS runs its own threads, and all functions here return immediately.
//! If the threads have ended, the node is reopened in a separate thread. Needs the feature `ros2`.

use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Arc, Mutex};

use super::action::active;
use super::advice::{Endpoint, Graph, Heard, topics, wire};
use super::clocks::{Clocks, Difference, Source};
use super::config::{Connection, Ros2Config};
use super::estop::Inputs;
use super::follow::named;
use super::grip::Gripper;
use super::joined::{Arm, Joined, NodeError, Published, Speed, ToldState, name_of, rivals};
use super::publisher::{RosPublisher, Simulator, lock};
use super::robot::{Counts, Output, RosRobot};
use host_robot::Robot as _;
use host_topics::message as ros;

/// Interval for checking the graph; discovery takes far longer.
const LOOK_INTERVAL_MS: u64 = 250;
/// Interval for checking the node's threads.
const WATCH_INTERVAL_MS: u64 = 100;

/// See the module.
pub struct RosNode {
    config: Ros2Config,
    connection: Connection,
    publish_sim: bool,
    /// `None` while the node is being reopened.
    joined: Option<Joined>,
    published: Arc<Mutex<Option<Published>>>,
    opening: Option<Receiver<Result<(Joined, Published), NodeError>>>,
    clocks: Clocks,
    heard: Heard,
    controller_state: Option<(u64, ros::ControllerState)>,
    /// E-stop and fault flag.
    inputs: Inputs,
    looked_ms: Option<u64>,
    watched_ms: Option<u64>,
    readers: usize,
    /// The last message about each of these topics, to report it only once.
    said: [Option<String>; 4],
    counts: Counts,
}

/// A robot's report about itself.
enum HeardOf<'a> {
    Arm(&'a ros::JointState, &'a str),
    Base(&'a ros::Odometry),
    Controller(&'a ToldState),
    ForeignGoals(usize),
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
    /// [`NodeError`]: the domain or a topic is not available.
    pub fn open(
        config: &Ros2Config,
        connection: &Connection,
        simulator: Option<Simulator>,
    ) -> Result<(Self, RosPublisher), NodeError> {
        let publish_sim = simulator.is_some();
        let (joined, published) = Joined::open(config, connection, publish_sim)?;
        let published = Arc::new(Mutex::new(Some(published)));
        let publisher = RosPublisher::new(config, &published, simulator);
        let node = RosNode {
            joined: Some(joined),
            published,
            config: config.clone(),
            connection: connection.clone(),
            publish_sim,
            opening: None,
            clocks: Clocks::default(),
            heard: Heard::default(),
            controller_state: None,
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
        self.joined.as_mut().map(Joined::graph).unwrap_or_default()
    }

    /// Returns topics of the simulator that another node also publishes.
    pub fn rivals(&mut self) -> Vec<String> {
        let graph = self.graph();
        rivals(&self.config, &graph)
    }

    /// Returns whether the node is on the graph and its threads are alive.
    pub fn is_alive(&self) -> bool {
        self.joined.as_ref().is_some_and(|joined| joined.watch.is_alive())
    }

    /// Returns the robot's clock minus its reference, or `None` if the robot sends no stamps.
    pub fn clock_difference(&self, now_ms: u64) -> Option<Difference> {
        self.clocks.difference(now_ms)
    }

    /// Returns the robot's current time in seconds for trajectories, or `None` if it is unknown.
    pub fn robot_time_s(&self, wall_s: f64, now_ms: u64) -> Option<f64> {
        self.clocks.robot_s(wall_s, now_ms)
    }

    /// Returns the reason why nothing may be armed, or `None`.
    pub fn refusal(&self, now_ms: u64) -> Option<String> {
        if self.joined.is_none() {
            return Some("the node on the graph is being opened anew".to_owned());
        }
        self.inputs.refusal(now_ms).or_else(|| self.clocks.refusal_of(self.config.stamp, now_ms))
    }

    /// Processes messages received at `wall_s` (seconds since 1970). Returns messages for the user.
    pub fn receive(&mut self, robot: &mut RosRobot, wall_s: f64, now_ms: u64) -> Vec<String> {
        robot.at(now_ms);
        let mut notes = Vec::new();
        self.watch(robot, now_ms, &mut notes);
        self.hear(wall_s, now_ms, |heard| match heard {
            HeardOf::Arm(state, teller) => robot.see_from(teller, state),
            HeardOf::Base(odometry) => robot.see_base(odometry),
            HeardOf::Controller(told) => robot.see_controller(&told.state, told.scaling()),
            HeardOf::ForeignGoals(goals) => robot.set_foreign_goals(goals),
        });
        if let Some(Arm::Action(follow)) = self.joined.as_mut().map(|joined| &mut joined.arm) {
            for (goal, answer) in follow.answers() {
                robot.answer(goal, answer);
            }
            robot.set_foreign_goals(follow.foreign());
        }
        if let Some(gripper) = self.joined.as_mut().and_then(|joined| joined.gripper.as_mut()) {
            for (goal, answer) in gripper.answers() {
                robot.grip_answer(goal, answer);
            }
        }
        notes.extend(robot.take_notes());
        if self.looked_ms.is_none_or(|at| now_ms.saturating_sub(at) >= LOOK_INTERVAL_MS) {
            self.looked_ms = Some(now_ms);
            self.look(robot, now_ms, &mut notes);
        }
        notes
    }

    /// Processes the robot's reports about itself.
    fn hear(&mut self, wall_s: f64, now_ms: u64, mut see: impl FnMut(HeardOf<'_>)) {
        let Some(joined) = &mut self.joined else { return };
        // Messages that cannot be read are dropped.
        while let Ok(Some((clock, _))) = joined.clock.take() {
            self.heard.clocks += 1;
            self.clocks.hear_clock(clock.clock.seconds(), now_ms);
        }
        let own = joined.own_name();
        for (n, readers) in joined.flags.iter().enumerate() {
            for reader in readers {
                while let Ok(Some((flag, info))) = reader.take() {
                    let writer = name_of(info.publisher_gid().as_bytes());
                    if writer != own {
                        self.inputs.hear(n, &writer, flag.data, now_ms);
                    }
                }
            }
        }
        while let Some(Ok(Some((list, _)))) = joined.goals.as_ref().map(|goals| goals.take()) {
            see(HeardOf::ForeignGoals(active(&list).count()));
        }
        while let Some(Ok(Some((state, info)))) = joined.joint_states.as_ref().map(|states| states.take()) {
            self.counts.joint_states += 1;
            self.clocks.hear(Source::JointStates, state.header.stamp.seconds(), wall_s, now_ms);
            see(HeardOf::Arm(&state, &name_of(info.publisher_gid().as_bytes())));
        }
        while let Some(Ok(Some((odom, _)))) = joined.odom.as_ref().map(|odom| odom.take()) {
            self.clocks.hear(Source::Odometry, odom.header.stamp.seconds(), wall_s, now_ms);
            see(HeardOf::Base(&odom));
        }
        while let Some(Ok(Some((state, _)))) = joined.controller_state.as_ref().map(|states| states.take()) {
            self.heard.controller_states += 1;
            see(HeardOf::Controller(&state));
            self.controller_state = Some((now_ms, state.state));
        }
    }

    /// Examines the graph without moving a robot: it listens and sends a harmless request to the arm's server.
    /// Call it often. It returns the results so far.
    pub fn examine(&mut self, wall_s: f64, now_ms: u64) -> Heard {
        self.hear(wall_s, now_ms, |_| {});
        if self.looked_ms.is_none_or(|at| now_ms.saturating_sub(at) >= LOOK_INTERVAL_MS) {
            self.looked_ms = Some(now_ms);
            if let Some(joined) = &mut self.joined {
                let graph = joined.graph();
                if let Arm::Action(follow) = &mut joined.arm {
                    // The missing reply will show why the server cannot be asked.
                    if follow.look(&mut joined.node, &graph) == Ok(true) {
                        follow.ask();
                    }
                }
            }
        }
        if let Some(Arm::Action(follow)) = self.joined.as_mut().map(|joined| &mut joined.arm) {
            let _ = follow.answers();
            self.heard.probe = follow.probe();
        }
        Heard {
            joint_states: self.counts.joint_states,
            difference: self.clocks.difference(now_ms),
            refusal: self.clocks.refusal(now_ms),
            ..self.heard.clone()
        }
    }

    /// Returns the last report of the arm's controller about itself, and its time of arrival.
    pub fn controller_state(&self) -> Option<&(u64, ros::ControllerState)> {
        self.controller_state.as_ref()
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
        if self.joined.as_ref().is_some_and(|joined| !joined.watch.is_alive()) {
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
        // Nothing waits for this, because closing a dead node may take time.
        std::thread::spawn(move || {
            drop(sender.send(Joined::open(&config, &connection, publish_sim)));
            drop(dead);
        });
        self.opening = Some(receiver);
    }

    /// Reports a message once until it changes.
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
        let listened_to = match &mut joined.arm {
            Arm::None => false,
            Arm::Topic(_) => {
                let topics = topics(&self.config, &graph);
                let ours = topics.iter().find(|topic| topic.key == "arm_controller");
                let match_of = |r: &&Endpoint| {
                    ours.is_some_and(|ours| r.topic == ours.topic && r.type_name == ours.type_name)
                };
                let controllers: Vec<&Endpoint> = graph.readers.iter().filter(match_of).collect();
                let status = wire::topic(&format!(
                    "{}/follow_joint_trajectory/_action/status",
                    self.config.resolve(&self.config.arm_controller)
                ));
                if !graph.writers.iter().any(|w| w.topic == status) {
                    // If the server disappears, its goals disappear too.
                    robot.set_foreign_goals(0);
                }
                servers_note = (controllers.len() > 1).then(|| too_many(&controllers));
                controllers.len() == 1
            }
            Arm::Action(follow) => {
                let servers = follow.servers(&graph);
                servers_note = match servers.as_slice() {
                    [] => None,
                    [one] => Some(format!("goals go to an action server on {}", one.vendor)),
                    several => Some(too_many(several)),
                };
                follow.look(&mut joined.node, &graph).unwrap_or_else(|error| {
                    notes.push(error.to_string());
                    false
                })
            }
        };
        let missing = match &mut joined.gripper {
            None => Some("this robot's gripper is not driven".to_owned()),
            Some(gripper) => {
                gripper.look(&mut joined.node, &graph).unwrap_or_else(|error| Some(error.to_string()))
            }
        };
        robot.set_gripper_missing(missing);
        let gripper_note = joined.gripper.as_ref().and_then(Gripper::about);
        let rivals = if self.publish_sim { rivals(&self.config, &graph) } else { Vec::new() };
        if !rivals.is_empty() {
            // The call also affects a node that is reopened.
            self.publish_sim = false;
            if let Some(published) = &mut *lock(&self.published) {
                published.sim = None;
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
        // The comparison ignores numbers, because they change continually.
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
            let sent = match output {
                Output::Twist(twist) => {
                    self.counts.twists += 1;
                    let twist = ros::Twist::from(twist);
                    match &joined.speed {
                        Speed::Plain(publisher) => publisher.publish(twist).is_ok(),
                        Speed::Stamped(publisher) => {
                            let stamp = self.clocks.stamp_s(self.config.stamp, wall_s, now_ms);
                            let header = ros::Header {
                                stamp: ros::Time::after_s(stamp),
                                frame_id: self.config.base_frame.clone(),
                            };
                            publisher.publish(ros::TwistStamped { header, twist }).is_ok()
                        }
                    }
                }
                Output::Trajectory(trajectory) => match &joined.arm {
                    Arm::Topic(publisher) => {
                        self.counts.motions += 1;
                        publisher.publish(trajectory).is_ok()
                    }
                    _ => false,
                },
                Output::Goal { goal, trajectory } => match &mut joined.arm {
                    Arm::Action(follow) => {
                        self.counts.motions += 1;
                        follow.send(goal, trajectory)
                    }
                    _ => false,
                },
                Output::Cancel { goal } => match &joined.arm {
                    Arm::Action(follow) => follow.cancel(goal),
                    _ => false,
                },
                Output::Grip { goal, position, effort } => {
                    joined.gripper.as_mut().is_some_and(|gripper| gripper.send(goal, position, effort))
                }
                Output::CancelGrip { goal } => {
                    joined.gripper.as_ref().is_some_and(|gripper| gripper.cancel(goal))
                }
            };
            self.counts.failed += u64::from(!sent);
        }
    }
}

fn too_many(controllers: &[&Endpoint]) -> String {
    format!(
        "{} controllers of one name: {}; no motion starts before only one is left",
        controllers.len(),
        named(controllers)
    )
}
