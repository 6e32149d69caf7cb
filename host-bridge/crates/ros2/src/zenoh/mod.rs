//! The node on Zenoh, with names as in rmw_zenoh.
//! A session through a router reads and writes topics and calls actions. This module needs the feature `zenoh`.

mod action;
mod inbox;
mod open;
mod outbox;
mod voice;
mod waiting;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use host_topics::cdr::encode;
use host_topics::message as ros;
use twox_hash::XxHash3_128;
use zenoh::Session;

use crate::action::active;
use crate::advice::{Graph, Probe};
use crate::answer::Answer;
use crate::config::Ros2Config;
use crate::follow;
use crate::grip::{self, Found, JUST_FOUND, KINDS, Meant, NO_GRIPPER};
use crate::gripper::GripAnswer;
use crate::transport::{ArmWay, Came, NodeError, Sent, Transport, Unsent};
use crate::vendor::Vendor;
use crate::zenoh_keys::{Entity, Named, Node, Quality, Told};
use action::Client;
use inbox::{Asked, Inbox, Read, Which, Word};
use outbox::Outbox;
use waiting::{Ask, Order, Place};

pub use open::open;

/// Maximum number of stored tokens of others.
const TOKENS_MAX: usize = 8192;
/// Maximum number of the gripper's goals that are remembered.
const GRIPS_MAX: usize = 16;
/// The time to wait for the stored messages of a topic's writers.
const HISTORY_PATIENCE: Duration = Duration::from_secs(10);

/// Returns the writer that this token announces, as rmw_zenoh's identity of an end point.
fn writer_of(token: &str) -> [u8; 16] {
    // The low half comes first, and each half has the machine's byte order.
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// The content of a participant's token, and the identity of its sender.
struct Known {
    told: Told,
    writer: [u8; 16],
}

/// Everybody's tokens.
type Tokens = Arc<Mutex<BTreeMap<String, Known>>>;

fn lock(tokens: &Tokens) -> MutexGuard<'_, BTreeMap<String, Known>> {
    tokens.lock().unwrap_or_else(PoisonError::into_inner)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The gripper that is used.
struct Gripper {
    meant: Meant,
    joint: String,
    /// The gripper's name, kind and client.
    server: Option<(String, usize, Client)>,
}

/// See the module.
struct ZenohNode {
    session: Session,
    node: Node,
    tokens: Tokens,
    inbox: Inbox,
    outbox: Outbox,
    /// The topic of the base's speed, and its quality of service.
    cmd_vel: String,
    quality: Quality,
    is_stamped: bool,
    way: ArmWay,
    /// The controller that moves the arm.
    controller: String,
    /// The action client, if goals are used.
    arm: Option<Client>,
    gripper: Option<Gripper>,
    /// Topics whose writers store their last message.
    /// The next field lists the writers that were already asked for their message.
    latched: Vec<(Read, Named)>,
    asked: BTreeSet<String>,
}

impl ZenohNode {
    fn speed_place(&self) -> Place {
        if self.is_stamped { Place::SpeedStamped } else { Place::SpeedPlain }
    }

    fn declare_speed(&self) {
        let kind = if self.is_stamped { "geometry_msgs/msg/TwistStamped" } else { "geometry_msgs/msg/Twist" };
        let speed = Named::new(&self.cmd_vel, kind);
        self.outbox.order(Order::Write(self.speed_place(), speed, self.quality));
    }

    /// Returns the session of an end point, from its identity or because only one session writes that topic.
    fn session_of(&self, writer: [u8; 16], read: Read) -> String {
        let tokens = lock(&self.tokens);
        let publishers = || tokens.values().filter(|known| known.told.entity == Entity::Publisher);
        if let Some(known) = publishers().find(|known| known.writer == writer) {
            return known.told.session.clone();
        }
        let named = self.latched.iter().find(|(known, _)| *known == read).map(|(_, named)| named);
        let writes = |known: &&Known| {
            let end = known.told.end.as_ref().map(|(end, _)| end);
            end.is_some() && end == named
        };
        match publishers().filter(writes).collect::<Vec<_>>().as_slice() {
            [only] => only.told.session.clone(),
            _ => hex(&writer),
        }
    }

    /// Asks newly discovered writers for their stored messages.
    fn ask_for_history(&mut self) {
        let tokens = lock(&self.tokens);
        self.asked.retain(|token| tokens.contains_key(token));
        for (read, named) in &self.latched {
            let is_new = |(token, known): &(&String, &Known)| {
                let end = known.told.end.as_ref();
                let writes = end.is_some_and(|(end, quality)| end == named && quality.transient_local);
                known.told.entity == Entity::Publisher && writes && !self.asked.contains(*token)
            };
            let new: Vec<String> = tokens.iter().filter(is_new).map(|(token, _)| token.clone()).collect();
            let ask = || Ask {
                key: format!("{}/@adv/**", named.key(self.node.domain)),
                payload: Vec::new(),
                attached: None,
                about: Asked::History(*read),
                patience: HISTORY_PATIENCE,
                until: None,
            };
            if !new.is_empty() && self.outbox.ask(ask()) != Sent::No {
                self.asked.extend(new);
            }
        }
    }
}

impl Transport for ZenohNode {
    fn graph(&mut self) -> Graph {
        self.ask_for_history();
        let tokens = lock(&self.tokens);
        let mut graph = Graph::default();
        for Known { told, .. } in tokens.values() {
            let name = (told.entity == Entity::Node).then(|| told.node.clone());
            let known = graph.participants.entry(told.session.clone()).or_default();
            known.vendor = Vendor::ZENOH;
            known.name = name.or(known.name.take());
            match told.endpoint() {
                Some((end, true)) => graph.readers.push(end),
                Some((end, false)) => graph.writers.push(end),
                None => {}
            }
        }
        graph
    }

    fn is_alive(&self) -> bool {
        !self.session.is_closed()
    }

    fn take(&mut self, came: &mut dyn FnMut(Came)) {
        for (word, writer) in self.inbox.take_words() {
            match word {
                Word::Clock(clock) => came(Came::Clock(clock)),
                Word::Flag(input, stop) => {
                    let writer = self.session_of(writer, Read::Flag(input));
                    came(Came::Flag { input, writer, stop });
                }
                Word::Arm(state) => came(Came::Arm(state, hex(&writer))),
                Word::Base(odometry) => came(Came::Base(odometry)),
                Word::Thing(n, pose) => came(Came::Thing(n, pose, hex(&writer))),
                Word::Controller(told) => came(Came::Controller(told)),
            }
        }
        if self.way == ArmWay::Topic
            && let Some(list) = self.inbox.take_status(Which::Arm)
        {
            came(Came::ForeignGoals(active(&list).count()));
        }
    }

    fn is_stamped(&self) -> bool {
        self.is_stamped
    }

    fn set_stamped(&mut self, _: &Ros2Config, stamped: bool) -> Result<(), NodeError> {
        self.outbox.order(Order::Unwrite(self.speed_place()));
        self.is_stamped = stamped;
        self.declare_speed();
        Ok(())
    }

    fn send_speed(&mut self, speed: ros::TwistStamped) -> Sent {
        let message = if self.is_stamped { encode(&speed) } else { encode(&speed.twist) };
        self.outbox.put(self.speed_place(), message)
    }

    fn arm_way(&self) -> ArmWay {
        self.way
    }

    fn send_trajectory(&mut self, trajectory: ros::JointTrajectory) -> Sent {
        match self.way {
            ArmWay::Topic => self.outbox.put(Place::Trajectory, encode(&trajectory)),
            _ => Sent::No,
        }
    }

    fn take_unsent(&mut self) -> Unsent {
        self.outbox.take_unsent()
    }

    fn look_for_server(&mut self, graph: &Graph) -> Result<bool, NodeError> {
        // Two servers would both accept every goal.
        Ok(self.arm.is_some() && follow::servers(graph, &self.controller).len() == 1)
    }

    fn send_goal(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool {
        let goal = ros::FollowGoal { trajectory, ..ros::FollowGoal::default() };
        self.arm.as_mut().is_some_and(|arm| arm.send(ours, &goal))
    }

    fn cancel(&mut self, ours: u32) -> Sent {
        self.arm.as_mut().map_or(Sent::No, |arm| arm.cancel(ours))
    }

    fn ask(&mut self) {
        if let Some(arm) = &mut self.arm {
            arm.ask();
        }
    }

    fn probe(&self) -> Probe {
        self.arm.as_ref().map_or(Probe::NotSent, Client::probe)
    }

    fn foreign(&self) -> usize {
        self.arm.as_ref().map_or(0, Client::foreign)
    }

    fn answers(&mut self) -> Vec<(u32, Answer)> {
        self.arm.as_mut().map(|arm| follow::answers(arm.said())).unwrap_or_default()
    }

    fn look_for_gripper(&mut self, graph: &Graph) -> Option<String> {
        let Some(gripper) = &mut self.gripper else { return Some(NO_GRIPPER.to_owned()) };
        let Found { name, kind, .. } = match gripper.meant.only(graph) {
            Ok(found) => found,
            Err(why) => return Some(why),
        };
        match &gripper.server {
            Some((known, its_kind, client)) if *known == name && *its_kind == kind => {
                (client.foreign() > 0).then(|| grip::at_work(&name))
            }
            _ => {
                let ends = (self.inbox.clone(), self.outbox.clone());
                let client = Client::new(Which::Gripper, &name, KINDS[kind].0, GRIPS_MAX, &self.node, ends);
                self.latched.retain(|(read, _)| *read != Read::Status(Which::Gripper));
                self.latched.push((Read::Status(Which::Gripper), action::status(&name)));
                gripper.server = Some((name, kind, client));
                Some(JUST_FOUND.to_owned())
            }
        }
    }

    fn about_gripper(&self) -> Option<String> {
        let (name, kind, _) = self.gripper.as_ref()?.server.as_ref()?;
        Some(grip::about(name, *kind))
    }

    fn send_grip(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool {
        let Some(Gripper { joint, server: Some((_, kind, client)), .. }) = &mut self.gripper else {
            return false;
        };
        match kind {
            0 => client.send(ours, &grip::command(position, effort)),
            _ => client.send(ours, &grip::parallel(joint, position, effort)),
        }
    }

    fn cancel_grip(&mut self, ours: u32) -> Sent {
        let server = self.gripper.as_mut().and_then(|gripper| gripper.server.as_mut());
        server.map_or(Sent::No, |(_, _, client)| client.cancel(ours))
    }

    fn grip_answers(&mut self) -> Vec<(u32, GripAnswer)> {
        match self.gripper.as_mut().and_then(|gripper| gripper.server.as_mut()) {
            None => Vec::new(),
            Some((_, 0, client)) => grip::command_answers(client.said()),
            Some((_, _, client)) => grip::parallel_answers(client.said()),
        }
    }
}
