//! Analyses a graph for `doctor --ros2`. The analysis finds subscribers, or the reasons why there are none.

use std::collections::{BTreeMap, BTreeSet};

use super::clocks::Difference;
use super::config::{ArmInterface, Connection, Ros2Config, RosEnvironment};
use super::hashes;
use super::vendor::Vendor;

/// Another participant on the graph.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Participant {
    /// Whose middleware.
    pub vendor: Vendor,
    /// The version of the protocol, such as `2.3`; empty if it is unknown.
    pub version: String,
    /// Name that the node reports about itself.
    pub name: Option<String>,
}

/// A reader or writer of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Name on the wire: `rt/cmd_vel`.
    pub topic: String,
    /// Type on the wire: `geometry_msgs::msg::dds_::Twist_`.
    pub type_name: String,
    /// Whether the end point requests (or offers) retransmission of lost messages.
    pub reliable: bool,
    /// Whether the end point requests (or offers) messages from before its start.
    pub transient_local: bool,
    /// Whose middleware.
    pub vendor: Vendor,
    /// The participant, as the first 12 bytes of its GUID.
    pub participant: String,
    /// REP-2016's hash of the type, if it is announced.
    pub type_hash: Option<String>,
}

/// What was discovered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Graph {
    /// Participants other than this program, by the first 12 bytes of their GUID.
    pub participants: BTreeMap<String, Participant>,
    /// Their readers.
    pub readers: Vec<Endpoint>,
    /// Their writers.
    pub writers: Vec<Endpoint>,
}

/// Information from this machine's sockets.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Machine {
    /// Domains in which a program on this machine listens.
    pub domains: BTreeSet<u16>,
    /// Whether a Zenoh router listens.
    pub zenoh: bool,
}

impl Machine {
    /// Parses the text of Linux's `/proc/net/udp` and `/proc/net/tcp`.
    pub fn from_proc(udp: &str, tcp: &str) -> Self {
        let ports = |text: &str, listening_only: bool| -> BTreeSet<u16> {
            let port = |line: &str| {
                let mut words = line.split_whitespace();
                let local = words.nth(1)?;
                let state = words.nth(1)?;
                let port = u16::from_str_radix(local.rsplit(':').next()?, 16).ok()?;
                (!listening_only || state == "0A").then_some(port)
            };
            text.lines().skip(1).filter_map(port).collect()
        };
        // A participant's first port is 7400 + 250 × domain + 10 + 2 × number. The next port is for its data.
        let domain = |port: u16| {
            let offset = port.checked_sub(7400)?;
            let within = offset % 250;
            (within >= 10 && within.is_multiple_of(2)).then_some(offset / 250)
        };
        let udp = ports(udp, false);
        // Both ports must exist; a single port belongs to another program.
        let pairs = udp.iter().filter(|&&port| port < u16::MAX && udp.contains(&(port + 1)));
        let domains = pairs.filter_map(|&port| domain(port)).collect();
        Machine { domains, zenoh: ports(tcp, true).contains(&7447) }
    }
}

/// A topic of ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Name for users: `/cmd_vel`.
    pub name: String,
    /// As on the wire.
    pub topic: String,
    /// As on the wire.
    pub type_name: String,
    /// Whether the bridge writes the topic; otherwise it reads the topic.
    pub written: bool,
    /// Our offer or request.
    pub reliable: bool,
    /// Whether the robot needs another participant on this topic.
    pub needed: bool,
    /// The key in `[ros2]`.
    pub key: &'static str,
}

/// Names and types on the wire.
pub mod wire {
    /// `geometry_msgs::msg::dds_::Twist_`
    pub const TWIST: &str = "geometry_msgs::msg::dds_::Twist_";
    /// `geometry_msgs::msg::dds_::TwistStamped_`
    pub const TWIST_STAMPED: &str = "geometry_msgs::msg::dds_::TwistStamped_";
    /// `diagnostic_msgs::msg::dds_::DiagnosticArray_`
    pub const DIAGNOSTICS: &str = "diagnostic_msgs::msg::dds_::DiagnosticArray_";
    /// `sensor_msgs::msg::dds_::JointState_`
    pub const JOINT_STATE: &str = "sensor_msgs::msg::dds_::JointState_";
    /// `trajectory_msgs::msg::dds_::JointTrajectory_`
    pub const TRAJECTORY: &str = "trajectory_msgs::msg::dds_::JointTrajectory_";
    /// `std_msgs::msg::dds_::Bool_`
    pub const BOOL: &str = "std_msgs::msg::dds_::Bool_";
    /// The topic on which the action's goals are requested.
    pub const SEND_GOAL: &str = "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_Request_";

    /// A topic's name on the wire.
    pub fn topic(name: &str) -> String {
        format!("rt{name}")
    }

    const SEND_GOAL_TAIL: &str = "/follow_joint_trajectory/_action/send_goalRequest";

    /// The topic on which goals for a controller are sent.
    pub fn send_goal(controller: &str) -> String {
        format!("rq{controller}{SEND_GOAL_TAIL}")
    }

    /// The controller whose goals are sent on this topic, if there is one.
    pub fn controller(topic: &str) -> Option<&str> {
        topic.strip_prefix("rq")?.strip_suffix(SEND_GOAL_TAIL)
    }
}

/// `geometry_msgs::msg::dds_::Twist_` → `geometry_msgs/msg/Twist`.
pub fn ros_type(type_name: &str) -> String {
    let plain = type_name.replace("::dds_::", "::").replace("::", "/");
    plain.strip_suffix('_').unwrap_or(&plain).to_owned()
}

/// `rt/cmd_vel` → `/cmd_vel`.
pub fn ros_name(topic: &str) -> String {
    match topic.split_once('/') {
        Some((_, name)) => format!("/{name}"),
        None => topic.to_owned(),
    }
}

/// Returns the topics of a configuration. If the type of speeds is left open, the subscribers determine it.
pub fn topics(config: &Ros2Config, graph: &Graph) -> Vec<Topic> {
    let plain = |key, name: &str, type_name: &str, written, reliable, needed| {
        let name = config.resolve(name);
        let topic = wire::topic(&name);
        Topic { name, topic, type_name: type_name.to_owned(), written, reliable, needed, key }
    };
    let speed = wire::topic(&config.resolve(&config.cmd_vel));
    let wants = |kind: &str| graph.readers.iter().any(|r| r.topic == speed && r.type_name == kind);
    let stamped = config.stamped.fixed().unwrap_or_else(|| wants(wire::TWIST_STAMPED) || !wants(wire::TWIST));
    let twist = if stamped { wire::TWIST_STAMPED } else { wire::TWIST };
    let controller = config.resolve(&config.arm_controller);
    let mut topics = vec![
        plain("cmd_vel", &config.cmd_vel, twist, true, config.reliable, true),
        plain("diagnostics", &config.diagnostics, wire::DIAGNOSTICS, true, true, false),
    ];
    let flags =
        [("estop", &config.estop), ("fault", &config.fault)].into_iter().filter(|(_, name)| !name.is_empty());
    topics.extend(flags.map(|(key, name)| plain(key, name, wire::BOOL, false, false, true)));
    match config.arm {
        ArmInterface::None => return topics,
        ArmInterface::Topic | ArmInterface::Stream => {
            let name = format!("{controller}/joint_trajectory");
            topics.push(plain("arm_controller", &name, wire::TRAJECTORY, true, true, true));
        }
        ArmInterface::Action => topics.push(Topic {
            name: format!("{controller}/follow_joint_trajectory"),
            topic: wire::send_goal(&controller),
            type_name: wire::SEND_GOAL.to_owned(),
            written: true,
            reliable: true,
            needed: true,
            key: "arm_controller",
        }),
    }
    topics.push(plain("joint_states", &config.joint_states, wire::JOINT_STATE, false, false, true));
    topics
}

/// Returns why two end points do not match, or `None` if they do.
fn mismatch(ours: &Topic, theirs: &Endpoint) -> Option<String> {
    if ours.type_name == theirs.type_name
        && let (Some(known), Some(hash)) = (hashes::of(&ros_type(&ours.type_name)), &theirs.type_hash)
        && hash != known
        && hash != "INVALID"
    {
        return Some(format!(
            "has another {} than Jazzy's ({hash}): its packages are older or newer; what goes out may not be understood",
            ros_type(&ours.type_name)
        ));
    }
    if ours.type_name != theirs.type_name {
        return Some(format!("is {}, ours {}", ros_type(&theirs.type_name), ros_type(&ours.type_name)));
    }
    if ours.written && theirs.reliable && !ours.reliable {
        return Some("asks for reliable, ours is best effort: set reliable = true".to_owned());
    }
    if ours.written && theirs.transient_local {
        return Some("asks for transient local, ours is volatile: make that reader volatile".to_owned());
    }
    None
}

/// The result for one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// For people, in order.
    pub lines: Vec<String>,
    /// What to do.
    pub advice: Vec<String>,
}

/// Examines one topic and returns the result.
pub fn look_at(ours: &Topic, graph: &Graph) -> Finding {
    let (others, role) =
        if ours.written { (&graph.readers, "reader") } else { (&graph.writers, "publisher") };
    let (mut lines, mut advice) = (Vec::new(), Vec::new());
    let kept = |reliable| if reliable { "reliable" } else { "best effort" };
    let there: Vec<&Endpoint> = others.iter().filter(|other| other.topic == ours.topic).collect();
    let matched = there.iter().filter(|other| mismatch(ours, other).is_none()).count();
    lines.push(format!(
        "{} [{}, {}]: {matched} {role}{} matched",
        ours.name,
        ros_type(&ours.type_name),
        kept(ours.reliable),
        if matched == 1 { "" } else { "s" }
    ));
    for other in &there {
        let durable = if other.transient_local { "transient local" } else { "volatile" };
        let (wire_type, reliable) = (ros_type(&other.type_name), kept(other.reliable));
        match mismatch(ours, other) {
            None => lines.push(format!("  {role}: {wire_type}, {reliable}, {durable}, {}", whose(other))),
            Some(why) => {
                lines.push(format!(
                    "  {role} NOT matched: {wire_type}, {reliable}, {durable}, {}",
                    whose(other)
                ));
                advice.push(format!("{}: a {role} {why}{}", ours.name, remedy(ours, other)));
            }
        }
    }
    if matched > 0 && ours.key == "cmd_vel" {
        let writers = graph.writers.iter().filter(|w| w.topic == ours.topic).count();
        if writers > 0 {
            advice.push(format!(
                "{}: {writers} other publisher{} too; put twist_mux between them and the base",
                ours.name,
                if writers == 1 { "" } else { "s" }
            ));
        }
    }
    if matched > 1 && ours.key == "arm_controller" {
        let servers: Vec<String> =
            there.iter().map(|s| format!("{} ({})", s.vendor, s.participant)).collect();
        advice.push(format!(
            "{}: {matched} controllers of one name: {}; end all but one, no motion starts before",
            ours.name,
            servers.join(", ")
        ));
    }
    if matched > 1 && ours.key == "joint_states" {
        advice.push(format!(
            "{}: {matched} publishers; whose angles are the arm's? Leave one (`ros2 topic info -v {}`)",
            ours.name, ours.name
        ));
    }
    if there.is_empty() && ours.needed && !graph.participants.is_empty() {
        let same_type = others.iter().filter(|other| other.type_name == ours.type_name);
        let mut names: Vec<String> = same_type.map(|other| ros_name(&other.topic)).collect();
        names.sort();
        names.dedup();
        let known = if ours.topic.starts_with("rq/") {
            // Returns only the controller's part of the name.
            let tail = "/follow_joint_trajectory/_action/send_goalRequest";
            names.iter().filter_map(|name| name.strip_suffix(tail)).map(str::to_owned).collect()
        } else {
            names
        };
        advice.push(if known.is_empty() {
            format!(
                "{}: no {role} on it or of its type: is that node running, its controller active?",
                ours.name
            )
        } else {
            format!(
                "{}: no {role} there, but on {}: set {} or namespace in [ros2]",
                ours.name,
                known.join(", "),
                ours.key
            )
        });
    }
    Finding { lines, advice }
}

fn whose(end: &Endpoint) -> String {
    match &end.type_hash {
        // This length is enough to distinguish two hashes.
        Some(hash) => format!("{}, {}", end.vendor, hash.get(..15).unwrap_or(hash)),
        None => format!("{}, no type hash", end.vendor),
    }
}

/// A harmless request and its answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Probe {
    /// No server is known, or there are several of them.
    #[default]
    NotSent,
    /// Not answered yet.
    Waiting,
    /// Answered.
    Answered,
}

/// Observations and attempts during the examination of the graph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Heard {
    /// Angles of the arm.
    pub joint_states: u64,
    /// Number of reports of the arm's controller about itself.
    pub controller_states: u64,
    /// A simulation's time.
    pub clocks: u64,
    /// The difference between the robot's clock and its reference.
    pub difference: Option<Difference>,
    /// The reason why the bridge would not be armed.
    pub refusal: Option<String>,
    /// The result of asking the arm's server to cancel a goal that does not exist.
    pub probe: Probe,
}

/// Describes the results of all attempts.
pub fn tried(config: &Ros2Config, graph: &Graph, heard: &Heard, environment: &RosEnvironment) -> Finding {
    let (mut lines, mut advice) = (Vec::new(), Vec::new());
    let states = config.resolve(&config.joint_states);
    let controller = config.resolve(&config.arm_controller);
    let has_arm = config.arm != ArmInterface::None;
    let written = |name: &str| graph.writers.iter().any(|w| w.topic == wire::topic(name));
    lines.push(match heard.difference {
        None => "clocks: the robot stamps nothing that is read here: only zero stamps are sent".to_owned(),
        Some(Difference { seconds, is_simulated }) => format!(
            "clocks: the robot's stamps are {:+.0} ms from {}",
            seconds * 1000.0,
            if is_simulated { "/clock" } else { "this machine's clock" }
        ),
    });
    advice.extend(heard.refusal.iter().cloned());
    if heard.clocks > 0 || written("/clock") {
        lines.push("simulated time: somebody publishes /clock; it is followed".to_owned());
        if heard.refusal.is_none() && heard.difference.is_none() {
            advice.push(
                "somebody publishes /clock, but no stamp of the robot is read: do its nodes run with use_sim_time?"
                    .to_owned(),
            );
        }
        if config.stamp == super::Stamp::Wall {
            advice.push(
                "stamp = \"wall\" under simulated time: a base that is told so never stops by itself; set stamp = \
                 \"zero\" or \"clock\" in [ros2]"
                    .to_owned(),
            );
        }
    }
    if has_arm && written(&states) && heard.joint_states == 0 {
        advice.push(format!(
            "{states}: has a publisher, but no message came: is joint_state_broadcaster active?"
        ));
    }
    let action = wire::send_goal(&controller);
    if has_arm && let Some(server) = graph.readers.iter().find(|r| r.topic == action) {
        match heard.probe {
            Probe::Answered => lines.push(format!("action server on {}: answers", server.vendor)),
            Probe::Waiting => advice.push(format!(
                "{controller}: its action server (on {}) does not answer a harmless request: is that node alive, do \
                 datagrams from it arrive here (firewall, another network)?",
                server.vendor
            )),
            // There are two servers, which another line reports, or the server appeared only at the very end.
            Probe::NotSent => {}
        }
        if let Some(rmw) = environment.rmw.as_deref()
            && (rmw == "rmw_cyclonedds_cpp") != (server.vendor == Vendor::CYCLONE_DDS)
        {
            advice.push(format!(
                "RMW_IMPLEMENTATION = {rmw} here, but the arm's action server runs on {}: this program asks it in its \
                 own way, the ros2 tools of this machine will get no answer from it; set it as on the robot",
                server.vendor
            ));
        }
    }
    let pieces = wire::topic(&format!("{controller}/joint_trajectory"));
    let speaks = graph.readers.iter().any(|r| r.topic == action || r.topic == pieces);
    if has_arm && speaks && heard.controller_states == 0 {
        advice.push(format!(
            "{controller}: says nothing on its controller_state: it is not active and rejects every motion; `ros2 \
             control list_controllers`, then `ros2 control set_controller_state {} active`",
            controller.rsplit('/').next().unwrap_or(&controller)
        ));
    }
    advice.extend(variables(environment));
    Finding { lines, advice }
}

/// Lists environment variables that other nodes use and this one does not support.
pub fn variables(environment: &RosEnvironment) -> Vec<String> {
    let mut advice = Vec::new();
    if let Some(peers) = &environment.static_peers {
        advice.push(format!(
            "ROS_STATIC_PEERS = {peers} is not obeyed: this program finds others by multicast and on this machine \
             only; where multicast does not pass, see docs/sites.md"
        ));
    }
    if let Some(server) = &environment.discovery_server {
        advice.push(format!(
            "ROS_DISCOVERY_SERVER = {server} is not obeyed: a robot that announces itself to a discovery server only \
             is not seen; start it without, or see docs/sites.md"
        ));
    }
    advice
}

fn remedy(ours: &Topic, other: &Endpoint) -> &'static str {
    match (ours.type_name.as_str(), other.type_name.as_str()) {
        (wire::TWIST_STAMPED, wire::TWIST) => {
            "; it hears nothing: set stamped = false in [ros2] for that one alone"
        }
        (wire::TWIST, wire::TWIST_STAMPED) => "; it hears nothing: leave stamped and --unstamped out",
        _ => "",
    }
}

/// Gives advice if there are no other participants.
pub fn nobody(connection: &Connection, machine: &Machine) -> Vec<String> {
    let mut advice = Vec::new();
    let others: Vec<String> =
        machine.domains.iter().filter(|d| **d != connection.domain_id).map(u16::to_string).collect();
    if !others.is_empty() {
        advice.push(format!(
            "on this machine somebody is in domain {}, not {}: set ROS_DOMAIN_ID or domain_id in [ros2]",
            others.join(", "),
            connection.domain_id
        ));
    }
    if machine.zenoh {
        advice.push(
            "a Zenoh router listens on this machine: a robot on rmw_zenoh_cpp is not seen over DDS; set transport = \
             \"zenoh\" in [ros2], or run the robot with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"
                .to_owned(),
        );
    }
    if connection.interfaces.iter().any(std::net::IpAddr::is_loopback) {
        advice.push("only this machine is searched (interfaces, ROS_AUTOMATIC_DISCOVERY_RANGE)".to_owned());
    } else {
        advice.push(
            "robots on other machines are found by multicast to 239.255.0.1: same network, no firewall on UDP \
             7400 and up, Wi-Fi that passes multicast; name the interface in [ros2] where there are several"
                .to_owned(),
        );
    }
    advice.push("`echo $ROS_DOMAIN_ID $RMW_IMPLEMENTATION` on the robot shows what it uses".to_owned());
    advice
}

/// Gives the same advice for a graph with a Zenoh router.
pub fn nobody_on_zenoh(connection: &Connection) -> Vec<String> {
    vec![
        format!(
            "the Zenoh router answers, but tells of nobody: run the robot with RMW_IMPLEMENTATION=rmw_zenoh_cpp and \
             ROS_DOMAIN_ID={} on the same router",
            connection.domain_id
        ),
        "with access control each side needs a certificate of this pair and the namespace that goes with it \
         (docs/sites.md)"
            .to_owned(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reader(topic: &str, type_name: &str) -> Endpoint {
        let (topic, type_name) = (topic.to_owned(), type_name.to_owned());
        Endpoint {
            topic,
            type_name,
            reliable: true,
            transient_local: false,
            vendor: Vendor::FAST_DDS,
            participant: "robot".to_owned(),
            type_hash: None,
        }
    }

    fn graph(readers: Vec<Endpoint>) -> Graph {
        let participants = BTreeMap::from([("robot".to_owned(), Participant::default())]);
        Graph { participants, readers, writers: Vec::new() }
    }

    fn cmd_vel(change: impl Fn(&mut Ros2Config), readers: Vec<Endpoint>) -> Finding {
        let mut config = Ros2Config::default();
        change(&mut config);
        let graph = graph(readers);
        look_at(&topics(&config, &graph)[0], &graph)
    }

    #[test]
    fn a_matched_reader_is_shown_with_its_type_and_needs_no_advice() {
        let found = cmd_vel(|_| {}, vec![reader("rt/cmd_vel", wire::TWIST_STAMPED)]);
        assert_eq!(found.advice, [""; 0]);
        assert!(
            found.lines[0].contains("/cmd_vel [geometry_msgs/msg/TwistStamped, reliable]: 1 reader matched")
        );
        assert!(found.lines[1].contains("reliable, volatile"), "{:?}", found.lines);
    }

    #[test]
    fn twist_against_twist_stamped_is_named_with_the_option_that_helps() {
        let found = cmd_vel(|_| {}, vec![reader("rt/cmd_vel", wire::TWIST)]);
        assert_eq!((found.lines[0].contains("Twist, reliable]: 1 reader"), found.advice.len()), (true, 0));
        // There are two types at once. One of them is ignored, and this is reported.
        let both = vec![reader("rt/cmd_vel", wire::TWIST), reader("rt/cmd_vel", wire::TWIST_STAMPED)];
        let found = cmd_vel(|_| {}, both);
        assert!(found.lines[0].contains("TwistStamped, reliable]: 1 reader"), "{:?}", found.lines);
        assert!(found.advice[0].contains("stamped = false"), "{:?}", found.advice);
        let found = cmd_vel(
            |c| c.stamped = super::super::Stamped::Fixed(false),
            vec![reader("rt/cmd_vel", wire::TWIST_STAMPED)],
        );
        assert!(found.advice[0].contains("--unstamped"), "{:?}", found.advice);
    }

    #[test]
    fn quality_of_service_that_cannot_match_is_named() {
        let found = cmd_vel(|c| c.reliable = false, vec![reader("rt/cmd_vel", wire::TWIST_STAMPED)]);
        assert!(found.advice[0].contains("reliable = true"), "{:?}", found.advice);
        let durable = Endpoint { transient_local: true, ..reader("rt/cmd_vel", wire::TWIST_STAMPED) };
        assert!(cmd_vel(|_| {}, vec![durable]).advice[0].contains("volatile"));
    }

    #[test]
    fn a_reader_of_the_type_elsewhere_is_suggested() {
        let there = reader("rt/diff_drive_controller/cmd_vel", wire::TWIST_STAMPED);
        let found = cmd_vel(|_| {}, vec![there]);
        assert!(found.advice[0].contains("/diff_drive_controller/cmd_vel"), "{:?}", found.advice);
        let goals = reader(&wire::send_goal("/gen3/joint_trajectory_controller"), wire::SEND_GOAL);
        let graph = graph(vec![goals]);
        let config = Ros2Config { arm: ArmInterface::Action, ..Ros2Config::default() };
        let found = look_at(&topics(&config, &graph)[2], &graph);
        assert!(found.advice[0].contains("on /gen3/joint_trajectory_controller:"), "{:?}", found.advice);
    }

    #[test]
    fn another_publisher_of_the_speed_is_a_case_for_twist_mux() {
        let mut graph = graph(vec![reader("rt/cmd_vel", wire::TWIST_STAMPED)]);
        graph.writers.push(reader("rt/cmd_vel", wire::TWIST_STAMPED));
        assert!(look_at(&topics(&Ros2Config::default(), &graph)[0], &graph).advice[0].contains("twist_mux"));
    }

    #[test]
    fn a_type_of_one_name_and_another_hash_is_named() {
        let with = |hash: &str| {
            let hash = Some(hash.to_owned());
            let end = Endpoint { type_hash: hash, ..reader("rt/cmd_vel", wire::TWIST_STAMPED) };
            cmd_vel(|_| {}, vec![end]).advice
        };
        assert!(with("RIHS01_00")[0].contains("another geometry_msgs/msg/TwistStamped"));
        assert_eq!(with(hashes::of("geometry_msgs/msg/TwistStamped").unwrap()), [""; 0]);
        assert_eq!(with("INVALID"), [""; 0]);
    }

    #[test]
    fn two_servers_and_two_writers_of_angles_are_named() {
        let server = reader(&wire::send_goal("/joint_trajectory_controller"), wire::SEND_GOAL);
        let mut graph = graph(vec![server.clone(), server]);
        graph.writers = vec![reader("rt/joint_states", wire::JOINT_STATE); 2];
        let config = Ros2Config { arm: ArmInterface::Action, ..Ros2Config::default() };
        let topics = topics(&config, &graph);
        assert!(look_at(&topics[2], &graph).advice[0].contains("2 controllers of one name"));
        assert!(look_at(&topics[3], &graph).advice[0].contains("2 publishers"));
    }

    #[test]
    fn what_was_tried_in_vain_is_named() {
        let server = reader(&wire::send_goal("/joint_trajectory_controller"), wire::SEND_GOAL);
        let mut graph = graph(vec![server]);
        graph.writers.push(reader("rt/joint_states", wire::JOINT_STATE));
        let well = Heard {
            joint_states: 9,
            controller_states: 9,
            difference: Some(Difference { seconds: 0.001, is_simulated: false }),
            probe: Probe::Answered,
            ..Heard::default()
        };
        let config = Ros2Config::default();
        let said = |heard: &Heard, environment: &RosEnvironment| {
            tried(&config, &graph, heard, environment).advice.join("\n")
        };
        let plain = RosEnvironment::default();
        assert_eq!(said(&well, &plain), "");
        assert!(said(&Heard { probe: Probe::Waiting, ..well.clone() }, &plain).contains("does not answer"));
        assert!(said(&Heard { controller_states: 0, ..well.clone() }, &plain).contains("not active"));
        assert!(said(&Heard { joint_states: 0, ..well.clone() }, &plain).contains("no message came"));
        let late = Heard { refusal: Some("30.00 s behind".to_owned()), ..well.clone() };
        assert!(said(&late, &plain).contains("30.00 s behind"));
        let environment = RosEnvironment {
            rmw: Some("rmw_cyclonedds_cpp".to_owned()),
            static_peers: Some("10.0.0.7".to_owned()),
            discovery_server: Some("10.0.0.8:11811".to_owned()),
            ..plain
        };
        let all = said(&well, &environment);
        for word in ["RMW_IMPLEMENTATION = rmw_cyclonedds_cpp", "10.0.0.7", "10.0.0.8:11811"] {
            assert!(all.contains(word), "{word} in {all}");
        }
    }

    #[test]
    fn sockets_tell_other_domains_and_a_zenoh_router() {
        let udp = "  sl  local_address rem_address   st\n   1: 00000000:3BCC 00000000:0000 07\n   \
                   2: 00000000:3BCD 00000000:0000 07\n   3: 00000000:1CF2 00000000:0000 07\n";
        let tcp = "  sl  local_address rem_address   st\n   0: 00000000:1D17 00000000:0000 0A\n";
        // 0x3BCC = 15308 = 7400 + 250 * 31 + 158; 0x1CF2 = 7410 alone; 0x1D17 = 7447.
        let machine = Machine::from_proc(udp, tcp);
        assert_eq!(machine, Machine { domains: BTreeSet::from([31]), zenoh: true });
        let connection = Ros2Config::default().connection(&Default::default()).unwrap();
        let advice = nobody(&connection, &machine).join("\n");
        for word in ["domain 31, not 0", "Zenoh", "multicast"] {
            assert!(advice.contains(word), "{advice}");
        }
    }

    #[test]
    fn names_on_the_wire_read_as_people_write_them() {
        assert_eq!(ros_type(wire::TWIST_STAMPED), "geometry_msgs/msg/TwistStamped");
        assert_eq!(ros_name("rt/cell1/cmd_vel"), "/cell1/cmd_vel");
    }
}
