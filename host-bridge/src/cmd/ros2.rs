//! The ROS 2 side of `run` and `doctor`. Without the feature `ros2` only the word that it is missing.

#[cfg(not(feature = "ros2"))]
pub use off::{Link, doctor};
#[cfg(feature = "ros2")]
pub use on::{Link, doctor};

#[cfg(feature = "ros2")]
mod on {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, SystemTime};

    use anyhow::{Result, bail};
    use host_bridge::bridge::BridgeEvent;
    use host_bridge::links::{Clock, Waiter};
    use host_bridge::live::Live;
    use host_bridge::robot::Robot as _;
    use host_bridge::ros2::advice::{Machine, look_at, nobody, topics};
    use host_bridge::ros2::config::{Connection, RosEnvironment};
    use host_bridge::ros2::diagnostics::Diagnostics;
    use host_bridge::ros2::message::Time;
    use host_bridge::ros2::node::RosNode;
    use host_bridge::ros2::{Counts, Ros2Config};
    use signal_hook::consts::{SIGINT, SIGTERM};

    /// Others are looked for so long before the simulator's state is published.
    const SEARCH: Duration = Duration::from_millis(2500);
    /// Zero and cancellations are sent for so long at the end.
    const FAREWELL_MS: u64 = 300;

    fn connection(config: &Ros2Config) -> Result<Connection> {
        config.connection(&RosEnvironment::read()).map_err(anyhow::Error::msg)
    }

    /// The program's node.
    pub struct Link {
        node: RosNode,
        diagnostics: Diagnostics,
        name: String,
        about: String,
        interrupted: Arc<AtomicBool>,
    }

    impl Link {
        /// Joins the graph.
        pub fn open(config: &Ros2Config, publish_sim: bool) -> Result<Self> {
            let connection = connection(config)?;
            let node = RosNode::open(config, &connection, publish_sim)?;
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
            let interrupted = Arc::new(AtomicBool::new(false));
            for signal in [SIGINT, SIGTERM] {
                signal_hook::flag::register(signal, Arc::clone(&interrupted))?;
            }
            let about = format!(
                "ROS 2 domain {} ({}), {}",
                connection.domain_id,
                connection.domain_from,
                config.resolve(&config.cmd_vel)
            );
            Ok(Link {
                node,
                diagnostics: Diagnostics::default(),
                name: config.node.clone(),
                about,
                interrupted,
            })
        }

        /// For the title.
        pub fn about(&self) -> String {
            self.about.clone()
        }

        /// Ctrl-C or an order to end: zero is to be sent first.
        pub fn interrupted(&self) -> bool {
            self.interrupted.load(Ordering::Relaxed)
        }

        /// Takes what came in; what a person should know.
        pub fn receive(&mut self, live: &mut Live, now_ms: u64) -> Vec<String> {
            live.ros_mut().map(|robot| self.node.receive(robot, now_ms)).unwrap_or_default()
        }

        /// Sends what was decided since `woken`.
        pub fn send(&mut self, live: &mut Live, events: &[BridgeEvent], now_ms: u64, woken: SystemTime) {
            let stamp = Time::at(woken);
            if let Some(robot) = live.ros_mut() {
                self.node.send(robot, stamp);
            }
            for event in events {
                self.diagnostics.note(event);
            }
            if let Some(message) = self.diagnostics.take(&self.name, live.bridge(), now_ms, stamp) {
                self.node.diagnose(message);
            }
            self.node.publish_sim(live.robot(), now_ms, stamp);
        }

        /// Stops the robot and says good-bye.
        pub fn end(mut self, live: &mut Live, clock: &dyn Clock, waiter: &Waiter) -> Counts {
            let Some(robot) = live.ros_mut() else { return self.node.counts() };
            robot.at(clock.now_ms());
            robot.halt();
            let until_ms = clock.now_ms() + FAREWELL_MS;
            while clock.now_ms() < until_ms {
                let now_ms = clock.now_ms();
                self.node.receive(robot, now_ms);
                robot.step(now_ms);
                self.node.send(robot, Time::at(SystemTime::now()));
                waiter.sleep(Duration::from_millis(5));
            }
            self.node.counts()
        }
    }

    /// Looks at the graph for a while; is all well?
    pub fn doctor(config: &Ros2Config, seconds: f64) -> Result<bool> {
        let connection = connection(config)?;
        let node = RosNode::open(config, &connection, false)?;
        std::thread::sleep(Duration::from_secs_f64(seconds));
        let graph = node.graph();
        println!("\nROS 2: domain {} (from {})", connection.domain_id, connection.domain_from);
        let interfaces: Vec<String> = connection.interfaces.iter().map(ToString::to_string).collect();
        println!(
            "  interfaces: {}",
            if interfaces.is_empty() { "all".to_owned() } else { interfaces.join(", ") }
        );
        println!(
            "  goals as {} has them; {} other participant{}",
            if connection.cyclone_services { "rmw_cyclonedds_cpp" } else { "rmw_fastrtps_cpp" },
            graph.participants.len(),
            if graph.participants.len() == 1 { "" } else { "s" }
        );
        let mut advice = Vec::new();
        for topic in topics(config) {
            let found = look_at(&topic, &graph);
            for line in found.lines {
                println!("  {line}");
            }
            advice.extend(found.advice);
        }
        if graph.participants.is_empty() {
            // What our own sockets say would mislead: they go first.
            drop(node);
            let read = |file| std::fs::read_to_string(file).unwrap_or_default();
            let udp = read("/proc/net/udp") + &read("/proc/net/udp6");
            let tcp = read("/proc/net/tcp") + &read("/proc/net/tcp6");
            advice.push("nobody else is in this domain".to_owned());
            advice.extend(nobody(&connection, &Machine::from_proc(&udp, &tcp)));
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
    use std::convert::Infallible;
    use std::time::SystemTime;

    use anyhow::{Result, bail};
    use host_bridge::bridge::BridgeEvent;
    use host_bridge::links::{Clock, Waiter};
    use host_bridge::live::Live;
    use host_bridge::ros2::{Counts, Ros2Config};

    const MISSING: &str = "this program was built without ROS 2: `cargo install --path host-bridge --features \
                           ros2`, or `cargo run --release --features ros2 -- …`";

    /// No node.
    pub struct Link(Infallible);

    impl Link {
        /// Says what is missing.
        pub fn open(_: &Ros2Config, _: bool) -> Result<Self> {
            bail!(MISSING)
        }

        /// Never called.
        pub fn about(&self) -> String {
            match self.0 {}
        }

        /// Never called.
        pub fn interrupted(&self) -> bool {
            match self.0 {}
        }

        /// Never called.
        pub fn receive(&mut self, _: &mut Live, _: u64) -> Vec<String> {
            match self.0 {}
        }

        /// Never called.
        pub fn send(&mut self, _: &mut Live, _: &[BridgeEvent], _: u64, _: SystemTime) {
            match self.0 {}
        }

        /// Never called.
        pub fn end(self, _: &mut Live, _: &dyn Clock, _: &Waiter) -> Counts {
            match self.0 {}
        }
    }

    /// Says what is missing.
    pub fn doctor(_: &Ros2Config, _: f64) -> Result<bool> {
        bail!(MISSING)
    }
}
