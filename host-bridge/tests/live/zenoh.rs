//! Tests the program over Zenoh, from a router to an independent robot (`tests/ros2/zenoh_peer.py`).
//! The router uses TLS and access control, with the files of docs/zenoh as described in docs/sites.md.
//! Run: `cargo xtask test --full --only Zenoh`.

use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::double::{BENT, Double, FORWARD, LEVEL};
use crate::graph::{
    DECISION_MS, SILENCE_MS, Teller, armed, bridge, bridge_on_its_own, delay_ms, desk, is, is_full,
    middle_and_worst, number, site_in, speed, teller, wall_s,
};
use crate::lateness::Lateness;
use crate::live::ros2::{GRIP_MAPS, GRIPS_CLOSED, closes_opens_and_halts, grips_with, number_of, used};
use crate::program::Desk;

/// Duration for which the router is stopped, in wall-clock time.
const STALL: Duration = Duration::from_secs(2);
/// Maximum time from the router's continuation to zero speed at the robot.
/// This time covers waiting messages and TCP's pauses.
const AFTER_STALL_MS: f64 = 1500.0;

/// Creates certificates, and copies the files of docs/zenoh with the paths of these certificates.
struct Router {
    teller: Teller,
    folder: String,
}

impl Router {
    fn start(desk: &Desk, python: &str) -> Self {
        let folder = desk.path("certificates").display().to_string();
        let docs = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/zenoh");
        let names = ["localhost", "cell1-laptop", "cell1-robot", "cell2-robot"];
        let made =
            Command::new("sh").arg(format!("{docs}/certificates.sh")).arg(&folder).args(names).status();
        assert!(made.is_ok_and(|status| status.success()), "certificates need openssl");
        for (file, name) in [("router", "router"), ("session", "cell1-laptop")] {
            let text = std::fs::read_to_string(format!("{docs}/{file}.json5")).unwrap();
            let text = text.replace("/etc/bimanual", &folder);
            std::fs::write(format!("{folder}/{name}.json5"), &text).unwrap();
            for other in ["cell1-robot", "cell2-robot"].into_iter().filter(|_| file == "session") {
                std::fs::write(format!("{folder}/{other}.json5"), text.replace(name, other)).unwrap();
            }
        }
        let mut teller =
            teller(desk, "the router", python, "zenoh_router.py", &[&format!("{folder}/router.json5")]);
        teller.has("ready", |v| is(v, "ready"));
        Router { teller, folder }
    }

    fn file(&self, name: &str) -> String {
        format!("{}/{name}.json5", self.folder)
    }

    fn robot(&self, desk: &Desk, python: &str, name: &str, options: &[&str]) -> Teller {
        let file = self.file(name);
        let all = [&["--zenoh", &*file, "--namespace", "/cell1"], options].concat();
        let mut robot = teller(desk, "the robot", python, "zenoh_peer.py", &all);
        robot.has("ready", |v| is(v, "ready"));
        robot
    }

    fn section(&self) -> String {
        format!("namespace = '/cell1'\ntransport = 'zenoh'\nzenoh_config = '{}'\n", self.file("cell1-laptop"))
    }
}

fn says(value: &Value, text: &str) -> bool {
    is(value, "robot") && value["text"].as_str().is_some_and(|said| said.contains(text))
}

fn is_zero(value: &Value) -> bool {
    speed(value) == Some((0.0, 0.0))
}

#[test]
fn hands_drive_a_robot_through_a_router_with_tls_and_access_control_and_no_stall_delays_a_stop() {
    let name = "hands_drive_a_robot_through_a_router_with_tls_and_access_control_and_no_stall_delays_a_stop";
    let Some(site) = site_in("zenoh", name, true) else { return };
    let desk = desk("zenoh-1");
    let router = Router::start(&desk, &site.python);
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    // One robot names its attachments, as Jazzy does; later releases do not.
    let options = ["--robot", "--action", "--odom", "--pace", "8", "--labelled"];
    let mut robot = router.robot(&desk, &site.python, "cell1-robot", &options);
    // The certificate of another pair is used on this pair's topics.
    let mut stranger = router.robot(&desk, &site.python, "cell2-robot", &["--base-only"]);
    robot.order("flag /cell1/e_stop off");
    let section = router.section() + "arm = 'action'\nestop = 'e_stop'\n";
    let ports = ["--left", &left.port(), "--right", &right.port()];
    let mut bridge = bridge(&desk, 0, &section, &ports);

    // The other side reads types, hashes and quality of service from the tokens of the bridge.
    for (topic, type_name) in [
        ("rt/cell1/cmd_vel", "geometry_msgs::msg::dds_::TwistStamped_"),
        (
            "rq/cell1/joint_trajectory_controller/follow_joint_trajectory/_action/send_goalRequest",
            "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_Request_",
        ),
    ] {
        let matched = robot.has(topic, |v| is(v, "matched") && v["topic"] == topic);
        assert_eq!((&matched["type"], &matched["node"]), (&type_name.into(), &"/cell1/bimanual".into()));
        assert_eq!((&matched["reliable"], &matched["volatile"]), (&true.into(), &true.into()));
        assert!(matched["hash"].as_str().is_some_and(|hash| hash.starts_with("RIHS01_")), "{matched}");
    }
    bridge.has("its reader", |v| says(v, "1 reader on /cell1/cmd_vel"));
    bridge.has("its server", |v| says(v, "goals go to an action server on Zenoh"));
    // The last e-stop message was sent before the bridge started.
    bridge.has("armed", armed);
    robot.catch_up();
    assert!(!robot.seen.iter().any(|(_, v)| speed(v).is_some()), "nothing is sent while nothing moves");

    let lateness = Lateness::watch();
    let mut delays_ms = Vec::new();
    for _ in 0..10 {
        left.hold(FORWARD);
        let first = robot.wait("forward", |v| speed(v).is_some_and(|s| s.0 > 0.0));
        assert_eq!((speed(&first), &first["became"]), (Some((0.5, 0.0)), &"acted".into()));
        assert_eq!(first["frame"], "base_link");
        delays_ms.push(delay_ms(&first));
        left.hold(LEVEL);
        delays_ms.push(delay_ms(&robot.wait("zero", is_zero)));
    }
    let (middle_ms, worst_ms) = middle_and_worst(delays_ms);
    println!("Zenoh, TLS: tilt, decision to robot: median {middle_ms:.2} ms, worst {worst_ms:.2} ms of 20");
    assert!(!lateness.was_quiet() || middle_ms <= DECISION_MS);

    // A gesture causes a goal, its feedback and its result.
    let goal = robot.wait("a goal", |v| is(v, "goal"));
    let finished = robot.has("the arm arrives", |v| is(v, "finished") && v["id"] == goal["id"]);
    assert_eq!(finished["status"], 4);
    bridge.has("arrival", |v| is(v, "motion-ended") && v["reached"] == true);
    for part in ["base", "arm"] {
        bridge.has("an acceptance", |v| is(v, "accepted") && v["part"] == part);
    }
    robot.order("pace 1");
    robot.wait("another goal", |v| is(v, "goal"));
    desk.pass(Duration::from_millis(200));
    left.hold(BENT);
    robot.wait("the cancellation", |v| is(v, "cancel") && v["running"] == true);
    robot.has("cancelled", |v| is(v, "finished") && v["status"] == 5);
    left.hold(LEVEL);
    bridge.wait("armed again", armed);

    // A stop comes before the reply to the goal.
    // The cancellation is therefore repeated until the goal's end is known.
    robot.order("arm late");
    robot.wait("a goal that is not answered", |v| is(v, "goal") && v["mode"] == "late");
    left.hold(BENT);
    let late = robot.wait_from(0, "the answer", |v| is(v, "accepted late"));
    let cancelled = robot.wait_from(late, "its cancellation", |v| is(v, "cancel") && v["running"] == true);
    robot.wait_from(cancelled, "cancelled", |v| is(v, "finished") && v["status"] == 5);
    robot.order("arm accept");
    left.hold(LEVEL);
    bridge.wait("armed again", armed);

    // Another participant publishes an e-stop.
    left.hold(FORWARD);
    robot.wait("forward", |v| speed(v).is_some_and(|s| s.0 > 0.0));
    robot.order("flag /cell1/e_stop on");
    robot.wait("zero", is_zero);
    bridge.has("the refusal", |v| {
        is(v, "robot-refuses") && v["reason"].as_str().unwrap().contains("e-stop is pressed")
    });
    left.hold(LEVEL);
    robot.order("flag /cell1/e_stop off");
    bridge.wait("armed again", armed);

    // The router is suspended. The program halts at once nevertheless, and sends the halt as soon as it can.
    left.hold(FORWARD);
    robot.wait("forward", |v| speed(v).is_some_and(|s| s.0 > 0.0));
    robot.catch_up();
    let stalled = robot.seen.len();
    router.teller.signal("STOP");
    desk.pass(Duration::from_millis(300));
    let (lateness, pulled_s, before) = (Lateness::watch(), wall_s(), bridge.seen.len());
    left.pull();
    let at = bridge.wait_from(before, "the halt", |v| is(v, "halt"));
    let halted_ms = (bridge.seen[at].0 - pulled_s) * 1000.0;
    println!("the router stands still, a cable is pulled: halted after {halted_ms:.0} ms");
    assert!(!lateness.was_quiet() || halted_ms <= SILENCE_MS);
    // Meanwhile, the base's own timeout stops the robot.
    // On a busy machine, this may already have happened.
    robot.wait_from(stalled, "the base stops by itself", |v| is(v, "stopped"));
    desk.pass(STALL);
    robot.catch_up();
    let (lateness, going_s, going) = (Lateness::watch(), wall_s(), robot.seen.len());
    router.teller.signal("CONT");
    let zero = robot.wait_from(going, "zero", is_zero);
    let zero = robot.seen[zero].1.clone();
    let zero_ms = (number(&zero["t"]) - going_s) * 1000.0;
    println!("the router goes on: zero after {zero_ms:.0} ms");
    assert!(!lateness.was_quiet() || zero_ms <= AFTER_STALL_MS);
    left.hold(LEVEL);
    left.plug();
    bridge.wait("armed again", armed);

    // The program is killed, and the base stops by itself.
    left.hold(FORWARD);
    robot.wait("forward", |v| speed(v).is_some_and(|s| s.0 > 0.0));
    bridge.signal("KILL");
    let killed_s = wall_s();
    let stopped = robot.wait("the base stops by itself", |v| is(v, "stopped"));
    println!("killed: the base is at rest after {:.0} ms", (number(&stopped["t"]) - killed_s) * 1000.0);
    drop(bridge);
    robot.order("quit");
    let (_, said, errors) = robot.end();
    assert!(!errors.contains("Traceback"), "{errors}");
    assert!(!said.iter().any(|v| v["became"].as_str().is_some_and(|became| became.contains("older"))));
    stranger.catch_up();
    assert!(
        !stranger.seen.iter().any(|(_, v)| speed(v).is_some()),
        "another pair's certificate hears nothing"
    );
}

#[test]
fn a_gripper_and_an_arm_on_the_topic_obey_over_zenoh_as_over_dds() {
    let Some(site) = site_in("zenoh", "a_gripper_and_an_arm_on_the_topic_obey_over_zenoh_as_over_dds", false)
    else {
        return;
    };
    let desk = desk("zenoh-gripper");
    let router = Router::start(&desk, &site.python);
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    let options = [&["--robot", "--start-offset", "0.1"], &grips_with("parallel")[..]].concat();
    let mut robot = router.robot(&desk, &site.python, "cell1-robot", &options);
    let ports = ["--left", &left.port(), "--right", &right.port()];
    let section = router.section() + GRIPS_CLOSED;
    let mut bridge = bridge(&desk, 0, &section, &[&ports[..], &GRIP_MAPS].concat());
    closes_opens_and_halts("parallel", &left, &mut robot, &mut bridge);
    // The third gesture moved the arm home in several pieces.
    let pieces = || robot.seen.iter().filter(|(_, v)| is(v, "trajectory"));
    assert!(pieces().count() > 2);
    assert!(pieces().all(|(_, v)| v["refused"].is_null()), "each is one that the controller takes");
}

#[test]
fn doctor_over_zenoh_tries_and_names_a_missing_router_and_a_certificate_of_another_pair() {
    let name = "doctor_over_zenoh_tries_and_names_a_missing_router_and_a_certificate_of_another_pair";
    let Some(site) = site_in("zenoh", name, false) else { return };
    let desk = desk("zenoh-doctor");
    let router = Router::start(&desk, &site.python);
    let _robot = router.robot(&desk, &site.python, "cell1-robot", &["--robot", "--action"]);
    let doctor = |section: &str| {
        let config = desk.path(&format!("doctor-{}.toml", section.len()));
        std::fs::write(&config, format!("[ros2]\n{section}")).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_host-bridge"));
        command.args(["doctor", "--ros2", "--seconds", "4", "--config"]).arg(&config);
        let output = command.env_remove("RMW_IMPLEMENTATION").output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        (output.status.success(), text.into_owned())
    };
    let (well, text) = doctor(&router.section());
    assert!(well && text.contains("all is well"), "{text}");
    for words in
        ["action server on Zenoh: answers", "ms from this machine's clock", "RIHS01_", "over Zenoh, as"]
    {
        assert!(text.contains(words), "{words} in\n{text}");
    }
    let (well, text) = doctor(&router.section().replace("cell1-laptop", "cell2-robot"));
    assert!(!well && text.contains("tells of nobody") && text.contains("certificate of this pair"), "{text}");
    let (well, text) = doctor("transport = 'zenoh'\nzenoh_connect = ['tcp/localhost:7448']\n");
    assert!(!well && text.contains("no Zenoh router can be reached"), "{text}");
}

/// Runs a shell command, which must succeed.
fn net(words: &str) {
    let status = Command::new("sh").args(["-c", words]).status();
    assert!(status.is_ok_and(|status| status.success()), "{words}");
}

/// A pair of operator and robot.
struct Pair {
    left: Double,
    /// The operator makes gestures all the time; used only with an arm.
    _right: Option<Double>,
    bridge: Teller,
    robot: Teller,
}

impl Pair {
    fn has_arm(&self) -> bool {
        self._right.is_some()
    }
}

/// Number of messages that all pairs sent, and number of messages that arrived.
#[derive(Default)]
struct Sums {
    /// Speed messages.
    sent: u64,
    replaced: u64,
    received: u64,
    late: u64,
    oldest_ms: f64,
    /// Action requests.
    goals: u64,
    withdrawn: u64,
    goals_received: u64,
    oldest_goal_ms: f64,
    cancels: u64,
    cancels_received: u64,
    oldest_cancel_ms: f64,
    failed: u64,
}

impl Sums {
    /// Ends a pair and adds its counts.
    fn end(&mut self, pair: Pair) {
        let Pair { bridge, mut robot, .. } = pair;
        bridge.interrupt();
        let (_, said, errors) = bridge.end();
        let counts = said.last().unwrap()["ros2"].clone();
        let count =
            |name: &str| counts[name].as_u64().unwrap_or_else(|| panic!("{name} of {counts}: {errors}"));
        robot.listen(Duration::from_millis(300));
        robot.order("quit");
        let (_, said, _) = robot.end();
        assert!(
            !said.iter().any(|v| v["became"] == "acted on an older one"),
            "an older one after a newer one"
        );
        let end = said.last().unwrap();
        self.sent += count("twists");
        self.replaced += count("replaced");
        self.failed += count("failed");
        self.received += end["received"].as_u64().unwrap();
        self.late += end["dropped"].as_u64().unwrap();
        self.oldest_ms = self.oldest_ms.max(number(&end["oldest_ms"]));
        self.goals += count("motions");
        self.withdrawn += count("withdrawn");
        self.cancels += count("cancels");
        for v in said.iter().filter(|v| is(v, "goal arrived")) {
            self.goals_received += 1;
            let age_ms = number(&v["age_ms"]);
            self.oldest_goal_ms = self.oldest_goal_ms.max(age_ms);
            let cancelled = |other: &Value| is(other, "cancel arrived") && other["id"] == v["id"];
            assert!(age_ms <= GOAL_BOUND_MS || said.iter().any(cancelled), "an old goal runs on: {v}");
        }
        for v in said.iter().filter(|v| is(v, "cancel arrived")) {
            self.cancels_received += 1;
            self.oldest_cancel_ms = self.oldest_cancel_ms.max(number(&v["age_ms"]));
        }
    }
}

/// If a goal has no reply after `answer_ms`, the bridge abandons the goal and requests its cancellation.
const GOAL_BOUND_MS: f64 = 1000.0;

#[test]
fn twenty_pairs_share_a_router_through_stalls_and_losses_and_nothing_stale_is_acted_on() {
    if !is_full() {
        println!("SKIPPED: 20 pairs for 60 s run under --full");
        return;
    }
    let name = "twenty_pairs_share_a_router_through_stalls_and_losses_and_nothing_stale_is_acted_on";
    let Some(site) = site_in("zenoh", name, true).filter(|site| site.has_own_network) else { return };
    let (pairs, seconds) = (number_of("BIMANUAL_PAIRS", 20), number_of("BIMANUAL_PAIRS_S", 60));
    // Number of pairs that have an arm with goals. Their operators stop the arm during each stall.
    let arms = number_of("BIMANUAL_ARMS", 3).min(pairs);
    let desk = desk("zenoh-2");
    let write = |name: &str, text: &str| {
        let path = desk.path(name).display().to_string();
        std::fs::write(&path, text).unwrap();
        path
    };
    // Checks the statements of docs/zenoh about stalled links.
    // TLS is not used, because the session's test covers it.
    let rest = "scouting: { multicast: { enabled: false } }, transport: { link: { tx: { lease: 60000, queue: { \
                congestion_control: { block: { wait_before_close: 60000000 } } } } } }";
    let listens = format!("{{ mode: 'router', listen: {{ endpoints: ['tcp/127.0.0.1:7447'] }}, {rest} }}");
    let connects = format!("{{ mode: 'client', connect: {{ endpoints: ['tcp/127.0.0.1:7447'] }}, {rest} }}");
    let (router, session) = (write("router.json5", &listens), write("session.json5", &connects));
    let mut router = teller(&desk, "the router", &site.python, "zenoh_router.py", &[&router]);
    router.has("ready", |v| is(v, "ready"));
    let mut all: Vec<Pair> = Vec::new();
    for number in 1..=pairs {
        let has_arm = number <= arms;
        let left = Double::left_named(&desk, &format!("left-{number}"));
        let right = has_arm.then(|| Double::right_named(&desk, &format!("right-{number}"), 0.0));
        let space = format!("/cell{number}");
        let mut options = vec!["--zenoh", &session, "--namespace", &space, "--quiet"];
        options.extend(if has_arm { &["--robot", "--action", "--pace", "1"][..] } else { &["--base-only"] });
        let mut robot = teller(&desk, "the robot", &site.python, "zenoh_peer.py", &options);
        robot.has("ready", |v| is(v, "ready"));
        let arm = if has_arm { "arm = 'action'\n" } else { "" };
        let section =
            format!("namespace = '{space}'\ntransport = 'zenoh'\nzenoh_config = '{session}'\n{arm}");
        let right_port = right.as_ref().map(Double::port);
        let mut ports = vec!["--left".to_owned(), left.port()];
        ports.extend(right_port.into_iter().flat_map(|port| ["--right".to_owned(), port]));
        let ports: Vec<&str> = ports.iter().map(String::as_str).collect();
        // The program's processor time is measured, so the test does not control its clock.
        let bridge = bridge_on_its_own(&desk, 0, &section, &ports);
        all.push(Pair { left, _right: right, bridge, robot });
    }
    for pair in &mut all {
        pair.bridge.has("armed", armed);
        pair.bridge.has("the reader", |v| says(v, "1 reader"));
        pair.robot.has("the writer", |v| is(v, "matched"));
    }
    desk.pass(Duration::from_secs(2));
    let seconds_of = |pair: &Pair| [&pair.bridge, &pair.robot].map(|one| used(one.process.id()).1);
    let before: Vec<_> = all.iter().map(seconds_of).collect();
    let lateness = Lateness::watch();
    let start = Instant::now();
    let with_arms = |all: &[Pair], pose| {
        all.iter().filter(|pair| pair.has_arm()).for_each(|pair| pair.left.hold(pose));
    };
    all.iter().for_each(|pair| pair.left.hold(FORWARD));
    // TCP is blocked for 200 ms every 5 s.
    // In the middle of the test, a fifth of all packets is lost for 10 s.
    let loses = "INPUT -i lo -p tcp -m statistic --mode random --probability 0.2 -j DROP";
    let (mut stalls, mut is_lossy, mut was_lossy) = (0, false, false);
    while start.elapsed().as_secs() < seconds {
        desk.pass(Duration::from_millis(3300));
        net("iptables -A INPUT -i lo -p tcp -j DROP");
        // The operators stop their arms while no message gets through.
        with_arms(&all, BENT);
        desk.pass(Duration::from_millis(200));
        net("iptables -D INPUT -i lo -p tcp -j DROP");
        stalls += 1;
        let middle = start.elapsed().as_secs() >= seconds / 2;
        if middle && !was_lossy {
            net(&format!("iptables -A {loses}"));
            (is_lossy, was_lossy) = (true, true);
        } else if is_lossy && start.elapsed().as_secs() >= seconds / 2 + 10 {
            net(&format!("iptables -D {loses}"));
            is_lossy = false;
        }
        with_arms(&all, LEVEL);
        desk.pass(Duration::from_millis(1500));
        with_arms(&all, FORWARD);
    }
    if is_lossy {
        net(&format!("iptables -D {loses}"));
    }
    let took_s = start.elapsed().as_secs_f64();
    let mut figures = Vec::new();
    for (pair, before) in all.iter().zip(before).filter(|(pair, _)| !pair.has_arm()) {
        let [(mb, s), (robot_mb, robot_s)] = [&pair.bridge, &pair.robot].map(|one| used(one.process.id()));
        let percent = |now: f64, before: f64| (now - before) / took_s * 100.0;
        figures.push([mb, percent(s, before[0]), robot_mb, percent(robot_s, before[1])]);
    }
    let was_quiet = lateness.was_quiet();
    all.iter().for_each(|pair| pair.left.hold(LEVEL));
    with_arms(&all, BENT);
    desk.pass(Duration::from_secs(4));
    let mut sums = Sums::default();
    all.into_iter().for_each(|pair| sums.end(pair));
    println!(
        "Zenoh: {pairs} pairs over one router, {seconds} s, {stalls} stalls of 200 ms, a fifth of all packets lost for 10 s: {} \
         speeds decided, {} of them replaced by newer ones before they left, {} received, {} of them dropped by the base for \
         their age; oldest acted on {:.0} ms",
        sums.sent, sums.replaced, sums.received, sums.late, sums.oldest_ms
    );
    println!(
        "{arms} arms: {} goals, {} withdrawn before they left, {} received, oldest {:.0} ms; {} cancellations, {} received, \
         oldest {:.0} ms; {} failed",
        sums.goals,
        sums.withdrawn,
        sums.goals_received,
        sums.oldest_goal_ms,
        sums.cancels,
        sums.cancels_received,
        sums.oldest_cancel_ms,
        sums.failed
    );
    let mean = |of: usize| figures.iter().map(|f| f[of]).sum::<f64>() / figures.len() as f64;
    println!(
        "per pair: bridge {:.1} MB and {:.1} % of a core; robot's side (Python) {:.1} MB and {:.1} %",
        mean(0),
        mean(1),
        mean(2),
        mean(3)
    );
    assert_eq!(sums.failed, 0);
    assert_eq!(sums.sent - sums.replaced, sums.received, "each speed that left arrived");
    assert_eq!(sums.goals - sums.withdrawn, sums.goals_received, "each goal that left arrived");
    assert_eq!(sums.cancels, sums.cancels_received, "each cancellation arrived");
    assert!(arms == 0 || sums.goals > 0 && sums.cancels > 0, "arms moved and were stopped");
    assert!(sums.oldest_ms <= 500.0, "nothing stale is acted on");
    assert!(sums.sent > if was_quiet { 40 } else { 5 } * seconds * (pairs - arms), "{}", sums.sent);
}
