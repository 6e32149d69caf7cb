//! The other side of the graph: `tests/ros2/peer.py` (Cyclone DDS) or `rclpy_peer.py` (Fast DDS) as a robot, the program beside it, and a network of their own.
//!
//! DDS and the robot keep time by the wall clock, as do the delays that are measured here. Boards and program share one
//! time, which goes no faster than that, and slower on a busy machine; so tests wait for what comes, and judge delays
//! only where the machine was quiet.
//!
//! Whoever includes this has `host_bridge()`, the program's path, and the parts of `desk`.

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

/// By the wall clock; a hang must not stop the tests.
const PATIENCE: Duration = Duration::from_secs(240);

/// Those that measure time are not disturbed by each other.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Is this the long run (`cargo xtask test --full`)?
pub fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// Seconds since 1970, as the robot's stamps are.
pub fn wall_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// A domain that nobody else on this machine is likely to use.
pub fn domain() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    20 + (std::process::id() * 7 + NEXT.fetch_add(1, Ordering::Relaxed)) % 80
}

/// A program that prints one JSON object per line.
pub struct Teller {
    what: &'static str,
    time: Time,
    /// The process.
    pub process: Rc<Process>,
    orders: Option<ChildStdin>,
    lines: Receiver<(f64, Value)>,
    /// Every line with the time at which it was read.
    pub seen: Vec<(f64, Value)>,
    errors: Receiver<String>,
}

/// Starts such a program in this way; `what` names it where it fails.
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
    /// Ends the test with the last lines of output.
    pub fn fail(&mut self, why: &str) -> ! {
        self.process.kill();
        let tail: Vec<String> = self.seen.iter().rev().take(40).rev().map(|(_, v)| v.to_string()).collect();
        let errors: Vec<String> = self.errors.try_iter().collect();
        panic!("{}: {why}; last lines:\n{}\n{}", self.what, tail.join("\n"), errors.join("\n"));
    }

    /// Reads what was printed, without waiting.
    pub fn catch_up(&mut self) {
        self.seen.extend(self.lines.try_iter());
    }

    /// Waits this long for a line from the `from`th on; returns its place.
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

    /// The next line, while time goes on; none at the end of the patience or of the program.
    fn next(&mut self, until: Instant) -> Option<(f64, Value)> {
        loop {
            match self.lines.try_recv() {
                Ok(line) => return Some(line),
                Err(TryRecvError::Empty) if Instant::now() < until => self.time.step(),
                Err(_) => return None,
            }
        }
    }

    /// The same, and fails if none comes.
    pub fn wait_from(&mut self, from: usize, what: &str, fits: impl FnMut(&Value) -> bool) -> usize {
        match self.find(from, PATIENCE, fits) {
            Some(place) => place,
            None => self.fail(&format!("no line for '{what}'")),
        }
    }

    /// Waits this long for a new line.
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

    /// Waits for a line that may have been there already.
    pub fn has(&mut self, what: &str, fits: impl FnMut(&Value) -> bool) -> Value {
        let place = self.wait_from(0, what, fits);
        self.seen[place].1.clone()
    }

    /// Types a line.
    pub fn order(&mut self, order: &str) {
        let orders = self.orders.as_mut().expect("its input is open");
        writeln!(orders, "{order}").unwrap();
    }

    /// Everything it says from now on for this long.
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

    /// Sends a signal of this name.
    pub fn signal(&self, name: &str) {
        self.process.signal(&format!("-{name}"));
    }

    /// Waits for the end; what it printed on standard error.
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

/// A desk whose time goes no faster than the wall clock.
pub fn desk(name: &str) -> Desk {
    let desk = Desk::new(name);
    desk.time().keep_pace();
    desk
}

/// The robot's program below `tests/ros2`.
fn peer_script() -> String {
    std::env::var("BIMANUAL_ROS2_PEER").unwrap_or_else(|_| "peer.py".to_owned())
}

/// Whether the robot is ROS 2's own client library on Fast DDS; else it is Cyclone DDS.
pub fn is_rclpy() -> bool {
    peer_script() == "rclpy_peer.py"
}

/// The robot, or what `options` turn it into.
pub fn peer(desk: &Desk, python: &str, domain: u32, options: &[&str]) -> Teller {
    let mut command = script(python, &peer_script());
    command.args(["--domain", &domain.to_string()]).args(options);
    command.env_remove("RMW_IMPLEMENTATION");
    start("the robot", desk.time(), &mut command, Process::on_its_own)
}

/// Another program of `tests/ros2`.
pub fn teller(desk: &Desk, what: &'static str, python: &str, name: &str, options: &[&str]) -> Teller {
    start(what, desk.time(), script(python, name).args(options), Process::on_its_own)
}

/// A robot on Cyclone DDS beside one on Fast DDS; none if its Python is not named.
pub fn cyclone_peer(desk: &Desk, domain: u32, options: &[&str]) -> Option<Teller> {
    let python = std::env::var("BIMANUAL_CYCLONE_PYTHON").ok()?;
    let mut command = script(&python, "peer.py");
    command.args(["--domain", &domain.to_string()]).args(options);
    Some(start("the robot on Cyclone DDS", desk.time(), &mut command, Process::on_its_own))
}

/// The arm's angles as a person is shown them, by `tests/ros2/shown.py`.
pub fn shown(desk: &Desk, python: &str, where_from: &[&str]) -> Teller {
    teller(desk, "what is shown", python, "shown.py", where_from)
}

fn script(python: &str, name: &str) -> Command {
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/ros2").join(name));
    command
}

/// The program under test with `section` in its configuration's `[ros2]`. Speeds are stamped, so that the test sees how
/// old they are, unless the section says otherwise.
pub fn bridge(desk: &Desk, domain: u32, section: &str, options: &[&str]) -> Teller {
    let mut command = bridge_command(desk, domain, section, options);
    start("the bridge", desk.time(), &mut command, |command| desk.time().spawn(command))
}

/// The same on the machine's own clock.
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

/// Whether a line reports this.
pub fn is(value: &Value, event: &str) -> bool {
    value["event"] == event
}

/// A number, or not a number.
pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// The twist that the robot took over, in m/s and rad/s.
pub fn speed(value: &Value) -> Option<(f64, f64)> {
    is(value, "speed").then(|| (number(&value["linear"]), number(&value["angular"])))
}

/// Whether the bridge says that it is armed.
pub fn armed(value: &Value) -> bool {
    is(value, "state") && value["state"] == "armed"
}

/// From a message's stamp to its arrival.
pub fn delay_ms(message: &Value) -> f64 {
    (number(&message["t"]) - number(&message["stamp"])) * 1000.0
}

/// A gesture's place among the diagnostics, if it started a motion.
pub fn started(message: &Value) -> Option<&Value> {
    let gesture = &message["status"]["bimanual: gesture"];
    let outcome = gesture["outcome"].as_str().filter(|_| is(message, "diagnostics"))?;
    outcome.starts_with("started").then_some(gesture)
}

/// How many gestures a message tells of; the last one is repeated every second.
pub fn gestures(message: &Value) -> u32 {
    message["status"]["bimanual: gesture"]["count"].as_str().and_then(|count| count.parse().ok()).unwrap_or(0)
}

/// Delays in ms: the median and the longest.
pub fn middle_and_worst(mut delays_ms: Vec<f64>) -> (f64, f64) {
    delays_ms.sort_by(f64::total_cmp);
    (delays_ms[delays_ms.len() / 2], delays_ms[delays_ms.len() - 1])
}

/// How long the robot may go on after a board fell silent.
pub const SILENCE_MS: f64 = 350.0;
/// From the bridge's decision to the robot, the median.
pub const DECISION_MS: f64 = 10.0;

/// What a test on the graph needs.
pub struct Site {
    /// The interpreter that has the robot's packages.
    pub python: String,
    /// A network that only this test has, in which datagrams can be dropped. Else it is the machine's loopback.
    pub has_own_network: bool,
    /// A lock that others wait for while this test runs.
    _alone: Option<MutexGuard<'static, ()>>,
}

/// A place for the test of this name (in a module `live::ros2`), which starts itself again in a new network namespace
/// where it may; `None` if it has run and passed there, or cannot run at all. Those that measure times do so one
/// after the other, as do all on loopback.
pub fn site(test: &str, measures: bool) -> Option<Site> {
    site_in("ros2", test, measures)
}

/// The same in another module of `live`.
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
    // As on a site's network, participants can find each other by multicast.
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
