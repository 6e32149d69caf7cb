//! Runs the bytes and keys of a file through a bridge and a robot again.

use std::collections::{BTreeMap, VecDeque};

use mcap::McapError;
use mcap::records::Record;
use serde::Serialize;
use shared_proto::frame::{Decoder, HOST_FRAME_MAX, encode_host};
use shared_proto::message::HostMessage;

use super::METADATA;
use super::records::records;
use super::setup::{Setup, SetupError};
use host_arm::Director;
use host_core::bridge::{Bridge, BridgeEvent};
use host_core::observe::Now;
use host_core::observe::SessionEvent;
use host_core::safety::Hand;
use host_robot::{Door as _, Odometry};
use host_sim::Simulator;
use host_topics::bimanual::{Bytes, Operated, Refused, Turns};
use host_topics::cdr::decode;
use host_topics::{Entry, Origin, Topic};

/// Maximum length of a step in ms. A step may be long because the laptop was suspended.
const PAUSE_MS: u64 = 3_600_000;

/// The result of a replay.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Replay {
    /// The title of the session.
    pub title: String,
    /// Duration of the replayed session.
    pub seconds: f64,
    /// All events in order.
    pub events: Vec<BridgeEvent>,
    /// Number of messages of each topic.
    pub messages: BTreeMap<&'static str, u64>,
    /// Number of messages that were recomputed and compared.
    pub compared: u64,
    /// Number of messages that differ.
    pub different: u64,
    /// The first message that differs.
    pub first_difference: Option<String>,
    /// The reason why the file ends early. Either it was still being written, or it is damaged.
    pub cut: Option<String>,
    /// Number of numbered messages that another program removed from the file.
    pub missing: u64,
    /// Topics that every session has, but that are missing in the file.
    pub absent: Vec<&'static str>,
    /// Time of the first gap, caused by a slow disk. Nothing after it was replayed.
    pub gap_ms: Option<u64>,
    /// The final position of the base.
    pub odometry: Odometry,
    /// Whether the robot rests at the end.
    pub at_rest: bool,
}

impl Replay {
    /// Returns whether all results were equal.
    pub fn is_same(&self) -> bool {
        self.different == 0 && self.compared > 0
    }
}

/// The file cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file is not an MCAP file.
    #[error("this is no MCAP file ({0}); give a file that `--record` has written")]
    Form(#[from] McapError),
    /// Another program wrote it.
    #[error("the file was not written by this program's `--record`: it does not say how its session started")]
    NoSetup,
    /// The recorded session cannot be started.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A message does not match its type.
    #[error("{topic}, at {seconds:.3} s: the message cannot be read; the file is damaged")]
    Message {
        /// The topic of the message.
        topic: &'static str,
        /// The time of the message.
        seconds: f64,
    },
}

/// Replays a file until its end or the first damaged place.
///
/// # Errors
/// Returns [`ReplayError`] if nothing can be replayed.
pub fn replay(file: &[u8]) -> Result<Replay, ReplayError> {
    let records = records(file)?;
    let mut topics = BTreeMap::new();
    let mut player: Option<Player> = None;
    let mut cut = None;
    let mut numbers = Numbers::default();
    for record in records {
        match record {
            Err(error) if player.is_none() => return Err(error.into()),
            Err(error) => {
                cut = Some(error.to_string());
                break;
            }
            Ok(Record::Metadata(metadata)) if metadata.name == METADATA && player.is_none() => {
                player = Some(Player::new(&Setup::from_metadata(&metadata.metadata)?)?);
            }
            Ok(Record::Channel(channel)) => {
                if let Some(topic) = Topic::named(&channel.topic) {
                    topics.insert(channel.id, topic);
                }
            }
            Ok(Record::Message { header, data }) => {
                let player = player.as_mut().ok_or(ReplayError::NoSetup)?;
                let Some(&topic) = topics.get(&header.channel_id) else { continue };
                numbers.take(header.sequence);
                let time_ms = header.log_time.saturating_sub(player.origin.nanoseconds) / 1_000_000;
                let entry = Entry { topic, time_ms, data: data.into_owned() };
                if player.take(entry)? == Then::Stop {
                    break;
                }
            }
            Ok(_) => {}
        }
    }
    let player = player.ok_or(ReplayError::NoSetup)?;
    let mut result = player.end(cut);
    result.missing = numbers.missing();
    // Every session contains these topics from its first moment on.
    let always =
        [Topic::Turns, Topic::Hands, Topic::Twist, Topic::Joints, Topic::Odometry, Topic::Transforms];
    let names = always.into_iter().map(Topic::name);
    result.absent = names.filter(|name| !result.messages.contains_key(name)).collect();
    Ok(result)
}

/// The message numbers of the recording program, which count all topics together and start at 0.
#[derive(Default)]
struct Numbers {
    count: u64,
    largest: u32,
}

impl Numbers {
    fn take(&mut self, number: u32) {
        self.count += 1;
        self.largest = self.largest.max(number);
    }

    /// Returns the number of missing messages. It is 0 if a program uses its own numbering, or no numbering.
    fn missing(&self) -> u64 {
        (u64::from(self.largest) + 1).saturating_sub(self.count)
    }
}

#[derive(PartialEq)]
enum Then {
    GoOn,
    Stop,
}

struct Player {
    origin: Origin,
    bridge: Bridge,
    robot: Director<Simulator>,
    moved_ms: u64,
    /// Whether an external robot was driven. In this case, only the hands' messages are compared.
    elsewhere: bool,
    /// Results of the most recent steps, which must be the next messages in the file.
    due: VecDeque<Entry>,
    now_ms: u64,
    result: Replay,
}

impl Player {
    fn new(setup: &Setup) -> Result<Self, SetupError> {
        let robot = setup.robot()?;
        Ok(Player {
            origin: Origin { nanoseconds: setup.origin_ns },
            bridge: setup.bridge()?.known_to(|motion| robot.knows(motion)),
            moved_ms: 0,
            elsewhere: setup.robot_elsewhere,
            due: VecDeque::new(),
            now_ms: 0,
            result: Replay {
                title: setup.title.clone(),
                seconds: 0.0,
                events: Vec::new(),
                messages: BTreeMap::new(),
                compared: 0,
                different: 0,
                first_difference: None,
                cut: None,
                missing: 0,
                absent: Vec::new(),
                gap_ms: None,
                odometry: Odometry::default(),
                at_rest: true,
            },
            robot,
        })
    }

    fn take(&mut self, entry: Entry) -> Result<Then, ReplayError> {
        let (topic, time_ms) = (entry.topic, entry.time_ms);
        if topic == Topic::Lost {
            self.result.gap_ms = Some(time_ms);
            return Ok(Then::Stop);
        }
        *self.result.messages.entry(topic.name()).or_default() += 1;
        let now = Now { time_ms, bridge: &self.bridge, robot: &self.robot };
        let again = match topic {
            Topic::LeftReceived
            | Topic::RightReceived
            | Topic::LeftSent
            | Topic::RightSent
            | Topic::Operated
            | Topic::Refused
            | Topic::Turns => {
                let unreadable =
                    ReplayError::Message { topic: topic.name(), seconds: time_ms as f64 / 1000.0 };
                self.repeat(&entry).ok_or(unreadable)?;
                return Ok(Then::GoOn);
            }
            Topic::LeftSample
            | Topic::RightSample
            | Topic::Imu
            | Topic::Magnetic
            | Topic::Log
            | Topic::Marks
            | Topic::Lost => {
                return Ok(Then::GoOn);
            }
            Topic::Events | Topic::Intents | Topic::Stops => self.due.pop_front(),
            Topic::Hands => Some(self.origin.hands(&now)),
            Topic::Twist => Some(self.origin.twist(&now)),
            Topic::Joints => Some(self.origin.joints(&now)),
            Topic::Odometry => Some(self.origin.odometry(&now)),
            Topic::Transforms => Some(self.origin.transforms(&now)),
        };
        if self.elsewhere && topic != Topic::Hands {
            return Ok(Then::GoOn);
        }
        self.result.compared += 1;
        if again.as_ref() != Some(&entry) {
            self.differs(format!("{}, at {:.3} s", topic.name(), time_ms as f64 / 1000.0));
        }
        Ok(Then::GoOn)
    }

    fn differs(&mut self, what: String) {
        self.result.different += 1;
        self.result.first_difference.get_or_insert(what);
    }

    /// Processes inputs and steps. Returns `None` if the message cannot be read.
    fn repeat(&mut self, entry: &Entry) -> Option<()> {
        let hand = match entry.topic {
            Topic::LeftReceived | Topic::LeftSent => Hand::Left,
            _ => Hand::Right,
        };
        match entry.topic {
            Topic::Turns => {
                for turn in decode::<Turns>(&entry.data)?.turns {
                    // A larger value means damage, and a session of that length would never end.
                    let latest_ms = self.now_ms.max(entry.time_ms).saturating_add(PAUSE_MS);
                    match turn.kind {
                        0 if turn.ms <= self.now_ms.saturating_add(PAUSE_MS) => self.decide(turn.ms),
                        1 if turn.ms <= PAUSE_MS && self.moved_ms + turn.ms <= latest_ms => {
                            self.moved_ms += turn.ms;
                            self.robot.step(self.moved_ms);
                        }
                        2 => self.robot.begin_planned(),
                        _ => return None,
                    }
                }
            }
            Topic::Operated => {
                let Operated { time_ms, key, .. } = decode(&entry.data)?;
                match key {
                    0 => self.bridge.stop_key(time_ms, &mut self.robot),
                    1 => self.bridge.release_key(time_ms, &mut self.robot),
                    2 => self.bridge.end_arm_key(time_ms, &mut self.robot),
                    3 | 4 => self.bridge.show_key(key == 3),
                    5 => self.bridge.clutch_key(time_ms, &mut self.robot),
                    _ => return None,
                }
            }
            Topic::Refused => {
                let Refused { time_ms, reason, .. } = decode(&entry.data)?;
                let refusal = (!reason.is_empty()).then_some(reason);
                self.bridge.robot_refuses(refusal, time_ms, &mut self.robot);
            }
            topic => {
                let Bytes { time_ms, data, .. } = decode(&entry.data)?;
                if matches!(topic, Topic::LeftReceived | Topic::RightReceived) {
                    self.bridge.receive(hand, &data, time_ms, &mut self.robot);
                } else {
                    self.send(hand, &data, time_ms);
                }
            }
        }
        Some(())
    }

    fn decide(&mut self, time_ms: u64) {
        self.now_ms = time_ms;
        self.bridge.step(time_ms, &mut self.robot);
        for event in self.bridge.take_events() {
            self.result.events.push(event.clone());
            let entries = self.origin.event(&SessionEvent::Bridge(event));
            self.due.extend(entries.into_iter().filter(|entry| entry.topic != Topic::Log));
        }
    }

    /// Informs the link about its requests and pings, because the ages of states depend on them.
    fn send(&mut self, hand: Hand, frame: &[u8], time_ms: u64) {
        let mut decoder = Decoder::<HOST_FRAME_MAX>::new();
        let mut sent = None;
        for &byte in frame {
            sent = match decoder.push_host(byte) {
                Some(HostMessage::HelloRequest) => Some(true),
                Some(HostMessage::Ping { .. }) => Some(false),
                Some(_) => return,
                None => sent,
            };
        }
        let again = match sent {
            Some(true) => self.bridge.poll(hand, time_ms),
            Some(false) => self.bridge.ping(hand, time_ms),
            None => None,
        };
        let mut buffer = [0; HOST_FRAME_MAX];
        let again = again.and_then(|message| encode_host(&message, &mut buffer).ok());
        self.result.compared += 1;
        if again != Some(frame) {
            self.differs(format!("frame to the {hand} hand, at {:.3} s", time_ms as f64 / 1000.0));
        }
    }

    fn end(mut self, cut: Option<String>) -> Replay {
        if cut.is_none()
            && !self.elsewhere
            && self.result.gap_ms.is_none()
            && let Some(entry) = self.due.pop_front()
        {
            let seconds = entry.time_ms as f64 / 1000.0;
            self.differs(format!("{}, at {seconds:.3} s: is not in the file", entry.topic.name()));
        }
        Replay {
            seconds: self.now_ms as f64 / 1000.0,
            cut,
            odometry: self.robot.robot().odometry(),
            at_rest: self.robot.robot().at_rest(),
            ..self.result
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_such_file_is_refused_with_the_reason() {
        for (bytes, told) in
            [(&b""[..], "no MCAP file"), (&b"timestamp,accX\n0,1\n and a few more"[..], "no MCAP file")]
        {
            let error = replay(bytes).unwrap_err().to_string();
            assert!(error.contains(told), "{error}");
        }
        // This is a complete file of another program.
        // It consists of magic, header, data end, footer and magic.
        let mut file = Vec::new();
        let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut file)).unwrap();
        writer.finish().unwrap();
        drop(writer);
        assert!(matches!(replay(&file), Err(ReplayError::NoSetup)));
    }
}
