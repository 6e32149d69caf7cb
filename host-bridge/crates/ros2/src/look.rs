//! Reads the graph before a robot is driven: the robot's description, and the controllers that follow trajectories.
//! These functions publish nothing on the graph.

use std::time::{Duration, Instant};

use host_topics::message as ros;
use ros2_client::Subscription;

use super::config::{Carrier, Connection, Ros2Config};
use super::follow::STATUS;
use super::joined::{bare, latched, subscription_with};
use super::transport::NodeError;

/// The graph is read for at least this long, because end points are discovered one by one.
const SETTLE: Duration = Duration::from_millis(2500);

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest URDF on the topic of descriptions.
    pub description: Option<String>,
    /// Names of controllers that have a `follow_joint_trajectory` action, in order.
    pub controllers: Vec<String>,
}

/// Reads the graph until a description arrives, but no longer than `wait`.
///
/// # Errors
/// Fails if the domain or topic is not available. It also fails for a robot on Zenoh, which is not read here.
pub fn look(config: &Ros2Config, connection: &Connection, wait: Duration) -> Result<Found, NodeError> {
    if config.transport == Carrier::Zenoh {
        let why = "a robot's description is read over DDS alone: save it to a file, and name that in the scene's [arm]";
        return Err(NodeError(why.to_owned()));
    }
    let (context, mut node) = bare(config, connection)?;
    let topic = config.resolve(&config.robot_description);
    let reader: Subscription<ros::Text> =
        subscription_with(&mut node, &topic, ("std_msgs", "String"), &latched())?;
    let participant = context.domain_participant();
    let mut found = Found::default();
    let start = Instant::now();
    loop {
        while let Ok(Some((text, _))) = reader.take() {
            found.description = Some(text.data);
        }
        let enough = found.description.is_some() && start.elapsed() >= SETTLE;
        if enough || start.elapsed() >= wait {
            let writers = participant.discovered_writers();
            found.controllers =
                controllers(writers.iter().map(|w| w.publication_topic_data.topic_name().as_str()));
            return Ok(found);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Returns the controllers whose actions have these topics.
fn controllers<'a>(topics: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut names: Vec<String> =
        topics.filter_map(|topic| Some(topic.strip_prefix("rt")?.strip_suffix(STATUS)?.to_owned())).collect();
    names.sort();
    names.dedup();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_are_the_names_before_their_actions_status_each_once() {
        let topics = [
            "rt/arm_controller/follow_joint_trajectory/_action/status",
            "rt/arm_controller/follow_joint_trajectory/_action/feedback",
            "rt/cell/torso_controller/follow_joint_trajectory/_action/status",
            "rt/arm_controller/follow_joint_trajectory/_action/status",
            "rt/joint_states",
        ];
        assert_eq!(controllers(topics.into_iter()), ["/arm_controller", "/cell/torso_controller"]);
    }
}
