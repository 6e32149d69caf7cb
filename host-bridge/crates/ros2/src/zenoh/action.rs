//! An action's client on Zenoh, which calls three services and reads two topics.

use std::time::{Duration, Instant};

use host_topics::cdr::{decode, encode};
use host_topics::message as ros;
use ros2_client::action::GoalId;
use ros2_client::action_msgs::GoalStatusEnum;
use ros2_client::unique_identifier_msgs::UUID;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::inbox::{Asked, Inbox, Read, Which};
use super::outbox::{Outbox, now_ns};
use super::waiting::{Ask, Order};
use super::writer_of;
use crate::action::{Said, active};
use crate::advice::Probe;
use crate::transport::Sent;
use crate::zenoh_keys::{Attached, Entity, Named, Node, Quality};

/// The time to wait for an answer; the bridge abandons goals sooner.
const PATIENCE: Duration = Duration::from_secs(10);
/// Maximum duration of a goal.
const RESULT_PATIENCE: Duration = Duration::from_secs(600);
/// A goal that waits longer than this is dropped unsent, because by then the bridge requests its end.
const GOAL_WAITS: Duration = Duration::from_millis(500);

/// A goal of ours, which may already be over.
struct Goal {
    ours: u32,
    id: GoalId,
}

/// See the module.
pub struct Client {
    which: Which,
    /// The domain of the requests' keys.
    domain: u16,
    send_goal: Named,
    get_result: Named,
    cancel_goal: Named,
    /// Who sends them.
    writer: [u8; 16],
    inbox: Inbox,
    outbox: Outbox,
    goals: Vec<Goal>,
    /// Maximum number of goals that are remembered.
    most: usize,
    requests: i64,
    probe: Probe,
    foreign: usize,
}

impl Client {
    /// Creates a client for this action of `control_msgs`. Subscriptions of earlier clients of this kind end.
    pub fn new(
        which: Which,
        name: &str,
        kind: &str,
        most: usize,
        node: &Node,
        ends: (Inbox, Outbox),
    ) -> Self {
        let (inbox, outbox) = ends;
        let part = |part: &str, kind: &str| Named::new(&format!("{name}/_action/{part}"), kind);
        let send_goal = part("send_goal", &format!("control_msgs/action/{kind}_SendGoal"));
        let get_result = part("get_result", &format!("control_msgs/action/{kind}_GetResult"));
        let cancel_goal = part("cancel_goal", "action_msgs/srv/CancelGoal");
        let feedback = part("feedback", &format!("control_msgs/action/{kind}_FeedbackMessage"));
        outbox.order(Order::Forget(which));
        inbox.forget(which);
        outbox.order(Order::Read(Read::Feedback(which), feedback, Quality::RELIABLE));
        outbox.order(Order::Read(Read::Status(which), status(name), Quality::LATCHED));
        let mut writer = [0; 16];
        for named in [&get_result, &cancel_goal, &send_goal] {
            let token = node.end_token(outbox.id(), Entity::Client, named, Quality::RELIABLE);
            writer = writer_of(&token);
            outbox.order(Order::Say(which, token));
        }
        Client {
            which,
            domain: node.domain,
            send_goal,
            get_result,
            cancel_goal,
            writer,
            inbox,
            outbox,
            goals: Vec::new(),
            most,
            requests: 0,
            probe: Probe::NotSent,
            foreign: 0,
        }
    }

    fn request(&mut self, to: fn(&Client) -> &Named, message: &impl Serialize, about: Asked) -> Sent {
        self.requests += 1;
        let (patience, waits) = match about {
            Asked::Result(..) => (RESULT_PATIENCE, None),
            Asked::Goal(..) => (PATIENCE, Some(GOAL_WAITS)),
            _ => (PATIENCE, None),
        };
        self.outbox.ask(Ask {
            key: to(self).key(self.domain),
            payload: encode(message),
            attached: Some(Attached { number: self.requests, sent_ns: now_ns(), writer: self.writer }),
            about,
            patience,
            until: waits.map(|waits| Instant::now() + waits),
        })
    }

    /// Sends a goal. Returns whether the goal was accepted for sending.
    pub fn send(&mut self, ours: u32, goal: &impl Serialize) -> bool {
        let id = UUID::new_random();
        let sent = self.request(|client| &client.send_goal, &(id, goal), Asked::Goal(self.which, id));
        let sent = sent != Sent::No;
        if sent {
            if self.goals.len() == self.most {
                self.goals.remove(0);
            }
            self.goals.push(Goal { ours, id });
        }
        sent
    }

    /// Requests the end of a goal. Returns whether the request was accepted. A goal that was not sent yet is dropped.
    pub fn cancel(&mut self, ours: u32) -> Sent {
        let Some(id) = self.goals.iter().find(|goal| goal.ours == ours).map(|goal| goal.id) else {
            return Sent::No;
        };
        self.outbox.withdraw(Asked::Goal(self.which, id));
        self.request_end(id, Asked::Cancel(self.which))
    }

    fn request_end(&mut self, id: GoalId, about: Asked) -> Sent {
        // A goal's number without a time selects that goal alone.
        self.request(|client| &client.cancel_goal, &(id, ros::Time::default()), about)
    }

    /// Requests (once) the end of a goal that does not exist.
    pub fn ask(&mut self) {
        if self.probe == Probe::NotSent
            && self.request_end(UUID::new_random(), Asked::Probe(self.which)) != Sent::No
        {
            self.probe = Probe::Waiting;
        }
    }

    /// Returns the result of that request so far.
    pub fn probe(&self) -> Probe {
        self.probe
    }

    /// Returns the number of active goals on the server that other programs sent.
    pub fn foreign(&self) -> usize {
        self.foreign
    }

    fn ours(&self, id: GoalId) -> Option<u32> {
        self.goals.iter().find(|goal| goal.id == id).map(|goal| goal.ours)
    }

    /// Returns all answers, each with our number of the goal.
    pub fn said<R: DeserializeOwned, F: DeserializeOwned>(&mut self) -> Vec<(u32, Said<R, F>)> {
        let (mut said, mut ends) = (Vec::new(), Vec::new());
        for (about, bytes) in self.inbox.take_answers(self.which) {
            match about {
                Asked::Goal(_, id) => {
                    let Some(ours) = self.ours(id) else { continue };
                    match decode::<(bool, ros::Time)>(&bytes) {
                        Some((true, _)) => {
                            self.request(|client| &client.get_result, &id, Asked::Result(self.which, id));
                            said.push((ours, Said::Accepted));
                        }
                        // The goal is kept. After a forged answer, another server may still accept it.
                        Some((false, _)) => said.push((ours, Said::Rejected)),
                        None => {}
                    }
                }
                Asked::Result(_, id) => {
                    if let (Some(ours), Some((status, result))) =
                        (self.ours(id), decode::<(GoalStatusEnum, R)>(&bytes))
                    {
                        ends.push((ours, Said::Result(status, result)));
                    }
                }
                Asked::Probe(_) => self.probe = Probe::Answered,
                // The goal's own result shows whether the cancellation succeeded.
                Asked::Cancel(_) | Asked::History(_) => {}
            }
        }
        for bytes in self.inbox.take_progress(self.which) {
            if let Some((id, feedback)) = decode::<(GoalId, F)>(&bytes)
                && let Some(ours) = self.ours(id)
            {
                said.push((ours, Said::Feedback(feedback)));
            }
        }
        if let Some(list) = self.inbox.take_status(self.which) {
            self.foreign = active(&list).filter(|id| self.ours(*id).is_none()).count();
        }
        said.extend(ends);
        said
    }
}

/// The status of all goals, as reported by an action's server.
pub fn status(name: &str) -> Named {
    Named::new(&format!("{name}/_action/status"), "action_msgs/msg/GoalStatusArray")
}
