//! `host-bridge demo`: plays the bundled session of both hands and compares it with its script.

use std::process::ExitCode;

use anyhow::Result;
use host_bridge::demo::Demo;
use host_bridge::describe;
use host_bridge::hands::ModelFile;
use host_bridge::script::Check;
use host_bridge::session::Summary;
use serde::Serialize;

use super::web::has_display;
use crate::play::{PlayOptions, play, say};

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

/// Plays the session. The exit code shows whether the result matches the script.
pub fn run(args: &Args) -> Result<ExitCode> {
    let stage = args.play.stage()?;
    let (robot, map) = args.play.robot_and_map(&stage)?;
    let named = stage.planner.as_ref().and_then(|planner| planner.world().scene().demo.as_deref());
    let demo = Demo::named(named).map_err(anyhow::Error::msg)?;
    let script = demo.script.clone();
    let model = ModelFile::bundled()?;
    let about = format!("{} ({})", model.name(), model.about());
    let mut session = demo.session(&model, map, robot)?;

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
