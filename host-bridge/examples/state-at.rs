//! Prints the state of the demo at given times, as one JSON object per line.
//! This is an example of an observer, and `tests/web` compares its output with the web page.
//!
//! ```text
//! printf '1000\n2500\n' | cargo run -p host-bridge --example state-at [SCENE.toml]
//! ```

use std::collections::BTreeSet;
use std::io::BufRead as _;

use anyhow::{Context as _, Result};
use host_bridge::arm::gen3::COUNT;
use host_bridge::arm::model::SerialArm;
use host_bridge::config::Config;
use host_bridge::demo::Demo;
use host_bridge::hands::ModelFile;
use host_bridge::intent::MotionMap;
use host_bridge::observe::{Now, Observer, Snapshot, link_poses_in_world};
use host_bridge::plan::Planner;
use host_bridge::robots::Stage;
use host_bridge::scene::Scene;

/// Prints the state at these times.
struct Printer(BTreeSet<u64>);

impl Observer for Printer {
    fn state(&mut self, now: &Now<'_>) {
        if self.0.remove(&now.time_ms) {
            let links = link_poses_in_world(now, &now.robot.picture().arm.joints_rad);
            // The page draws one frame for each joint of the arm, and one for the flange.
            let links = &links[..=COUNT];
            // Written directly, as the page's own state is: through a JSON value, an `f32` would become a longer `f64`.
            let texts = (serde_json::to_string(&Snapshot::of(now)), serde_json::to_string(links));
            let (Ok(state), Ok(links)) = texts else { return eprintln!("a state has no JSON text") };
            println!("{{\"state\":{state},\"links\":{links}}}");
        }
    }
}

fn main() -> Result<()> {
    let planner = match std::env::args().nth(1) {
        None => None,
        Some(file) => {
            let text = std::fs::read_to_string(&file).with_context(|| file.clone())?;
            let scene = Scene::parse(&text).with_context(|| file.clone())?;
            Some(Planner::new(SerialArm::gen3(), scene).context(file)?)
        }
    };
    let config = Config::default();
    let robot = Stage::new(&config, planner)?.simulated(&config);
    let mut times = BTreeSet::new();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        times.insert(line.trim().parse().with_context(|| format!("'{line}' is no time in ms"))?);
    }
    let last_ms = times.last().copied().unwrap_or(0);

    let model = ModelFile::bundled()?;
    let mut session = Demo::bundled().session(&model, MotionMap::default(), robot)?;
    session.tap_mut().add(Box::new(Printer(times)));
    while session.now_ms() <= last_ms && !session.finished() {
        session.step();
    }
    Ok(())
}
