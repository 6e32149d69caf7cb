//! `host-bridge demo`: the bundled session of both hands, checked against its script.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context as _, Result};
use host_bridge::adc::AdcRecording;
use host_bridge::describe;
use host_bridge::hands::{LeftBoard, ModelFile, RightBoard};
use host_bridge::script::{Check, Script};
use host_bridge::session::{Session, Summary};
use models::recording::Recording;
use serde::Serialize;

use super::web::has_display;
use crate::play::{PlayOptions, play, say};

const SCRIPT: &str = include_str!("../../sessions/demo/session.toml");
const LEFT: &[u8] = include_bytes!("../../sessions/demo/left.csv");
const RIGHT: &[u8] = include_bytes!("../../sessions/demo/right.csv");

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    #[command(flatten)]
    play: PlayOptions,
}

#[derive(Serialize)]
struct Report<'a> {
    title: &'a str,
    model: &'a str,
    ok: bool,
    checks: &'a [Check],
    #[serde(flatten)]
    summary: &'a Summary,
}

/// Plays it; the exit code says whether everything came out as scripted.
pub fn run(args: &Args) -> Result<ExitCode> {
    let map = args.play.motion_map()?;
    let robot = args.play.robot()?;
    let script = Script::parse(SCRIPT).context("the bundled session.toml")?;
    let left = AdcRecording::parse(Path::new("sessions/demo/left.csv"), LEFT)?;
    let right = Recording::parse(Path::new("sessions/demo/right.csv"), RIGHT)?;
    let model = ModelFile::bundled()?;
    let about = format!("{} ({})", model.name(), model.about());
    let left = LeftBoard::new(left, Some(script.calibration.into()), 1);
    let right = RightBoard::new(right.resampled(), &model, 1)?;
    let mut session = Session::with_robot(Some(Box::new(left)), Some(Box::new(right)), map, robot);

    let title = format!("bimanual demo: {}", script.title);
    play(&mut session, &args.play, &format!("{title}\nmodel: {about}"), has_display())?;

    let summary = session.summary();
    let checks = script.expect.check(&summary);
    let ok = checks.iter().all(|check| check.ok);
    say(&args.play, &describe::summary(&summary));
    for check in &checks {
        let verdict = if check.ok { "ok    " } else { "FAILED" };
        say(&args.play, &format!("{verdict} {}: {}", check.what, check.got));
        if !check.ok {
            say(&args.play, &format!("       expected: {}", check.expected));
        }
    }
    if args.play.json {
        let report = Report { title: &title, model: &about, ok, checks: &checks, summary: &summary };
        println!("{}", serde_json::to_string(&report)?);
    }
    Ok(if ok { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
