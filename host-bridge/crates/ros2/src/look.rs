//! Reads the graph before a robot is driven: the robot's description, and the controllers that follow trajectories.
//! These functions publish nothing on the graph.

use std::time::{Duration, Instant};

use host_topics::message as ros;
use ros2_client::Subscription;

use super::advice::wire;
use super::config::{Carrier, Connection, Ros2Config};
use super::joined::{bare, latched, subscription_with};
use super::transport::NodeError;

/// The graph is read for at least this long, because end points are discovered one by one.
const SETTLE: Duration = Duration::from_millis(2500);

/// Reading goes on for this long after a new controller was discovered, because another one may follow.
const FOLLOWING: Duration = Duration::from_millis(1000);

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest URDF on the topic of descriptions.
    pub description: Option<String>,
    /// Names of controllers that have a `follow_joint_trajectory` action, in order.
    pub controllers: Vec<String>,
}

impl Found {
    /// Returns whether nothing needs to be waited for, this long after the start and after the last new controller.
    fn is_complete(&self, wanted: Option<&str>, since_start: Duration, since_new: Duration) -> bool {
        let has_controller = match wanted {
            Some(name) => self.controllers.iter().any(|known| known == name),
            None => !self.controllers.is_empty() && since_new >= FOLLOWING,
        };
        self.description.is_some() && has_controller && since_start >= SETTLE
    }
}

/// Reads the graph until a description and a controller are found, but no longer than `wait`.
/// If `wanted` names a controller, only this one counts.
/// What is missing then, is missing in the result.
///
/// # Errors
/// Fails if the domain or topic is not available. It also fails for a robot on Zenoh, which is not read here.
pub fn look(
    config: &Ros2Config,
    connection: &Connection,
    wanted: Option<&str>,
    wait: Duration,
) -> Result<Found, NodeError> {
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
    let mut new = start;
    loop {
        while let Ok(Some((text, _))) = reader.take() {
            found.description = Some(text.data);
        }
        let readers = participant.discovered_readers();
        let names = controllers(readers.iter().map(|r| r.subscription_topic_data.topic_name().as_str()));
        if names != found.controllers {
            (found.controllers, new) = (names, Instant::now());
        }
        if found.is_complete(wanted, start.elapsed(), new.elapsed()) || start.elapsed() >= wait {
            return Ok(found);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Returns the controllers whose actions read these topics.
/// These are the same topics by which the arm's own client finds its controller.
fn controllers<'a>(topics: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut names: Vec<String> = topics.filter_map(wire::controller).map(str::to_owned).collect();
    names.sort();
    names.dedup();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_alone_is_no_reason_to_stop_looking_for_the_controller() {
        let long = Duration::from_secs(7);
        let mut found = Found { description: Some("<robot/>".to_owned()), controllers: Vec::new() };
        assert!(!found.is_complete(None, long, long));
        found.controllers = vec!["/lift_controller".to_owned()];
        assert!(found.is_complete(None, long, long));
        assert!(found.is_complete(Some("/lift_controller"), long, Duration::ZERO));
        assert!(!found.is_complete(Some("/arm_controller"), long, long));
        // Soon after the start, or after a new controller, more may follow.
        assert!(!found.is_complete(None, Duration::from_secs(1), Duration::from_secs(1)));
        assert!(!found.is_complete(None, long, Duration::from_millis(500)));
        found.description = None;
        assert!(!found.is_complete(None, long, long));
    }

    #[test]
    fn controllers_are_the_names_before_their_actions_goals_each_once() {
        let topics = [
            "rq/arm_controller/follow_joint_trajectory/_action/send_goalRequest",
            "rq/arm_controller/follow_joint_trajectory/_action/cancel_goalRequest",
            "rq/cell/torso_controller/follow_joint_trajectory/_action/send_goalRequest",
            "rq/arm_controller/follow_joint_trajectory/_action/send_goalRequest",
            "rt/joint_states",
        ];
        assert_eq!(controllers(topics.into_iter()), ["/arm_controller", "/cell/torso_controller"]);
    }
}
