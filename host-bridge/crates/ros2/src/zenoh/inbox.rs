//! The inbox: Zenoh's threads read messages and store a limited number of them until the node takes them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use host_topics::cdr::decode;
use host_topics::message as ros;
use ros2_client::action::GoalId;
use ros2_client::action_msgs::GoalStatusArray;
use zenoh::sample::Sample;

use crate::transport::ToldState;
use crate::zenoh_keys::Attached;

/// Maximum number of stored messages; the oldest one is dropped.
const KEPT_MAX: usize = 512;
/// Maximum number of writers of flags that are distinguished.
const WRITERS_MAX: usize = 64;

/// An action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Which {
    /// The arm's.
    Arm,
    /// The gripper's.
    Gripper,
}

/// A topic that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Read {
    /// A simulation's time.
    Clock,
    /// The e-stop or fault flag with this number.
    Flag(usize),
    /// Angles.
    Arm,
    /// Odometry.
    Base,
    /// The arm's controller.
    Controller,
    /// The object whose topic has this index in the configured list.
    Thing(usize),
    /// The status of all goals on an action's server.
    Status(Which),
    /// The progress of a server's goals.
    Feedback(Which),
}

/// The purpose of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// A goal of ours.
    Goal(Which, GoalId),
    /// The result of a goal of ours.
    Result(Which, GoalId),
    /// The end of a goal.
    Cancel(Which),
    /// Requests the end of a goal that does not exist.
    Probe(Which),
    /// The stored messages of a topic's writers.
    History(Read),
}

/// A message that was read.
pub enum Word {
    /// A simulation's time.
    Clock(ros::Clock),
    /// E-stop or fault flag.
    Flag(usize, bool),
    /// Angles.
    Arm(ros::JointState),
    /// Odometry.
    Base(Box<ros::Odometry>),
    /// The arm's controller.
    Controller(Box<ToldState>),
    /// The pose of an object, with the index of its topic.
    Thing(usize, Box<ros::PoseStamped>),
}

/// An answer of an action's server.
#[derive(Default)]
struct FromServer {
    answers: VecDeque<(Asked, Vec<u8>)>,
    /// The progress of the goals.
    progress: VecDeque<Vec<u8>>,
    /// The newest status of all goals.
    status: Option<GoalStatusArray>,
}

#[derive(Default)]
struct Kept {
    /// The message, with its writer.
    words: VecDeque<(Word, [u8; 16])>,
    servers: [FromServer; 2],
    /// Times of the newest messages. A stored message for late subscribers is ignored if it is older.
    newest: BTreeMap<(Read, [u8; 16]), i64>,
}

/// See the module.
#[derive(Clone, Default)]
pub struct Inbox {
    kept: Arc<Mutex<Kept>>,
    /// Whether the attachment of the newest message names its values, as in Jazzy.
    pub is_labelled: Arc<AtomicBool>,
}

fn keep<T>(kept: &mut VecDeque<T>, new: T) {
    if kept.len() == KEPT_MAX {
        kept.pop_front();
    }
    kept.push_back(new);
}

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores a message; one that cannot be read is dropped.
    pub fn hear(&self, read: Read, sample: &Sample) {
        let Some(attachment) = sample.attachment() else { return };
        let Some((attached, labelled)) = Attached::read(&attachment.to_bytes()) else { return };
        self.is_labelled.store(labelled, Ordering::Relaxed);
        self.take_in(read, &attached, &sample.payload().to_bytes());
    }

    /// Stores a message that is given as bytes.
    fn take_in(&self, read: Read, attached: &Attached, bytes: &[u8]) {
        let mut kept = self.lock();
        if matches!(read, Read::Flag(_) | Read::Status(_)) {
            let known = (read, attached.writer);
            if kept.newest.get(&known).is_some_and(|newest| attached.number <= *newest) {
                return;
            }
            if kept.newest.len() < WRITERS_MAX || kept.newest.contains_key(&known) {
                kept.newest.insert(known, attached.number);
            }
        }
        let word = match read {
            Read::Clock => decode(bytes).map(Word::Clock),
            Read::Flag(input) => decode::<ros::Bool>(bytes).map(|flag| Word::Flag(input, flag.data)),
            Read::Arm => decode(bytes).map(Word::Arm),
            Read::Base => decode(bytes).map(|odometry| Word::Base(Box::new(odometry))),
            Read::Thing(n) => decode(bytes).map(|pose| Word::Thing(n, Box::new(pose))),
            Read::Controller => decode(bytes).map(|told| Word::Controller(Box::new(told))),
            Read::Status(which) => {
                if let Some(list) = decode(bytes) {
                    kept.servers[which as usize].status = Some(list);
                }
                None
            }
            Read::Feedback(which) => {
                keep(&mut kept.servers[which as usize].progress, bytes.to_vec());
                None
            }
        };
        if let Some(word) = word {
            keep(&mut kept.words, (word, attached.writer));
        }
    }

    /// Stores an answer to a request.
    pub fn answer(&self, about: Asked, sample: &Sample) {
        let which = match about {
            Asked::History(read) => return self.hear(read, sample),
            Asked::Goal(which, _) | Asked::Result(which, _) | Asked::Cancel(which) | Asked::Probe(which) => {
                which
            }
        };
        let bytes = sample.payload().to_bytes().into_owned();
        keep(&mut self.lock().servers[which as usize].answers, (about, bytes));
    }

    /// Returns the messages received since the last call.
    pub fn take_words(&self) -> VecDeque<(Word, [u8; 16])> {
        std::mem::take(&mut self.lock().words)
    }

    /// Returns the answers of an action's server since the last call.
    pub fn take_answers(&self, which: Which) -> VecDeque<(Asked, Vec<u8>)> {
        std::mem::take(&mut self.lock().servers[which as usize].answers)
    }

    /// Returns the progress of the action's goals since the last call.
    pub fn take_progress(&self, which: Which) -> VecDeque<Vec<u8>> {
        std::mem::take(&mut self.lock().servers[which as usize].progress)
    }

    /// Returns the newest status of all goals, if one has arrived since the last call.
    pub fn take_status(&self, which: Which) -> Option<GoalStatusArray> {
        self.lock().servers[which as usize].status.take()
    }

    /// An answer from another server of this action is useless.
    pub fn forget(&self, which: Which) {
        let mut kept = self.lock();
        kept.servers[which as usize] = FromServer::default();
        kept.newest.retain(|(read, _), _| *read != Read::Status(which));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_topics::cdr::encode;

    fn said(number: i64, writer: u8) -> Attached {
        Attached { number, sent_ns: 0, writer: [writer; 16] }
    }

    #[test]
    fn a_flags_older_word_that_comes_later_is_not_heard_and_writers_are_apart() {
        let inbox = Inbox::default();
        let flag = |number, writer, data| {
            inbox.take_in(Read::Flag(0), &said(number, writer), &encode(&ros::Bool { data }));
        };
        flag(5, 1, true);
        // Stored messages are requested when a subscription starts. They may arrive after newer messages.
        flag(4, 1, false);
        flag(5, 1, false);
        flag(1, 2, false);
        flag(6, 1, false);
        let heard: Vec<(bool, u8)> = inbox
            .take_words()
            .into_iter()
            .map(|(word, writer)| match word {
                Word::Flag(0, data) => (data, writer[0]),
                _ => panic!("a flag"),
            })
            .collect();
        assert_eq!(heard, [(true, 1), (false, 2), (false, 1)]);
        assert!(inbox.take_words().is_empty());
    }

    #[test]
    fn what_nobody_takes_is_bounded_and_what_cannot_be_read_is_dropped() {
        let inbox = Inbox::default();
        for number in 0..2000 {
            let clock = ros::Clock { clock: ros::Time { sec: number, nanosec: 0 } };
            inbox.take_in(Read::Clock, &said(i64::from(number), 1), &encode(&clock));
            inbox.take_in(Read::Feedback(Which::Arm), &said(i64::from(number), 1), &[1, 2, 3]);
            inbox.take_in(Read::Arm, &said(i64::from(number), 1), &[0, 1, 0, 0, 255]);
        }
        let words = inbox.take_words();
        assert_eq!(words.len(), KEPT_MAX);
        assert!(matches!(&words[0].0, Word::Clock(clock) if clock.clock.sec == 2000 - 512));
        assert_eq!(inbox.take_progress(Which::Arm).len(), KEPT_MAX);
        assert!(inbox.take_progress(Which::Gripper).is_empty());
    }

    #[test]
    fn another_servers_word_is_forgotten() {
        let inbox = Inbox::default();
        let list = encode(&GoalStatusArray { status_list: Vec::new() });
        inbox.take_in(Read::Status(Which::Gripper), &said(9, 1), &list);
        inbox.forget(Which::Gripper);
        assert!(inbox.take_status(Which::Gripper).is_none());
        // Messages of a writer that restarts are accepted.
        inbox.take_in(Read::Status(Which::Gripper), &said(1, 1), &list);
        assert!(inbox.take_status(Which::Gripper).is_some());
    }
}
