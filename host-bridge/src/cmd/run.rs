//! `host-bridge run`: the boards on their ports (or keys in their place) steer the simulated robot.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, SystemTime};

use anyhow::{Context as _, Result, bail, ensure};
use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use host_bridge::bridge::BridgeEvent;
use host_bridge::config::{KEYBOARD, Place};
use host_bridge::describe;
use host_bridge::foxglove::Foxglove;
use host_bridge::keyboard::HandKey;
use host_bridge::links::{Clock, Link as BoardLink, LinkEvent, News, SystemClock, Waiter, is_ble};
use host_bridge::live::Live;
use host_bridge::robot::Robot as _;
use host_bridge::ros2::{ArmInterface, Counts, RosRobot};
use host_bridge::safety::Hand;
use host_bridge::session::SessionEvent;
use host_bridge::web::Web;
use serde::Serialize;
use shared_proto::message::Heading;

use super::keep::{KeepArgs, Keeper, Start, origin};
use super::ports::{check_name, read_config, settings};
use super::ros2::Link;
use super::web::WebArgs;
use crate::play::robot_in_scene;
use crate::view::{Scene, View};

/// Bytes wake the loop at once; without any it turns this often.
const TURN: Duration = Duration::from_millis(2);
const DRAW_MS: u64 = 33;
/// The release key must be pressed twice within this time.
const CONFIRM_MS: u64 = 2000;

const KEYS: &str = "space: stop   r r: release a stop (no right hand)   Esc: quit";
const HAND_KEYS: &str = "keyboard: arrows drive while held, q faster, z slower; 1-6 gestures";

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Port of the left hand's board (tilt, bends: the base), or `keyboard`
    #[arg(long, value_name = "PORT|keyboard")]
    left: Option<String>,
    /// Port of the right hand's board (gestures: the arm), `ble[:NAME]`, or `keyboard`
    #[arg(long, value_name = "PORT|ble[:NAME]|keyboard")]
    right: Option<String>,
    /// Configuration file (TOML) with ports, thresholds, limits and motions
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the configuration in effect, all keys, and do nothing else
    #[arg(long)]
    print_config: bool,
    /// Gives a label of your own model a motion, such as wave=pick-up (repeatable)
    #[arg(long, value_name = "LABEL=MOTION")]
    map: Vec<String>,
    /// The hands change places: --left is the gesture board, --right the tilt board
    #[arg(long)]
    left_handed: bool,
    /// Drive a robot on a ROS 2 graph too, as the configuration says under ros2
    #[arg(long)]
    ros2: bool,
    /// Speeds as Twist, not TwistStamped
    #[arg(long, requires = "ros2")]
    unstamped: bool,
    /// There is no robot: publish the simulator's joint states, odometry and transforms
    #[arg(long, requires = "ros2")]
    publish_sim: bool,
    /// No live view: print events as lines
    #[arg(long)]
    headless: bool,
    /// Print events as JSON, one object per line, and no live view
    #[arg(long)]
    json: bool,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Scene (TOML: boxes, poses, base, arm): the arm plans its ways, and nothing is touched. Its base and
    /// arm take the place of the configuration's
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// The arm's accelerations rise and fall no faster than the configuration's jerk_rad_s3 (in a scene, its
    /// file says so)
    #[arg(long, conflicts_with = "scene")]
    jerk_limited: bool,
    #[command(flatten)]
    web: WebArgs,
    #[command(flatten)]
    keep: KeepArgs,
}

#[derive(Serialize)]
struct LinkLine<'a> {
    time_ms: u64,
    event: &'static str,
    hand: Hand,
    open: bool,
    text: &'a str,
}

#[derive(Serialize)]
struct PageLine<'a> {
    time_ms: u64,
    event: &'static str,
    url: &'a str,
}

#[derive(Serialize)]
struct RosLine<'a> {
    time_ms: u64,
    event: &'static str,
    text: &'a str,
}

#[derive(Serialize)]
struct EndLine {
    time_ms: u64,
    event: &'static str,
    odometry: host_bridge::base::Odometry,
    frames: [host_bridge::link::LinkCounters; 2],
    round_trip_ms: [Option<u64>; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    ros2: Option<Counts>,
}

/// Runs until somebody quits or the time is over.
pub fn run(args: &Args) -> Result<ExitCode> {
    let mut config = read_config(args.config.as_deref())?;
    config.left_handed |= args.left_handed;
    config.arm.jerk_limited |= args.jerk_limited;
    config.ros2.stamped &= !args.unstamped;
    if args.publish_sim {
        // The simulator's arm is the one that moves.
        config.ros2.arm = ArmInterface::None;
    }
    for (asked, known) in [(&args.left, &mut config.ports.left), (&args.right, &mut config.ports.right)] {
        if let Some(port) = asked {
            known.clone_from(port);
        }
    }
    for mapping in &args.map {
        let (label, motion) =
            mapping.split_once('=').context("--map takes LABEL=MOTION, such as wave=pick-up")?;
        config.motions.insert(label.to_owned(), motion.to_owned());
    }
    config.check()?;
    if args.print_config {
        print!("{}", config.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(seconds) = args.seconds {
        ensure!(seconds > 0.0 && seconds <= 1e6, "--seconds takes more than 0");
    }
    let [left, right] = config.hand_ports().map(str::to_owned);
    if left.is_empty() && right.is_empty() {
        bail!(
            "no hand: give --left PORT, --right PORT or both (`host-bridge list` shows the ports); without \
             boards try --left keyboard --right keyboard, or `host-bridge demo`"
        );
    }
    ensure!(
        left == KEYBOARD || left != right,
        "{left}: both hands cannot be on the same port; `host-bridge list` shows the ports"
    );
    for port in [&left, &right] {
        check_name(port)?;
    }
    let is_terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal();
    let wants_view = is_terminal && !args.headless && !args.json;
    let places = config.places();
    ensure!(
        wants_view || !places.contains(&Place::Keyboard),
        "a keyboard hand needs the live view: start it in a terminal, without --headless and --json"
    );

    let robot = args.scene.as_deref().map(robot_in_scene).transpose()?;
    let web = args.web.start(false)?;
    let ros = if args.ros2 { Some(Link::open(&config.ros2, args.publish_sim)?) } else { None };
    let clock = Arc::new(SystemClock::start());
    let waiter = clock.waiter();
    let (sender, events) = channel();
    let open = |hand: Hand, port: &str| {
        (places[hand as usize] == Place::Board).then(|| {
            let clock: Arc<dyn Clock> = clock.clone();
            BoardLink::start(hand, port, settings(&config), clock, sender.clone())
        })
    };
    let links = [open(Hand::Left, &left), open(Hand::Right, &right)];
    let name = |port: &str| if port.is_empty() { "none".to_owned() } else { port.to_owned() };
    let about = ros.as_ref().map_or("simulated robot".to_owned(), Link::about);
    let mut title = format!("bimanual: left hand {}, right hand {}, {about}", name(&left), name(&right));
    let mut live = match robot {
        None => Live::new(&config, places[0], places[1], clock.now_ms()),
        Some(robot) => Live::with_robot(&config, places[0], places[1], robot, clock.now_ms()),
    };
    if ros.is_some() {
        live = live.with_ros(RosRobot::new(&config.ros2, config.arm_limits()));
    }
    let origin = origin(clock.now_ms());
    let foxglove = args.web.start_foxglove(origin)?;
    if let Some(foxglove) = &foxglove {
        live.tap_mut().add(Box::new(foxglove.teller()));
        title += &format!("\nfoxglove: {}", foxglove.url());
    }
    if let Some(web) = &web {
        live.tap_mut().add(Box::new(web.watcher(&title)));
        title += &format!("\npage: {}", web.url());
    }
    let start =
        Start { title: &title, config: &config, maps: &[], scene: args.scene.as_deref(), origin, live: true };
    let keeper = args.keep.start(live.tap_mut(), &start)?;
    let mut session = Session {
        live,
        ros,
        keeper,
        view: if wants_view { Some(View::open(&title)?) } else { None },
        json: args.json,
        links,
        web,
        released_ms: None,
        keys: if places.contains(&Place::Keyboard) {
            format!("{KEYS}\n{HAND_KEYS}")
        } else {
            KEYS.to_owned()
        },
    };
    if session.view.is_none() && !args.json {
        session.line(&title);
    }
    let urls =
        [("page", session.web.as_ref().map(Web::url)), ("foxglove", foxglove.as_ref().map(Foxglove::url))];
    for (event, url) in urls {
        if let (true, Some(url)) = (args.json, url) {
            let line = PageLine { time_ms: clock.now_ms(), event, url: &url };
            session.line(&serde_json::to_string(&line)?);
        }
    }
    let until_ms = args.seconds.map_or(u64::MAX, |seconds| (seconds * 1000.0) as u64);
    session.turn_until(until_ms, &*clock, &waiter, &events)?;
    let counts = session.ros.take().map(|ros| ros.end(&mut session.live, &*clock, &waiter));
    session.end(clock.now_ms(), counts);
    if let Some(foxglove) = foxglove {
        foxglove.end();
    }
    Ok(ExitCode::SUCCESS)
}

struct Session {
    live: Live,
    ros: Option<Link>,
    keeper: Keeper,
    view: Option<View>,
    json: bool,
    links: [Option<BoardLink>; 2],
    web: Option<Web>,
    released_ms: Option<u64>,
    keys: String,
}

impl Session {
    fn turn_until(
        &mut self,
        until_ms: u64,
        clock: &dyn Clock,
        waiter: &Waiter,
        events: &Receiver<LinkEvent<Hand>>,
    ) -> Result<()> {
        let mut drawn_ms = 0;
        while clock.now_ms() < until_ms && !self.ros.as_ref().is_some_and(Link::interrupted) {
            let event = waiter.receive(events, TURN);
            let woken = SystemTime::now();
            match event {
                Ok(event) => {
                    self.heard(event, clock.now_ms());
                    while let Ok(event) = events.try_recv() {
                        self.heard(event, clock.now_ms());
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => waiter.sleep(TURN),
            }
            let now_ms = clock.now_ms();
            if self.web.as_ref().is_some_and(Web::take_stop) {
                self.live.stop_key(now_ms);
            }
            if let Some(problem) = self.keeper.take_problem() {
                self.told(&problem);
            }
            let ready = [0, 1].map(|i| self.links[i].as_ref().is_some_and(BoardLink::is_ready));
            let told = self.ros.as_mut().map(|ros| ros.receive(&mut self.live, now_ms)).unwrap_or_default();
            let events = self.live.step(now_ms, ready);
            if let Some(ros) = &mut self.ros {
                ros.send(&mut self.live, &events, now_ms, woken);
            }
            for event in events {
                self.note(event)?;
            }
            for text in told {
                self.ros_line(now_ms, &text);
            }
            for hand in [Hand::Left, Hand::Right] {
                for frame in self.live.take_outgoing(hand) {
                    if let Some(link) = &self.links[hand as usize] {
                        link.send(&frame);
                    }
                }
            }
            if let Some(view) = &mut self.view {
                if now_ms - drawn_ms >= DRAW_MS {
                    drawn_ms = now_ms;
                    view.draw_scene(&Scene {
                        bridge: self.live.bridge(),
                        robot: self.live.robot(),
                        now_ms,
                        keys: &self.keys,
                        pace: String::new(),
                    })?;
                }
                while let Some(key) = self.view.as_mut().and_then(|view| view.pressed().transpose()) {
                    if self.press(key?, now_ms) {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }

    fn heard(&mut self, event: LinkEvent<Hand>, now_ms: u64) {
        let hand = event.link;
        match event.news {
            // By the time of handling: what waited is as old as it is.
            News::Bytes(bytes) => self.live.receive(hand, &bytes, now_ms),
            News::Opened => {
                let over_air = self.links[hand as usize].as_ref().is_some_and(|link| is_ble(link.port()));
                let what = if over_air { "connected over Bluetooth" } else { "the port is open" };
                self.link_line(now_ms, hand, true, what);
            }
            News::Closed(why) => self.link_line(now_ms, hand, false, &why),
        }
    }

    fn link_line(&mut self, time_ms: u64, hand: Hand, open: bool, text: &str) {
        if self.json {
            let line = LinkLine { time_ms, event: "link", hand, open, text };
            self.line(&serde_json::to_string(&line).unwrap_or_default());
        } else {
            self.line(&format!("{:>8.3} s  {hand} hand: {text}", time_ms as f64 / 1000.0));
        }
    }

    fn ros_line(&mut self, time_ms: u64, text: &str) {
        if self.json {
            let line = RosLine { time_ms, event: "ros2", text };
            self.line(&serde_json::to_string(&line).unwrap_or_default());
        } else {
            self.line(&format!("{:>8.3} s  ROS 2: {text}", time_ms as f64 / 1000.0));
        }
    }

    fn note(&mut self, event: BridgeEvent) -> Result<()> {
        if self.json {
            let line = serde_json::to_string(&event)?;
            self.line(&line);
            return Ok(());
        }
        let event = SessionEvent::Bridge(event);
        if !describe::is_echo(&event) {
            let time_s = describe::time_ms(&event) as f64 / 1000.0;
            self.line(&format!("{time_s:>8.3} s  {}", describe::text(&event)));
        }
        Ok(())
    }

    fn line(&mut self, line: &str) {
        match &mut self.view {
            Some(view) => view.note(line.to_owned()),
            // A closed pipe is no reason to stop the robot with a panic.
            None => {
                let mut out = std::io::stdout();
                let _ = writeln!(out, "{line}").and_then(|()| out.flush());
            }
        }
    }

    /// Handles a key; true when it means to quit.
    fn press(&mut self, key: KeyEvent, now_ms: u64) -> bool {
        let hand_key = match key.code {
            KeyCode::Up => Some(HandKey::Arrow(Heading::Forward)),
            KeyCode::Down => Some(HandKey::Arrow(Heading::Backward)),
            KeyCode::Left => Some(HandKey::Arrow(Heading::Left)),
            KeyCode::Right => Some(HandKey::Arrow(Heading::Right)),
            KeyCode::Char('q') => Some(HandKey::Faster),
            KeyCode::Char('z') => Some(HandKey::Slower),
            KeyCode::Char(digit @ '1'..='6') => Some(HandKey::Gesture(digit as u8 - b'0')),
            _ => None,
        };
        match (key.kind, hand_key) {
            (KeyEventKind::Release, Some(key)) => self.live.release_hand_key(key),
            (KeyEventKind::Release, None) => {}
            (_, Some(key)) => self.live.press(key, now_ms),
            (_, None) => match key.code {
                KeyCode::Esc => return true,
                KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return true,
                KeyCode::Char(' ') => self.live.stop_key(now_ms),
                KeyCode::Char('r') if self.released_ms.take().is_some_and(|t| now_ms - t < CONFIRM_MS) => {
                    self.live.release_key(now_ms);
                }
                KeyCode::Char('r') => {
                    self.released_ms = Some(now_ms);
                    self.line("press r again to release the stop");
                }
                _ => {}
            },
        }
        false
    }

    /// About the session's file.
    fn told(&mut self, text: &str) {
        if self.json {
            let line = serde_json::json!({ "event": "file", "text": text });
            self.line(&line.to_string());
        } else {
            self.line(text);
        }
    }

    fn end(&mut self, time_ms: u64, ros2: Option<Counts>) {
        self.view = None;
        if let Some(web) = self.web.take() {
            web.end(&self.live.now(time_ms));
        }
        if let Some(line) = self.keeper.end(self.live.tap_mut()) {
            self.told(&line);
        }
        let bridge = self.live.bridge();
        let odometry = self.live.robot().odometry();
        let links = [Hand::Left, Hand::Right].map(|hand| bridge.link(hand));
        if self.json {
            let end = EndLine {
                time_ms,
                event: "end",
                odometry,
                frames: links.map(|link| link.counters()),
                round_trip_ms: links.map(|link| link.round_trip_ms()),
                ros2,
            };
            self.line(&serde_json::to_string(&end).unwrap_or_default());
            return;
        }
        let text = format!(
            "{:.1} s; base: {:.2} m driven; frames: left {} ({} lost), right {} ({} lost)",
            time_ms as f64 / 1000.0,
            odometry.path_m,
            links[0].counters().frames,
            links[0].counters().lost,
            links[1].counters().frames,
            links[1].counters().lost
        );
        self.line(&text);
        if let Some(counts) = ros2 {
            self.line(&format!("ROS 2: {} speeds and {} arm motions sent", counts.twists, counts.motions));
        }
    }
}
