//! The streams of a session's file that an export needs.

use std::collections::BTreeMap;

use host_topics::Topic;
use host_topics::cdr::Reader;
use mcap::McapError;
use mcap::read::{ChunkFlattener, Options};
use mcap::records::Record;

use crate::journal::METADATA;

/// What a file says, each stream in the order of its times (ms since the session began).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Streams {
    /// What the session is called.
    pub title: String,
    /// Names of the joints, without the base's wheels.
    pub joint_names: Vec<String>,
    /// Where the joints are, in rad (or m).
    pub joints: Vec<(u64, Vec<f64>)>,
    /// Where the base is and how it moves: x and y in m, turn in rad, m/s, rad/s.
    pub base: Vec<(u64, [f64; 5])>,
    /// What the base is asked for: m/s, rad/s.
    pub asked: Vec<(u64, [f64; 2])>,
    /// What happened.
    pub events: Vec<(u64, Happened)>,
}

/// What an export makes episodes of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happened {
    /// A gesture was performed; the motion that it started, if one.
    Gesture(String, Option<String>),
    /// A motion ended: at its pose, or not.
    MotionEnded(String, bool),
    /// Somebody pressed stop, on a keyboard or on the page.
    StopKey,
}

/// Why a file cannot be exported; the text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// It is no MCAP file.
    #[error("this is no MCAP file ({0}); give a file that `--record` has written")]
    Form(#[from] McapError),
    /// A message is not as its type says.
    #[error("{topic}, at {seconds:.3} s: the message cannot be read; the file is damaged")]
    Message {
        /// Where.
        topic: &'static str,
        /// When.
        seconds: f64,
    },
    /// A stream is not there.
    #[error("the file has no messages of {0}, which an episode needs; record the session whole")]
    Missing(&'static str),
    /// The joints change on the way.
    #[error("the joints change within the file, from {0} to {1}; export sessions of one robot")]
    Joints(String, String),
    /// Files do not go together.
    #[error("{0}")]
    Mixed(String),
    /// Something cannot be written.
    #[error("{0}")]
    Write(String),
}

impl Streams {
    /// Reads the bytes of a file, to its end or to where it is damaged.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn read(file: &[u8]) -> Result<Self, ExportError> {
        if !file.starts_with(mcap::MAGIC) {
            return Err(McapError::BadMagic.into());
        }
        let mut streams = Streams::default();
        let mut topics = BTreeMap::new();
        let mut origin_ns = None;
        for record in ChunkFlattener::new_with_options(file, Options::IgnoreEndMagic.into())? {
            let Ok(record) = record else { break };
            match record {
                Record::Metadata(metadata) if metadata.name == METADATA => {
                    let text = |key: &str| metadata.metadata.get(key).cloned();
                    streams.title = text("title").unwrap_or_default();
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
        // Another program may have put the messages into another order.
        streams.joints.sort_by_key(|(time, _)| *time);
        streams.base.sort_by_key(|(time, _)| *time);
        streams.asked.sort_by_key(|(time, _)| *time);
        streams.events.sort_by_key(|(time, _)| *time);
        Ok(streams)
    }

    /// `None` where the message cannot be read.
    fn take(&mut self, topic: Topic, time_ms: u64, data: &[u8]) -> Option<Result<(), ExportError>> {
        let mut reader = Reader::new(data)?;
        match topic {
            Topic::Joints => {
                header(&mut reader)?;
                let names = texts(&mut reader)?;
                let positions = numbers(&mut reader)?;
                if names.len() != positions.len() {
                    return None;
                }
                let kept = |name: &String| !name.ends_with("_wheel");
                let pairs = names.iter().zip(&positions).filter(|(name, _)| kept(name));
                let (names, positions): (Vec<String>, Vec<f64>) =
                    pairs.map(|(name, position)| (name.clone(), *position)).unzip();
                if self.joints.is_empty() {
                    self.joint_names = names;
                } else if names != self.joint_names {
                    return Some(Err(ExportError::Joints(self.joint_names.join(", "), names.join(", "))));
                }
                self.joints.push((time_ms, positions));
            }
            Topic::Odometry => {
                header(&mut reader)?;
                reader.blob()?;
                let [x, y, _] = three(&mut reader)?;
                let [_, _, z] = three(&mut reader)?;
                let w = number(&mut reader)?;
                for _ in 0..36 {
                    number(&mut reader)?;
                }
                let ([linear, _, _], [_, _, angular]) = (three(&mut reader)?, three(&mut reader)?);
                self.base.push((time_ms, [x, y, 2.0 * z.atan2(w), linear, angular]));
            }
            Topic::Twist => {
                header(&mut reader)?;
                let ([linear, _, _], [_, _, angular]) = (three(&mut reader)?, three(&mut reader)?);
                self.asked.push((time_ms, [linear, angular]));
            }
            Topic::Events => {
                header(&mut reader)?;
                let time_ms = reader.u64()?;
                text(&mut reader)?;
                let json: serde_json::Value = serde_json::from_str(&text(&mut reader)?).ok()?;
                self.events.extend(happened(&json).map(|happened| (time_ms, happened)));
            }
            Topic::Operated => {
                reader.i32()?;
                reader.u32()?;
                let time_ms = reader.u64()?;
                if reader.u8()? == 0 {
                    self.events.push((time_ms, Happened::StopKey));
                }
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

fn header(reader: &mut Reader<'_>) -> Option<()> {
    reader.i32()?;
    reader.u32()?;
    reader.blob().map(drop)
}

fn number(reader: &mut Reader<'_>) -> Option<f64> {
    reader.u64().map(f64::from_bits).filter(|number| number.is_finite())
}

fn three(reader: &mut Reader<'_>) -> Option<[f64; 3]> {
    Some([number(reader)?, number(reader)?, number(reader)?])
}

fn text(reader: &mut Reader<'_>) -> Option<String> {
    let bytes = reader.blob()?;
    String::from_utf8(bytes.strip_suffix(&[0]).unwrap_or(bytes).to_vec()).ok()
}

fn texts(reader: &mut Reader<'_>) -> Option<Vec<String>> {
    // Not more than a message can hold, whatever it says.
    (0..reader.u32()?.min(1 << 10)).map(|_| text(reader)).collect()
}

fn numbers(reader: &mut Reader<'_>) -> Option<Vec<f64>> {
    (0..reader.u32()?.min(1 << 10)).map(|_| number(reader)).collect()
}
