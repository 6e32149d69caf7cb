//! The client of the arm's action on the graph.
//! Requests depend on the vendor of the action's server, which is known once the server is discovered.

use ros2_client::action::ActionClient;
use ros2_client::action_msgs::GoalStatusEnum;
use ros2_client::unique_identifier_msgs::UUID;
use ros2_client::{Node, QosProfile, RmwRequestId};

use super::action::{self, Goals, Said};
use super::advice::{Endpoint, Graph, Probe, wire};
use super::answer::Answer;
use super::transport::NodeError;
use super::vendor::Wrapping;
use host_topics::message as ros;

type Client = ActionClient<ros::FollowGoal, ros::FollowResult, ros::FollowFeedback>;

/// The last part of the topic with the status of a controller's action.
pub const STATUS: &str = "/follow_joint_trajectory/_action/status";

/// Maximum number of stored goals.
const GOALS_MAX: usize = 64;

/// See the module.
pub struct Follow {
    controller: String,
    qos: QosProfile,
    client: Option<(Wrapping, Box<Client>)>,
    goals: Goals,
    probe: Option<RmwRequestId>,
    probed: Probe,
}

impl Follow {
    /// Creates an action below the controller's name, without a known server.
    pub fn new(controller: String, qos: QosProfile) -> Self {
        let (client, goals) = (None, Goals::new(GOALS_MAX));
        Follow { controller, qos, client, goals, probe: None, probed: Probe::NotSent }
    }

    /// Looks for the action's server. Returns whether goals may be sent.
    ///
    /// # Errors
    /// Fails if the client cannot be created.
    pub fn look(&mut self, node: &mut Node, graph: &Graph) -> Result<bool, NodeError> {
        let servers = servers(graph, &self.controller);
        let Some(first) = servers.first() else { return Ok(false) };
        let wrapping = first.vendor.wrapping();
        if self.client.as_ref().is_none_or(|(known, _)| *known != wrapping) {
            let name = format!("{}/follow_joint_trajectory", self.controller);
            let client = action::connect(node, &name, "FollowJointTrajectory", wrapping, &self.qos)?;
            self.client = Some((wrapping, Box::new(client)));
            self.goals.clear();
            return Ok(false);
        }
        // Two servers would both accept every goal, and the answer of one would hide that of the other.
        Ok(servers.len() == 1)
    }

    /// Sends a goal. Returns whether the goal was accepted for sending.
    pub fn send(&mut self, ours: u32, trajectory: ros::JointTrajectory) -> bool {
        let Some((_, client)) = &self.client else { return false };
        self.goals.send(client, ours, ros::FollowGoal { trajectory, ..ros::FollowGoal::default() })
    }

    /// Requests the cancellation of a goal. Returns whether the request was accepted for sending.
    pub fn cancel(&self, ours: u32) -> bool {
        self.client.as_ref().is_some_and(|(_, client)| self.goals.cancel(client, ours))
    }

    /// Requests (once) the cancellation of a goal that does not exist.
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

    /// Returns the result of [`Follow::ask`] so far.
    pub fn probe(&self) -> Probe {
        self.probed
    }

    /// Returns the number of active goals on the server that other programs sent.
    pub fn foreign(&self) -> usize {
        if self.client.is_some() { self.goals.foreign() } else { 0 }
    }

    /// Returns the server's answers, each with our number of the goal.
    pub fn answers(&mut self) -> Vec<(u32, Answer)> {
        let Some((_, client)) = &self.client else { return Vec::new() };
        let (probe, probed) = (self.probe, &mut self.probed);
        // The result shows the end of a cancellation, so answers to cancellations are read only after a probe.
        let said = self.goals.said(client, |request| {
            if probe == Some(request) {
                *probed = Probe::Answered;
            }
        });
        answers(said)
    }
}

/// An answer of the arm's server.
pub fn answers(said: Vec<(u32, Said<ros::FollowResult, ros::FollowFeedback>)>) -> Vec<(u32, Answer)> {
    said.into_iter().map(|(ours, said)| (ours, answer(said))).collect()
}

fn answer(said: Said<ros::FollowResult, ros::FollowFeedback>) -> Answer {
    match said {
        Said::Accepted => Answer::Accepted,
        Said::Rejected => Answer::Rejected,
        Said::Feedback(feedback) => Answer::Progress(feedback.desired.time_from_start.seconds()),
        Said::Result(GoalStatusEnum::Succeeded, _) => Answer::Succeeded,
        Said::Result(GoalStatusEnum::Canceled, _) => Answer::Ended("cancelled".to_owned()),
        Said::Result(other, ros::FollowResult { error_code, error_string }) => {
            Answer::Ended(format!("{other:?}, error {error_code} {error_string}"))
        }
    }
}

/// Returns the servers of the arm's action below this controller, which are the readers of its requests.
pub fn servers<'a>(graph: &'a Graph, controller: &str) -> Vec<&'a Endpoint> {
    let topic = wire::send_goal(controller);
    graph.readers.iter().filter(|r| r.topic == topic && r.type_name == wire::SEND_GOAL).collect()
}

/// Lists servers in a form for users: `Fast DDS (010f...)`.
pub fn named(servers: &[&Endpoint]) -> String {
    let names: Vec<String> = servers.iter().map(|s| format!("{} ({})", s.vendor, s.participant)).collect();
    names.join(", ")
}
