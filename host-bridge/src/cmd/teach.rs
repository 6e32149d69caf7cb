//! `host-bridge teach NAME`: saves the robot's current arm pose; `--play` moves to it.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::arm::Director;
use host_bridge::arm::motions::is_grasp;
use host_bridge::config::Config;
use host_bridge::ending::Ending;
use host_bridge::profile;
use host_bridge::robot::{Door as _, Joints, MotionName, Robot};
use host_bridge::robots::Stage;
use host_bridge::ros2::ArmInterface;
use host_bridge::taught::with_pose;
use host_bridge::teach::{Play, Played, Rest, SEARCH_MS};

use super::ports::read_config;
use super::ros2::{FAREWELL_MS, Graph};
use super::run::{check_braking, check_joints};
use crate::play::{Interrupted, stage, stage_of};

/// Interval for reading the robot's state.
const TURN: Duration = Duration::from_millis(5);

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Name of the pose; a gesture moves to it with --map LABEL=NAME, or a line under [motions]
    #[arg(value_name = "NAME")]
    name: String,
    /// Scene file for the pose, in which motions are also planned
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Configuration file with the robot's names under ros2, and for the pose if there is no scene
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Instead of saving a pose, move to the pose with this name (or perform the motion)
    #[arg(long)]
    play: bool,
    /// Do not ask before the arm moves
    #[arg(long, requires = "play")]
    yes: bool,
}

/// Reads the robot's pose, or moves it.
pub fn run(args: &Args) -> Result<ExitCode> {
    let mut config = match &args.config {
        Some(file) if !file.exists() && !args.play => Config::default(),
        file => read_config(file.as_deref())?,
    };
    if let Some(scene) = &args.scene {
        profile::take(&mut config, scene).map_err(anyhow::Error::msg)?;
    }
    if config.ros2.arm == ArmInterface::None {
        bail!("[ros2] says arm = \"none\": there is no arm to teach");
    }
    let Some(into) = args.scene.as_ref().or(args.config.as_ref()).filter(|_| !args.play) else {
        ensure!(args.play, "name the file that the pose is written into: --scene FILE or --config FILE");
        return play(args, &config);
    };
    let is_taken = is_grasp(&args.name) || [MotionName::END_ARM, "ready"].contains(&args.name.as_str());
    ensure!(!args.name.trim().is_empty() && !is_taken, "'{}' is no name for a pose of yours", args.name);
    // The arm may be anywhere, and its speed limits are not needed.
    let stage = stage(&config, args.scene.as_deref())?;
    check_joints(&config, &stage)?;
    let (_, count) = stage.arm();
    config.ros2.arm = ArmInterface::Topic;
    let mut door = open(&config, &stage)?;
    let joints_rad = here(&mut door)?;
    let text = if into.exists() {
        std::fs::read_to_string(into).with_context(|| into.display().to_string())?
    } else {
        String::new()
    };
    let about = || into.display().to_string();
    let new = with_pose(&text, &args.name, &joints_rad[..count]).with_context(about)?;
    // Checks that the new file is valid.
    match &args.scene {
        Some(scene) => drop(stage_of(&config, &new, scene)?),
        None => check(&new).with_context(about)?,
    }
    models::recording::write_whole(into, new.as_bytes()).with_context(about)?;
    let angles: Vec<String> = joints_rad[..count].iter().map(|angle| format!("{angle:.3}")).collect();
    println!("{}: pose '{}' is [{}] rad", into.display(), args.name, angles.join(", "));
    println!("--map LABEL={} lets a gesture go there", quoted(&args.name));
    Ok(ExitCode::SUCCESS)
}

fn quoted(name: &str) -> String {
    if name.contains(' ') { format!("\"{name}\"") } else { name.to_owned() }
}

/// Checks that the new configuration is valid.
fn check(text: &str) -> Result<()> {
    Stage::new(&Config::parse(text)?, None)?;
    Ok(())
}

type Remote = Director<Box<dyn Robot + Send>>;

fn open(config: &Config, stage: &Stage) -> Result<Remote> {
    let base = stage.simulator(config).base_limits().to_owned();
    let mut ros2 = config.ros2.clone();
    stage.tell(&mut ros2);
    let graph = Graph::open(&ros2, stage.limits, base, None)?;
    eprintln!("{}", graph.about);
    let robot: Box<dyn Robot + Send> = Box::new(graph.driver);
    Ok(stage.before(robot))
}

/// Returns the arm's angles as soon as it rests.
fn here(door: &mut Remote) -> Result<Joints> {
    let start = Instant::now();
    let mut rest = Rest::default();
    loop {
        let now_ms = start.elapsed().as_millis() as u64;
        if now_ms >= SEARCH_MS {
            break;
        }
        door.step(now_ms);
        if let Some(joints_rad) = door.robot().arm().and_then(|arm| rest.see(&arm.value, now_ms)) {
            return Ok(joints_rad);
        }
        std::thread::sleep(TURN);
    }
    ensure!(!rest.was_told(), "the arm still moves; let it rest, then teach");
    bail!(
        "no angles of all joints within {} s: are joint_states and joint_names under [ros2] the robot's? \
         `host-bridge doctor --ros2` tells",
        SEARCH_MS / 1000
    )
}

/// Moves to the pose, like a gesture.
fn play(args: &Args, config: &Config) -> Result<ExitCode> {
    let stage = stage(config, args.scene.as_deref())?;
    stage.motions.get(&args.name)?;
    check_braking(config, &stage)?;
    if !args.yes {
        ensure!(
            std::io::stdin().is_terminal(),
            "--play asks before the arm moves; give --yes where nobody can answer"
        );
        eprint!("The arm will move to '{}'. Enter goes, Ctrl-C does not, and stops it later: ", args.name);
        std::io::stderr().flush()?;
        std::io::stdin().read_line(&mut String::new())?;
    }
    let mut door = open(config, &stage)?;
    let ended = Arc::new(AtomicBool::new(false));
    let _ending = Ending::watch(&ended, false)?;
    let start = Instant::now();
    let mut play = Play::new(args.name.as_str().into(), FAREWELL_MS);
    loop {
        let now_ms = start.elapsed().as_millis() as u64;
        let interrupted = ended.load(Ordering::SeqCst);
        match play.turn(&mut door, now_ms, interrupted, |text| eprintln!("{text}")) {
            None => std::thread::sleep(TURN),
            Some(Played::Reached) => break,
            Some(Played::Interrupted) => return Err(Interrupted.into()),
            Some(Played::Not(why)) => bail!("{why}"),
        }
    }
    println!("'{}' reached", args.name);
    Ok(ExitCode::SUCCESS)
}
