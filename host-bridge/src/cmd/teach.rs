//! `host-bridge teach NAME`: where the robot's arm is now becomes a pose; `--play` goes there.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::arm::Director;
use host_bridge::arm::motions::is_grasp;
use host_bridge::base::Twist;
use host_bridge::config::Config;
use host_bridge::ending::Ending;
use host_bridge::robot::{Door as _, Joints, MotionName, Report, Robot};
use host_bridge::robots::Stage;
use host_bridge::ros2::ArmInterface;
use host_bridge::taught::with_pose;

use super::ports::read_config;
use super::ros2::{FAREWELL_MS, Graph};
use super::run::check_braking;
use crate::play::{Interrupted, stage, stage_of};

/// The robot is waited for so long.
const SEARCH: Duration = Duration::from_secs(8);
const TURN: Duration = Duration::from_millis(5);
/// Nothing that is taught moves faster,
const REST_RAD_S: f64 = 0.02;
/// nor further in this time.
const RESTED: Duration = Duration::from_millis(500);
const NOISE_RAD: f64 = 0.002;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Name of the pose; a gesture goes there with --map LABEL=NAME, or one line under [motions]
    #[arg(value_name = "NAME")]
    name: String,
    /// Scene that the pose is written into; with it motions are planned
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Configuration file: the robot's names under ros2, and the pose where no scene is given
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Goes to the pose (or does the motion) of that name instead
    #[arg(long)]
    play: bool,
    /// Does not ask before the arm moves
    #[arg(long, requires = "play")]
    yes: bool,
}

/// Asks the robot where it is, or sends it there.
pub fn run(args: &Args) -> Result<ExitCode> {
    let mut config = match &args.config {
        Some(file) if !file.exists() && !args.play => Config::default(),
        file => read_config(file.as_deref())?,
    };
    if config.ros2.arm == ArmInterface::None {
        bail!("[ros2] says arm = \"none\": there is no arm to teach");
    }
    let Some(into) = args.scene.as_ref().or(args.config.as_ref()).filter(|_| !args.play) else {
        ensure!(args.play, "name the file that the pose is written into: --scene FILE or --config FILE");
        return play(args, &config);
    };
    let is_taken = is_grasp(&args.name) || [MotionName::END_ARM, "ready"].contains(&args.name.as_str());
    ensure!(!args.name.trim().is_empty() && !is_taken, "'{}' is no name for a pose of yours", args.name);
    // The arm may have any place now; its speed limits are not asked for.
    let stage = stage(&config, args.scene.as_deref())?;
    let count = stage.planner.as_ref().map_or(host_bridge::robot::JOINTS, |p| p.world().arm().joints.len());
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
    // As it will be, it can be used.
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

/// A configuration as it will be can be used.
fn check(text: &str) -> Result<()> {
    Stage::new(&Config::parse(text)?, None)?;
    Ok(())
}

type Remote = Director<Box<dyn Robot + Send>>;

fn open(config: &Config, stage: &Stage) -> Result<Remote> {
    let base = stage.simulator(config).base_limits().to_owned();
    let graph = Graph::open(&config.ros2, stage.limits, base, None)?;
    eprintln!("{}", graph.about);
    let robot: Box<dyn Robot + Send> = Box::new(graph.driver);
    Ok(stage.before(robot))
}

/// The arm's angles, once they have been the same for a while: not every driver tells speeds.
fn here(door: &mut Remote) -> Result<Joints> {
    let start = Instant::now();
    let mut rested: Option<(Joints, Instant)> = None;
    while start.elapsed() < SEARCH {
        door.step(start.elapsed().as_millis() as u64);
        if let Some(arm) = door.robot().arm() {
            let here = arm.value.joints_rad;
            let moves = arm.value.velocity_rad_s.iter().any(|v| v.abs() > REST_RAD_S);
            match rested {
                Some((there, since)) if !moves && is_near(&here, &there) => {
                    if since.elapsed() >= RESTED {
                        return Ok(here);
                    }
                }
                _ => rested = Some((here, Instant::now())),
            }
        }
        std::thread::sleep(TURN);
    }
    match rested {
        Some(_) => bail!("the arm still moves; let it rest, then teach"),
        None => bail!(
            "no angles of all joints within {} s: are joint_states and joint_names under [ros2] the robot's? \
             `host-bridge doctor --ros2` tells",
            SEARCH.as_secs()
        ),
    }
}

fn is_near(one: &Joints, two: &Joints) -> bool {
    one.iter().zip(two).all(|(a, b)| (a - b).abs() <= NOISE_RAD)
}

/// Goes there as a gesture would.
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
    let now_ms = || start.elapsed().as_millis() as u64;
    let name = MotionName::from(args.name.as_str());
    let turn = |door: &mut Remote| -> Option<bool> {
        door.step(now_ms());
        // It says that somebody commands; the base stays where it is.
        door.drive(Twist::ZERO);
        let mut reached = None;
        for report in door.take_reports() {
            match report {
                Report::MotionEnded { reached: there, .. } => reached = Some(there),
                Report::Note(text) => eprintln!("{text}"),
                _ => {}
            }
        }
        door.send();
        std::thread::sleep(TURN);
        reached
    };
    // The robot is waited for; the motion is asked for once.
    let mut ready = false;
    while !ready && start.elapsed() < SEARCH && !ended.load(Ordering::SeqCst) {
        turn(&mut door);
        ready = door.refusal().is_none() && door.robot().can_follow().is_ok();
    }
    if let Some(refusal) = door.refusal() {
        bail!("the robot refuses to move: {refusal}");
    }
    let mut started = Ok(());
    let (mut reached, mut refused) = (None, None);
    if !ended.load(Ordering::SeqCst) {
        started = door.start_motion(&name);
        while started.is_ok() && reached.is_none() && refused.is_none() && !ended.load(Ordering::SeqCst) {
            reached = turn(&mut door);
            refused = door.refusal();
        }
    }
    if reached != Some(true) {
        door.halt();
        let until_ms = now_ms() + FAREWELL_MS;
        while now_ms() < until_ms {
            turn(&mut door);
        }
    }
    if let Some(refusal) = refused {
        bail!("the robot refuses to move on: {refusal}");
    }
    if ended.load(Ordering::SeqCst) {
        return Err(Interrupted.into());
    }
    started.map_err(|why| anyhow::anyhow!("'{}' does not start: {why}", args.name))?;
    ensure!(reached == Some(true), "'{}' was given up on the way", args.name);
    println!("'{}' reached", args.name);
    Ok(ExitCode::SUCCESS)
}
