//! The common part of all action clients.
//! The client is created for the vendor of its server.
//! The client stores the goals that were sent, and reads the server's reports about them.

use ros2_client::action::{ActionClient, ActionClientQosPolicies, GoalId};
use ros2_client::action_msgs::{GoalStatus, GoalStatusArray, GoalStatusEnum};
use ros2_client::qos::Durability;
use ros2_client::{ActionTypeName, Message, Name, Node, QosProfile, RmwRequestId, ServiceMapping};

use super::transport::NodeError;
use super::vendor::Wrapping;

/// Creates a client of this action, whose types are from `control_msgs`.
///
/// # Errors
/// Fails if the action's name is invalid, or the client cannot be created.
pub fn connect<G, R, F>(
    node: &mut Node,
    name: &str,
    kind: &str,
    wrapping: Wrapping,
    qos: &QosProfile,
) -> Result<ActionClient<G, R, F>, NodeError>
where
    G: Message + Clone + 'static,
    R: Message + Clone + 'static,
    F: Message + 'static,
{
    let mapping = match wrapping {
        Wrapping::Cyclone => ServiceMapping::Cyclone,
        Wrapping::Rpc => ServiceMapping::Enhanced,
    };
    let parsed = Name::parse(name).map_err(|error| NodeError::of(name, &error))?;
    let policies = ActionClientQosPolicies {
        goal_service: qos.clone(),
        result_service: qos.clone(),
        cancel_service: qos.clone(),
        feedback_subscription: qos.clone(),
        status_subscription: qos.clone().durability(Durability::TransientLocal),
    };
    let type_name = ActionTypeName::new("control_msgs", kind);
    node.create_action_client(mapping, &parsed, &type_name, policies)
        .map_err(|error| NodeError::of(name, &error))
}

/// A server's report about a goal.
pub enum Said<R, F> {
    /// It runs.
    Accepted,
    /// It does not.
    Rejected,
    /// The progress of the goal.
    Feedback(F),
    /// The final status and the result of the goal.
    Result(GoalStatusEnum, R),
}

/// A goal of ours, which may already be over.
struct Goal {
    ours: u32,
    request: RmwRequestId,
    id: GoalId,
    result: Option<RmwRequestId>,
}

/// The goals that were sent to an action's server.
pub struct Goals {
    known: Vec<Goal>,
    /// Maximum number of goals that are stored.
    most: usize,
    /// Number of active goals on the server that other programs sent.
    foreign: usize,
}

impl Goals {
    /// Creates an empty list that stores this many goals.
    pub fn new(most: usize) -> Self {
        Goals { known: Vec::new(), most, foreign: 0 }
    }

    /// Deletes all goals. Their answers would go to a client that no longer exists.
    pub fn clear(&mut self) {
        self.known.clear();
    }

    /// Returns the number of active goals on the server that other programs sent.
    pub fn foreign(&self) -> usize {
        self.foreign
    }

    /// Sends a goal. Returns whether the goal was accepted for sending.
    pub fn send<G, R, F>(&mut self, client: &ActionClient<G, R, F>, ours: u32, goal: G) -> bool
    where
        G: Message + Clone + 'static,
        R: Message + Clone + 'static,
        F: Message + 'static,
    {
        let Ok((request, id)) = client.send_goal(goal) else { return false };
        if self.known.len() == self.most {
            self.known.remove(0);
        }
        self.known.push(Goal { ours, request, id, result: None });
        true
    }

    /// Requests the cancellation of a goal. Returns whether the request was accepted for sending.
    pub fn cancel<G, R, F>(&self, client: &ActionClient<G, R, F>, ours: u32) -> bool
    where
        G: Message + Clone + 'static,
        R: Message + Clone + 'static,
        F: Message + 'static,
    {
        let known = self.known.iter().find(|goal| goal.ours == ours);
        known.is_some_and(|goal| client.cancel_goal(goal.id).is_ok())
    }

    /// Returns all reports, with our numbers of the goals. Answers to cancellations are passed to `cancelled`.
    pub fn said<G, R, F>(
        &mut self,
        client: &ActionClient<G, R, F>,
        mut cancelled: impl FnMut(RmwRequestId),
    ) -> Vec<(u32, Said<R, F>)>
    where
        G: Message + Clone + 'static,
        R: Message + Clone + 'static,
        F: Message + 'static,
    {
        let mut said = Vec::new();
        let goals = &mut self.known;
        while let Ok(Some((request, response))) = client.goal_client().receive_response() {
            let Some(goal) = goals.iter_mut().find(|goal| goal.request == request) else { continue };
            if response.accepted {
                goal.result = client.request_result(goal.id).ok();
                said.push((goal.ours, Said::Accepted));
            } else {
                // The goal is kept. With two servers or a forged answer, another server may still accept it.
                said.push((goal.ours, Said::Rejected));
            }
        }
        while let Ok(Some((message, _))) = client.feedback_subscription().take() {
            if let Some(goal) = goals.iter().find(|goal| goal.id == message.goal_id) {
                said.push((goal.ours, Said::Feedback(message.feedback)));
            }
        }
        while let Ok(Some((request, response))) = client.result_client().receive_response() {
            // The goal is kept. A forged result must not prevent a stop from cancelling it.
            let Some(goal) = goals.iter_mut().find(|goal| goal.result == Some(request)) else { continue };
            goal.result = None;
            said.push((goal.ours, Said::Result(response.status, response.result)));
        }
        while let Ok(Some((request, _))) = client.cancel_client().receive_response() {
            cancelled(request);
        }
        while let Ok(Some(list)) = client.receive_status() {
            self.foreign = active(&list).filter(|id| !goals.iter().any(|goal| goal.id == *id)).count();
        }
        said
    }
}

/// Returns the unfinished goals in a server's list.
pub fn active(list: &GoalStatusArray) -> impl Iterator<Item = GoalId> + '_ {
    use GoalStatusEnum::{Accepted, Canceling, Executing};
    let runs = |status: &&GoalStatus| matches!(status.status, Accepted | Executing | Canceling);
    list.status_list.iter().filter(runs).map(|status| status.goal_info.goal_id)
}
