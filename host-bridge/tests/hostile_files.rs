//! Feeds damaged configurations, scenes, arms and models to their parsers.
//! The parsers must not panic, hang, or use unlimited memory.
//!
//! The damage is generated as in `fuzz.rs`, and hangs are detected by processor time.
//! With `BIMANUAL_FULL=1` each parser gets 100,000 files.
#![cfg(unix)]

use std::path::Path;
use std::time::Duration;

use host_bridge::config::Config;
use host_bridge::hands::ModelFile;
use host_bridge::scene::Scene;
use models::card::Card;
use shared_dsp::right::network::Model;

#[path = "../../models/tests/common/damage.rs"]
mod damage;

use damage::{Rng, damage};

/// Limit in processor time, which does not depend on the load of the machine. A longer delay would look like a hang.
const SLOW: Duration = Duration::from_secs(2);
const MEMORY_MAX_MB: u64 = 500;

/// Returns the processor time of this thread.
fn worked() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) / 1024
}

/// Gives mutated files to a parser that returns whether it accepted the file.
fn torment(name: &str, seeds: &[&[u8]], parse: impl Fn(&[u8]) -> bool) {
    let count = if std::env::var_os("BIMANUAL_FULL").is_some() { 100_000 } else { 200 };
    let mut rng = Rng(name.len() as u64);
    let (mut worst, mut taken) = (Duration::ZERO, 0);
    for (n, seed) in seeds.iter().enumerate() {
        assert!(parse(seed), "{name}: seed {n} is good");
    }
    for n in 0..count {
        let mut file = seeds[n % seeds.len()].to_vec();
        let donor = seeds[rng.below(seeds.len())];
        for _ in 0..1 + rng.below(4) {
            damage(&mut rng, &mut file, donor);
        }
        let began = worked();
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| parse(&file)));
        let took = worked() - began;
        if done.is_err() || took > SLOW {
            let kept = std::env::temp_dir().join(format!("hostile-{}-{n}", name.replace(' ', "-")));
            std::fs::write(&kept, &file).unwrap();
            panic!(
                "{name}, file {n}: {} after {took:?}; kept as {}",
                if done.is_err() { "a panic" } else { "slow" },
                kept.display()
            );
        }
        taken += usize::from(done.unwrap_or(false));
        worst = worst.max(took);
    }
    println!("row: mutated files: {name} | {count}, {taken} still good | {} ms | 2000 ms", worst.as_millis());
    let memory_mb = peak_mb();
    assert!(memory_mb < MEMORY_MAX_MB, "{name}: {memory_mb} MB");
}

fn text(bytes: &[u8]) -> std::borrow::Cow<'_, str> {
    String::from_utf8_lossy(bytes)
}

fn bytes(file: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap()
}

#[test]
fn configurations() {
    let all = Config::default().to_toml();
    let more = "left_handed = true\n[ros2]\nestop = '/e_stop'\n\
                [[pose]]\nname = 'up'\njoints_rad = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\n\
                [[motion]]\nname = 'wave'\nsteps = [{ to = 'up' }]\n";
    torment("configurations", &[all.as_bytes(), more.as_bytes()], |file| Config::parse(&text(file)).is_ok());
}

#[test]
fn scenes() {
    let scenes: Vec<Vec<u8>> =
        ["bins", "shelf", "posts", "room"].iter().map(|name| bytes(&format!("scenes/{name}.toml"))).collect();
    let seeds: Vec<&[u8]> = scenes.iter().map(Vec::as_slice).collect();
    torment("scenes", &seeds, |file| Scene::parse(&text(file)).is_ok());
}

#[cfg(feature = "urdf")]
#[test]
fn descriptions_of_arms() {
    use host_bridge::arm::urdf::{Missing, parse};
    let arm = bytes("scenes/other-arm.urdf");
    torment("descriptions of arms (URDF)", &[&arm], |file| {
        let missing = Missing::of(&host_bridge::scene::ArmTable::default());
        parse(&text(file), &missing).is_ok()
    });
}

#[test]
fn models_and_their_cards() {
    let model = ModelFile::bundled().unwrap();
    torment("models of the board", &[model.blob()], |file| Model::parse(file).is_ok());
    let card = bytes("../models/bundled/right-aligned.card.json");
    torment("cards of models", &[&card], |file| Card::parse(Path::new("a.card.json"), file).is_ok());
}
