//! `host-bridge record`: the right hand's raw samples into files that `models train` and Edge Impulse read.

use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::capture::{Collector, sparkline};
use host_bridge::ending::Ending;
use host_bridge::keyboard::LABELS;
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk};
use models::recording::write_whole;
use shared_proto::message::{Board, HostMessage, Mode};

use super::ports::PortOptions;
use crate::play::Interrupted;

const HELLO_MS: u64 = 6000;
const REQUEST_MS: u64 = 4000;
/// A program that was told to end has less time to bring the board back.
const BACK_MS: u64 = 700;
/// Without samples for so long the board is not recording.
const SILENCE_MS: u64 = 3000;
/// In a guided session a spoilt take is taken again.
const ATTEMPTS: u32 = 3;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    #[command(flatten)]
    port: PortOptions,
    /// Which gesture this is, for example circle
    #[arg(long, required_unless_present = "guided", conflicts_with = "guided")]
    label: Option<String>,
    /// Who performs it
    #[arg(long)]
    person: String,
    /// Length of a recording (the paper's: 150)
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// Walk through all labels, one after the other
    #[arg(long)]
    guided: bool,
    /// Labels of a guided session, separated by commas
    #[arg(long, default_value = LABELS, requires = "guided")]
    labels: String,
    /// Seconds to get ready
    #[arg(long, default_value_t = 3)]
    countdown: u64,
    /// Folder for FOLDER/<label>/<person>__<n>.csv
    #[arg(long, value_name = "FOLDER", default_value = "recordings")]
    out: PathBuf,
}

/// Records; every file is written whole or not at all.
pub fn run(args: &Args) -> Result<ExitCode> {
    ensure!((0.5..=3600.0).contains(&args.seconds), "--seconds takes 0.5 to 3600");
    ensure!(args.countdown <= 60, "--countdown takes up to 60 seconds");
    check_name("--person", &args.person)?;
    ensure!(!args.person.contains("__"), "--person: two underscores end the name in a file; use one");
    let labels: Vec<String> = match &args.label {
        Some(label) => vec![label.clone()],
        None => args.labels.split(',').map(|label| label.trim().to_owned()).collect(),
    };
    for label in &labels {
        check_name("label", label)?;
    }
    // Whether there is room is known before anybody performs anything for it.
    for label in &labels {
        let folder = args.out.join(label);
        make_folder(&folder)?;
        let trial = folder.join(format!("{}.trial", args.person));
        std::fs::write(&trial, []).and_then(|()| std::fs::remove_file(&trial)).with_context(|| {
            format!("{}: nothing can be written here; is there room, and may you?", folder.display())
        })?;
    }
    let (port, settings) = args.port.resolve(Hand::Right)?;
    // From here on an end from outside is a flag, so that the board can be brought back to classifying.
    let interrupted = Arc::new(AtomicBool::new(false));
    let _ending = Ending::watch(&interrupted, false).context("signals cannot be caught here")?;

    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    if matches!(who.board, Board::LeftNano | Board::LeftReplay) {
        bail!("{port}: {} answers; only the right hand's samples are recorded", who.board);
    }
    let mode = |mode| move |request| HostMessage::SetMode { request, mode };
    talk.request(REQUEST_MS, mode(Mode::Record))?;
    let mut session = Session { talk, args, sample_hz: who.sample_hz, interrupted: &interrupted };
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
    // However it ended. If the board does not answer, `run` will call it back.
    let patience_ms = if session.is_interrupted() { BACK_MS } else { REQUEST_MS };
    let back = session.talk.request(patience_ms, mode(Mode::Classify));
    done?;
    if back.is_err() {
        println!("the board did not go back to classifying; restart it, or just start `host-bridge run`");
    }
    println!("next: models train {} --out trained", args.out.display());
    Ok(ExitCode::SUCCESS)
}

/// Names become parts of paths.
fn check_name(what: &str, name: &str) -> Result<()> {
    let plain = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
    ensure!(
        !name.is_empty() && name.chars().all(plain),
        "{what} {name:?}: use letters, digits, - and _ only"
    );
    Ok(())
}

struct Session<'a> {
    talk: Talk,
    args: &'a Args,
    sample_hz: u16,
    interrupted: &'a AtomicBool,
}

impl Session<'_> {
    /// One label: one good take.
    fn record(&mut self, label: &str) -> Result<()> {
        let attempts = if self.args.guided { ATTEMPTS } else { 1 };
        for attempt in 1.. {
            match self.take(label) {
                Ok(collector) => return self.save(label, collector),
                Err(error) if attempt < attempts && !error.is::<Interrupted>() => {
                    println!("   {error:#}; once more");
                }
                Err(error) if error.is::<Interrupted>() => return Err(error),
                Err(error) => return Err(error.context("nothing was saved")),
            }
        }
        Ok(())
    }

    fn take(&mut self, label: &str) -> Result<Collector> {
        for left in (1..=self.args.countdown).rev() {
            println!("   {label} in {left} …");
            let until_ms = self.talk.now_ms() + 1000;
            while self.talk.now_ms() < until_ms {
                self.ensure_wanted()?;
                self.ensure_open(50)?;
            }
        }
        // What came during the countdown is not part of it.
        while self.talk.next(0).is_some() {}
        println!("   go: {label}, {} s", self.args.seconds);
        let rate_hz = f64::from(self.sample_hz.max(1));
        let wanted = (self.args.seconds * rate_hz).round() as usize;
        let mut collector = Collector::new(wanted, self.sample_hz);
        let mut heard_ms = self.talk.now_ms();
        let mut full = false;
        while !full {
            self.ensure_wanted()?;
            match self.talk.next(100) {
                Some((at_ms, Said::Raw(batch))) => {
                    heard_ms = at_ms;
                    full = collector.push(&batch)?;
                    self.show(&collector, rate_hz);
                }
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
        Ok(collector)
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

    /// A bar, the time, and how the hand moves.
    fn show(&self, collector: &Collector, rate_hz: f64) {
        const BAR: usize = 20;
        if !std::io::stdout().is_terminal() {
            return;
        }
        let seconds = collector.len() as f64 / rate_hz;
        let part = ((seconds / self.args.seconds * BAR as f64) as usize).min(BAR);
        let line = sparkline(&collector.newest_acceleration(40), 4.0, 20.0);
        print!("\r   [{}{}] {seconds:>5.1} s  {line} ", "#".repeat(part), ".".repeat(BAR - part));
        let _ = std::io::stdout().flush();
    }

    fn save(&self, label: &str, collector: Collector) -> Result<()> {
        let (samples, clipped) = (collector.len(), collector.clipped());
        let file = next_file(&self.args.out.join(label), &self.args.person)?;
        // Edge Impulse's header; our own tools read both.
        let text = collector.recording().to_csv().replacen("timestamp_ms", "timestamp", 1);
        let about = || format!("{}: cannot be written; is there room, and may you?", file.display());
        if let Err(error) = write_whole(&file, text.as_bytes()) {
            // The empty file only kept the name.
            let _ = std::fs::remove_file(&file);
            return Err(error).with_context(about);
        }
        println!("   saved {} ({samples} samples, no gaps)", file.display());
        if clipped > 0 {
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

/// The first number that is free, taken: the file is there from now on, empty, so that nobody else takes it.
fn next_file(folder: &Path, person: &str) -> Result<PathBuf> {
    make_folder(folder)?;
    for n in 1..u32::MAX {
        let file = folder.join(format!("{person}__{n}.csv"));
        match std::fs::File::create_new(&file) {
            Ok(_) => return Ok(file),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("{}: cannot be made", file.display())),
        }
    }
    bail!("{}: no free file name", folder.display())
}
