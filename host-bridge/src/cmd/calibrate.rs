//! `host-bridge calibrate`: calibrates the left hand in the steps neutral, rest and bend.

use std::io::{BufRead as _, Write as _};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use host_bridge::links::Waiter;
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk, TalkError};
use shared_proto::message::{AckResult, CalibrationStep, HostMessage, health};

use super::ports::PortOptions;

const HELLO_MS: u64 = 6000;
/// Maximum duration of a step, which consists of 0.64 s of measuring and the write to EEPROM.
const STEP_MS: u64 = 8000;
const ATTEMPTS: u32 = 3;

const STEPS: [(CalibrationStep, &str); 3] = [
    (CalibrationStep::Neutral, "hold the hand level and still, palm down"),
    (CalibrationStep::Rest, "keep it there and stretch both fingers"),
    (CalibrationStep::Bend, "keep it there and bend both fingers as far as is comfortable"),
];

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
}

/// Performs the steps. The board stores each successful one.
pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(seconds) = args.every {
        ensure!((0.0..=60.0).contains(&seconds), "--every takes 0 to 60 seconds");
    }
    let (port, settings) = args.port.resolve(Hand::Left)?;
    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    if who.board.hand() != Some(Hand::Left) {
        bail!("{port}: {} answers; only the left hand's board is calibrated", who.board);
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
