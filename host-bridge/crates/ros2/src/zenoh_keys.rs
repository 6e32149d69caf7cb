//! Names on Zenoh as defined by rmw_zenoh:
//! keys of topics and services, tokens of end points, and attachments.
//! This module is sans-IO. Its source is rmw_zenoh's code (`liveliness_utils`, `attachment_helpers`, `qos`).
//! The names match this source code, but were not tested with rmw_zenoh itself.

use super::advice::{Endpoint, wire};
use super::hashes;
use super::vendor::Vendor;

/// The prefix of all tokens.
const ADMIN: &str = "@ros2_lv";
/// A type without a hash in our table matches any hash.
const ANY: &str = "*";

/// The kind of entity that a token announces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entity {
    /// A node.
    Node,
    /// A publisher.
    Publisher,
    /// A subscription.
    Subscription,
    /// A service's server.
    Server,
    /// A service's client.
    Client,
}

impl Entity {
    const ALL: [(Entity, &'static str); 5] = [
        (Entity::Node, "NN"),
        (Entity::Publisher, "MP"),
        (Entity::Subscription, "MS"),
        (Entity::Server, "SS"),
        (Entity::Client, "SC"),
    ];

    fn code(self) -> &'static str {
        Entity::ALL.iter().find(|(entity, _)| *entity == self).map_or("NN", |(_, code)| code)
    }

    fn of_code(code: &str) -> Option<Self> {
        Entity::ALL.iter().find(|(_, known)| *known == code).map(|(entity, _)| *entity)
    }
}

/// A topic, or a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// The form that users write: `/cell1/cmd_vel`.
    pub name: String,
    /// The form on the wire: `geometry_msgs::msg::dds_::Twist_`; a service has no suffixes of request and reply.
    pub type_name: String,
    /// REP-2016's.
    pub hash: String,
}

impl Named {
    /// Creates a topic with a type such as `geometry_msgs/msg/Twist`.
    pub fn new(name: &str, ros_type: &str) -> Self {
        let hash = hashes::of(ros_type).unwrap_or(ANY).to_owned();
        Named { name: name.to_owned(), type_name: wire_type(ros_type), hash }
    }

    /// Returns the key of its messages.
    pub fn key(&self, domain: u16) -> String {
        format!("{domain}/{}/{}/{}", self.name.trim_matches('/'), self.type_name, self.hash)
    }
}

/// `geometry_msgs/msg/Twist` → `geometry_msgs::msg::dds_::Twist_`.
pub fn wire_type(ros_type: &str) -> String {
    match ros_type.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => ros_type.to_owned(),
    }
}

/// A name in a token contains no slashes: `%` replaces each slash, and stands for an empty name.
fn mangled(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

fn demangled(name: &str) -> String {
    name.replace('%', "/")
}

/// Quality of service of a topic.
/// Omitted values are rmw_zenoh's defaults (reliable, volatile, the last 42 messages).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quality {
    /// Whether lost messages are sent again.
    pub reliable: bool,
    /// Whether the last message is stored for late subscribers.
    pub transient_local: bool,
    /// The number of stored messages.
    pub depth: u32,
}

impl Quality {
    /// The quality of service that most topics have.
    pub const RELIABLE: Quality = Quality { reliable: true, transient_local: false, depth: 10 };
    /// The last message is stored for late subscribers.
    pub const LATCHED: Quality = Quality { reliable: true, transient_local: true, depth: 1 };

    fn code(self) -> String {
        let reliable = if self.reliable { "" } else { "2" };
        let durable = if self.transient_local { "1" } else { "" };
        format!("{reliable}:{durable}:,{}:,:,:,,", self.depth)
    }

    fn of_code(code: &str) -> Option<Self> {
        let mut parts = code.split(':');
        let (reliable, durable) = (parts.next()?, parts.next()?);
        let depth = parts.next()?.split(',').nth(1)?;
        let depth = if depth.is_empty() { 42 } else { depth.parse().ok()? };
        Some(Quality { reliable: reliable != "2", transient_local: durable == "1", depth })
    }
}

/// A node on the graph, as described in its tokens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// ROS's domain.
    pub domain: u16,
    /// The session.
    pub session: String,
    /// Empty, or such as `/cell1`.
    pub namespace: String,
    /// Its name.
    pub name: String,
}

impl Node {
    /// The token of the node itself.
    pub fn token(&self) -> String {
        self.begin(0, Entity::Node)
    }

    /// Returns the token of one of the node's end points, distinguished by `id`.
    pub fn end_token(&self, id: u32, entity: Entity, named: &Named, quality: Quality) -> String {
        let Named { name, type_name, hash } = named;
        let (name, type_name) = (mangled(name), mangled(type_name));
        format!("{}/{name}/{type_name}/{hash}/{}", self.begin(id, entity), quality.code())
    }

    fn begin(&self, id: u32, entity: Entity) -> String {
        let Node { domain, session, namespace, name } = self;
        // The `%` is the default ROS enclave. In the key, it comes before the namespace.
        format!(
            "{ADMIN}/{domain}/{session}/0/{id}/{}/%/{}/{}",
            entity.code(),
            mangled(namespace),
            mangled(name)
        )
    }
}

/// Returns a pattern for all tokens of a domain.
pub fn tokens_of(domain: u16) -> String {
    format!("{ADMIN}/{domain}/**")
}

/// The content of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told {
    /// What it is about.
    pub entity: Entity,
    /// Whose session.
    pub session: String,
    /// With its namespace: `/cell1/bimanual`.
    pub node: String,
    /// Of all but nodes.
    pub end: Option<(Named, Quality)>,
}

/// Reads a token; returns `None` for any other text.
pub fn read_token(token: &str) -> Option<Told> {
    let parts: Vec<&str> = token.split('/').collect();
    let [ADMIN, _, session, _, _, code, _, namespace, node, rest @ ..] = &parts[..] else { return None };
    let entity = Entity::of_code(code)?;
    let end = match (entity, rest) {
        (Entity::Node, _) => None,
        (_, [name, type_name, hash, quality, ..]) => {
            let (name, type_name) = (demangled(name), demangled(type_name));
            Some((Named { name, type_name, hash: (*hash).to_owned() }, Quality::of_code(quality)?))
        }
        _ => return None,
    };
    let node = format!("{}/{}", demangled(namespace).trim_end_matches('/'), demangled(node));
    Some(Told { entity, session: (*session).to_owned(), node, end })
}

impl Told {
    /// Returns the end point as DDS would show it, and whether it is a reader.
    /// The result is `None` for nodes and clients.
    pub fn endpoint(&self) -> Option<(Endpoint, bool)> {
        let (named, quality) = self.end.as_ref()?;
        let (topic, type_name, reads) = match self.entity {
            Entity::Publisher => (wire::topic(&named.name), named.type_name.clone(), false),
            Entity::Subscription => (wire::topic(&named.name), named.type_name.clone(), true),
            Entity::Server => {
                (format!("rq{}Request", named.name), format!("{}Request_", named.type_name), true)
            }
            Entity::Node | Entity::Client => return None,
        };
        let end = Endpoint {
            topic,
            type_name,
            reliable: quality.reliable,
            // Every writer matches every reader here.
            transient_local: false,
            vendor: Vendor::ZENOH,
            participant: self.session.clone(),
            // The type of a service differs from that of its request.
            type_hash: (self.entity != Entity::Server).then(|| named.hash.clone()),
        };
        Some((end, reads))
    }
}

/// The attachment of each message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attached {
    /// The number of the writer's message, or of a client's request.
    pub number: i64,
    /// Time of sending, in ns since 1970.
    pub sent_ns: i64,
    /// Who sent it.
    pub writer: [u8; 16],
}

/// In Jazzy, each value has a name; later releases only store the values in order.
const LABELS: [&str; 3] = ["sequence_number", "source_timestamp", "source_gid"];

impl Attached {
    /// Returns the bytes, with or without the values' names.
    pub fn bytes(&self, labelled: bool) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(77);
        let parts: [&[u8]; 3] = [&self.number.to_le_bytes(), &self.sent_ns.to_le_bytes(), &self.writer];
        for (label, part) in LABELS.iter().zip(parts) {
            if labelled {
                bytes.push(label.len() as u8);
                bytes.extend_from_slice(label.as_bytes());
            }
            if part.len() == self.writer.len() {
                bytes.push(part.len() as u8);
            }
            bytes.extend_from_slice(part);
        }
        bytes
    }

    /// Reads either form, and returns whether it contained names.
    pub fn read(bytes: &[u8]) -> Option<(Self, bool)> {
        let labelled = bytes.get(1..16) == Some(LABELS[0].as_bytes());
        let mut rest = bytes;
        let mut part = |label: &str, length: usize| -> Option<&[u8]> {
            if labelled {
                let (named, after) = rest.split_at_checked(label.len() + 1)?;
                (named[1..] == *label.as_bytes()).then_some(())?;
                rest = after;
            }
            if length == 16 {
                rest = rest.strip_prefix(&[16])?;
            }
            let (value, after) = rest.split_at_checked(length)?;
            rest = after;
            Some(value)
        };
        let number = i64::from_le_bytes(part(LABELS[0], 8)?.try_into().ok()?);
        let sent_ns = i64::from_le_bytes(part(LABELS[1], 8)?.try_into().ok()?);
        let writer = part(LABELS[2], 16)?.try_into().ok()?;
        Some((Attached { number, sent_ns, writer }, labelled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(namespace: &str) -> Node {
        let (session, name) = ("a1b2".to_owned(), "bimanual".to_owned());
        Node { domain: 5, session, namespace: namespace.to_owned(), name }
    }

    #[test]
    fn a_topics_key_is_domain_name_type_and_hash() {
        let hash = hashes::of("geometry_msgs/msg/Twist").unwrap();
        let twist = Named::new("/cell1/cmd_vel", "geometry_msgs/msg/Twist");
        assert_eq!(twist.key(5), format!("5/cell1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{hash}"));
        let goal =
            Named::new("/c/follow/_action/send_goal", "control_msgs/action/FollowJointTrajectory_SendGoal");
        assert!(goal.key(0).contains(
            "/_action/send_goal/control_msgs::action::dds_::FollowJointTrajectory_SendGoal_/RIHS01_"
        ));
    }

    #[test]
    fn tokens_say_who_is_there_and_read_back() {
        assert_eq!(node("").token(), "@ros2_lv/5/a1b2/0/0/NN/%/%/bimanual");
        let quality = Quality { reliable: true, transient_local: false, depth: 10 };
        let twist = Named::new("/cell1/cmd_vel", "geometry_msgs/msg/Twist");
        let token = node("/cell1").end_token(7, Entity::Publisher, &twist, quality);
        let hash = &twist.hash;
        assert_eq!(
            token,
            format!(
                "@ros2_lv/5/a1b2/0/7/MP/%/%cell1/bimanual/%cell1%cmd_vel/geometry_msgs::msg::dds_::Twist_/{hash}/::,10:,:,:,,"
            )
        );
        let told = read_token(&token).unwrap();
        assert_eq!((told.entity, told.session.as_str()), (Entity::Publisher, "a1b2"));
        assert_eq!(told.node, "/cell1/bimanual");
        assert_eq!(told.end, Some((twist, quality)));
        // These are the values in rmw_zenoh's own documentation: best effort, transient local, keep all.
        let theirs =
            "@ros2_lv/0/q1/1/32/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/RIHS01_x/2:1:2,10:,:,:,,";
        let (named, kept) = read_token(theirs).unwrap().end.unwrap();
        assert_eq!((named.name.as_str(), kept.reliable, kept.transient_local), ("/chatter", false, true));
        assert_eq!(read_token(&node("").token()).unwrap().node, "/bimanual");
        for none in
            ["", "@ros2_lv/0", "@ros2_lv/0/a/0/0/XX/%/%/n", "@ros2_lv/0/a/0/0/MP/%/%/n", "a/0/a/0/0/NN/%/%/n"]
        {
            assert_eq!(read_token(none), None, "{none}");
        }
    }

    #[test]
    fn a_server_reads_requests_as_one_on_dds_would() {
        let goal = Named::new(
            "/jtc/follow_joint_trajectory/_action/send_goal",
            "control_msgs/action/FollowJointTrajectory_SendGoal",
        );
        let quality = Quality { reliable: true, transient_local: false, depth: 42 };
        let told = read_token(&node("").end_token(3, Entity::Server, &goal, quality)).unwrap();
        let (end, reads) = told.endpoint().unwrap();
        assert!(reads);
        assert_eq!(end.topic, super::super::advice::wire::send_goal("/jtc"));
        assert_eq!(end.type_name, super::super::advice::wire::SEND_GOAL);
    }

    #[test]
    fn what_is_attached_reads_back_in_both_layouts_and_nothing_else_does() {
        let attached = Attached {
            number: 7,
            sent_ns: 1_790_000_000_000_000_001,
            writer: std::array::from_fn(|i| i as u8),
        };
        let (plain, labelled) = (attached.bytes(false), attached.bytes(true));
        assert_eq!((plain.len(), labelled.len()), (33, 77));
        // These bytes were assembled by hand from rmw_zenoh's attachment_helpers.cpp:
        // two integers, the length and 16 bytes.
        // In Jazzy's form, the length and the name of each value precede the value.
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let (number, sent) = ("0700000000000000", "0100f323845bd718");
        let writer = "10000102030405060708090a0b0c0d0e0f";
        assert_eq!(hex(&plain), format!("{number}{sent}{writer}"));
        let [first, second, third] =
            ["sequence_number", "source_timestamp", "source_gid"].map(|label| hex(label.as_bytes()));
        assert_eq!(hex(&labelled), format!("0f{first}{number}10{second}{sent}0a{third}{writer}"));
        assert_eq!(Attached::read(&plain), Some((attached, false)));
        assert_eq!(Attached::read(&labelled), Some((attached, true)));
        for bytes in [&plain, &labelled] {
            for length in 0..bytes.len() {
                assert_eq!(Attached::read(&bytes[..length]), None, "{length}");
            }
        }
    }
}
