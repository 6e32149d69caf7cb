//! Messages that wait to be sent, lane by lane. Sans-IO.
//! Each kind keeps its newest message. At most [`ASKS_MAX`] requests wait, plus one cancellation per goal.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use super::inbox::{Asked, Read, Which};
use crate::transport::Sent;
use crate::zenoh_keys::{Attached, Named, Quality};

/// Maximum number of requests that wait.
const ASKS_MAX: usize = 32;
/// Maximum number of waiting cancellations, which is also the number of goals that are remembered.
const CANCELS_MAX: usize = 256;

/// The lanes wait for the network independently, so that no lane delays another one.
/// Each lane has its own thread and its own queue in Zenoh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Cancellations come first, followed by the operator's stop, goals and other requests.
    Requests,
    /// The arm's trajectories, including the one that stops the arm.
    Arm,
    /// The base's speeds, including the zero that stops the base.
    Base,
    /// All other messages, which are dropped on a slow network.
    Rest,
}

impl Lane {
    /// All lanes, with the most urgent one first.
    pub const ALL: [Lane; 4] = [Lane::Requests, Lane::Arm, Lane::Base, Lane::Rest];
}

/// What is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// The base's speed with a stamp.
    SpeedStamped,
    /// The same speed without a stamp.
    SpeedPlain,
    /// A trajectory, or a piece of one.
    Trajectory,
    /// The operator's stop.
    Stopped,
    /// What the hands do.
    Diagnostics,
    /// The simulator's angles.
    JointStates,
    /// The simulator's path.
    Odometry,
    /// The simulator's frames.
    Frames,
    /// The simulator's URDF.
    Description,
}

impl Place {
    /// Returns the lane of its messages.
    pub fn lane(self) -> Lane {
        match self {
            Place::SpeedStamped | Place::SpeedPlain => Lane::Base,
            Place::Trajectory => Lane::Arm,
            Place::Stopped => Lane::Requests,
            Place::Diagnostics
            | Place::JointStates
            | Place::Odometry
            | Place::Frames
            | Place::Description => Lane::Rest,
        }
    }
}

/// A request.
pub struct Ask {
    /// The service's key.
    pub key: String,
    /// CDR, or nothing.
    pub payload: Vec<u8>,
    /// The attachment, if there is one.
    pub attached: Option<Attached>,
    /// The purpose of the answer.
    pub about: Asked,
    /// The maximum time to wait for the answer.
    pub patience: Duration,
    /// A request that has not been sent by this time is dropped.
    pub until: Option<Instant>,
}

/// A change of the publishers, subscriptions and tokens.
pub enum Order {
    /// A topic will be published from now on.
    Write(Place, Named, Quality),
    /// The topic is no longer published.
    Unwrite(Place),
    /// A topic will be read from now on.
    Read(Read, Named, Quality),
    /// A token of an action's client.
    Say(Which, String),
    /// The action's server has changed. Subscriptions and tokens for the old server end.
    Forget(Which),
}

impl Order {
    /// The lane that carries this out.
    pub fn lane(&self) -> Lane {
        match self {
            Order::Write(place, ..) | Order::Unwrite(place) => place.lane(),
            // These orders are executed before the first goal to that server.
            Order::Read(..) | Order::Say(..) | Order::Forget(..) => Lane::Requests,
        }
    }
}

/// The next task of a lane's thread.
pub enum Job {
    /// Publishes this.
    Put(Place, Vec<u8>),
    /// Sends this request.
    Ask(Ask),
    /// Carries this out.
    Order(Order),
}

/// One lane.
#[derive(Default)]
pub struct Waiting {
    newest: BTreeMap<Place, Vec<u8>>,
    cancels: VecDeque<Ask>,
    asks: VecDeque<Ask>,
    orders: VecDeque<Order>,
    withdrawn: u64,
    /// No further messages will be added.
    pub has_ended: bool,
}

impl Waiting {
    /// Adds an order to the end of the queue.
    pub fn order(&mut self, order: Order) {
        if let Order::Unwrite(place) = order {
            self.newest.remove(&place);
        }
        self.orders.push_back(order);
    }

    /// Adds a message, which replaces an older one that still waits. Returns whether it replaced one.
    pub fn put(&mut self, place: Place, message: Vec<u8>) -> bool {
        self.newest.insert(place, message).is_some()
    }

    /// Adds a request, unless too many wait. The same cancellation waits only once.
    pub fn ask(&mut self, ask: Ask) -> Sent {
        let (line, most) = match ask.about {
            Asked::Cancel(_) => (&mut self.cancels, CANCELS_MAX),
            _ => (&mut self.asks, ASKS_MAX),
        };
        let is_same = |other: &Ask| other.key == ask.key && other.payload == ask.payload;
        if matches!(ask.about, Asked::Cancel(_)) && line.iter().any(is_same) {
            return Sent::Instead;
        }
        if line.len() >= most {
            return Sent::No;
        }
        line.push_back(ask);
        Sent::Yes
    }

    /// Drops a request that is no longer useful.
    pub fn withdraw(&mut self, about: Asked) {
        self.keep(|ask| ask.about != about);
    }

    /// Keeps only the requests that satisfy this condition.
    fn keep(&mut self, is_kept: impl Fn(&Ask) -> bool) {
        let before = self.asks.len();
        self.asks.retain(is_kept);
        self.withdrawn += (before - self.asks.len()) as u64;
    }

    /// Returns the number of requests that were withdrawn or became too old since the last call.
    pub fn take_withdrawn(&mut self) -> u64 {
        std::mem::take(&mut self.withdrawn)
    }

    /// Returns the next task: orders, cancellations, messages, requests.
    /// (A cancellation never overtakes its goal: a goal that still waits is withdrawn first.)
    pub fn next(&mut self, now: Instant) -> Option<Job> {
        if let Some(order) = self.orders.pop_front() {
            return Some(Job::Order(order));
        }
        if let Some(cancel) = self.cancels.pop_front() {
            return Some(Job::Ask(cancel));
        }
        if let Some((place, message)) = self.newest.pop_first() {
            return Some(Job::Put(place, message));
        }
        self.keep(|ask| ask.until.is_none_or(|until| now <= until));
        self.asks.pop_front().map(Job::Ask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::unique_identifier_msgs::UUID;

    fn ask(about: Asked, until: Option<Instant>) -> Ask {
        let patience = Duration::from_secs(1);
        Ask { key: String::new(), payload: Vec::new(), attached: None, about, patience, until }
    }

    /// Creates the cancellation of the goal with this number.
    fn cancel(goal: u8) -> Ask {
        Ask { payload: vec![goal], ..ask(Asked::Cancel(Which::Arm), None) }
    }

    /// Describes the next task in one word.
    fn next(waiting: &mut Waiting, now: Instant) -> Option<String> {
        waiting.next(now).map(|job| match job {
            Job::Put(place, message) => format!("{place:?} {message:?}"),
            Job::Ask(ask) => match ask.about {
                Asked::Goal(..) => "goal".to_owned(),
                Asked::Cancel(_) => format!("cancel {:?}", ask.payload),
                _ => "question".to_owned(),
            },
            Job::Order(_) => "order".to_owned(),
        })
    }

    #[test]
    fn after_a_stall_only_the_newest_speed_goes_and_the_replaced_one_is_known() {
        let (mut waiting, now) = (Waiting::default(), Instant::now());
        assert!(!waiting.put(Place::SpeedStamped, vec![2]));
        assert!(waiting.put(Place::SpeedStamped, vec![0]), "the one before was never sent");
        assert_eq!(next(&mut waiting, now).as_deref(), Some("SpeedStamped [0]"));
        assert_eq!(next(&mut waiting, now), None);
        // The place is free for another request.
        assert!(!waiting.put(Place::SpeedStamped, vec![3]));
    }

    #[test]
    fn cancellations_go_before_all_that_waits_with_them_and_goals_come_last() {
        let (mut waiting, now) = (Waiting::default(), Instant::now());
        waiting.ask(ask(Asked::Probe(Which::Arm), None));
        waiting.ask(ask(Asked::Goal(Which::Gripper, UUID::new_random()), None));
        waiting.put(Place::Stopped, vec![1]);
        waiting.ask(cancel(7));
        let went: Vec<String> = std::iter::from_fn(|| next(&mut waiting, now)).collect();
        assert_eq!(went, ["cancel [7]", "Stopped [1]", "question", "goal"]);
    }

    #[test]
    fn no_speed_and_no_piece_of_a_trajectory_waits_where_cancellations_do() {
        let lanes =
            [Place::SpeedStamped, Place::SpeedPlain, Place::Trajectory, Place::Stopped].map(Place::lane);
        assert_eq!(lanes, [Lane::Base, Lane::Base, Lane::Arm, Lane::Requests]);
        let quality = Quality::RELIABLE;
        let named = Named::new("/cmd_vel", "geometry_msgs/msg/Twist");
        let orders = [
            Order::Write(Place::SpeedPlain, named.clone(), quality),
            Order::Unwrite(Place::Diagnostics),
            Order::Read(Read::Status(Which::Arm), named, quality),
            Order::Forget(Which::Arm),
        ];
        assert_eq!(
            orders.map(|order| order.lane()),
            [Lane::Base, Lane::Rest, Lane::Requests, Lane::Requests]
        );
    }

    #[test]
    fn a_goal_that_was_stopped_or_waited_too_long_never_goes_and_its_cancellation_does() {
        let (mut waiting, now) = (Waiting::default(), Instant::now());
        let goal = Asked::Goal(Which::Arm, UUID::new_random());
        let until = now + Duration::from_millis(500);
        waiting.ask(ask(goal, Some(until)));
        waiting.ask(ask(Asked::Goal(Which::Gripper, UUID::new_random()), Some(until)));
        waiting.withdraw(goal);
        waiting.ask(cancel(1));
        assert_eq!(next(&mut waiting, now).as_deref(), Some("cancel [1]"));
        assert_eq!(next(&mut waiting, now).as_deref(), Some("goal"), "the gripper's own");
        waiting.ask(ask(goal, Some(until)));
        assert_eq!(next(&mut waiting, until + Duration::from_millis(1)), None);
        assert_eq!((waiting.take_withdrawn(), waiting.take_withdrawn()), (2, 0));
    }

    #[test]
    fn requests_are_bounded_and_beside_them_a_cancellation_of_each_goal_always_waits_once() {
        let (mut waiting, now) = (Waiting::default(), Instant::now());
        let mut question = || waiting.ask(ask(Asked::Probe(Which::Arm), None));
        assert_eq!((0..100).filter(|_| question() == Sent::Yes).count(), ASKS_MAX);
        assert_eq!(question(), Sent::No);
        assert!((0..64).all(|goal| waiting.ask(cancel(goal)) == Sent::Yes));
        assert!((0..64).all(|goal| waiting.ask(cancel(goal)) == Sent::Instead));
        let went: Vec<String> = std::iter::from_fn(|| next(&mut waiting, now)).collect();
        assert_eq!(went.iter().filter(|what| what.starts_with("cancel")).count(), 64);
        assert_eq!(went.len(), 64 + ASKS_MAX);
    }

    #[test]
    fn what_is_no_longer_written_does_not_go() {
        let (mut waiting, now) = (Waiting::default(), Instant::now());
        waiting.put(Place::SpeedPlain, vec![1]);
        waiting.order(Order::Unwrite(Place::SpeedPlain));
        assert_eq!(next(&mut waiting, now).as_deref(), Some("order"));
        assert_eq!(next(&mut waiting, now), None);
    }
}
