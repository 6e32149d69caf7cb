//! A robot on the ROS 2 graph for tests: `tests/ros2/peer.py` (Cyclone DDS) or `rclpy_peer.py` (Fast DDS).
//! The robot and the program under test share their own network.
//!
//! DDS and the robot use wall-clock time, and delays are measured in wall-clock time.
//! Boards and program share a time that is never faster than the wall clock. It is slower on a busy machine.
//! Tests therefore wait for events, and judge delays only on a quiet machine.
//!
//! A test that includes this module must define `host_bridge()`, the program's path, and the modules of `desk`.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::Value;

use super::host_bridge;
use super::port::alone as starting;
use super::program::Desk;
use super::time::{Process, Time};

/// Limit in wall-clock time, so that a test cannot hang forever.
const PATIENCE: Duration = Duration::from_secs(240);

/// Lock for tests that measure time, so that they do not disturb each other.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns whether this is the long run (`cargo xtask test --full`).
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// Returns the time in seconds since 1970, as in the robot's stamps.
pub fn wall_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Returns a domain id that other programs on this machine are unlikely to use.
pub fn domain() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    20 + (std::process::id() * 7 + NEXT.fetch_add(1, Ordering::Relaxed)) % 80
}

/// A program that prints one JSON object per line.
pub struct Teller {
    what: &'static str,
    time: Time,
    /// The running process.
    pub process: Rc<Process>,
    orders: Option<ChildStdin>,
    lines: Receiver<(f64, Value)>,
    /// All lines with the times at which they were read.
    pub seen: Vec<(f64, Value)>,
    errors: Receiver<String>,
}

/// Starts such a program. Error messages use the name `what`.
fn start(
    what: &'static str,
    time: &Time,
    command: &mut Command,
    spawn: impl FnOnce(&mut Command) -> Rc<Process>,
) -> Teller {
    let process = spawn(command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()));
    let (orders, out, err) = {
        let mut child = process.child();
        (child.stdin.take(), child.stdout.take().unwrap(), child.stderr.take().unwrap())
    };
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(out).lines().map_while(Result::ok) {
            let value = serde_json::from_str(&line).unwrap_or(Value::String(line));
            drop(sender.send((wall_s(), value)));
        }
    });
    let (sender, errors) = channel();
    std::thread::spawn(move || {
        BufReader::new(err).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
    });
    Teller { what, time: time.clone(), process, orders, lines, seen: Vec::new(), errors }
}

impl Teller {
    /// Fails the test and prints the last lines of output.
    pub fn fail(&mut self, why: &str) -> ! {
        self.process.kill();
        let tail: Vec<String> = self.seen.iter().rev().take(40).rev().map(|(_, v)| v.to_string()).collect();
        let errors: Vec<String> = self.errors.try_iter().collect();
        panic!("{}: {why}; last lines:\n{}\n{}", self.what, tail.join("\n"), errors.join("\n"));
    }

    /// Reads the available output without waiting.
    pub fn catch_up(&mut self) {
        self.seen.extend(self.lines.try_iter());
    }

    /// Waits for a matching line from index `from` on, and returns its index.
    pub fn find(
        &mut self,
        from: usize,
        patience: Duration,
        mut fits: impl FnMut(&Value) -> bool,
    ) -> Option<usize> {
        let until = Instant::now() + patience;
        let mut place = from;
        loop {
            while place < self.seen.len() {
                if fits(&self.seen[place].1) {
                    return Some(place);
                }
                place += 1;
            }
            let line = self.next(until)?;
            self.seen.push(line);
        }
    }

    /// Returns the next line while time advances, or `None` at the time limit or the end of the program.
    fn next(&mut self, until: Instant) -> Option<(f64, Value)> {
        loop {
            match self.lines.try_recv() {
                Ok(line) => return Some(line),
                Err(TryRecvError::Empty) if Instant::now() < until => self.time.step(),
                Err(_) => return None,
            }
        }
    }

    /// Like [`Self::find`], but fails if there is no such line.
    pub fn wait_from(&mut self, from: usize, what: &str, fits: impl FnMut(&Value) -> bool) -> usize {
        match self.find(from, PATIENCE, fits) {
            Some(place) => place,
            None => self.fail(&format!("no line for '{what}'")),
        }
    }

    /// Waits for a new line, at most for this duration.
    pub fn wait_for(&mut self, patience: Duration, fits: impl FnMut(&Value) -> bool) -> Option<Value> {
        self.catch_up();
        let place = self.find(self.seen.len(), patience, fits)?;
        Some(self.seen[place].1.clone())
    }

    /// Waits for a new line.
    pub fn wait(&mut self, what: &str, fits: impl FnMut(&Value) -> bool) -> Value {
        match self.wait_for(PATIENCE, fits) {
            Some(value) => value,
            None => self.fail(&format!("no line for '{what}'")),
        }
    }

    /// Waits for a matching line, which may already have been printed.
    pub fn has(&mut self, what: &str, fits: impl FnMut(&Value) -> bool) -> Value {
        let place = self.wait_from(0, what, fits);
        self.seen[place].1.clone()
    }

    /// Types a line.
    pub fn order(&mut self, order: &str) {
        let orders = self.orders.as_mut().expect("its input is open");
        writeln!(orders, "{order}").unwrap();
    }

    /// Returns all lines that are printed during this duration.
    pub fn listen(&mut self, time: Duration) -> Vec<Value> {
        self.catch_up();
        let from = self.seen.len();
        self.time.pass(time);
        self.catch_up();
        self.seen[from..].iter().map(|(_, value)| value.clone()).collect()
    }

    /// Presses Ctrl-C.
    pub fn interrupt(&self) {
        self.signal("INT");
    }

    /// Sends a signal with this name.
    pub fn signal(&self, name: &str) {
        self.process.signal(&format!("-{name}"));
    }

    /// Waits for the end, and returns the status, the lines and the standard error output.
    pub fn end(mut self) -> (ExitStatus, Vec<Value>, String) {
        drop(self.orders.take());
        let until = Instant::now() + PATIENCE;
        while let Some(line) = self.next(until) {
            self.seen.push(line);
        }
        if Instant::now() >= until {
            self.fail("does not end");
        }
        let errors: Vec<String> = self.errors.iter().collect();
        let seen = std::mem::take(&mut self.seen);
        (self.process.wait(), seen.into_iter().map(|(_, value)| value).collect(), errors.join("\n"))
    }
}

/// Creates a desk whose time is never faster than the wall clock.
pub fn desk(name: &str) -> Desk {
    let desk = Desk::new(name);
    desk.time().keep_pace();
    desk
}

/// Path of the robot's script below `tests/ros2`.
fn peer_script() -> String {
    std::env::var("BIMANUAL_ROS2_PEER").unwrap_or_else(|_| "peer.py".to_owned())
}

/// Returns whether the robot uses ROS 2's own client library on Fast DDS. Otherwise it uses Cyclone DDS.
pub fn is_rclpy() -> bool {
    peer_script() == "rclpy_peer.py"
}

/// Starts the robot, or another program that `options` select.
pub fn peer(desk: &Desk, python: &str, domain: u32, options: &[&str]) -> Teller {
    let mut command = script(python, &peer_script());
    command.args(["--domain", &domain.to_string()]).args(options);
    command.env_remove("RMW_IMPLEMENTATION");
    start("the robot", desk.time(), &mut command, Process::on_its_own)
}

/// Starts another program of `tests/ros2`.
pub fn teller(desk: &Desk, what: &'static str, python: &str, name: &str, options: &[&str]) -> Teller {
    start(what, desk.time(), script(python, name).args(options), Process::on_its_own)
}

/// Starts a robot on Cyclone DDS beside the one on Fast DDS. Returns `None` if no Python is configured for it.
pub fn cyclone_peer(desk: &Desk, domain: u32, options: &[&str]) -> Option<Teller> {
    let python = std::env::var("BIMANUAL_CYCLONE_PYTHON").ok()?;
    let mut command = script(&python, "peer.py");
    command.args(["--domain", &domain.to_string()]).args(options);
    Some(start("the robot on Cyclone DDS", desk.time(), &mut command, Process::on_its_own))
}

/// Starts `tests/ros2/shown.py`, which prints the arm's angles as viewers display them.
pub fn shown(desk: &Desk, python: &str, where_from: &[&str]) -> Teller {
    teller(desk, "what is shown", python, "shown.py", where_from)
}

fn script(python: &str, name: &str) -> Command {
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/ros2").join(name));
    command
}

/// Starts the program under test with `section` as its `[ros2]` configuration.
/// By default speed commands have a stamp, so that the test can determine their age.
pub fn bridge(desk: &Desk, domain: u32, section: &str, options: &[&str]) -> Teller {
    let mut command = bridge_command(desk, domain, section, options);
    start("the bridge", desk.time(), &mut command, |command| desk.time().spawn(command))
}

/// Starts the same program on the wall clock.
pub fn bridge_on_its_own(desk: &Desk, domain: u32, section: &str, options: &[&str]) -> Teller {
    let mut command = bridge_command(desk, domain, section, options);
    start("the bridge", desk.time(), &mut command, Process::on_its_own)
}

fn bridge_command(desk: &Desk, domain: u32, section: &str, options: &[&str]) -> Command {
    // Several stations may share a domain.
    let numbers = (0..).map(|number| desk.path(&format!("desk-{domain}-{number}.toml")));
    let config = numbers.into_iter().find(|config| !config.exists()).expect("a free name");
    let stamp = if section.contains("stamp = ") { "" } else { "stamp = 'wall'\n" };
    let text = format!("[ros2]\ndomain_id = {domain}\ninterfaces = ['127.0.0.1']\n{stamp}{section}");
    std::fs::write(&config, text).unwrap();
    let mut command = Command::new(host_bridge());
    command.args(["run", "--ros2", "--json", "--config"]).arg(&config).args(options);
    for variable in
        ["ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"]
    {
        command.env_remove(variable);
    }
    command
}

/// Returns whether a line contains this report.
pub fn is(value: &Value, event: &str) -> bool {
    value["event"] == event
}

/// Returns the number, or NaN if there is none.
pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Returns the speed that the robot applied, in m/s and rad/s.
pub fn speed(value: &Value) -> Option<(f64, f64)> {
    is(value, "speed").then(|| (number(&value["linear"]), number(&value["angular"])))
}

/// Returns whether the bridge reports that it is armed.
pub fn armed(value: &Value) -> bool {
    is(value, "state") && value["state"] == "armed"
}

/// Returns the delay between a message's stamp and its arrival.
pub fn delay_ms(message: &Value) -> f64 {
    (number(&message["t"]) - number(&message["stamp"])) * 1000.0
}

/// Returns the entry of a gesture in the diagnostics, if it started a motion.
pub fn started(message: &Value) -> Option<&Value> {
    let gesture = &message["status"]["bimanual: gesture"];
    let outcome = gesture["outcome"].as_str().filter(|_| is(message, "diagnostics"))?;
    outcome.starts_with("started").then_some(gesture)
}

/// Returns the number of gestures in a message. The last gesture is repeated every second.
pub fn gestures(message: &Value) -> u32 {
    message["status"]["bimanual: gesture"]["count"].as_str().and_then(|count| count.parse().ok()).unwrap_or(0)
}

/// Returns the median and the maximum of delays in ms.
pub fn middle_and_worst(mut delays_ms: Vec<f64>) -> (f64, f64) {
    delays_ms.sort_by(f64::total_cmp);
    (delays_ms[delays_ms.len() / 2], delays_ms[delays_ms.len() - 1])
}

/// Maximum time that the robot may continue after a board falls silent, in ms.
pub const SILENCE_MS: f64 = 350.0;
/// Maximum median delay from the bridge's decision to the robot, in ms.
pub const DECISION_MS: f64 = 10.0;

/// The environment of a test on the graph.
pub struct Site {
    /// The Python interpreter with the robot's packages.
    pub python: String,
    /// Whether the test has its own network, in which it can drop datagrams.
    /// Otherwise, it uses the machine's loopback interface.
    pub has_own_network: bool,
    /// A lock that makes other tests wait while this test runs.
    _alone: Option<MutexGuard<'static, ()>>,
}

/// Returns the environment for the test with this name (in a module `live::ros2`).
/// If permitted, the test restarts itself in a new network namespace.
/// Returns `None` if the test has already passed in that namespace, or cannot run at all.
/// Tests that measure times run one after another in a namespace. On loopback, all tests do so.
pub fn site(test: &str, measures: bool) -> Option<Site> {
    site_in("ros2", test, measures)
}

/// Returns the environment for a test in another module of `live`.
pub fn site_in(module: &str, test: &str, measures: bool) -> Option<Site> {
    const INSIDE: &str = "BIMANUAL_OWN_NETWORK";
    let Ok(python) = std::env::var("BIMANUAL_ROS2_PYTHON") else {
        println!("SKIPPED: BIMANUAL_ROS2_PYTHON is not set; `cargo xtask test --only \"ROS 2\"` sets it");
        return None;
    };
    if std::env::var_os(INSIDE).is_some() {
        return Some(Site { python, has_own_network: true, _alone: None });
    }
    let lock = measures.then(alone);
    let unshare = |script: &str| {
        let mut command = Command::new("unshare");
        command.args(["-n", "sh", "-c", script]);
        command
    };
    // Participants find each other by multicast, as on a real network.
    let up = "ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo";
    let probe = unshare(&format!("{up} && iptables -L >/dev/null"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    if !probe.is_ok_and(|status| status.success()) {
        println!("on loopback: a network of its own needs root, unshare, iproute2 and iptables");
        return Some(Site { python, has_own_network: false, _alone: lock.or_else(|| Some(alone())) });
    }
    let mut again = unshare(&format!("{up} && exec \"$0\" --exact \"$1\" --nocapture"));
    let child = {
        let _starting = starting();
        again
            .arg(std::env::current_exe().unwrap())
            .arg(format!("live::{module}::{test}"))
            .env(INSIDE, "1")
            .spawn()
    };
    let status = child.and_then(|mut child| child.wait()).unwrap();
    assert!(status.success(), "{test} failed in a network of its own");
    None
}
