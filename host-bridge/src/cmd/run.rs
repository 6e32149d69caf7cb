//! `host-bridge run`: the user drives the robot with boards, or with keys that replace boards.

use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::config::{Config, HandInput, KEYBOARD};
use host_bridge::control::{Control, Flags, Work};
use host_bridge::ending::Ending;
use host_bridge::engine::Engine;
use host_bridge::foxglove::Foxglove;
use host_bridge::keyboard::{KeyLeft, KeyRight};
use host_bridge::links::{Clock, Link as BoardLink, SystemClock, is_ble, is_serial_over_air, queue};
use host_bridge::profile;
use host_bridge::robot::brake::longest_s;
use host_bridge::robot::{Door as _, Robot};
use host_bridge::robots::{Echoed, Stage};
use host_bridge::ros2::stream::HORIZON_MS;
use host_bridge::ros2::{ArmInterface, Counts, Stamped};
use host_bridge::safety::{Hand, PerHand};
use host_bridge::source::Source;
use host_bridge::view::View;
use host_bridge::wearer::{self, Wearer};
use host_bridge::web::Web;

use super::keep::{KeepArgs, Start, origin};
use super::lines::PageLine;
use super::ports::{check_name, read_config, settings};
use super::ros2::{FAREWELL_MS, Graph, Output};
use super::screen::{Held, SHOW, Screen, keys};
use super::web::WebArgs;
use crate::play::{check_motions, stage};

/// Maximum braking time of an arm that is driven through a graph.
const BRAKING_MAX_S: f64 = 1.0;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    #[command(flatten)]
    pub hands: HandArgs,
    #[command(flatten)]
    pub keep: KeepArgs,
}

/// The options that select hands and robot, also used by `record --session`.
#[derive(clap::Args, Clone, Debug)]
pub struct HandArgs {
    /// Port of the left hand's board (tilt and bends for the base), `ble[:NAME]`, or `keyboard`
    #[arg(long, value_name = "PORT|ble[:NAME]|keyboard")]
    left: Option<String>,
    /// Port of the right hand's board (gestures for the arm), `ble[:NAME]`, or `keyboard`
    #[arg(long, value_name = "PORT|ble[:NAME]|keyboard")]
    right: Option<String>,
    /// Configuration file (TOML) with ports, thresholds, limits and motions
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the complete configuration in effect and exit
    #[arg(long)]
    print_config: bool,
    /// Assign a motion to a label of your own model, such as wave=pick-up (repeatable)
    #[arg(long, value_name = "LABEL=MOTION")]
    map: Vec<String>,
    /// Let this gesture mark episodes of a recorded session instead of moving anything: LABEL=begin, end, again,
    /// good or bad
    /// (repeatable)
    #[arg(long, value_name = "LABEL=MARK")]
    mark: Vec<String>,
    /// Exchange the hands: --left is then the port of the gesture board, and --right that of the tilt board
    #[arg(long)]
    left_handed: bool,
    /// Use no left hand: the right hand's own tilt drives the base while no gesture is drawn. The board needs firmware with
    /// wire 1.6 or later
    #[arg(long)]
    one_handed: bool,
    /// Also drive a robot on a ROS 2 graph, as configured under ros2
    #[arg(long)]
    ros2: bool,
    /// Publish speeds as Twist instead of TwistStamped
    #[arg(long, requires = "ros2")]
    unstamped: bool,
    /// Without a robot: publish the simulator's joint states, odometry and transforms
    #[arg(long, requires = "ros2")]
    publish_sim: bool,
    /// Print events as lines instead of the live view
    #[arg(long)]
    headless: bool,
    /// Print events as JSON, one object per line, instead of the live view
    #[arg(long)]
    json: bool,
    /// End after this many seconds
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Scene (TOML: boxes, poses, base, arm) in which the arm plans its paths without contact. Its base and arm replace
    /// those of the configuration
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Limit the arm's jerk to the configuration's jerk_rad_s3 (a scene sets this in its own file)
    #[arg(long, conflicts_with = "scene")]
    jerk_limited: bool,
    /// Who wears the right hand: shows each gesture three times (key t, or the page's button), and gets a model of their
    /// own [default: a guest]
    #[arg(long, value_name = "NAME")]
    wearer: Option<String>,
    /// Where wearers' models and recordings are kept, a folder for each
    #[arg(long, value_name = "FOLDER", default_value = "wearers")]
    wearers: PathBuf,
    /// The model to start from, if the right hand's board does not run the bundled one;
    /// its card, .float.tflite and .memory.bin lie beside it
    #[arg(long, value_name = "FILE.tflite")]
    model: Option<PathBuf>,
    #[command(flatten)]
    web: WebArgs,
}

/// Runs until the user quits or the time is over.
pub fn run(args: &Args) -> Result<ExitCode> {
    steer(&args.hands, &args.keep)
}

/// Like [`run`], but with a session file that another command has selected.
pub fn steer(args: &HandArgs, keep: &KeepArgs) -> Result<ExitCode> {
    let mut config = read_config(args.config.as_deref())?;
    config.left_handed |= args.left_handed;
    config.one_handed.on |= args.one_handed;
    config.arm.jerk_limited |= args.jerk_limited;
    if args.unstamped {
        config.ros2.stamped = Stamped::Fixed(false);
    }
    if args.publish_sim {
        // In this case, the motion belongs to the simulator's arm.
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
    for marking in &args.mark {
        let (label, mark) = marking.split_once('=').context("--mark takes LABEL=MARK, such as wave=begin")?;
        let mark = mark.parse().map_err(anyhow::Error::msg).context("--mark")?;
        config.marks.insert(label.trim().to_owned(), mark);
    }
    if let Some(name) = &args.wearer {
        super::record::check_person("--wearer", name)?;
    }
    if let Some(scene) = &args.scene {
        profile::take(&mut config, scene).map_err(anyhow::Error::msg)?;
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
        !config.one_handed.on || !right.is_empty(),
        "one-handed: give the port of the right hand's board with --right; `host-bridge list` shows the ports"
    );
    ensure!(
        // Left and right hands advertise different services, so `ble` alone names one board of each kind.
        left == KEYBOARD || left == "ble" || left != right,
        "{left}: both hands cannot be on the same port; `host-bridge list` shows the ports"
    );
    for port in [&left, &right] {
        check_name(port)?;
    }
    for port in [&left, &right] {
        ensure!(
            !is_serial_over_air(port) || config.ports.allow_unbonded,
            "{port} is a serial port over Bluetooth, and whether its module is bonded cannot be told: use a cable, or set \
             allow_unbonded = true under [ports] (the base alone, at most 0.2 m/s)"
        );
    }
    let is_terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal();
    let wants_view = is_terminal && !args.headless && !args.json;
    let inputs = config.inputs();
    let by_keyboard = inputs.iter().any(|(_, input)| *input == HandInput::Keyboard);
    ensure!(
        wants_view || !by_keyboard,
        "a keyboard hand needs the live view: start it in a terminal, without --headless and --json"
    );

    ensure!(
        inputs.right == HandInput::Board || (args.wearer.is_none() && args.model.is_none()),
        "--wearer and --model are for a right hand with a board: give its port with --right"
    );

    let stage = stage(&config, args.scene.as_deref())?;
    stage.tell(&mut config.ros2);
    let map = config.motion_map();
    check_motions(&map, &config.mappings(), &stage.motions)?;
    let records = keep.record.is_some();
    let web = args.web.start(false, records)?;
    let braking_s = if args.ros2 { check_braking(&config, &stage)? } else { 0.0 };
    let graph = if args.ros2 {
        let base = stage.simulator(&config).base_limits().to_owned();
        let simulated = args.publish_sim.then(|| stage.simulated(&config).setting());
        Some(Graph::open(&config.ros2, stage.limits, base, simulated.as_ref())?)
    } else {
        None
    };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    // Until the control thread has reported its state, the session counts as busy.
    let starting = clock.waiter();
    let (sender, events) = queue();
    let open = |hand: Hand, port: &str| {
        (inputs[hand] == HandInput::Board).then(|| {
            BoardLink::start(hand, port, settings(&config, hand), Arc::clone(&clock), sender.clone())
        })
    };
    let links = PerHand { left: open(Hand::Left, &left), right: open(Hand::Right, &right) };
    let over_air = PerHand::of(|hand| links[hand].as_ref().is_some_and(|link| is_ble(link.port())));
    let name = |port: &str| if port.is_empty() { "none".to_owned() } else { port.to_owned() };
    let third_stop = match config.ros2.arm {
        ArmInterface::None => String::new(),
        ArmInterface::Stream => {
            format!(", arm at rest {:.2} s after the last word", 0.001 * HORIZON_MS as f64 + braking_s)
        }
        ArmInterface::Action | ArmInterface::Topic => {
            ", arm in whole motions: without a third stop".to_owned()
        }
    };
    let about =
        graph.as_ref().map_or("simulated robot".to_owned(), |graph| graph.about.clone() + &third_stop);
    let mut title = format!("bimanual: left hand {}, right hand {}, {about}", name(&left), name(&right));
    if config.one_handed.on {
        title += "\none-handed: the right hand's tilt drives the base while no gesture is drawn";
    }
    if let Some(restriction) = config.restriction() {
        title += &format!("\n{}", restriction.text);
    }
    let source = |input: HandInput, keys: &dyn Fn() -> Source<'static>| match input {
        HandInput::Nobody => Source::Nobody,
        HandInput::Board => Source::link(),
        HandInput::Keyboard => keys(),
    };
    let sources = [
        source(inputs.left, &|| Source::here(KeyLeft::new(config.keyboard))),
        source(inputs.right, &|| Source::here(KeyRight::new())),
    ];
    let (counts, output, robot) = robot(&stage, &config, graph, args.publish_sim, clock.now_ms());
    let robot_elsewhere = counts.is_some() && !args.publish_sim;
    let mut engine =
        Engine::new(config.bridge(map), stage.before(robot).planning_aside(), sources, clock.now_ms())
            .with_tilt(config.tilt)
            .with_vibration(config.vibration.wired);
    if records {
        engine = engine.with_marks(config.marks.clone());
    }
    let origin = origin(clock.now_ms());
    if let Some(output) = output {
        engine.tap_mut().add(Box::new(output));
    }
    let foxglove = args.web.start_foxglove(origin)?;
    if let Some(foxglove) = &foxglove {
        engine.tap_mut().add(Box::new(foxglove.teller()));
        title += &format!("\nfoxglove: {}", foxglove.url());
    }
    if let Some(web) = &web {
        engine.tap_mut().add(Box::new(web.watcher(&title)));
        title += &format!("\npage: {}", web.url());
    }
    let start = Start {
        title: &title,
        config: &config,
        maps: &[],
        scene: args.scene.as_deref(),
        origin,
        live: true,
        robot_elsewhere,
    };
    let keeper = keep.start(engine.tap_mut(), &start)?;
    let flags = Flags::default();
    let ending = Ending::watch(&flags.quit_flag(), wants_view)?;
    let shows = inputs.right == HandInput::Board && config.keyboard.end_arm != SHOW;
    let clutch = config.jog.key.chars().next();
    let keys = keys(config.keyboard.end_arm, clutch, by_keyboard, records, shows);
    let mut screen = Screen {
        view: if wants_view { Some(View::open(&title)?) } else { None },
        json: args.json,
        keeper,
        over_air,
        released: None,
        records,
        shows,
        keys,
        end_arm: config.keyboard.end_arm,
        clutch,
        clutch_held: Held::default(),
    };
    if screen.view.is_none() && !args.json {
        screen.line(&title);
    }
    let urls = [("page", web.as_ref().map(Web::url)), ("foxglove", foxglove.as_ref().map(Foxglove::url))];
    for (event, url) in urls {
        if let (true, Some(url)) = (args.json, url) {
            let line = PageLine { time_ms: clock.now_ms(), event, url: &url };
            screen.line(&serde_json::to_string(&line)?);
        }
    }
    let who = wearer::Settings {
        name: args.wearer.clone(),
        folder: args.wearers.clone(),
        model: args.model.clone(),
    };
    let has_wearer = inputs.right == HandInput::Board;
    let wearer = has_wearer.then(|| Wearer::start(who, &*clock)).transpose()?;
    let work = Work {
        engine,
        clock: Arc::clone(&clock),
        links,
        events,
        asks_for_stop: web.as_ref().map_or_else(|| Box::new(|| false) as _, |web| Box::new(web.stops()) as _),
        wearer,
        shows: web.as_ref().map_or_else(|| Box::new(|| false) as _, |web| Box::new(web.shows()) as _),
        marks: web.as_ref().map_or_else(|| Box::new(|| None) as _, |web| Box::new(web.marks()) as _),
        until_ms: args.seconds.map_or(u64::MAX, |seconds| (seconds * 1000.0) as u64),
        farewell_ms: if counts.is_some() { FAREWELL_MS } else { 0 },
    };
    let control = Control::start(work, flags.clone())?;
    starting.leave();
    let shown = screen.show(&control, &flags);
    let dropped = control.dropped();
    let engine = control.end();
    screen.view = None;
    shown?;
    let mut engine = engine.context("the control thread failed; the robot was halted")?;
    let time_ms = clock.now_ms();
    if let Some(web) = web {
        web.end(&engine.now(time_ms));
    }
    if let Some(line) = screen.keeper.end(engine.tap_mut()) {
        screen.told(&line);
    }
    let counts = counts.map(|counts| *counts.lock().unwrap_or_else(PoisonError::into_inner));
    screen.end(&engine.now(time_ms), counts, dropped);
    if let Some(foxglove) = foxglove {
        foxglove.end();
    }
    if let Some(text) = ending.panicked() {
        bail!("a thread failed, and the robot was halted; please report this: {text}");
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the longest braking time of the arm, if it is short enough for streaming.
pub fn check_braking(config: &Config, stage: &Stage) -> Result<f64> {
    check_joints(config, stage)?;
    let braking_s = longest_s(&stage.limits);
    ensure!(
        config.ros2.arm != ArmInterface::Stream || braking_s <= BRAKING_MAX_S,
        "the arm would take {braking_s:.1} s to brake: lower velocity_scaling or raise acceleration_scaling under \
         [arm] until it is {BRAKING_MAX_S} s or less"
    );
    Ok(braking_s)
}

/// Checks that the robot's arm has as many joints as the arm for which motions are planned.
pub fn check_joints(config: &Config, stage: &Stage) -> Result<()> {
    let (name, joints) = stage.arm();
    let names = config.ros2.joint_names.len();
    ensure!(
        config.ros2.arm == ArmInterface::None || names == joints,
        "joint_names under [ros2] has {names} names, and {name} {joints} joints: name all of them from the foot on, or give the \
         arm's own description in a scene (urdf under [arm], --scene FILE)"
    );
    Ok(())
}

type AnyRobot = Box<dyn Robot + Send>;

/// Returns the robot on the graph, or the simulator.
fn robot(
    stage: &Stage,
    config: &Config,
    graph: Option<Graph>,
    publish_sim: bool,
    now_ms: u64,
) -> (Option<Arc<Mutex<Counts>>>, Option<Output>, AnyRobot) {
    let simulator = || stage.simulator(config).starting_at(now_ms);
    match graph {
        None => (None, None, Box::new(simulator())),
        Some(Graph { driver, output, counts, .. }) => {
            let robot: AnyRobot = if publish_sim {
                Box::new(Echoed { simulator: simulator(), graph: driver })
            } else {
                Box::new(driver)
            };
            (Some(counts), Some(output), robot)
        }
    }
}
