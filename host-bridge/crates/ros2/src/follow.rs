//! The arm's action on the graph: asked as the vendor of its server has it, which is known once that server is seen.

use ros2_client::action::{ActionClient, ActionClientQosPolicies, GoalId};
use ros2_client::action_msgs::{GoalStatus, GoalStatusArray, GoalStatusEnum};
use ros2_client::qos::Durability;
use ros2_client::unique_identifier_msgs::UUID;
use ros2_client::{ActionTypeName, Name, Node, QosProfile, RmwRequestId, ServiceMapping};

use super::advice::{Endpoint, Graph, Probe, wire};
use super::arm::Answer;
use super::joined::NodeError;
use super::vendor::Wrapping;
use host_topics::message as ros;

type Client = ActionClient<ros::FollowGoal, ros::FollowResult, ros::FollowFeedback>;

/// More goals are not remembered.
const GOALS_MAX: usize = 64;

/// A goal of ours, also one that is over.
struct Goal {
    ours: u32,
    request: RmwRequestId,
    id: GoalId,
    result: Option<RmwRequestId>,
}

/// See the module.
pub struct Follow {
    controller: String,
    qos: QosProfile,
    client: Option<(Wrapping, Box<Client>)>,
    goals: Vec<Goal>,
    probe: Option<RmwRequestId>,
    probed: Probe,
    /// Active goals on the server that are not ours.
    foreign: usize,
}

impl Follow {
    /// An action below the controller's name; nobody is asked yet.
    pub fn new(controller: String, qos: QosProfile) -> Self {
        let (client, goals) = (None, Vec::new());
        Follow { controller, qos, client, goals, probe: None, probed: Probe::NotSent, foreign: 0 }
    }

    /// The servers of this action: readers of its requests.
    pub fn servers<'a>(&self, graph: &'a Graph) -> Vec<&'a Endpoint> {
        let topic = wire::send_goal(&self.controller);
        graph.readers.iter().filter(|r| r.topic == topic && r.type_name == wire::SEND_GOAL).collect()
    }

    /// Looks who serves the action. Returns whether goals may be sent, and what a person should know.
    ///
    /// # Errors
    /// Where the client cannot be made.
    pub fn look(&mut self, node: &mut Node, graph: &Graph) -> Result<bool, NodeError> {
        let servers = self.servers(graph);
        let Some(first) = servers.first() else { return Ok(false) };
        let wrapping = first.vendor.wrapping();
        if self.client.as_ref().is_none_or(|(known, _)| *known != wrapping) {
            self.client = Some((wrapping, Box::new(self.connect(node, wrapping)?)));
            // Their answers would come to the client that is gone.
            self.goals.clear();
            return Ok(false);
        }
        // Of two servers both would take every goal, and one answer would hide the other.
        Ok(servers.len() == 1)
    }

    fn connect(&self, node: &mut Node, wrapping: Wrapping) -> Result<Client, NodeError> {
        let mapping = match wrapping {
            Wrapping::Cyclone => ServiceMapping::Cyclone,
            Wrapping::Rpc => ServiceMapping::Enhanced,
        };
        let name = format!("{}/follow_joint_trajectory", self.controller);
        let parsed = Name::parse(&name).map_err(|error| NodeError::of(&name, &error))?;
        let qos = ActionClientQosPolicies {
            goal_service: self.qos.clone(),
            result_service: self.qos.clone(),
            cancel_service: self.qos.clone(),
            feedback_subscription: self.qos.clone(),
            status_subscription: self.qos.clone().durability(Durability::TransientLocal),
        };
        let type_name = ActionTypeName::new("control_msgs", "FollowJointTrajectory");
        node.create_action_client(mapping, &parsed, &type_name, qos)
            .map_err(|error| NodeError::of(&name, &error))
    }

    /// Sends a goal; whether it could be handed over.
    pub fn send(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool {
        let Some((_, client)) = &self.client else { return false };
        let message = ros::FollowGoal { trajectory, ..ros::FollowGoal::default() };
        let sent = client.send_goal(message);
        if let Ok((request, id)) = sent {
            if self.goals.len() == GOALS_MAX {
                self.goals.remove(0);
            }
            self.goals.push(Goal { ours, request, id, result: None });
        }
        sent.is_ok()
    }

    /// Asks for a goal's end; whether that could be handed over.
    pub fn cancel(&self, ours: u32) -> bool {
        let Some((_, client)) = &self.client else { return false };
        let known = self.goals.iter().find(|goal| goal.ours == ours);
        known.is_some_and(|goal| client.cancel_goal(goal.id).is_ok())
    }

    /// Asks once for the end of a goal that nobody has.
    pub fn ask(&mut self) {
        if self.probed == Probe::NotSent
            && let Some((_, client)) = &self.client
        {
            self.probe = client.cancel_goal(UUID::new_random()).ok();
            if self.probe.is_some() {
                self.probed = Probe::Waiting;
            }
        }
    }

    /// What came of [`Follow::ask`] so far.
    pub fn probe(&self) -> Probe {
        self.probed
    }

    /// How many goals run on the server that are not ours.
    pub fn foreign(&self) -> usize {
        if self.client.is_some() { self.foreign } else { 0 }
    }

    /// What the server said: our number of the goal, and the answer.
    pub fn answers(&mut self) -> Vec<(u32, Answer)> {
        let mut said = Vec::new();
        let Some((_, client)) = &self.client else { return said };
        let goals = &mut self.goals;
        while let Ok(Some((request, response))) = client.goal_client().receive_response() {
            let Some(goal) = goals.iter_mut().find(|goal| goal.request == request) else { continue };
            if response.accepted {
                goal.result = client.request_result(goal.id).ok();
                said.push((goal.ours, Answer::Accepted));
            } else {
                // Kept: of two servers, or after a forged word, another may accept it yet.
                said.push((goal.ours, Answer::Rejected));
            }
        }
        while let Ok(Some((message, _))) = client.feedback_subscription().take() {
            if let Some(goal) = goals.iter().find(|goal| goal.id == message.goal_id) {
                let at_s = message.feedback.desired.time_from_start.seconds();
                said.push((goal.ours, Answer::Progress(at_s)));
            }
        }
        while let Ok(Some((request, response))) = client.result_client().receive_response() {
            let Some(place) = goals.iter().position(|goal| goal.result == Some(request)) else { continue };
            // Kept: a result that was forged must not keep a stop from cancelling.
            let goal = &mut goals[place];
            goal.result = None;
            let answer = match response.status {
                GoalStatusEnum::Succeeded => Answer::Succeeded,
                GoalStatusEnum::Canceled => Answer::Ended("cancelled".to_owned()),
                other => {
                    let ros::FollowResult { error_code, error_string } = &response.result;
                    Answer::Ended(format!("{other:?}, error {error_code} {error_string}"))
                }
            };
            said.push((goal.ours, answer));
        }
        // The result says what became of a cancellation; its own answers are only looked for after a probe.
        while let Ok(Some((request, _))) = client.cancel_client().receive_response() {
            if self.probe == Some(request) {
                self.probed = Probe::Answered;
            }
        }
        while let Ok(Some(list)) = client.receive_status() {
            let foreign = active(&list).filter(|id| !goals.iter().any(|goal| goal.id == *id));
            self.foreign = foreign.count();
        }
        said
    }
}

/// The goals in a server's list that are not over.
pub fn active(list: &GoalStatusArray) -> impl Iterator<Item = GoalId> + '_ {
    use GoalStatusEnum::{Accepted, Canceling, Executing};
    let runs = |status: &&GoalStatus| matches!(status.status, Accepted | Executing | Canceling);
    list.status_list.iter().filter(runs).map(|status| status.goal_info.goal_id)
}

/// A list of servers for people: `Fast DDS (010f...)`.
pub fn named(servers: &[&Endpoint]) -> String {
    let names: Vec<String> = servers.iter().map(|s| format!("{} ({})", s.vendor, s.participant)).collect();
    names.join(", ")
}
