//! Reads the streams of a session file that an export needs.

use std::collections::BTreeMap;

use host_core::episodes::Mark;
use host_topics::Topic;
use host_topics::bimanual::{Event, Mark as MarkMessage, Operated};
use host_topics::cdr::decode;
use host_topics::message::{JointState, Odometry, Twist, TwistStamped};
use mcap::McapError;
use mcap::records::Record;

use crate::journal::METADATA;
use crate::journal::records::records;

/// The contents of a file. Each stream is sorted by time (ms since the session began).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Streams {
    /// Title of the recorded session.
    pub title: String,
    /// Description of the task, if `--task` was given.
    pub task: Option<String>,
    /// Names of the joints, without the base's wheels.
    pub joint_names: Vec<String>,
    /// Positions of the joints in rad (or m).
    pub joints: Vec<(u64, Vec<f64>)>,
    /// Position and motion of the base: x and y in m, turn in rad, speed in m/s, turn rate in rad/s.
    pub base: Vec<(u64, [f64; 5])>,
    /// Commanded speed of the base: forward in m/s, turn rate in rad/s.
    pub asked: Vec<(u64, [f64; 2])>,
    /// The events with their times.
    pub events: Vec<(u64, Happened)>,
}

/// The events that define episodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happened {
    /// A gesture was performed, with the motion that it started, if any.
    Gesture(String, Option<String>),
    /// A motion ended, either at its pose or earlier.
    MotionEnded(String, bool),
    /// The operator pressed stop on a keyboard or on the page.
    StopKey,
    /// The operator marked an episode.
    Marked(Mark),
}

/// The reason why a file cannot be exported, with a remedy in the text.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The file is not an MCAP file.
    #[error("this is no MCAP file ({0}); give a file that `--record` has written")]
    Form(#[from] McapError),
    /// A message does not match its type.
    #[error("{topic}, at {seconds:.3} s: the message cannot be read; the file is damaged")]
    Message {
        /// The topic of the message.
        topic: &'static str,
        /// The time of the message.
        seconds: f64,
    },
    /// A required stream is missing.
    #[error("the file has no messages of {0}, which an episode needs; record the session whole")]
    Missing(&'static str),
    /// The number or names of the joints change during the session.
    #[error("the joints change within the file, from {0} to {1}; export sessions of one robot")]
    Joints(String, String),
    /// The given files cannot be combined.
    #[error("{0}")]
    Mixed(String),
    /// An output file cannot be written.
    #[error("{0}")]
    Write(String),
}

impl Streams {
    /// Reads a file until its end or the first damaged place.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn read(file: &[u8]) -> Result<Self, ExportError> {
        let mut streams = Streams::default();
        let mut topics = BTreeMap::new();
        let mut origin_ns = None;
        for record in records(file)? {
            let Ok(record) = record else { break };
            match record {
                Record::Metadata(metadata) if metadata.name == METADATA => {
                    let text = |key: &str| metadata.metadata.get(key).cloned();
                    streams.title = text("title").unwrap_or_default();
                    streams.task = text("task");
                    origin_ns = origin_ns.or(text("origin_ns").and_then(|text| text.parse().ok()));
                }
                Record::Channel(channel) => {
                    if let Some(topic) = Topic::named(&channel.topic) {
                        topics.insert(channel.id, topic);
                    }
                }
                Record::Message { header, data } => {
                    let Some(&topic) = topics.get(&header.channel_id) else { continue };
                    let origin: u64 = *origin_ns.get_or_insert(header.log_time);
                    let time_ms = header.log_time.saturating_sub(origin) / 1_000_000;
                    let damaged =
                        ExportError::Message { topic: topic.name(), seconds: time_ms as f64 / 1000.0 };
                    streams.take(topic, time_ms, &data).ok_or(damaged)??;
                }
                _ => {}
            }
        }
        for (topic, is_empty) in [
            (Topic::Joints, streams.joints.is_empty()),
            (Topic::Odometry, streams.base.is_empty()),
            (Topic::Twist, streams.asked.is_empty()),
        ] {
            if is_empty {
                return Err(ExportError::Missing(topic.name()));
            }
        }
        // Another program may have reordered the messages.
        streams.joints.sort_by_key(|(time, _)| *time);
        streams.base.sort_by_key(|(time, _)| *time);
        streams.asked.sort_by_key(|(time, _)| *time);
        streams.events.sort_by_key(|(time, _)| *time);
        Ok(streams)
    }

    /// Returns whether the operator marked an episode.
    pub fn is_marked(&self) -> bool {
        self.events.iter().any(|(_, happened)| matches!(happened, Happened::Marked(_)))
    }

    /// Processes a message; `None` if it cannot be read.
    fn take(&mut self, topic: Topic, time_ms: u64, data: &[u8]) -> Option<Result<(), ExportError>> {
        match topic {
            Topic::Joints => {
                let JointState { name: names, position: positions, .. } = decode(data)?;
                if names.len() != positions.len() || !positions.iter().all(|rad| rad.is_finite()) {
                    return None;
                }
                let pairs = names.into_iter().zip(positions);
                let (names, positions): (Vec<String>, Vec<f64>) =
                    pairs.filter(|(name, _)| !name.ends_with("_wheel")).unzip();
                if self.joints.is_empty() {
                    self.joint_names = names;
                } else if names != self.joint_names {
                    return Some(Err(ExportError::Joints(self.joint_names.join(", "), names.join(", "))));
                }
                self.joints.push((time_ms, positions));
            }
            Topic::Odometry => {
                let Odometry { pose, twist, .. } = decode(data)?;
                let (place, [linear, angular]) = (pose.pose, speeds(&twist.twist)?);
                let turn_rad = 2.0 * place.orientation.z.atan2(place.orientation.w);
                let base = [place.position.x, place.position.y, turn_rad, linear, angular];
                if !base.iter().all(|number| number.is_finite()) {
                    return None;
                }
                self.base.push((time_ms, base));
            }
            Topic::Twist => self.asked.push((time_ms, speeds(&decode::<TwistStamped>(data)?.twist)?)),
            Topic::Events => {
                let Event { time_ms, json, .. } = decode(data)?;
                let json: serde_json::Value = serde_json::from_str(&json).ok()?;
                self.events.extend(happened(&json).map(|happened| (time_ms, happened)));
            }
            Topic::Operated => {
                let Operated { time_ms, key, .. } = decode(data)?;
                if key == 0 {
                    self.events.push((time_ms, Happened::StopKey));
                }
            }
            Topic::Marks => {
                let MarkMessage { time_ms, mark, .. } = decode(data)?;
                // A mark that only a later version knows is ignored here.
                self.events.extend(mark.parse().ok().map(|mark| (time_ms, Happened::Marked(mark))));
            }
            _ => {}
        }
        Some(Ok(()))
    }
}

fn happened(json: &serde_json::Value) -> Option<Happened> {
    let text = |key: &str| json.get(key).and_then(|value| value.as_str()).map(str::to_owned);
    match json.get("event")?.as_str()? {
        "gesture" => {
            let started = json.get("outcome").and_then(|outcome| outcome.get("started")?.as_str());
            Some(Happened::Gesture(text("label")?, started.map(str::to_owned)))
        }
        "motion-ended" => Some(Happened::MotionEnded(text("motion")?, json.get("reached")?.as_bool()?)),
        _ => None,
    }
}

/// Returns the speed forward and the turn rate to the left; `None` for NaN and infinity.
fn speeds(twist: &Twist) -> Option<[f64; 2]> {
    let speeds = [twist.linear.x, twist.angular.z];
    speeds.iter().all(|speed| speed.is_finite()).then_some(speeds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_topics::cdr::encode;
    use host_topics::message::Header;

    /// Returns a file with a few messages of each stream.
    fn small() -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = mcap::WriteOptions::new().compression(None).create(&mut bytes).unwrap();
        let metadata =
            BTreeMap::from([("title".to_owned(), "t".to_owned()), ("origin_ns".to_owned(), "5".to_owned())]);
        writer.write_metadata(&mcap::records::Metadata { name: METADATA.to_owned(), metadata }).unwrap();
        let joints = JointState {
            header: Header::default(),
            name: vec!["joint_1".to_owned(), "left_wheel".to_owned()],
            position: vec![0.5, 7.0],
            velocity: vec![0.0, 0.0],
            effort: Vec::new(),
        };
        let messages = [
            (Topic::Joints, encode(&joints)),
            (Topic::Odometry, encode(&Odometry::default())),
            (Topic::Twist, encode(&TwistStamped::default())),
        ];
        for (topic, data) in &messages {
            let id = writer.add_channel(0, topic.name(), "cdr", &BTreeMap::new()).unwrap();
            for n in 0..3 {
                let log_time = 5 + n * 20_000_000;
                let header = mcap::records::MessageHeader {
                    channel_id: id,
                    sequence: 0,
                    log_time,
                    publish_time: log_time,
                };
                writer.write_to_known_channel(&header, data).unwrap();
            }
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    #[test]
    fn streams_are_read_without_the_wheels() {
        let streams = Streams::read(&small()).unwrap();
        assert_eq!(
            (streams.title.as_str(), streams.joint_names.as_slice()),
            ("t", &["joint_1".to_owned()][..])
        );
        assert_eq!(streams.joints[2], (40, vec![0.5]));
        assert_eq!((streams.base.len(), streams.asked.len()), (3, 3));
    }

    proptest::proptest! {
        #[test]
        fn damaged_files_never_panic(
            changes in proptest::collection::vec((0usize..4000, 0u8..), 1..12),
            cut in 0usize..4000,
        ) {
            let mut bytes = small();
            for (at, value) in changes {
                let at = at % bytes.len();
                bytes[at] = value;
            }
            let _ = Streams::read(&bytes);
            let _ = Streams::read(&bytes[..cut % bytes.len()]);
        }
    }
}
