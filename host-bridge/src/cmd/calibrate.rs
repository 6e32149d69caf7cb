//! `host-bridge calibrate`: calibrates the left hand in the steps neutral, rest and bend.
//! With `--one-handed`, it determines how the right hand's board is worn from three poses.

use std::io::{BufRead as _, Write as _};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::config::Config;
use host_bridge::links::Waiter;
use host_bridge::one_handed::{OneHanded, SINCE_MINOR};
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk, TalkError};
use host_bridge::taught::with_worn;
use host_bridge::worn::{Handedness, Level, PoseError};
use shared_proto::message::{AckResult, CalibrationStep, HostMessage, TiltThresholds, health};

use super::ports::{PortOptions, port_of, read_config, settings};

const HELLO_MS: u64 = 6000;
/// Maximum duration of a step, which consists of 0.64 s of measuring and the write to EEPROM.
const STEP_MS: u64 = 8000;
/// Boards describe their hardware at once after each hello.
const ABOUT_MS: u64 = 1000;
const ATTEMPTS: u32 = 3;

const STEPS: [(CalibrationStep, &str); 3] = [
    (CalibrationStep::Neutral, "hold the hand level and still, palm down"),
    (CalibrationStep::Rest, "keep it there and stretch both fingers"),
    (CalibrationStep::Bend, "keep it there and bend both fingers as far as is comfortable"),
];

/// The three poses of a right hand that drives.
const POSES: [&str; 3] = [
    "hold the hand level and still, palm down",
    "tilt the hand forward by about 30° (fingers down), and keep it still",
    "level it, then tilt it to the left by about 30° (left edge down), and keep it still",
];
/// Hops of 80 ms in a measurement of a pose, which takes as long as that of a left hand.
const HOPS: usize = 8;
/// Maximum difference between these hops along each axis, 0.05 g, which is about 3°.
const STEADY_MM_S2: u16 = 490;
/// Maximum duration of a measurement.
const MEASURE_MS: u64 = 3000;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    #[command(flatten)]
    port: PortOptions,
    /// Do not wait for Enter: start each step this many seconds after its announcement
    #[arg(long, value_name = "SECONDS")]
    every: Option<f64>,
    /// Delete the calibration in the board, which then uses the nominal values of its parts
    #[arg(long, conflicts_with = "every")]
    reset: bool,
    /// Determine how the right hand's board is worn, for `run --one-handed`, and write it into the --config file
    #[arg(long, conflicts_with = "reset")]
    one_handed: bool,
}

/// Performs the steps. The board stores each successful one.
pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(seconds) = args.every {
        ensure!((0.0..=60.0).contains(&seconds), "--every takes 0 to 60 seconds");
    }
    if args.one_handed {
        return one_handed(args);
    }
    let (port, settings) = args.port.resolve(Hand::Left)?;
    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    if who.board.hand() != Some(Hand::Left) {
        bail!(
            "{port}: {} answers; only the left hand's board is calibrated. For a right hand that drives, add --one-handed",
            who.board
        );
    }
    if args.reset {
        let step = CalibrationStep::Reset;
        talk.request(STEP_MS, |request| HostMessage::Calibrate { request, step })?;
        println!("forgotten; nominal parts are in use");
        return Ok(ExitCode::SUCCESS);
    }
    println!("{}, firmware {}: three steps of less than a second each", who.board, who.firmware);
    for (number, (step, pose)) in STEPS.iter().enumerate() {
        for attempt in 1.. {
            announce(talk.waiter(), number + 1, pose, args.every)?;
            match talk.request(STEP_MS, |request| HostMessage::Calibrate { request, step: *step }) {
                Ok(_) => break,
                Err(TalkError::Refused { result: AckResult::Unsteady, .. }) => {
                    println!("   refused: {}", why_refused(*step));
                    ensure!(
                        attempt < ATTEMPTS,
                        "step {} was refused {ATTEMPTS} times; the steps before it are kept, run calibrate again",
                        number + 1
                    );
                }
                Err(error) => {
                    bail!("{error}; the steps that succeeded before are kept, run calibrate again");
                }
            }
        }
        println!("   done");
    }
    report(&mut talk);
    Ok(ExitCode::SUCCESS)
}

/// Determines how the right hand's board is worn. The right board stores no calibration, so a configuration file does.
fn one_handed(args: &Args) -> Result<ExitCode> {
    let Some(file) = &args.port.config else {
        bail!(
            "name the file that the board's axes are written into: --config FILE (it is created if there is none)"
        );
    };
    let config = if file.exists() { read_config(Some(file))? } else { Config::default() };
    let port = port_of(Hand::Right, args.port.port.as_deref(), &config)?;
    let mut talk = Talk::open(&port, settings(&config, Hand::Right));
    let who = talk.hello(HELLO_MS)?;
    if who.board.hand() != Some(Hand::Right) {
        bail!("{port}: {} answers; only the right hand's board drives in one-handed mode", who.board);
    }
    ensure!(
        who.version.1 >= SINCE_MINOR,
        "{port}: its firmware (wire 1.{}) sends no tilt: update the board to wire 1.{SINCE_MINOR} \
         (firmware-nano33/README.md)",
        who.version.1
    );
    let axes = match talk.about(ABOUT_MS) {
        Some(about) => Handedness::of(about.sensor),
        None => {
            println!("the board does not say which sensor it has; its axes count as right-handed");
            Handedness::Right
        }
    };
    // The laptop applies the thresholds; the request only makes the board send its tilt.
    let thresholds = TiltThresholds::DEFAULT;
    talk.request(STEP_MS, |request| HostMessage::SetThresholds { request, thresholds })?;
    println!("{}, firmware {}: three poses of less than a second each", who.board, who.firmware);
    let level = pose(&mut talk, 0, args.every, |mean| Ok(Level::of(mean)?))?;
    let worn = pose(&mut talk, 1, args.every, |mean| Ok(level.forward(config.one_handed, axes, mean)?))?;
    pose(&mut talk, 2, args.every, |mean| Ok(level.check_left(&worn, mean)?))?;
    store(file, &worn)?;
    println!(
        "{}: the fingers are at {}, the left edge at {}, and up is {}; the neutral pose is {} mrad forward and {} mrad left",
        file.display(),
        worn.forward.name(),
        worn.left.name(),
        worn.up.name(),
        worn.neutral_pitch_mrad,
        worn.neutral_roll_mrad
    );
    println!("next: host-bridge run --one-handed --right {port} --config {}", file.display());
    Ok(ExitCode::SUCCESS)
}

/// Announces a pose and measures it, until it is clear or was refused too often.
fn pose<T>(
    talk: &mut Talk,
    number: usize,
    every: Option<f64>,
    judge: impl Fn([f64; 3]) -> Result<T>,
) -> Result<T> {
    let mut refused = 0;
    loop {
        announce(talk.waiter(), number + 1, POSES[number], every)?;
        let found = match measure(talk)? {
            Some(mean) => judge(mean),
            None => Err(anyhow::anyhow!("the hand moved; keep it still for a second")),
        };
        match found {
            Ok(found) => {
                println!("   done");
                return Ok(found);
            }
            Err(why) => {
                println!("   refused: {why}");
                refused += 1;
                // Another tilt could only confirm whichever of the two poses is wrong.
                let contradicts = why.downcast_ref().is_some_and(PoseError::is_contradiction);
                ensure!(!contradicts, "two poses contradict each other, and nothing is stored: {why}");
                ensure!(
                    refused < ATTEMPTS,
                    "pose {} was refused {ATTEMPTS} times, and nothing is stored; run calibrate again",
                    number + 1
                );
            }
        }
    }
}

/// Measures the mean acceleration in mm/s²; `None` means that the hand moved.
fn measure(talk: &mut Talk) -> Result<Option<[f64; 3]>> {
    let from_ms = talk.now_ms();
    // The first hop may have begun before the pose.
    let mut hops = Vec::with_capacity(HOPS + 1);
    while hops.len() <= HOPS {
        ensure!(
            talk.now_ms() < from_ms + MEASURE_MS,
            "{}: the board sends no tilt; restart it, and run calibrate again",
            talk.port()
        );
        match talk.next(50) {
            Some((at_ms, Said::Tilt(tilt))) if at_ms >= from_ms => hops.push(tilt.acceleration_mm_s2),
            Some((_, Said::Closed(why))) => bail!("{why}"),
            _ => {}
        }
    }
    let hops = &hops[1..];
    let mut mean = [0.0; 3];
    for (axis, mean) in mean.iter_mut().enumerate() {
        let along = || hops.iter().map(|hop| hop[axis]);
        let (least, most) = (along().min().unwrap_or_default(), along().max().unwrap_or_default());
        if most.abs_diff(least) > STEADY_MM_S2 {
            return Ok(None);
        }
        *mean = along().map(f64::from).sum::<f64>() / hops.len() as f64;
    }
    Ok(Some(mean))
}

/// Writes the axes into the file, and preserves everything else.
fn store(file: &Path, worn: &OneHanded) -> Result<()> {
    let about = || file.display().to_string();
    let text = if file.exists() { std::fs::read_to_string(file).with_context(about)? } else { String::new() };
    let new = with_worn(&text, worn).with_context(about)?;
    // Checks that the new file is valid, and that it says what was measured.
    let read = Config::parse(&new).with_context(about)?.one_handed;
    ensure!(
        OneHanded { on: worn.on, ..read } == *worn,
        "{}: the keys of [one_handed] cannot be written here; write the section anew, and run calibrate again",
        about()
    );
    models::recording::write_whole(file, new.as_bytes()).with_context(about)
}

/// Describes possible problems of a pose, because the board only reports a failure.
fn why_refused(step: CalibrationStep) -> &'static str {
    match step {
        CalibrationStep::Neutral => {
            "the hand moved, or it is not level with the palm down; hold it so, and still, for a second"
        }
        CalibrationStep::Rest => "a finger moved; keep both straight and still for a second",
        CalibrationStep::Bend => {
            "a finger moved, or reads about the same as when it was straight; bend both further and hold still. If they are \
             bent, a flex sensor slips, sits on another finger, or its divider has the wrong resistor"
        }
        CalibrationStep::Reset => "the board could not forget its calibration; restart it",
    }
}

fn announce(waiter: &Waiter, number: usize, pose: &str, every: Option<f64>) -> Result<()> {
    match every {
        Some(seconds) => {
            println!("{number}. {pose}");
            waiter.sleep(Duration::from_secs_f64(seconds));
        }
        None => {
            print!("{number}. {pose}, then press Enter ");
            std::io::stdout().flush()?;
            let mut line = String::new();
            let count = waiter.aside(|| std::io::stdin().lock().read_line(&mut line))?;
            ensure!(count > 0, "nobody can press Enter here; use --every 3 for a step every 3 seconds");
        }
    }
    Ok(())
}

/// Prints the current readings of the hand. The neutral pose should be close to 0°.
fn report(talk: &mut Talk) {
    let until_ms = talk.now_ms() + 1000;
    let mut last = None;
    while talk.now_ms() < until_ms {
        if let Some((_, Said::Left(state))) = talk.next(50) {
            last = Some(state);
        }
    }
    let Some(state) = last else {
        println!("calibrated and kept in the board, which has fallen silent since: see `host-bridge doctor`");
        return;
    };
    let degrees = |mrad: i16| (f64::from(mrad) / 1000.0).to_degrees();
    println!(
        "calibrated and kept in the board; it reads pitch {:.0}°, roll {:.0}° now",
        degrees(state.pitch_mrad),
        degrees(state.roll_mrad)
    );
    if state.health & !health::DEFAULT_CALIBRATION != 0 {
        println!("but it reports trouble (health {:#04x}): `host-bridge doctor` says more", state.health);
    }
}
