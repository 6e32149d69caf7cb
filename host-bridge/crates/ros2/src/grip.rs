//! The gripper's action on the graph, for both kinds of servers.

use ros2_client::action::ActionClient;
use ros2_client::{Node, QosProfile};

use super::action::{self, Goals, Said};
use super::advice::{Endpoint, Graph};
use super::config::Ros2Config;
use super::follow::named;
use super::gripper::GripAnswer;
use super::transport::NodeError;
use super::vendor::{Vendor, Wrapping};
use host_topics::message as ros;

/// Maximum number of stored goals.
const GOALS_MAX: usize = 64;
/// The reason given for a robot whose gripper is not configured.
pub const NO_GRIPPER: &str = "this robot's gripper is not driven";
/// The last part of the topic on which the gripper's server reads requests.
const REQUEST: &str = "/_action/send_goalRequest";

/// The kinds of action, with the type of their requests.
pub const KINDS: [(&str, &str); 2] = [
    ("GripperCommand", "control_msgs::action::dds_::GripperCommand_SendGoal_Request_"),
    ("ParallelGripperCommand", "control_msgs::action::dds_::ParallelGripperCommand_SendGoal_Request_"),
];

type Command = ActionClient<ros::GripGoal, ros::GripResult, ros::GripResult>;
type Parallel = ActionClient<ros::ParallelGoal, ros::ParallelResult, ros::ParallelFeedback>;

enum Client {
    Command(Box<Command>),
    Parallel(Box<Parallel>),
}

/// The configured choice of the server.
pub struct Meant {
    /// The action's name; empty means the only one below the namespace.
    name: String,
    namespace: String,
}

/// The server that was chosen.
pub struct Found {
    /// The action's name.
    pub name: String,
    /// Its index in [`KINDS`].
    pub kind: usize,
    /// The vendor of the server's middleware.
    pub vendor: Vendor,
}

impl Meant {
    /// Returns the choice as configured, or `None` if no gripper is used.
    pub fn new(config: &Ros2Config) -> Option<Self> {
        let name = match config.gripper.as_str() {
            "" => return None,
            "auto" => String::new(),
            name => config.resolve(name),
        };
        Some(Meant { name, namespace: config.namespace.clone() })
    }

    /// Returns whether the name is `/NAMESPACE/CONTROLLER/gripper_cmd` and belongs to this robot.
    fn may_be_ours(&self, name: &str) -> bool {
        let below = name.strip_prefix(&self.namespace).and_then(|rest| rest.strip_prefix('/'));
        let controller = below.and_then(|rest| rest.strip_suffix("/gripper_cmd"));
        controller.is_some_and(|controller| !controller.is_empty() && !controller.contains('/'))
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

    /// The only one.
    ///
    /// # Errors
    /// There is no server, or more than one.
    pub fn only(&self, graph: &Graph) -> Result<Found, String> {
        let servers = self.servers(graph);
        match servers.as_slice() {
            [(name, kind, server)] => Ok(Found { name: name.clone(), kind: *kind, vendor: server.vendor }),
            [] if self.name.is_empty() => {
                Err(format!("there is no action server {}/CONTROLLER/gripper_cmd", self.namespace))
            }
            [] => Err(format!("no server of {}", self.name)),
            _ => {
                let ends: Vec<&Endpoint> = servers.iter().map(|(_, _, end)| *end).collect();
                Err(format!("there are {} servers: {}; name one", servers.len(), named(&ends)))
            }
        }
    }
}

/// Describes the chosen gripper for users.
pub fn about(name: &str, kind: usize) -> String {
    format!("the gripper is {name} ({})", KINDS[kind].0)
}

/// Explains why a server that executes another program's goal is not used.
pub fn at_work(name: &str) -> String {
    format!("{name} is at a goal of another program")
}

/// Explains why a newly discovered server is not used at once.
pub const JUST_FOUND: &str = "its server has just been found";

/// Creates a goal of `GripperCommand`.
pub fn command(position: f64, effort: Option<f64>) -> ros::GripGoal {
    ros::GripGoal { command: ros::GripperCommand { position, max_effort: effort.unwrap_or(0.0) } }
}

/// Creates a goal of `ParallelGripperCommand`; a joint without a name is the gripper's only one.
pub fn parallel(joint: &str, position: f64, effort: Option<f64>) -> ros::ParallelGoal {
    let named = Some(joint.to_owned()).filter(|joint| !joint.is_empty());
    ros::ParallelGoal {
        command: ros::JointState {
            name: named.into_iter().collect(),
            position: vec![position],
            effort: effort.into_iter().collect(),
            ..ros::JointState::default()
        },
    }
}

/// See the module.
pub struct Gripper {
    meant: Meant,
    joint: String,
    qos: QosProfile,
    /// Name and kind of the action, and the vendor of its server.
    client: Option<((String, usize, Wrapping), Client)>,
    goals: Goals,
}

impl Gripper {
    /// Creates the gripper of a configuration, if it has one. No server is known yet.
    pub fn new(config: &Ros2Config, qos: QosProfile) -> Option<Self> {
        Some(Gripper {
            meant: Meant::new(config)?,
            joint: config.gripper_joint.clone(),
            qos,
            client: None,
            goals: Goals::new(GOALS_MAX),
        })
    }

    /// Describes the chosen server for users.
    pub fn about(&self) -> Option<String> {
        let ((name, kind, _), _) = self.client.as_ref()?;
        Some(about(name, *kind))
    }

    /// Looks for the action's server. Returns the reason why none can be used, or `None` if one can be used.
    ///
    /// # Errors
    /// Fails if the client cannot be created.
    pub fn look(&mut self, node: &mut Node, graph: &Graph) -> Result<Option<String>, NodeError> {
        let Found { name, kind, vendor } = match self.meant.only(graph) {
            Ok(found) => found,
            Err(why) => return Ok(Some(why)),
        };
        let key = (name, kind, vendor.wrapping());
        if self.client.as_ref().is_none_or(|(known, _)| *known != key) {
            let client = self.connect(node, &key)?;
            self.client = Some((key, client));
            self.goals.clear();
            return Ok(Some(JUST_FOUND.to_owned()));
        }
        Ok((self.goals.foreign() > 0).then(|| at_work(&key.0)))
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

    /// Sends a goal. Returns whether the goal was accepted for sending.
    pub fn send(&mut self, ours: u32, position: f64, effort: Option<f64>) -> bool {
        match &self.client {
            None => false,
            Some((_, Client::Command(client))) => self.goals.send(client, ours, command(position, effort)),
            Some((_, Client::Parallel(client))) => {
                self.goals.send(client, ours, parallel(&self.joint, position, effort))
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
        match &self.client {
            None => Vec::new(),
            Some((_, Client::Command(client))) => command_answers(self.goals.said(client, |_| ())),
            Some((_, Client::Parallel(client))) => parallel_answers(self.goals.said(client, |_| ())),
        }
    }
}

/// Converts an answer of a `GripperCommand` server.
pub fn command_answers(said: Vec<(u32, Said<ros::GripResult, ros::GripResult>)>) -> Vec<(u32, GripAnswer)> {
    answers(
        said,
        |result| (result.position, result.stalled, result.reached_goal),
        |feedback| feedback.position,
    )
}

/// Converts an answer of a `ParallelGripperCommand` server.
pub fn parallel_answers(
    said: Vec<(u32, Said<ros::ParallelResult, ros::ParallelFeedback>)>,
) -> Vec<(u32, GripAnswer)> {
    let first = |state: &ros::JointState| state.position.first().copied().unwrap_or(f64::NAN);
    answers(
        said,
        |result| (first(&result.state), result.stalled, result.reached_goal),
        |feedback| first(&feedback.state),
    )
}

/// Converts an answer of a server of either kind.
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
