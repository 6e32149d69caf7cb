//! `host-bridge record`: records raw samples of one hand, or a session of both hands with the robot.
//! `models train` and Edge Impulse read the right hand's files, and `replay --left` reads the left hand's.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::capture::{CaptureProblem, Collector, LeftCollector, sparkline};
use host_bridge::ending::Ending;
use host_bridge::keyboard::LABELS;
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk, TalkError};
use host_bridge::wearer::next_file;
use models::recording::write_whole;
use shared_proto::message::{AckResult, HostMessage, Mode};

use super::ports::PortOptions;
use super::{keep, run as steering};
use crate::play::Interrupted;

const HELLO_MS: u64 = 6000;
const REQUEST_MS: u64 = 4000;
/// Maximum time for returning the board to classifying. It is short, because the program is about to end.
const BACK_MS: u64 = 700;
/// If no samples arrive for this long, the board is not recording.
const SILENCE_MS: u64 = 3000;
/// Number of attempts for a recording in a guided session.
const ATTEMPTS: u32 = 3;

/// Labels of a guided session of the left hand.
const LEFT_LABELS: &str = "level,forward,backward,left,right,index,middle,both-fingers";

/// Options.
#[derive(clap::Args, Clone, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    whole: Option<Whole>,
    /// The hand to record: the right one's IMU for `models train`, or the left one's converter for `replay --left`
    #[arg(long, value_enum, default_value = "right")]
    hand: Which,
    #[command(flatten)]
    port: PortOptions,
    /// Label of the gesture or movement, for example circle
    #[arg(long, required_unless_present = "guided", conflicts_with = "guided")]
    label: Option<String>,
    /// Name of the person who performs it
    #[arg(long, required = true)]
    person: Option<String>,
    /// Length of a recording in seconds (in the paper: 150)
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// Lead through all labels, one after another
    #[arg(long)]
    guided: bool,
    /// Labels of a guided session, separated by commas [default: the model's; for the left hand level,forward,…]
    #[arg(long, requires = "guided")]
    labels: Option<String>,
    /// Number of seconds to get ready before a recording starts
    #[arg(long, default_value_t = 3)]
    countdown: u64,
    /// Folder in which the files <label>/<person>__<n>.csv are written [default: recordings; for the left hand recordings-left]
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Recordings of both hands.
#[derive(clap::Subcommand, Clone, Debug)]
enum Whole {
    /// Record both hands together with the robot to FILE.mcap, like `run --record FILE.mcap`, with marks of episodes
    #[command(long_flag = "session")]
    Recorder(Box<SessionArgs>),
}

/// Options of a whole session.
#[derive(clap::Args, Clone, Debug)]
struct SessionArgs {
    /// The new file; `replay FILE.mcap` plays it, and `export FILE.mcap` converts it to a data set
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// Description of the session's task, for `export`
    #[arg(long, value_name = "TEXT")]
    task: Option<String>,
    #[command(flatten)]
    hands: steering::HandArgs,
}

/// The hand to record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Which {
    /// The IMU of the right hand
    Right,
    /// The converter of the left hand, which measures tilt and fingers
    Left,
}

/// Records samples. Every file is written completely or not at all.
pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(Whole::Recorder(session)) = &args.whole {
        let keep = keep::KeepArgs { record: Some(session.file.clone()), task: session.task.clone() };
        return steering::steer(&session.hands, &keep);
    }
    ensure!((0.5..=3600.0).contains(&args.seconds), "--seconds takes 0.5 to 3600");
    ensure!(args.countdown <= 60, "--countdown takes up to 60 seconds");
    let person = args.person.as_deref().unwrap_or_default();
    check_person("--person", person)?;
    let (hand, known, folder) = match args.hand {
        Which::Right => (Hand::Right, LABELS, "recordings"),
        Which::Left => (Hand::Left, LEFT_LABELS, "recordings-left"),
    };
    let out = args.out.clone().unwrap_or_else(|| folder.into());
    let labels: Vec<String> = match &args.label {
        Some(label) => vec![label.clone()],
        None => {
            let labels = args.labels.as_deref().unwrap_or(known);
            labels.split(',').map(|label| label.trim().to_owned()).collect()
        }
    };
    for label in &labels {
        check_name("label", label)?;
    }
    // Disk space is checked before the user performs anything.
    for label in &labels {
        let folder = out.join(label);
        make_folder(&folder)?;
        // The name is specific to this process, because another recording of the same label may run this check too.
        let trial = folder.join(format!("{person}.{}.trial", std::process::id()));
        std::fs::write(&trial, []).and_then(|()| std::fs::remove_file(&trial)).with_context(|| {
            format!("{}: nothing can be written here; is there room, and may you?", folder.display())
        })?;
    }
    let (port, settings) = args.port.resolve(hand)?;
    // From now on, a signal only sets a flag, so that the board can be returned to classifying.
    let interrupted = Arc::new(AtomicBool::new(false));
    let _ending = Ending::watch(&interrupted, false).context("signals cannot be caught here")?;

    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    let is_left = who.board.hand() == Some(Hand::Left);
    if is_left != (hand == Hand::Left) {
        let (there, option) = if is_left { ("left", "--hand left") } else { ("right", "--hand right") };
        bail!(
            "{port}: {} answers, the {there} hand's board; `record {option}` records it, or give the {hand} hand's port",
            who.board
        );
    }
    let mode = |mode| move |request| HostMessage::SetMode { request, mode };
    talk.request(REQUEST_MS, mode(Mode::Record)).map_err(|error| match error {
        TalkError::Refused { port, result: AckResult::Unsupported, .. } => anyhow::anyhow!(
            "{port}: this board's firmware ({}, protocol {}.{}) sends no samples; flash it with the one of this version",
            who.firmware, who.version.0, who.version.1
        ),
        other => other.into(),
    })?;
    let mut session =
        Recorder { talk, args, person, out: &out, sample_hz: who.sample_hz, interrupted: &interrupted };
    let mut done = Ok(());
    for (number, label) in labels.iter().enumerate() {
        if args.guided {
            let what = if label == "idle" {
                " (what a hand does between gestures: rest, reach, turn over, walk)"
            } else {
                ""
            };
            println!("{} of {}: {label}{what}", number + 1, labels.len());
        }
        done = session.record(label);
        if done.is_err() {
            break;
        }
    }
    // This happens after any result. If the board does not answer, `run` will do it.
    let patience_ms = if session.is_interrupted() { BACK_MS } else { REQUEST_MS };
    let back = session.talk.request(patience_ms, mode(Mode::Classify));
    done?;
    if back.is_err() {
        println!("the board did not go back to classifying; restart it, or just start `host-bridge run`");
    }
    match args.hand {
        Which::Right => println!("next: models train {} --out trained", out.display()),
        Which::Left => {
            println!("next: host-bridge replay --left FILE, with --calibration start where it begins level")
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// A person's name, which is also part of file names.
pub fn check_person(option: &str, name: &str) -> Result<()> {
    check_name(option, name)?;
    ensure!(!name.contains("__"), "{option}: two underscores end the name in a file; use one");
    Ok(())
}

/// Checks a name that becomes part of a file path.
fn check_name(what: &str, name: &str) -> Result<()> {
    let plain = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
    ensure!(
        !name.is_empty() && name.chars().all(plain),
        "{what} {name:?}: use letters, digits, - and _ only"
    );
    Ok(())
}

/// The samples recorded so far.
enum Taken {
    Right(Collector),
    Left(LeftCollector),
}

impl Taken {
    /// Processes a message. Returns whether there are enough samples, or `None` for messages without samples of this hand.
    fn push(&mut self, said: &Said) -> Option<Result<bool, CaptureProblem>> {
        match (self, said) {
            (Taken::Right(collector), Said::Raw(batch)) => Some(collector.push(batch)),
            (Taken::Left(collector), Said::RawLeft(raw)) => Some(collector.push(raw)),
            _ => None,
        }
    }

    fn len(&self) -> usize {
        match self {
            Taken::Right(collector) => collector.len(),
            Taken::Left(collector) => collector.len(),
        }
    }

    fn clipped(&self) -> usize {
        match self {
            Taken::Right(collector) => collector.clipped(),
            Taken::Left(collector) => collector.clipped(),
        }
    }

    /// Describes the hand's movement: its acceleration, or its forward tilt and both fingers.
    fn line(&self) -> String {
        match self {
            Taken::Right(collector) => sparkline(&collector.newest_acceleration(40), 4.0, 20.0),
            Taken::Left(collector) => {
                let line = |n, least, most| sparkline(&collector.newest(n, 12), least, most);
                format!("x {} index {} middle {}", line(0, 0.4, 0.6), line(3, 0.4, 0.8), line(4, 0.4, 0.8))
            }
        }
    }

    fn csv(self) -> String {
        match self {
            // Writes the header that Edge Impulse expects, which our own tools also read.
            Taken::Right(collector) => {
                collector.recording().to_csv().replacen("timestamp_ms", "timestamp", 1)
            }
            Taken::Left(collector) => collector.recording().to_csv(),
        }
    }
}

struct Recorder<'a> {
    talk: Talk,
    args: &'a Args,
    person: &'a str,
    out: &'a Path,
    sample_hz: u16,
    interrupted: &'a AtomicBool,
}

impl Recorder<'_> {
    /// Records one label until there is one good recording.
    fn record(&mut self, label: &str) -> Result<()> {
        let attempts = if self.args.guided { ATTEMPTS } else { 1 };
        for attempt in 1.. {
            match self.take(label) {
                Ok(taken) => return self.save(label, taken),
                Err(error) if attempt < attempts && !error.is::<Interrupted>() => {
                    println!("   {error:#}; once more");
                }
                Err(error) if error.is::<Interrupted>() => return Err(error),
                Err(error) => return Err(error.context("nothing was saved")),
            }
        }
        Ok(())
    }

    fn take(&mut self, label: &str) -> Result<Taken> {
        for left in (1..=self.args.countdown).rev() {
            println!("   {label} in {left} …");
            let until_ms = self.talk.now_ms() + 1000;
            while self.talk.now_ms() < until_ms {
                self.ensure_wanted()?;
                self.ensure_open(50)?;
            }
        }
        // Samples from the countdown do not belong to the recording.
        while self.talk.next(0).is_some() {}
        println!("   go: {label}, {} s", self.args.seconds);
        let rate_hz = f64::from(self.sample_hz.max(1));
        let wanted = (self.args.seconds * rate_hz).round() as usize;
        let mut taken = match self.args.hand {
            Which::Right => Taken::Right(Collector::new(wanted, self.sample_hz)),
            Which::Left => Taken::Left(LeftCollector::new(wanted, self.sample_hz)),
        };
        let mut heard_ms = self.talk.now_ms();
        let mut full = false;
        while !full {
            self.ensure_wanted()?;
            let said = self.talk.next(100);
            if let Some((at_ms, said)) = &said
                && let Some(pushed) = taken.push(said)
            {
                heard_ms = *at_ms;
                full = pushed?;
                self.show(&taken, rate_hz);
                continue;
            }
            match said {
                Some((_, Said::Closed(why))) => bail!("{why}"),
                Some((_, Said::Hello(_))) => {
                    bail!("the board restarted; check its power and cable, and record again");
                }
                Some((_, Said::Fault(fault))) => println!("   the board reports {:?}", fault.kind),
                _ if self.talk.now_ms() - heard_ms > SILENCE_MS => {
                    bail!("{}: no samples for 3 s; restart the board and try again", self.talk.port());
                }
                _ => {}
            }
        }
        if std::io::stdout().is_terminal() {
            println!();
        }
        Ok(taken)
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    fn ensure_wanted(&self) -> Result<()> {
        if self.is_interrupted() {
            println!("\ninterrupted: this take was not saved");
            return Err(Interrupted.into());
        }
        Ok(())
    }

    fn ensure_open(&mut self, patience_ms: u64) -> Result<()> {
        match self.talk.next(patience_ms) {
            Some((_, Said::Closed(why))) => bail!("{why}"),
            _ => Ok(()),
        }
    }

    /// Displays a progress bar, the time, and the hand's movement.
    fn show(&self, taken: &Taken, rate_hz: f64) {
        const BAR: usize = 20;
        if !std::io::stdout().is_terminal() {
            return;
        }
        let seconds = taken.len() as f64 / rate_hz;
        let part = ((seconds / self.args.seconds * BAR as f64) as usize).min(BAR);
        let line = taken.line();
        print!("\r   [{}{}] {seconds:>5.1} s  {line} ", "#".repeat(part), ".".repeat(BAR - part));
        let _ = std::io::stdout().flush();
    }

    fn save(&self, label: &str, taken: Taken) -> Result<()> {
        let (samples, clipped) = (taken.len(), taken.clipped());
        let folder = self.out.join(label);
        let file = next_file(&folder, self.person)
            .with_context(|| format!("{}: no file can be made there", folder.display()))?;
        let text = taken.csv();
        let about = || format!("{}: cannot be written; is there room, and may you?", file.display());
        if let Err(error) = write_whole(&file, text.as_bytes()) {
            // The empty file only reserved the name.
            let _ = std::fs::remove_file(&file);
            return Err(error).with_context(about);
        }
        println!("   saved {} ({samples} samples, no gaps)", file.display());
        if clipped > 0 && self.args.hand == Which::Left {
            println!(
                "   {clipped} samples stand at an end of the converter: a line is open, shorted or out of its range; \
                 check the wiring"
            );
        } else if clipped > 0 {
            println!(
                "   {clipped} samples are clipped: the sensor's range was not enough. Move less fast{}",
                if clipped * 100 > samples { " and record it again: more than 1 % is too much" } else { "" }
            );
        }
        Ok(())
    }
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: the folder cannot be made", folder.display()))
}
