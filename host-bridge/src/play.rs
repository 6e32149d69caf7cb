//! Plays a session in real time and displays it.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::{Director, Motions};
use host_bridge::config::Config;
use host_bridge::describe;
use host_bridge::ending::Ending;
use host_bridge::intent::MotionMap;
use host_bridge::observe::{SessionEvent, Snapshot};
use host_bridge::plan::Planner;
use host_bridge::robot::{Door, MotionName};
use host_bridge::robots::Stage;
use host_bridge::scene::Scene;
use host_bridge::session::Session;
use host_bridge::sim::Simulator;
use host_bridge::view::{Key, Scene as Shown, View};
use host_bridge::web::Web;

use crate::cmd::keep::{KeepArgs, Start, origin};
use crate::cmd::web::WebArgs;

/// Interval at which the terminal is drawn.
const DRAW_INTERVAL: Duration = Duration::from_millis(33);
/// Interval at which the session's time advances.
const TURN: Duration = Duration::from_millis(4);

/// Options of all commands that play a session.
#[derive(clap::Args, Clone, Debug)]
pub struct PlayOptions {
    /// Speed relative to real time; 0 = as fast as the machine can
    #[arg(long, default_value_t = 1.0)]
    pub speed: f64,
    /// Print events as lines instead of the live view
    #[arg(long)]
    pub headless: bool,
    /// Print one JSON object at the end on stdout; events go to stderr
    #[arg(long)]
    pub json: bool,
    /// Assign an arm motion or pose to a label, LABEL=MOTION (repeatable). Without a scene: home, pick-up, place,
    /// place-top-right, place-bottom-right, random-top and the poses of motions/paper.toml
    #[arg(long, value_name = "LABEL=MOTION")]
    pub map: Vec<String>,
    /// Scene (TOML: boxes, poses, base, arm) in which the arm plans its paths without contact
    #[arg(long, value_name = "FILE.toml")]
    pub scene: Option<PathBuf>,
    /// Limit the arm's jerk to 4.3 rad/s³ (a scene sets this in its own file)
    #[arg(long, conflicts_with = "scene")]
    pub jerk_limited: bool,
    #[command(flatten)]
    pub web: WebArgs,
    #[command(flatten)]
    pub keep: KeepArgs,
}

impl PlayOptions {
    /// Returns the default configuration with the requested changes.
    fn config(&self) -> Config {
        let mut config = Config::default();
        config.arm.jerk_limited = self.jerk_limited;
        config
    }

    /// Returns the surroundings and the motions of the arm.
    pub fn stage(&self) -> Result<Stage> {
        stage(&self.config(), self.scene.as_deref())
    }

    /// Returns the simulated robot behind its door, and the paper's map with the requested changes.
    pub fn robot_and_map(&self, stage: &Stage) -> Result<(Director<Simulator>, MotionMap)> {
        let door = stage.simulated(&self.config());
        let mut map = MotionMap::default();
        for mapping in &self.map {
            map.assign(mapping)?;
        }
        check_motions(&map, &self.map, door.motions())?;
        Ok((door, map))
    }

    fn check(&self) -> Result<()> {
        ensure!(
            self.speed.is_finite() && self.speed >= 0.0,
            "--speed {} is not a speed; use 1 for real time, 20 for twenty times that, 0 for full speed",
            self.speed
        );
        Ok(())
    }
}

/// Returns the configured stage in the scene of a file.
pub fn stage(config: &Config, scene: Option<&Path>) -> Result<Stage> {
    let Some(file) = scene else { return Ok(Stage::new(config, None)?) };
    let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    stage_of(config, &text, file)
}

/// Like [`stage`], but with this text instead of the file's content.
pub fn stage_of(config: &Config, text: &str, file: &Path) -> Result<Stage> {
    let about = || format!("{}", file.display());
    let scene = Scene::parse(text).with_context(about)?;
    let arm = arm(&scene, file)?;
    let planner = Planner::new(arm, scene).with_context(about)?;
    for note in planner.world().notes() {
        eprintln!("{}: {note}", file.display());
    }
    Stage::new(config, Some(planner)).with_context(about)
}

/// Checks that explicitly mapped motions exist.
/// Other motions of the paper's map may be missing for another arm.
pub fn check_motions(map: &MotionMap, mappings: &[String], motions: &Motions) -> Result<()> {
    for label in mappings.iter().filter_map(|mapping| mapping.split_once('=')).map(|(label, _)| label.trim())
    {
        if let Some(motion) = map.motion(label).filter(|motion| **motion != *MotionName::END_ARM) {
            motions.get(motion.as_str()).with_context(|| format!("in the mapping of '{label}'"))?;
        }
    }
    Ok(())
}

/// Returns the scene's arm. It is the Gen3, or an arm from a file whose path is relative to the scene.
fn arm(scene: &Scene, scene_file: &Path) -> Result<SerialArm> {
    let Some(urdf) = &scene.arm.urdf else { return Ok(SerialArm::gen3()) };
    let file = scene_file.parent().unwrap_or(Path::new("")).join(urdf);
    #[cfg(feature = "urdf")]
    {
        let about = || format!("{}", file.display());
        let read = host_bridge::arm_file::read(urdf, scene_file, &scene.arm);
        let read = read.map_err(anyhow::Error::msg).with_context(about)?;
        let missing = host_bridge::arm::urdf::Missing::of(&scene.arm);
        let arm = host_bridge::arm::urdf::parse(&read.text, &missing).with_context(about)?;
        for note in read.notes.iter().chain(&arm.notes) {
            eprintln!("{}: {note}", file.display());
        }
        Ok(arm)
    }
    #[cfg(not(feature = "urdf"))]
    anyhow::bail!("{}: this program reads no URDF; build it with `--features urdf`", file.display())
}

/// The user pressed q or Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Plays to the end. With `page_unasked`, a page is also served if a port is free.
pub fn play<D: Door>(
    session: &mut Session<'_, D>,
    options: &PlayOptions,
    title: &str,
    page_unasked: bool,
) -> Result<()> {
    options.check()?;
    let a_terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal();
    let wants_view = a_terminal && !options.headless && !options.json;
    let web = options.web.start(page_unasked && wants_view, false)?;
    let origin = origin(session.now_ms());
    let foxglove = options.web.start_foxglove(origin)?;
    let mut headline = title.to_owned();
    if let Some(foxglove) = &foxglove {
        session.tap_mut().add(Box::new(foxglove.teller()));
        headline += &format!("\nfoxglove: {}", foxglove.url());
    }
    if let Some(web) = &web {
        session.tap_mut().add(Box::new(web.watcher(title)));
        headline += &format!("\npage: {}", web.url());
    }
    let ended = Arc::new(AtomicBool::new(false));
    // This must happen before the view uses the terminal.
    // An end in between would leave the terminal in raw mode.
    let _ending = Ending::watch(&ended, wants_view)?;
    let mut view = if wants_view { Some(View::open(&headline)?) } else { None };
    if view.is_none() {
        say(options, &headline);
    }
    let mut drawn: Option<Instant> = None;
    let mut keeper = options.keep.start(
        session.tap_mut(),
        &Start {
            title,
            config: &options.config(),
            maps: &options.map,
            scene: options.scene.as_deref(),
            origin,
            live: false,
            robot_elsewhere: false,
        },
    )?;
    let started = Instant::now();
    while !session.finished() {
        if ended.load(Ordering::SeqCst) {
            return Err(Interrupted.into());
        }
        let wanted_ms = if options.speed == 0.0 {
            session.now_ms() + 1000
        } else {
            (started.elapsed().as_secs_f64() * options.speed * 1000.0) as u64
        };
        while session.now_ms() < wanted_ms && !session.finished() {
            for event in session.step() {
                note(&event, view.as_mut(), options);
            }
        }
        if web.as_ref().is_some_and(Web::take_stop) {
            session.stop_key();
        }
        if let Some(problem) = keeper.take_problem() {
            match &mut view {
                Some(view) => view.note(problem),
                None => say(options, &problem),
            }
        }
        match &mut view {
            Some(view) => {
                if drawn.is_none_or(|at| at.elapsed() >= DRAW_INTERVAL) {
                    drawn = Some(Instant::now());
                    view.draw(&Shown {
                        snapshot: &Snapshot::of(&session.now()),
                        keys: "space: stop   q: quit",
                        pace: format!("×{}   ", options.speed),
                    })?;
                }
                match view.key(TURN)? {
                    Some(Key::Quit) => return Err(Interrupted.into()),
                    Some(Key::Stop) => session.stop_key(),
                    None => {}
                }
            }
            None if options.speed > 0.0 => std::thread::sleep(TURN),
            None => {}
        }
    }
    if let Some(web) = web {
        web.end(&session.now());
    }
    drop(view);
    let line = keeper.end(session.tap_mut());
    if let Some(foxglove) = foxglove {
        foxglove.end();
    }
    if let Some(line) = line {
        say(options, &line);
    }
    Ok(())
}

fn note(event: &SessionEvent, view: Option<&mut View>, options: &PlayOptions) {
    if describe::is_echo(event) {
        return;
    }
    let time_s = describe::time_ms(event) as f64 / 1000.0;
    let line = format!("{time_s:>8.3} s  {}", describe::text(event));
    match view {
        Some(view) => view.note(line),
        None => say(options, &line),
    }
}

/// Prints a line on a stream where it does not disturb the JSON object.
pub fn say(options: &PlayOptions, line: &str) {
    use std::io::Write as _;
    // A closed pipe (`| head`) must not interrupt the session with a panic.
    if options.json {
        let _ = writeln!(std::io::stderr(), "{line}");
    } else {
        let _ = writeln!(std::io::stdout(), "{line}");
    }
}
