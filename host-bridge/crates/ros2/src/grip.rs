//! The gripper's action on the graph, for both kinds of servers.

use ros2_client::action::ActionClient;
use ros2_client::{Node, QosProfile};

use super::action::{self, Goals, Said};
use super::advice::{Endpoint, Graph};
use super::config::Ros2Config;
use super::follow::named;
use super::gripper::GripAnswer;
use super::joined::NodeError;
use super::vendor::Wrapping;
use host_topics::message as ros;

/// Maximum number of stored goals.
const GOALS_MAX: usize = 64;
/// Suffix of the topic on which a server of this type receives requests.
const REQUEST: &str = "/_action/send_goalRequest";

/// The kinds of actions with the types of their requests.
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

/// See the module.
pub struct Gripper {
    /// Name of the action; empty means any in the namespace.
    name: String,
    namespace: String,
    joint: String,
    qos: QosProfile,
    /// Name, kind and vendor of the client's server.
    client: Option<((String, usize, Wrapping), Client)>,
    goals: Goals,
}

impl Gripper {
    /// Creates the gripper of a configuration, if it has one, without a known server.
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
            joint: config.gripper_joint.clone(),
            qos,
            client: None,
            goals: Goals::new(GOALS_MAX),
        })
    }

    /// Returns whether the name is `/NAMESPACE/CONTROLLER/gripper_cmd` and belongs to this robot.
    fn may_be_ours(&self, name: &str) -> bool {
        let below = name.strip_prefix(&self.namespace).and_then(|rest| rest.strip_prefix('/'));
        let controller = below.and_then(|rest| rest.strip_suffix("/gripper_cmd"));
        controller.is_some_and(|controller| !controller.is_empty() && !controller.contains('/'))
    }

    /// Describes the server for users.
    pub fn about(&self) -> Option<String> {
        let ((name, kind, _), _) = self.client.as_ref()?;
        Some(format!("the gripper is {name} ({})", KINDS[*kind].0))
    }

    /// Returns the possible servers with their names and kinds.
    fn servers<'a>(&self, graph: &'a Graph) -> Vec<(String, usize, &'a Endpoint)> {
        let server = |reader: &'a Endpoint| {
            let kind = KINDS.iter().position(|(_, request)| reader.type_name == *request)?;
            let name = reader.topic.strip_prefix("rq")?.strip_suffix(REQUEST)?;
            let meant = if self.name.is_empty() { self.may_be_ours(name) } else { name == self.name };
            meant.then(|| (name.to_owned(), kind, reader))
        };
        graph.readers.iter().filter_map(server).collect()
    }

    /// Searches for the action's server. Returns the reason if none can be used, otherwise `None`.
    ///
    /// # Errors
    /// Fails if the client cannot be created.
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
        if self.goals.foreign() > 0 {
            return Ok(Some(format!("{name} is at a goal of another program")));
        }
        Ok(None)
    }

    fn connect(
        &self,
        node: &mut Node,
        (name, kind, wrapping): &(String, usize, Wrapping),
    ) -> Result<Client, NodeError> {
        let action = KINDS[*kind].0;
        Ok(if *kind == 0 {
            Client::Command(Box::new(action::connect(node, name, action, *wrapping, &self.qos)?))
        } else {
            Client::Parallel(Box::new(action::connect(node, name, action, *wrapping, &self.qos)?))
        })
    }

    /// Sends a goal. Returns whether it was accepted for sending.
    pub fn send(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool {
        match &self.client {
            None => false,
            Some((_, Client::Command(client))) => {
                let command = ros::GripperCommand { position, max_effort: effort.unwrap_or(0.0) };
                self.goals.send(client, ours, ros::GripGoal { command })
            }
            Some((_, Client::Parallel(client))) => {
                let named = Some(self.joint.clone()).filter(|joint| !joint.is_empty());
                let command = ros::JointState {
                    name: named.into_iter().collect(),
                    position: vec![position],
                    effort: effort.into_iter().collect(),
                    ..ros::JointState::default()
                };
                self.goals.send(client, ours, ros::ParallelGoal { command })
            }
        }
    }

    /// Requests the cancellation of a goal. Returns whether the request was accepted for sending.
    pub fn cancel(&self, ours: u32) -> bool {
        match &self.client {
            None => false,
            Some((_, Client::Command(client))) => self.goals.cancel(client, ours),
            Some((_, Client::Parallel(client))) => self.goals.cancel(client, ours),
        }
    }

    /// Returns the server's answers, each with our number of the goal.
    pub fn answers(&mut self) -> Vec<(u32, GripAnswer)> {
        let first = |state: &ros::JointState| state.position.first().copied().unwrap_or(f64::NAN);
        match &self.client {
            None => Vec::new(),
            Some((_, Client::Command(client))) => answers(
                self.goals.said(client, |_| ()),
                |result| (result.position, result.stalled, result.reached_goal),
                |feedback| feedback.position,
            ),
            Some((_, Client::Parallel(client))) => answers(
                self.goals.said(client, |_| ()),
                |result| (first(&result.state), result.stalled, result.reached_goal),
                |feedback| first(&feedback.state),
            ),
        }
    }
}

/// Converts the reports of a server of either kind.
fn answers<R, F>(
    said: Vec<(u32, Said<R, F>)>,
    result_of: impl Fn(&R) -> (f64, bool, bool),
    place_of: impl Fn(&F) -> f64,
) -> Vec<(u32, GripAnswer)> {
    let answer = |said| match said {
        Said::Accepted => GripAnswer::Accepted,
        Said::Rejected => GripAnswer::Rejected,
        Said::Feedback(feedback) => GripAnswer::At(place_of(&feedback)),
        Said::Result(status, result) => {
            let (position, stalled, reached) = result_of(&result);
            GripAnswer::Done { position, stalled, reached, status: format!("{status:?}") }
        }
    };
    said.into_iter().map(|(ours, said)| (ours, answer(said))).collect()
}
