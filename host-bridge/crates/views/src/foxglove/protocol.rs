//! Messages from and to a viewer (Foxglove's WebSocket protocol, version 1).

use serde::Deserialize;
use serde_json::json;

use host_topics::{ENCODING, SCHEMA_ENCODING, Topic};

/// Names of the protocol, newest first. Both are currently identical.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Marks a message's data.
const MESSAGE_DATA: u8 = 1;

/// Selects a supported protocol from those offered in a header.
pub fn subprotocol(offered: &str) -> Option<&'static str> {
    SUBPROTOCOLS.into_iter().find(|known| offered.split(',').any(|name| name.trim() == *known))
}

/// The first words.
pub fn server_info(session: u64) -> String {
    json!({
        "op": "serverInfo",
        "name": concat!("bimanual ", env!("CARGO_PKG_VERSION")),
        // Viewers can only observe the session.
        "capabilities": [],
        "metadata": {},
        "sessionId": session.to_string(),
    })
    .to_string()
}

/// Lists all channels. A channel's number is the index of its topic in [`Topic::ALL`].
pub fn advertise() -> String {
    let channel = |topic: Topic| {
        json!({
            "id": topic as u32,
            "topic": topic.name(),
            "encoding": ENCODING,
            "schemaName": topic.kind(),
            "schema": topic.schema(),
            "schemaEncoding": SCHEMA_ENCODING,
        })
    };
    json!({ "op": "advertise", "channels": Topic::ALL.map(channel) }).to_string()
}

/// Creates a warning for the viewer's user.
pub fn warning(message: &str) -> String {
    json!({ "op": "status", "level": 1, "message": message }).to_string()
}

/// Creates one message for one subscription.
pub fn message_data(subscription: u32, time_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut message = Vec::with_capacity(13 + data.len());
    message.push(MESSAGE_DATA);
    message.extend(subscription.to_le_bytes());
    message.extend(time_ns.to_le_bytes());
    message.extend(data);
    message
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Wish {
    id: u32,
    channel_id: u32,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Words {
    op: String,
    #[serde(default)]
    subscriptions: Vec<Wish>,
    #[serde(default)]
    subscription_ids: Vec<u32>,
}

/// The subscriptions of one viewer, at most one for each topic.
#[derive(Debug, Default)]
pub struct Subscriptions([Option<u32>; Topic::ALL.len()]);

impl Subscriptions {
    /// Processes a message from the viewer.
    ///
    /// # Errors
    /// Returns the text for the viewer's user if a request cannot be satisfied.
    /// Other requests in the message still count.
    pub fn hear(&mut self, text: &str) -> Result<(), String> {
        let words: Words = serde_json::from_str(text).map_err(|error| format!("not understood: {error}"))?;
        match words.op.as_str() {
            "subscribe" => {
                words.subscriptions.iter().map(|wish| self.subscribe(wish)).fold(Ok(()), Result::and)
            }
            "unsubscribe" => {
                for wanted in &mut self.0 {
                    *wanted = wanted.filter(|id| !words.subscription_ids.contains(id));
                }
                Ok(())
            }
            other => Err(format!("'{other}' is not served: viewers of this robot only look on")),
        }
    }

    fn subscribe(&mut self, wish: &Wish) -> Result<(), String> {
        if self.0.contains(&Some(wish.id)) {
            return Err(format!("subscription {} is there already", wish.id));
        }
        match self.0.get_mut(wish.channel_id as usize) {
            Some(free @ None) => {
                *free = Some(wish.id);
                Ok(())
            }
            Some(Some(_)) => Err(format!("channel {} has a subscription already", wish.channel_id)),
            None => Err(format!("there is no channel {}", wish.channel_id)),
        }
    }

    /// The subscription to a topic.
    pub fn to(&self, topic: Topic) -> Option<u32> {
        self.0[topic as usize]
    }

    /// Returns a bit for each subscribed topic.
    pub fn bits(&self) -> u32 {
        (0..self.0.len()).filter(|&k| self.0[k].is_some()).fold(0, |bits, k| bits | 1 << k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subprotocol_that_is_known_is_chosen_the_newest_first() {
        assert_eq!(subprotocol("foxglove.websocket.v1"), Some("foxglove.websocket.v1"));
        assert_eq!(subprotocol("foxglove.websocket.v1, foxglove.sdk.v1"), Some("foxglove.sdk.v1"));
        for offered in ["", "foxglove.sdk.v2", "mqtt", "foxglove"] {
            assert_eq!(subprotocol(offered), None, "{offered}");
        }
    }

    #[test]
    fn data_is_one_byte_of_kind_then_subscription_and_time_in_little_endian() {
        let message = message_data(0x0403_0201, 0x0c0b_0a09_0807_0605, b"xy");
        assert_eq!(message, [1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, b'x', b'y']);
    }

    #[test]
    fn subscriptions_come_and_go_and_nonsense_changes_nothing() {
        let mut wanted = Subscriptions::default();
        let joints = Topic::Joints as u32;
        let both = format!(
            r#"{{"op":"subscribe","subscriptions":[{{"id":7,"channelId":{joints}}},{{"id":8,"channelId":999}}]}}"#
        );
        assert_eq!(wanted.hear(&both).unwrap_err(), "there is no channel 999");
        assert_eq!((wanted.to(Topic::Joints), wanted.bits()), (Some(7), 1 << joints));
        let again = both.replace("\"id\":7", "\"id\":9");
        assert!(wanted.hear(&again).unwrap_err().contains("already"));
        for words in
            ["", "{}", "[]", r#"{"op":"advertise","channels":[]}"#, r#"{"op":"subscribe","subscriptions":7}"#]
        {
            assert!(wanted.hear(words).is_err(), "{words}");
        }
        assert_eq!(wanted.bits(), 1 << joints);
        wanted.hear(r#"{"op":"unsubscribe","subscriptionIds":[8,7]}"#).unwrap();
        assert_eq!((wanted.to(Topic::Joints), wanted.bits()), (None, 0));
    }

    #[test]
    fn every_topic_is_advertised_with_its_type() {
        let told: serde_json::Value = serde_json::from_str(&advertise()).unwrap();
        let channels = told["channels"].as_array().unwrap();
        assert_eq!(channels.len(), Topic::ALL.len());
        // All topics must fit in the bits of the subscriptions.
        assert!(channels.len() <= u32::BITS as usize);
        let joints = &channels[Topic::Joints as usize];
        assert_eq!(
            (&joints["topic"], &joints["schemaEncoding"]),
            (&json!("/joint_states"), &json!("ros2msg"))
        );
        assert!(joints["schema"].as_str().unwrap().contains("float64[] velocity"));
    }
}
