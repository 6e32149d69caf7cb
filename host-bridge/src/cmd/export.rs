//! `host-bridge export`: exports sessions for training robots.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Sessions written by `--record`, all of one robot; their episodes are numbered consecutively
    #[arg(required = true, value_name = "SESSION.mcap")]
    sessions: Vec<PathBuf>,
    /// Write a LeRobotDataset v3 to this new folder (feature lerobot)
    #[arg(long, value_name = "DIR", required_unless_present = "csv")]
    lerobot: Option<PathBuf>,
    /// Write one CSV file per episode to this new folder
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Number of rows per second of recording
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=200))]
    fps: u32,
    /// What counts as an episode: the whole session, each completed motion of the arm, or the marks
    /// that the operator set during the session
    /// [default: the marks, if there are any; otherwise the whole session]
    #[arg(long, value_enum)]
    episodes: Option<Episodes>,
    /// Export only episodes that were marked as good
    #[arg(long, conflicts_with = "begin")]
    only_good: bool,
    /// Instead, begin an episode at this gesture
    #[arg(long, value_name = "LABEL", requires = "end", conflicts_with = "episodes")]
    begin: Option<String>,
    /// End the episode at this gesture and mark it as good
    #[arg(long, value_name = "LABEL", requires = "begin")]
    end: Option<String>,
    /// Discard the current episode at this gesture and begin again
    #[arg(long, value_name = "LABEL", requires = "begin")]
    again: Option<String>,
    /// Description of the task [default: the recording's --task, otherwise the motion or the session's title]
    #[arg(long, value_name = "TEXT")]
    task: Option<String>,
    /// Name of the robot
    #[arg(long, value_name = "NAME", default_value = "bimanual")]
    robot: String,
}

/// The definition of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Episodes {
    /// The whole session
    Session,
    /// Each motion of the arm
    Motions,
    /// The episodes that the operator marked
    Marks,
}

/// Reports that this build does not support exports.
#[cfg(not(feature = "mcap"))]
pub fn run(_args: &Args) -> Result<ExitCode> {
    anyhow::bail!("this program was built without sessions on disk; build it with `--features lerobot`")
}

/// Exports the sessions. Nothing is written unless every session can be read.
#[cfg(feature = "mcap")]
pub fn run(args: &Args) -> Result<ExitCode> {
    use anyhow::{Context as _, ensure};
    use host_bridge::export::{Columns, Cut, Streams, csv, episodes, frames};

    #[cfg(not(feature = "lerobot"))]
    ensure!(
        args.lerobot.is_none(),
        "--lerobot: this program was built without parquet; build it with `--features lerobot`"
    );
    let mut joints: Option<Vec<String>> = None;
    let mut sessions = Vec::new();
    for file in &args.sessions {
        let about = || format!("{}", file.display());
        if host_bridge::journal::index::complete(file).map_err(anyhow::Error::msg)? {
            println!("{}: its recording was cut short; it has its index now", file.display());
        }
        let streams = Streams::read(&std::fs::read(file).with_context(about)?).with_context(about)?;
        let first = joints.get_or_insert_with(|| streams.joint_names.clone());
        ensure!(
            *first == streams.joint_names,
            "{}: its joints are {}, those of the first session {}; export sessions of one robot together",
            file.display(),
            streams.joint_names.join(", "),
            first.join(", ")
        );
        sessions.push((file, streams));
    }
    let marked = sessions.iter().any(|(_, streams)| streams.is_marked());
    let cut = match (&args.begin, &args.end, args.episodes) {
        (Some(begin), Some(end), _) => {
            Cut::Gestures { begin: begin.clone(), end: end.clone(), again: args.again.clone() }
        }
        (_, _, Some(Episodes::Motions)) => Cut::Motions,
        (_, _, Some(Episodes::Session)) => Cut::Whole,
        (_, _, None) if !marked && !args.only_good => Cut::Whole,
        _ => Cut::Marks { only_good: args.only_good },
    };
    if matches!(cut, Cut::Marks { .. }) {
        ensure!(
            marked,
            "nobody marked an episode in these sessions (`host-bridge record --session` takes marks); \
             --episodes session or motions says what else one is"
        );
        println!("the episodes are those that the operator marked");
    }
    let mut all = Vec::new();
    for (file, streams) in &sessions {
        let found = episodes::find(streams, &cut, args.task.as_deref());
        for (time_ms, why) in &found.left_out {
            println!("{}: from {:.3} s: left out: {why}", file.display(), *time_ms as f64 / 1000.0);
        }
        for episode in &found.episodes {
            match frames::rows(streams, episode, args.fps) {
                Ok(rows) => all.push(rows),
                Err(why) => {
                    let at_s = episode.start_ms as f64 / 1000.0;
                    println!("{}: the episode from {at_s:.3} s is refused: {why}", file.display());
                }
            }
        }
    }
    ensure!(!all.is_empty(), "there are no episodes; --episodes and --begin say what one is");
    let columns = Columns::of(&joints.unwrap_or_default());
    let frames: usize = all.iter().map(|rows| rows.state.len()).sum();
    let line = format!(
        "{} episodes, {frames} rows at {} a second, {} values of state, {} of action",
        all.len(),
        args.fps,
        columns.state.len(),
        columns.action.len()
    );
    if let Some(folder) = &args.csv {
        csv::write(folder, &columns, &all, args.fps)?;
        println!("{}: {line}", folder.display());
    }
    #[cfg(feature = "lerobot")]
    if let Some(folder) = &args.lerobot {
        host_bridge::export::lerobot::write(folder, &columns, &all, args.fps, &args.robot)?;
        println!("{}: {line}", folder.display());
    }
    Ok(ExitCode::SUCCESS)
}
