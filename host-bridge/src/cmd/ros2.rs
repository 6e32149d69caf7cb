//! The ROS 2 part of `run` and `doctor`. Without the feature `ros2`, it only reports that the feature is missing.

#[cfg(not(feature = "ros2"))]
pub use off::{Graph, Output, doctor};
#[cfg(all(feature = "ros2", feature = "urdf"))]
pub use on::look;
#[cfg(feature = "ros2")]
pub use on::{Graph, Output, doctor};

/// After a halt, the graph is served for this long, so that zero speeds and cancellations arrive.
pub const FAREWELL_MS: u64 = 300;

#[cfg(feature = "ros2")]
mod on {
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

    use anyhow::{Result, bail};
    use host_bridge::base::BaseConfig;
    use host_bridge::observe::{Now, Observer, SessionEvent};
    use host_bridge::robot::{JointLimits, RobotSetting};
    use host_bridge::ros2::advice::{
        Heard, Machine, look_at, nobody, nobody_on_zenoh, topics, tried, variables,
    };
    use host_bridge::ros2::config::{Carrier, Connection, RosEnvironment};
    use host_bridge::ros2::driver::RosDriver;
    #[cfg(feature = "urdf")]
    use host_bridge::ros2::look::{self, Found};
    use host_bridge::ros2::node::RosNode;
    use host_bridge::ros2::publisher::{RosPublisher, Simulator};
    use host_bridge::ros2::{ArmInterface, Counts, Ros2Config, RosRobot};
    use host_bridge::safety::State;
    use host_bridge::topics::diagnostics::Diagnostics;
    use host_bridge::topics::message::Time;

    /// Duration of the search for other publishers, before the simulator's state is published.
    const SEARCH: Duration = Duration::from_millis(2500);

    /// A description that is published once arrives within this time after joining, and controllers are discovered.
    #[cfg(feature = "urdf")]
    const LOOK: Duration = Duration::from_secs(10);

    /// Current time in seconds since 1970.
    fn wall_s() -> f64 {
        SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
    }

    /// Data about the robot on the graph. It is read before the robot is driven.
    /// If `wanted` names a controller, the graph is read until it is there.
    #[cfg(feature = "urdf")]
    pub fn look(config: &Ros2Config, wanted: Option<&str>) -> Result<Found> {
        Ok(look::look(config, &connection(config)?, wanted, LOOK)?)
    }

    fn connection(config: &Ros2Config) -> Result<Connection> {
        config.connection(&RosEnvironment::read()).map_err(anyhow::Error::msg)
    }

    /// The program's connection to the graph: a robot, and additional topics.
    pub struct Graph {
        /// The robot that is driven.
        pub driver: RosDriver,
        /// The observer for the tap.
        pub output: Output,
        /// Text for the title.
        pub about: String,
        /// Counters of sent and received messages.
        pub counts: Arc<Mutex<Counts>>,
    }

    impl Graph {
        /// Joins the graph.
        pub fn open(
            config: &Ros2Config,
            limits: JointLimits,
            base: BaseConfig,
            simulator: Option<&RobotSetting>,
        ) -> Result<Self> {
            let connection = connection(config)?;
            let publish_sim = simulator.is_some();
            let simulator = simulator.map(|setting| Simulator::new(config, setting)).transpose();
            let simulator = simulator.map_err(anyhow::Error::msg)?;
            let (mut node, publisher) = RosNode::open(config, &connection, simulator)?;
            if publish_sim {
                std::thread::sleep(SEARCH);
                let rivals = node.rivals();
                if !rivals.is_empty() {
                    bail!(
                        "--publish-sim: somebody else publishes {}; a robot is there. Run without it to drive \
                         that robot, or choose another namespace or domain in [ros2]",
                        rivals.join(", ")
                    );
                }
            }
            let about = format!(
                "ROS 2{} domain {} ({}), {}",
                if config.transport == Carrier::Zenoh { " over Zenoh," } else { "" },
                connection.domain_id,
                connection.domain_from,
                config.resolve(&config.cmd_vel)
            );
            let driver = RosDriver::new(node, RosRobot::new(config, limits, base));
            let counts = driver.counts();
            let output = Output {
                publisher,
                diagnostics: Diagnostics::default(),
                name: config.node.clone(),
                publish_sim,
            };
            Ok(Graph { driver, output, about, counts })
        }
    }

    /// Publishes diagnostics, and also the simulator's state if the simulator is the robot.
    pub struct Output {
        publisher: RosPublisher,
        diagnostics: Diagnostics,
        name: String,
        publish_sim: bool,
    }

    impl Observer for Output {
        fn happened(&mut self, event: &SessionEvent) {
            if let SessionEvent::Bridge(event) = event {
                self.diagnostics.note(event);
            }
        }

        fn state(&mut self, now: &Now<'_>) {
            let stamp = Time::at(SystemTime::now());
            if let Some(message) = self.diagnostics.take(&self.name, now.bridge, now.time_ms, stamp) {
                self.publisher.diagnose(message);
            }
            self.publisher.say_stopped(now.bridge.safety().state() == State::Stopped, now.time_ms);
            if self.publish_sim {
                self.publisher.publish_sim(now.robot, now.time_ms, stamp);
            }
        }
    }

    /// Examines the graph for some time with harmless requests. Returns whether it found no problems.
    pub fn doctor(config: &Ros2Config, seconds: f64) -> Result<bool> {
        let environment = RosEnvironment::read();
        let connection = match connection(config) {
            Ok(connection) => connection,
            Err(why) => {
                println!("\nROS 2\n  → {why}");
                return Ok(false);
            }
        };
        // Only the controller's action can be queried, whichever interface the arm uses.
        let arm = match config.arm {
            ArmInterface::None => ArmInterface::None,
            _ => ArmInterface::Action,
        };
        let asking = Ros2Config { arm, ..config.clone() };
        let (mut node, publisher) = RosNode::open(&asking, &connection, None)?;
        let start = Instant::now();
        let mut heard = Heard::default();
        while start.elapsed().as_secs_f64() < seconds {
            std::thread::sleep(Duration::from_millis(10));
            heard = node.examine(wall_s(), start.elapsed().as_millis() as u64);
        }
        let graph = node.graph();
        println!("\nROS 2: domain {} (from {})", connection.domain_id, connection.domain_from);
        let interfaces: Vec<String> = connection.interfaces.iter().map(ToString::to_string).collect();
        match (config.transport, &connection.zenoh_config) {
            (Carrier::Zenoh, Some(file)) => println!("  over Zenoh, as {file} has it"),
            (Carrier::Zenoh, None) => println!("  over Zenoh, by {}", config.zenoh_connect.join(", ")),
            (Carrier::Dds, _) if interfaces.is_empty() => println!("  interfaces: all"),
            (Carrier::Dds, _) => println!("  interfaces: {}", interfaces.join(", ")),
        }
        for (id, other) in &graph.participants {
            let name = other.name.as_deref().filter(|name| !name.is_empty());
            let name = name.map(|name| format!(" \"{name}\"")).unwrap_or_default();
            let version = Some(&other.version).filter(|version| !version.is_empty());
            let version = version.map(|version| format!(", protocol {version}")).unwrap_or_default();
            println!("  participant {id}: {}{version}{name}", other.vendor);
        }
        let mut advice = Vec::new();
        for topic in topics(config, &graph) {
            let found = look_at(&topic, &graph);
            for line in found.lines {
                println!("  {line}");
            }
            advice.extend(found.advice);
        }
        if graph.participants.is_empty() && config.transport == Carrier::Zenoh {
            advice.push("nobody else is in this domain".to_owned());
            advice.extend(nobody_on_zenoh(&connection));
        } else if graph.participants.is_empty() {
            // Our own sockets would distort the result, so they are closed first.
            drop((node, publisher));
            let read = |file| std::fs::read_to_string(file).unwrap_or_default();
            let udp = read("/proc/net/udp") + &read("/proc/net/udp6");
            let tcp = read("/proc/net/tcp") + &read("/proc/net/tcp6");
            advice.push("nobody else is in this domain".to_owned());
            advice.extend(nobody(&connection, &Machine::from_proc(&udp, &tcp)));
            advice.extend(variables(&environment));
        } else {
            let found = tried(config, &graph, &heard, &environment);
            for line in found.lines {
                println!("  {line}");
            }
            advice.extend(found.advice);
        }
        for line in &advice {
            println!("  → {line}");
        }
        if advice.is_empty() {
            println!("  all is well");
        }
        Ok(advice.is_empty())
    }
}

#[cfg(not(feature = "ros2"))]
mod off {
    use std::sync::{Arc, Mutex};

    use anyhow::{Result, bail};
    use host_bridge::base::BaseConfig;
    use host_bridge::observe::Observer;
    use host_bridge::robot::{JointLimits, Robot, RobotSetting};
    use host_bridge::ros2::{Counts, Ros2Config};

    const MISSING: &str = "this program was built without ROS 2: `cargo install --path host-bridge --features \
                           ros2`, or `cargo run --release --features ros2 -- …`";

    /// Without a graph, no value of this type exists.
    pub struct Graph {
        /// The robot that is driven.
        pub driver: Box<dyn Robot + Send>,
        /// The observer for the tap.
        pub output: Output,
        /// Text for the title.
        pub about: String,
        /// Counters of sent and received messages.
        pub counts: Arc<Mutex<Counts>>,
    }

    /// Does nothing without the feature.
    pub struct Output;

    impl Observer for Output {}

    impl Graph {
        /// Reports that the feature is missing.
        pub fn open(_: &Ros2Config, _: JointLimits, _: BaseConfig, _: Option<&RobotSetting>) -> Result<Self> {
            bail!(MISSING)
        }
    }

    /// Reports that the feature is missing.
    pub fn doctor(_: &Ros2Config, _: f64) -> Result<bool> {
        bail!(MISSING)
    }
}
