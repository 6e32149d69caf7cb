//! The gripper's action on the graph, of whichever kind its server is.

use ros2_client::action::{ActionClient, ActionClientQosPolicies, GoalId};
use ros2_client::action_msgs::GoalStatusArray;
use ros2_client::qos::Durability;
use ros2_client::{ActionTypeName, Message, Name, Node, QosProfile, RmwRequestId, ServiceMapping};

use super::advice::{Endpoint, Graph};
use super::config::Ros2Config;
use super::follow::{active, named};
use super::gripper::GripAnswer;
use super::joined::NodeError;
use super::vendor::Wrapping;
use host_topics::message as ros;

/// More goals are not remembered.
const GOALS_MAX: usize = 16;
/// What its server's requests end in.
const REQUEST: &str = "/_action/send_goalRequest";

/// The kinds of action, and the type of their requests.
const KINDS: [(&str, &str); 2] = [
    ("GripperCommand", "control_msgs::action::dds_::GripperCommand_SendGoal_Request_"),
    ("ParallelGripperCommand", "control_msgs::action::dds_::ParallelGripperCommand_SendGoal_Request_"),
];

type Command = ActionClient<ros::GripGoal, ros::GripResult, ros::GripResult>;
type Parallel = ActionClient<ros::ParallelGoal, ros::ParallelResult, ros::ParallelFeedback>;

enum Client {
    Command(Box<Command>),
    Parallel(Box<Parallel>),
}

struct Goal {
    ours: u32,
    request: RmwRequestId,
    id: GoalId,
    result: Option<RmwRequestId>,
}

/// See the module.
pub struct Gripper {
    /// The action's name; empty = whichever there is below the namespace.
    name: String,
    namespace: String,
    /// Active goals on the server that are not ours.
    foreign: usize,
    joint: String,
    qos: QosProfile,
    /// Name, kind and vendor's way of the server that it is for.
    client: Option<((String, usize, Wrapping), Client)>,
    goals: Vec<Goal>,
}

impl Gripper {
    /// The gripper of a configuration, if it has one; nobody is asked yet.
    pub fn new(config: &Ros2Config, qos: QosProfile) -> Option<Self> {
        let name = match config.gripper.as_str() {
            "" => return None,
            "auto" => String::new(),
            name => config.resolve(name),
        };
        let namespace = config.namespace.clone();
        Some(Gripper {
            name,
            namespace,
            foreign: 0,
            joint: config.gripper_joint.clone(),
            qos,
            client: None,
            goals: Vec::new(),
        })
    }

    /// `/NAMESPACE/CONTROLLER/gripper_cmd`, and no other robot's.
    fn may_be_ours(&self, name: &str) -> bool {
        let below = name.strip_prefix(&self.namespace).and_then(|rest| rest.strip_prefix('/'));
        let controller = below.and_then(|rest| rest.strip_suffix("/gripper_cmd"));
        controller.is_some_and(|controller| !controller.is_empty() && !controller.contains('/'))
    }

    /// Which server is asked, for people.
    pub fn about(&self) -> Option<String> {
        let ((name, kind, _), _) = self.client.as_ref()?;
        Some(format!("the gripper is {name} ({})", KINDS[*kind].0))
    }

    /// The servers that could be meant, with their names and kinds.
    fn servers<'a>(&self, graph: &'a Graph) -> Vec<(String, usize, &'a Endpoint)> {
        let server = |reader: &'a Endpoint| {
            let kind = KINDS.iter().position(|(_, request)| reader.type_name == *request)?;
            let name = reader.topic.strip_prefix("rq")?.strip_suffix(REQUEST)?;
            let meant = if self.name.is_empty() { self.may_be_ours(name) } else { name == self.name };
            meant.then(|| (name.to_owned(), kind, reader))
        };
        graph.readers.iter().filter_map(server).collect()
    }

    /// Looks who serves the action. Why nobody can be asked; `None` = somebody can.
    ///
    /// # Errors
    /// Where the client cannot be made.
    pub fn look(&mut self, node: &mut Node, graph: &Graph) -> Result<Option<String>, NodeError> {
        let servers = self.servers(graph);
        let [(name, kind, server)] = servers.as_slice() else {
            return Ok(Some(match servers.len() {
                0 if self.name.is_empty() => {
                    format!("there is no action server {}/CONTROLLER/gripper_cmd", self.namespace)
                }
                0 => format!("no server of {}", self.name),
                _ => {
                    let ends: Vec<&Endpoint> = servers.iter().map(|(_, _, end)| *end).collect();
                    format!("there are {} servers: {}; name one", servers.len(), named(&ends))
                }
            }));
        };
        let key = (name.clone(), *kind, server.vendor.wrapping());
        if self.client.as_ref().is_none_or(|(known, _)| *known != key) {
            let client = self.connect(node, &key)?;
            self.client = Some((key, client));
            self.goals.clear();
            return Ok(Some("its server has just been found".to_owned()));
        }
        if self.foreign > 0 {
            return Ok(Some(format!("{name} is at a goal of another program")));
        }
        Ok(None)
    }

    fn connect(
        &self,
        node: &mut Node,
        (name, kind, wrapping): &(String, usize, Wrapping),
    ) -> Result<Client, NodeError> {
        let mapping = match wrapping {
            Wrapping::Cyclone => ServiceMapping::Cyclone,
            Wrapping::Rpc => ServiceMapping::Enhanced,
        };
        let parsed = Name::parse(name).map_err(|error| NodeError::of(name, &error))?;
        let qos = ActionClientQosPolicies {
            goal_service: self.qos.clone(),
            result_service: self.qos.clone(),
            cancel_service: self.qos.clone(),
            feedback_subscription: self.qos.clone(),
            status_subscription: self.qos.clone().durability(Durability::TransientLocal),
        };
        let type_name = ActionTypeName::new("control_msgs", KINDS[*kind].0);
        let failed = |error: ros2_client::ros2::CreateError| NodeError::of(name, &error);
        Ok(if *kind == 0 {
            Client::Command(Box::new(
                node.create_action_client(mapping, &parsed, &type_name, qos).map_err(failed)?,
            ))
        } else {
            Client::Parallel(Box::new(
                node.create_action_client(mapping, &parsed, &type_name, qos).map_err(failed)?,
            ))
        })
    }

    /// Sends a goal; whether it could be handed over.
    pub fn send(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool {
        let sent = match &self.client {
            None => return false,
            Some((_, Client::Command(client))) => {
                let command = ros::GripperCommand { position, max_effort: effort.unwrap_or(0.0) };
                client.send_goal(ros::GripGoal { command }).ok()
            }
            Some((_, Client::Parallel(client))) => {
                let named = Some(self.joint.clone()).filter(|joint| !joint.is_empty());
                let command = ros::JointState {
                    name: named.into_iter().collect(),
                    position: vec![position],
                    effort: effort.into_iter().collect(),
                    ..ros::JointState::default()
                };
                client.send_goal(ros::ParallelGoal { command }).ok()
            }
        };
        let Some((request, id)) = sent else { return false };
        if self.goals.len() == GOALS_MAX {
            self.goals.remove(0);
        }
        self.goals.push(Goal { ours, request, id, result: None });
        true
    }

    /// Asks for a goal's end; whether that could be handed over.
    pub fn cancel(&self, ours: u32) -> bool {
        let Some(goal) = self.goals.iter().find(|goal| goal.ours == ours) else { return false };
        match &self.client {
            None => false,
            Some((_, Client::Command(client))) => client.cancel_goal(goal.id).is_ok(),
            Some((_, Client::Parallel(client))) => client.cancel_goal(goal.id).is_ok(),
        }
    }

    /// What the server said: our number of the goal, and the answer.
    pub fn answers(&mut self) -> Vec<(u32, GripAnswer)> {
        let lists = match &self.client {
            None => Vec::new(),
            Some((_, Client::Command(client))) => lists(client),
            Some((_, Client::Parallel(client))) => lists(client),
        };
        for list in lists {
            let foreign = active(&list).filter(|id| !self.goals.iter().any(|goal| goal.id == *id));
            self.foreign = foreign.count();
        }
        let goals = &mut self.goals;
        let first = |state: &ros::JointState| state.position.first().copied().unwrap_or(f64::NAN);
        match &self.client {
            None => Vec::new(),
            Some((_, Client::Command(client))) => answers(
                client,
                goals,
                |result| (result.position, result.stalled, result.reached_goal),
                |feedback| feedback.position,
            ),
            Some((_, Client::Parallel(client))) => answers(
                client,
                goals,
                |result| (first(&result.state), result.stalled, result.reached_goal),
                |feedback| first(&feedback.state),
            ),
        }
    }
}

/// Everything that has come in.
fn answers<G, R, F>(
    client: &ActionClient<G, R, F>,
    goals: &mut [Goal],
    result_of: impl Fn(&R) -> (f64, bool, bool),
    place_of: impl Fn(&F) -> f64,
) -> Vec<(u32, GripAnswer)>
where
    G: Message + Clone + 'static,
    R: Message + Clone + 'static,
    F: Message + 'static,
{
    let mut said = Vec::new();
    while let Ok(Some((request, response))) = client.goal_client().receive_response() {
        let Some(goal) = goals.iter_mut().find(|goal| goal.request == request) else { continue };
        if response.accepted {
            goal.result = client.request_result(goal.id).ok();
            said.push((goal.ours, GripAnswer::Accepted));
        } else {
            said.push((goal.ours, GripAnswer::Rejected));
        }
    }
    while let Ok(Some((message, _))) = client.feedback_subscription().take() {
        if let Some(goal) = goals.iter().find(|goal| goal.id == message.goal_id) {
            said.push((goal.ours, GripAnswer::At(place_of(&message.feedback))));
        }
    }
    while let Ok(Some((request, response))) = client.result_client().receive_response() {
        let Some(goal) = goals.iter_mut().find(|goal| goal.result == Some(request)) else { continue };
        goal.result = None;
        let (position, stalled, reached) = result_of(&response.result);
        let status = format!("{:?}", response.status);
        said.push((goal.ours, GripAnswer::Done { position, stalled, reached, status }));
    }
    while let Ok(Some(_)) = client.cancel_client().receive_response() {}
    said
}

/// What the server tells of all goals.
fn lists<G, R, F>(client: &ActionClient<G, R, F>) -> Vec<GoalStatusArray>
where
    G: Message + Clone + 'static,
    R: Message + Clone + 'static,
    F: Message + 'static,
{
    std::iter::from_fn(|| client.receive_status().ok().flatten()).collect()
}
