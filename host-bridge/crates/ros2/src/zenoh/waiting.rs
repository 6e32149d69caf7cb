//! What waits to be sent, lane by lane. Of each kind of message only the newest waits; of requests at most [`ASKS_MAX`],
//! and of cancellations one per goal, which are never refused. Sans-IO.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use super::inbox::{Asked, Read, Which};
use crate::transport::Sent;
use crate::zenoh_keys::{Attached, Named, Quality};

/// More requests do not wait.
const ASKS_MAX: usize = 32;
/// More cancellations cannot wait: so many goals are not remembered.
const CANCELS_MAX: usize = 256;

/// What waits for the network apart from the others: each lane has its own thread and its own queue in Zenoh, so that
/// none holds up another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Cancellations first, then the operator's stop, goals and other requests.
    Requests,
    /// The arm's trajectories, with the one that stops it.
    Arm,
    /// The base's speeds, with the zero that stops it.
    Base,
    /// The rest, which a slow network drops.
    Rest,
}

impl Lane {
    /// All of them, the most urgent first.
    pub const ALL: [Lane; 4] = [Lane::Requests, Lane::Arm, Lane::Base, Lane::Rest];
}

/// What is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// The base's speed with a stamp.
    SpeedStamped,
    /// The same without.
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
    /// Where its messages wait.
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
    /// What is attached, if anything.
    pub attached: Option<Attached>,
    /// What the answer is about.
    pub about: Asked,
    /// No answer comes later than this.
    pub patience: Duration,
    /// If it has not left by then, it never does.
    pub until: Option<Instant>,
}

/// A change of what is written, read and said.
pub enum Order {
    /// A topic is written from now on.
    Write(Place, Named, Quality),
    /// It is not any more.
    Unwrite(Place),
    /// A topic is read from now on.
    Read(Read, Named, Quality),
    /// A token of an action's client.
    Say(Which, String),
    /// An action's server is another one: nothing of it is read or said any more.
    Forget(Which),
}

impl Order {
    /// Who carries it out.
    pub fn lane(&self) -> Lane {
        match self {
            Order::Write(place, ..) | Order::Unwrite(place) => place.lane(),
            // Before the first goal to that server.
            Order::Read(..) | Order::Say(..) | Order::Forget(..) => Lane::Requests,
        }
    }
}

/// What there is to do.
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
    /// Nobody puts anything in any more.
    pub has_ended: bool,
}

impl Waiting {
    /// An order waits for its turn.
    pub fn order(&mut self, order: Order) {
        if let Order::Unwrite(place) = order {
            self.newest.remove(&place);
        }
        self.orders.push_back(order);
    }

    /// A message takes the place of an older one, if one still waits; returns whether one did.
    pub fn put(&mut self, place: Place, message: Vec<u8>) -> bool {
        self.newest.insert(place, message).is_some()
    }

    /// A request waits for its turn, if not too many do. The same cancellation waits once.
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

    /// A request is of no use any more.
    pub fn withdraw(&mut self, about: Asked) {
        self.keep(|ask| ask.about != about);
    }

    /// Keeps only these requests.
    fn keep(&mut self, is_kept: impl Fn(&Ask) -> bool) {
        let before = self.asks.len();
        self.asks.retain(is_kept);
        self.withdrawn += (before - self.asks.len()) as u64;
    }

    /// How many requests were withdrawn or became too old since the last call.
    pub fn take_withdrawn(&mut self) -> u64 {
        std::mem::take(&mut self.withdrawn)
    }

    /// What goes next: orders, cancellations, messages, other requests. (A cancellation never overtakes its goal: a goal
    /// that still waits is withdrawn first.)
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

    /// The cancellation of the goal of this number.
    fn cancel(goal: u8) -> Ask {
        Ask { payload: vec![goal], ..ask(Asked::Cancel(Which::Arm), None) }
    }

    /// What goes next, in a word.
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
        // The place is free again.
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
