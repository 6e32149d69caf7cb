//! The section `[ros2]` of the configuration: names, frames, quality of service, and times.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};

use super::clocks::Stamp;
use super::sightings::Watched;
use host_robot::JOINTS;
use host_topics::messages::ARM_PREFIX;

/// The interface for arm motions. Only one interface is used at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ArmInterface {
    /// Sends short pieces to the controller's topic.
    /// Each piece ends at rest, so the arm stops if the program dies.
    #[default]
    Stream,
    /// Sends complete `FollowJointTrajectory` goals with feedback. A stop cancels the goal.
    /// **No third stop**: if the program dies, the arm finishes its goal.
    Action,
    /// Sends complete `JointTrajectory` messages. A stop sends a braking trajectory.
    /// **No third stop** either.
    Topic,
    /// Not at all.
    None,
}

/// The middleware that carries the node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Carrier {
    /// DDS, compatible with rmw_fastrtps and rmw_cyclonedds.
    #[default]
    Dds,
    /// Zenoh, compatible with rmw_zenoh (feature `zenoh`).
    Zenoh,
}

/// Whether speeds are stamped: `true`, `false` or `"auto"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Stamped {
    /// As said.
    Fixed(bool),
    /// Use the type that the subscriber requires.
    Open(Auto),
}

/// The word `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Auto {
    /// `auto`
    Auto,
}

impl Stamped {
    /// Use the type that the subscriber requires.
    pub const AUTO: Stamped = Stamped::Open(Auto::Auto);

    /// Returns the setting, or `None` if the subscriber decides.
    pub fn fixed(self) -> Option<bool> {
        match self {
            Stamped::Fixed(stamped) => Some(stamped),
            Stamped::Open(Auto::Auto) => None,
        }
    }
}

/// The arm of ros2_kortex has joint_1 to joint_7.
const GEN3_JOINTS: usize = 7;

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2Config {
    /// Name of the node.
    pub node: String,
    /// Namespace of this operator and robot, such as `/cell1`; empty if there is none.
    pub namespace: String,
    /// DDS domain from 0 to 232; -1 selects `ROS_DOMAIN_ID`, or 0 if that is not set.
    pub domain_id: i32,
    /// What carries it.
    pub transport: Carrier,
    /// Zenoh's routers, such as `tcp/localhost:7447`.
    pub zenoh_connect: Vec<String>,
    /// Zenoh's own configuration file, which overrides `zenoh_connect`.
    /// If it is empty, `ZENOH_SESSION_CONFIG_URI` is used, or no file.
    pub zenoh_config: String,
    /// Addresses of the network interfaces to use.
    /// An empty list means all interfaces, unless an environment variable restricts them:
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` and `ROS_LOCALHOST_ONLY=1` count as `["127.0.0.1"]`.
    pub interfaces: Vec<IpAddr>,
    /// Type of speeds: `TwistStamped` (true), `Twist` (false), or `"auto"`.
    /// Jazzy's diff_drive_controller needs true.
    /// The value `"auto"` follows the subscriber.
    pub stamped: Stamped,
    /// The stamps that speeds get.
    pub stamp: Stamp,
    /// Topic of the base's speed. Names without a leading slash are relative to the namespace.
    pub cmd_vel: String,
    /// Rate of speed commands while driving or stopping.
    pub rate_hz: u32,
    /// Duration for which zero is repeated after a stop. Afterwards, the topic is silent.
    pub stop_ms: u64,
    /// Maximum age of speeds in middleware that supports it (Fast DDS); 0 means unlimited.
    pub lifespan_ms: u64,
    /// Number of messages that a topic stores for slow subscribers.
    pub depth: u32,
    /// Whether lost messages are sent again. A best-effort writer does not match a reliable reader.
    pub reliable: bool,
    /// The interface for arm motions.
    pub arm: ArmInterface,
    /// The arm's controller.
    pub arm_controller: String,
    /// The arm's joints in order from its foot, with the names that the robot uses: one to eight.
    pub joint_names: Vec<String>,
    /// Topic on which the arm's angles are read (or, with `--publish-sim`, written).
    pub joint_states: String,
    /// Maximum age of angles for planning.
    pub joint_states_max_age_ms: u64,
    /// Time after which a goal without an answer is abandoned and cancelled.
    pub answer_ms: u64,
    /// The gripper's action, such as `gripper_controller/gripper_cmd`.
    /// The type of this action is GripperCommand or ParallelGripperCommand.
    /// `"auto"` selects the only action whose name ends in `gripper_cmd`; empty means none.
    pub gripper: String,
    /// Name of the gripper's joint in the joint states; empty if it is not reported.
    pub gripper_joint: String,
    /// Position of the joint when the gripper is open.
    pub gripper_open: f64,
    /// Position of the joint when the gripper is closed.
    pub gripper_closed: f64,
    /// Distance between the open fingers in m.
    pub gripper_width_m: f64,
    /// A gripper that sends no report for this long counts as failed.
    pub gripper_timeout_ms: u64,
    /// Topic of an external e-stop (`std_msgs/Bool`), whose publisher should latch it.
    /// The value true stops base and arm, like a lock in twist_mux.
    /// A missing publisher also stops them. An empty name means that there is no e-stop.
    pub estop: String,
    /// An e-stop that is silent for this long counts as a stop. 0 means that its last message remains valid.
    pub estop_timeout_ms: u64,
    /// Topic of a driver's fault flag, which is treated as an e-stop. For ros2_kortex:
    /// `/fault_controller/internal_fault`.
    pub fault: String,
    /// As `estop_timeout_ms`.
    pub fault_timeout_ms: u64,
    /// Topic that reports this program's stop (true = stopped), in the form of twist_mux's locks.
    pub stopped: String,
    /// Topic of the base's odometry. The stamps of the odometry are compared with this machine's clock.
    /// With `--publish-sim`, the simulator publishes its odometry on this topic.
    pub odom: String,
    /// Transforms of the simulator, if `--publish-sim` is given.
    pub tf: String,
    /// Gestures and states of the hands.
    pub diagnostics: String,
    /// Frame of the odometry.
    pub odom_frame: String,
    /// Frame of the base, and of its speed.
    pub base_frame: String,
    /// Frame of the arm's base. Empty means `arm_prefix` plus the link's name in the arm's own description.
    pub arm_base_frame: String,
    /// Prefix of the arm's link names, like `prefix` in ros2_kortex's description.
    pub arm_prefix: String,
    /// Topic of the simulator's URDF, with `--publish-sim`. Empty means that the URDF is not published.
    pub robot_description: String,
    /// The topics and frames that the motions need. They do not come from the configuration file.
    #[serde(skip)]
    pub watched: Watched,
}

impl Default for Ros2Config {
    fn default() -> Self {
        let text = str::to_owned;
        Ros2Config {
            node: text("bimanual"),
            namespace: String::new(),
            domain_id: -1,
            transport: Carrier::Dds,
            zenoh_connect: vec![text("tcp/localhost:7447")],
            zenoh_config: String::new(),
            interfaces: Vec::new(),
            stamped: Stamped::AUTO,
            stamp: Stamp::Zero,
            cmd_vel: text("cmd_vel"),
            rate_hz: 50,
            stop_ms: 1000,
            lifespan_ms: 500,
            depth: 10,
            reliable: true,
            arm: ArmInterface::Stream,
            arm_controller: text("joint_trajectory_controller"),
            joint_names: (1..=GEN3_JOINTS).map(|i| format!("joint_{i}")).collect(),
            joint_states: text("joint_states"),
            joint_states_max_age_ms: 500,
            answer_ms: 1000,
            gripper: text("auto"),
            gripper_joint: String::new(),
            gripper_open: 0.0,
            gripper_closed: 0.8,
            gripper_width_m: 0.085,
            gripper_timeout_ms: 5000,
            estop: String::new(),
            estop_timeout_ms: 0,
            fault: String::new(),
            fault_timeout_ms: 0,
            stopped: text("bimanual/stopped"),
            odom: text("odom"),
            tf: text("/tf"),
            diagnostics: text("/diagnostics"),
            odom_frame: text("odom"),
            base_frame: text("base_link"),
            arm_base_frame: String::new(),
            arm_prefix: text(ARM_PREFIX),
            robot_description: text("robot_description"),
            watched: Watched::default(),
        }
    }
}

/// The environment's settings, read at the start of the program.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosEnvironment {
    /// `ROS_DOMAIN_ID`.
    pub domain_id: Option<String>,
    /// `RMW_IMPLEMENTATION`.
    pub rmw: Option<String>,
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE`.
    pub discovery_range: Option<String>,
    /// `ROS_LOCALHOST_ONLY`.
    pub localhost_only: Option<String>,
    /// `ROS_STATIC_PEERS`.
    pub static_peers: Option<String>,
    /// `ROS_DISCOVERY_SERVER`.
    pub discovery_server: Option<String>,
    /// `ZENOH_SESSION_CONFIG_URI`.
    pub zenoh_config: Option<String>,
}

impl RosEnvironment {
    /// Reads the environment of this process.
    pub fn read() -> Self {
        let get = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        RosEnvironment {
            domain_id: get("ROS_DOMAIN_ID"),
            rmw: get("RMW_IMPLEMENTATION"),
            discovery_range: get("ROS_AUTOMATIC_DISCOVERY_RANGE"),
            localhost_only: get("ROS_LOCALHOST_ONLY"),
            static_peers: get("ROS_STATIC_PEERS"),
            discovery_server: get("ROS_DISCOVERY_SERVER"),
            zenoh_config: get("ZENOH_SESSION_CONFIG_URI"),
        }
    }
}

/// The way to connect, after all settings were combined.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// DDS domain.
    pub domain_id: u16,
    /// The origin of this setting.
    pub domain_from: &'static str,
    /// Addresses of the interfaces; empty means all.
    pub interfaces: Vec<IpAddr>,
    /// Zenoh's own configuration file.
    pub zenoh_config: Option<String>,
}

impl Connection {
    /// Returns whether only this machine can be reached.
    pub fn is_loopback_only(&self) -> bool {
        !self.interfaces.is_empty() && self.interfaces.iter().all(IpAddr::is_loopback)
    }
}

/// The largest domain with valid ports.
const DOMAIN_MAX: i32 = 232;

impl Ros2Config {
    /// Checks whether all values are valid.
    ///
    /// # Errors
    /// Returns the invalid value, and the valid ones.
    pub fn check(&self) -> Result<(), String> {
        let ensure = |sound: bool, what: &str| if sound { Ok(()) } else { Err(format!("ros2: {what}")) };
        ensure(is_name(&self.node), "node is letters, digits and underscores, not starting with a digit")?;
        ensure(
            self.namespace.is_empty() || self.namespace.starts_with('/') && are_names(&self.namespace[1..]),
            "namespace is empty or like \"/cell1\"",
        )?;
        ensure((-1..=DOMAIN_MAX).contains(&self.domain_id), "domain_id lies between 0 and 232, or is -1")?;
        let topics = [
            ("cmd_vel", &self.cmd_vel),
            ("arm_controller", &self.arm_controller),
            ("joint_states", &self.joint_states),
            ("odom", &self.odom),
            ("tf", &self.tf),
            ("diagnostics", &self.diagnostics),
            ("stopped", &self.stopped),
        ];
        let named = [
            ("estop", &self.estop),
            ("fault", &self.fault),
            ("robot_description", &self.robot_description),
            ("gripper", &self.gripper),
        ];
        for (key, name) in topics.into_iter().chain(named.into_iter().filter(|(_, name)| !name.is_empty())) {
            ensure(
                are_names(name.strip_prefix('/').unwrap_or(name)),
                &format!("{key} = \"{name}\" is no name; names are like \"cmd_vel\" or \"/robot/cmd_vel\""),
            )?;
        }
        ensure(
            [&self.estop, &self.fault].iter().all(|name| self.resolve(name) != self.resolve(&self.stopped)),
            "estop and fault are what others say: this program's own stop goes out on stopped, and is not read",
        )?;
        ensure(
            [self.estop_timeout_ms, self.fault_timeout_ms]
                .iter()
                .all(|ms| *ms == 0 || (50..=60_000).contains(ms)),
            "estop_timeout_ms and fault_timeout_ms are 0, or lie between 50 and 60000",
        )?;
        ensure((5..=50).contains(&self.rate_hz), "rate_hz lies between 5 and 50: robots stop after 0.5 s")?;
        ensure((100..=60_000).contains(&self.stop_ms), "stop_ms lies between 100 and 60000")?;
        ensure(
            self.lifespan_ms == 0 || (100..=5000).contains(&self.lifespan_ms),
            "lifespan_ms is 0 or lies between 100 and 5000",
        )?;
        ensure((1..=100).contains(&self.depth), "depth lies between 1 and 100")?;
        ensure(
            (50..=5000).contains(&self.joint_states_max_age_ms) && (100..=10_000).contains(&self.answer_ms),
            "joint_states_max_age_ms lies between 50 and 5000, answer_ms between 100 and 10000",
        )?;
        ensure(
            self.gripper_open.is_finite()
                && self.gripper_closed.is_finite()
                && self.gripper_open != self.gripper_closed
                && (0.001..=1.0).contains(&self.gripper_width_m)
                && (500..=60_000).contains(&self.gripper_timeout_ms),
            "gripper_open and gripper_closed are two positions, gripper_width_m lies between 0.001 and 1, \
             gripper_timeout_ms between 500 and 60000",
        )?;
        ensure(
            !self.zenoh_connect.is_empty() && self.zenoh_connect.iter().all(|at| at.contains('/')),
            "zenoh_connect has routers such as \"tcp/localhost:7447\"",
        )?;
        let mut names = self.joint_names.clone();
        names.sort();
        names.dedup();
        ensure(
            (1..=JOINTS).contains(&names.len())
                && names.len() == self.joint_names.len()
                && !names.contains(&String::new()),
            "joint_names are one to eight different names",
        )?;
        ensure(
            !self.odom_frame.is_empty() && !self.base_frame.is_empty() && self.odom_frame != self.base_frame,
            "odom_frame and base_frame are two different names",
        )
    }

    /// A name with its namespace.
    pub fn resolve(&self, name: &str) -> String {
        if name.starts_with('/') { name.to_owned() } else { format!("{}/{name}", self.namespace) }
    }

    /// Combines this configuration with the environment.
    ///
    /// # Errors
    /// Returns the setting of the environment that cannot be used, with a remedy.
    pub fn connection(&self, environment: &RosEnvironment) -> Result<Connection, String> {
        let (domain, domain_from) = match (self.domain_id, &environment.domain_id) {
            (0.., _) => (self.domain_id, "the configuration"),
            (_, Some(text)) => match text.trim().parse() {
                Ok(domain) if (0..=DOMAIN_MAX).contains(&domain) => (domain, "ROS_DOMAIN_ID"),
                _ => return Err(format!("ROS_DOMAIN_ID = '{text}' is no domain; choose one from 0 to 232")),
            },
            (_, None) => (0, "ROS's default"),
        };
        let local = match environment.discovery_range.as_deref() {
            Some("OFF") => {
                return Err(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes find nobody, and neither may this one; \
                            `unset ROS_AUTOMATIC_DISCOVERY_RANGE`, or LOCALHOST or SUBNET"
                        .to_owned(),
                );
            }
            Some("LOCALHOST") => true,
            None | Some("SUBNET" | "SYSTEM_DEFAULT") => environment.localhost_only.as_deref() == Some("1"),
            Some(other) => {
                return Err(format!(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE = '{other}' is none of SUBNET, LOCALHOST, OFF and SYSTEM_DEFAULT"
                ));
            }
        };
        let interfaces = if self.interfaces.is_empty() && local {
            vec![IpAddr::V4(Ipv4Addr::LOCALHOST)]
        } else {
            self.interfaces.clone()
        };
        if self.transport == Carrier::Dds
            && let Some(zenoh) = environment.rmw.as_deref().filter(|rmw| rmw.contains("zenoh"))
        {
            return Err(format!(
                "RMW_IMPLEMENTATION = {zenoh}, but the bridge speaks DDS as configured: set transport = \"zenoh\" in [ros2], or run \
                 the robot with rmw_cyclonedds_cpp or rmw_fastrtps_cpp"
            ));
        }
        let file = Some(&self.zenoh_config).filter(|file| !file.is_empty());
        let zenoh_config = file.or(environment.zenoh_config.as_ref()).cloned();
        // `check` and the match above keep the value within 0 to 232.
        let domain_id = u16::try_from(domain).unwrap_or(0);
        Ok(Connection { domain_id, domain_from, interfaces, zenoh_config })
    }
}

/// Returns whether this is a valid part of a ROS 2 name.
fn is_name(name: &str) -> bool {
    let starts = name.chars().next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
    starts && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !name.contains("__")
}

/// Returns whether these are valid parts with slashes between them.
fn are_names(names: &str) -> bool {
    names.split('/').all(is_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_the_namespace_unless_they_start_with_a_slash() {
        let config = Ros2Config { namespace: "/cell1".to_owned(), ..Ros2Config::default() };
        assert_eq!(config.resolve("cmd_vel"), "/cell1/cmd_vel");
        assert_eq!(config.resolve("/tf"), "/tf");
        assert_eq!(Ros2Config::default().resolve("cmd_vel"), "/cmd_vel");
    }

    #[test]
    fn zenohs_own_file_is_the_configured_one_or_the_environments_and_dds_refuses_a_zenoh_robot() {
        let environment = RosEnvironment {
            rmw: Some("rmw_zenoh_cpp".to_owned()),
            zenoh_config: Some("theirs.json5".to_owned()),
            ..RosEnvironment::default()
        };
        let mut config = Ros2Config { transport: Carrier::Zenoh, ..Ros2Config::default() };
        let file = |config: &Ros2Config| config.connection(&environment).unwrap().zenoh_config;
        assert_eq!(file(&config).as_deref(), Some("theirs.json5"));
        config.zenoh_config = "ours.json5".to_owned();
        assert_eq!(file(&config).as_deref(), Some("ours.json5"));
        config.transport = Carrier::Dds;
        let error = config.connection(&environment).unwrap_err();
        assert!(error.contains("transport = \"zenoh\""), "{error}");
    }

    #[test]
    fn bad_values_are_named() {
        let bad = |change: fn(&mut Ros2Config)| {
            let mut config = Ros2Config::default();
            change(&mut config);
            config.check().unwrap_err()
        };
        assert!(Ros2Config::default().check().is_ok());
        assert!(bad(|c| c.namespace = "cell1".to_owned()).contains("namespace"));
        assert!(bad(|c| c.cmd_vel = "cmd vel".to_owned()).contains("cmd_vel"));
        assert!(bad(|c| c.tf = "//tf".to_owned()).contains("tf"));
        assert!(bad(|c| c.rate_hz = 1).contains("0.5 s"));
        assert!(bad(|c| c.domain_id = 300).contains("domain_id"));
        assert!(bad(|c| c.joint_names[0] = "joint_2".to_owned()).contains("eight different"));
        assert!(bad(|c| c.joint_names.clear()).contains("eight different"));
        assert!(
            bad(|c| c.joint_names.extend(["joint_8", "joint_9"].map(str::to_owned)))
                .contains("eight different")
        );
        assert!(bad(|c| c.estop = "e stop".to_owned()).contains("estop"));
        assert!(bad(|c| c.estop = "/bimanual/stopped".to_owned()).contains("own stop"));
        assert!(bad(|c| c.fault_timeout_ms = 5).contains("fault_timeout_ms"));
        assert!(bad(|c| c.zenoh_connect = vec!["localhost".to_owned()]).contains("zenoh_connect"));
        assert!(bad(|c| c.node = "7up".to_owned()).contains("node"));
    }

    #[test]
    fn the_configuration_goes_before_the_environment_and_that_before_the_default() {
        let environment = RosEnvironment {
            domain_id: Some("42".to_owned()),
            rmw: Some("rmw_fastrtps_cpp".to_owned()),
            discovery_range: Some("LOCALHOST".to_owned()),
            ..RosEnvironment::default()
        };
        let mut config = Ros2Config::default();
        let default = config.connection(&RosEnvironment::default()).unwrap();
        assert_eq!(default.domain_id, 0);
        assert!(default.interfaces.is_empty());
        let from_environment = config.connection(&environment).unwrap();
        assert_eq!(from_environment.domain_id, 42);
        assert!(from_environment.is_loopback_only());
        assert_eq!(from_environment.interfaces, [IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        config.domain_id = 7;
        config.interfaces = vec!["10.0.0.2".parse().unwrap()];
        let own = config.connection(&environment).unwrap();
        assert_eq!((own.domain_id, own.is_loopback_only()), (7, false));
        assert_eq!(own.interfaces, config.interfaces);
    }

    #[test]
    fn zenoh_and_a_broken_domain_are_errors_that_say_what_to_do() {
        let config = Ros2Config::default();
        let with = |domain_id: Option<&str>, rmw: Option<&str>| {
            let text = |t: &str| t.to_owned();
            let environment = RosEnvironment {
                domain_id: domain_id.map(text),
                rmw: rmw.map(text),
                ..RosEnvironment::default()
            };
            config.connection(&environment).unwrap_err()
        };
        assert!(with(None, Some("rmw_zenoh_cpp")).contains("set transport = \"zenoh\""));
        assert!(with(Some("abc"), None).contains("0 to 232"));
        assert!(with(Some("233"), None).contains("0 to 232"));
        for (range, says) in [("OFF", "nodes find nobody"), ("EVERYWHERE", "none of SUBNET")] {
            let environment =
                RosEnvironment { discovery_range: Some(range.to_owned()), ..RosEnvironment::default() };
            assert!(config.connection(&environment).unwrap_err().contains(says));
        }
    }
}
