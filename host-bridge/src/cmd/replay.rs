//! `host-bridge replay`: plays your own recordings as if their boards were plugged in.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::adc::AdcRecording;
use host_bridge::bridge::{BridgeEvent, EventKind};
use host_bridge::describe;
use host_bridge::hands::{Delayed, LeftBoard, ModelFile, RightBoard, Wired, join, refused_at_start};
use host_bridge::safety::State;
use host_bridge::script::CalibrationTable;
use host_bridge::session::{Session, Summary};
use host_bridge::source::Source;
use models::sheet::{Columns, Reading, Units};
use serde::Serialize;

use crate::play::{PlayOptions, play, say};

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Session file written by `--record`, which is replayed and compared
    #[arg(value_name = "FILE.mcap", conflicts_with_all = ["right", "left", "record", "scene", "map", "jerk_limited"])]
    session: Option<PathBuf>,
    /// Recordings of the right hand (timestamp_ms,accX,…); several are joined into one
    #[arg(long, value_name = "IMU.csv", num_args = 1.., required_unless_present_any = ["left", "session"])]
    right: Vec<PathBuf>,
    /// Recording of the left hand (timestamp_ms,x,y,z,index,middle: counts of 8 to 12 bits at 50 to 500 Hz)
    #[arg(long, value_name = "ADC.csv")]
    left: Option<PathBuf>,
    /// Int8 model for the right hand, with its card in the same folder [default: the bundled model, 9 axes]
    #[arg(long, value_name = "FILE.tflite")]
    model: Option<PathBuf>,
    /// Calibration of the left hand: a TOML file with zero, rest and bend, or `start` for taking neutral and rest
    /// from the first 1.6 s (hand level and still, fingers straight)
    /// [default: nominal parts]
    #[arg(long, value_name = "FILE.toml|start", requires = "left")]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    reading: ReadingOptions,
    /// Start both recordings at once, even if their times are from a common clock
    #[arg(long, requires = "left", requires = "right")]
    own_clocks: bool,
    #[command(flatten)]
    play: PlayOptions,
}

/// Options for reading recordings of the right hand.
#[derive(clap::Args, Clone, Debug)]
struct ReadingOptions {
    /// Units of the right hand's recordings, overriding the files: g, mg or m/s2; rad/s or deg/s; uT or gauss
    #[arg(long, value_name = "UNIT,...", value_parser = |text: &str| text.parse::<Units>())]
    units: Option<Units>,
    /// Samples per second of recordings without times
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Columns: our names in the file's order (time,accX,accY,accZ,-), or OURS=THEIRS,... by name or number
    #[arg(long, value_name = "COLUMNS", value_parser = |text: &str| text.parse::<Columns>())]
    columns: Option<Columns>,
}

impl ReadingOptions {
    fn reading(&self) -> Result<Reading> {
        if let Some(rate) = self.rate {
            ensure!((25.0..=500.0).contains(&rate), "--rate takes 25 to 500 Hz");
        }
        let units = self.units.unwrap_or_default();
        Ok(Reading { units, rate_hz: self.rate, columns: self.columns.clone(), guess: false })
    }
}

#[derive(Serialize)]
struct Report<'a> {
    title: &'a str,
    model: Option<&'a str>,
    labels_without_motion: Vec<&'a str>,
    #[serde(flatten)]
    summary: &'a Summary,
}

/// Plays the recordings. Everything is read and checked before anything moves.
pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(file) = &args.session {
        return again(file, args);
    }
    let (robot, map) = args.play.robot_and_map(&args.play.stage()?)?;
    let left = args.left.as_deref().map(|file| read_left(file, args.calibration.as_deref())).transpose()?;
    if let (Some(model), true) = (&args.model, args.right.is_empty()) {
        bail!("--model {} is for a right hand; give its recording with --right", model.display());
    }
    let model = match (&args.model, args.right.is_empty()) {
        (_, true) => None,
        (Some(file), false) => Some(ModelFile::read(file)?),
        (None, false) => Some(ModelFile::bundled()?),
    };
    let reading = args.reading.reading()?;
    let right =
        model.as_ref().map(|model| join(&args.right, model.axes_of_recordings(), &reading)).transpose()?;
    let mut delays_ms = [0, 0];
    if let (Some(left), Some(right), false) = (&left, &right, args.own_clocks) {
        let spans = [left.span_ms, [right.start_ms, right.start_ms + 10.0 * right.recording.len() as f64]];
        let (delays, line) = aligned(spans);
        delays_ms = delays;
        line.iter().for_each(|line| say(&args.play, line));
    }
    let notes = left.iter().flat_map(|left| &left.notes).chain(right.iter().flat_map(|right| &right.notes));
    notes.for_each(|note| say(&args.play, note));
    let [left_ms, right_ms] = delays_ms;
    let left =
        left.map_or(Source::Nobody, |left| Source::here(Wired::new(Delayed::new(left.board, left_ms))));
    let right = match (&model, right) {
        (Some(model), Some(right)) => {
            let board = RightBoard::new(right.recording, model, 1)?.silent_in(right.silences);
            Source::here(Wired::new(Delayed::new(board, right_ms)))
        }
        _ => Source::Nobody,
    };
    let labels = model.as_ref().map_or(&[][..], ModelFile::labels);
    let model_about = model.as_ref().map(|model| format!("{} ({})", model.name(), model.about()));

    let title = "replay of your recordings";
    if model.is_some() {
        for label in map.without_motion(labels) {
            say(
                &args.play,
                &format!(
                    "label '{label}' has no motion and does nothing; --map {label}=pick-up gives it one"
                ),
            );
        }
        if let Some(label) = map.unknown_labels(labels, &args.play.map).into_iter().next() {
            bail!("--map: the model has no label '{label}'; it has {}", labels.join(", "));
        }
    }
    let unmapped = map.without_motion(labels);
    let mut session = Session::new([left, right], map.clone(), robot);
    let about = model_about.as_deref().unwrap_or("none (no right hand)");
    play(&mut session, &args.play, &format!("{title}\nmodel: {about}"), false)?;

    let summary = session.summary();
    say(&args.play, &describe::summary(&summary));
    let armed = |event: &BridgeEvent| event.kind == EventKind::State { state: State::Armed };
    if !summary.events.iter().any(armed) {
        say(&args.play, "the hands were never neutral together, so nothing could move");
        if args.left.is_some() && args.calibration.is_none() {
            say(&args.play, "the left hand was read with nominal parts; try --calibration start");
        }
    }
    if args.play.json {
        let report = Report {
            title,
            model: model_about.as_deref(),
            labels_without_motion: unmapped,
            summary: &summary,
        };
        println!("{}", serde_json::to_string(&report)?);
    }
    Ok(ExitCode::SUCCESS)
}

/// Replays a session from a file.
#[cfg(feature = "mcap")]
fn again(file: &Path, args: &Args) -> Result<ExitCode> {
    use host_bridge::observe::SessionEvent;
    let about = || format!("{}", file.display());
    if host_bridge::journal::index::complete(file).unwrap_or(false) {
        say(&args.play, "the recording was cut short; the file has its index now");
    }
    let bytes = std::fs::read(file).with_context(about)?;
    let replay = host_bridge::journal::replay(&bytes).with_context(about)?;
    for event in &replay.events {
        let event = SessionEvent::Bridge(event.clone());
        if !describe::is_echo(&event) {
            let time_s = describe::time_ms(&event) as f64 / 1000.0;
            say(&args.play, &format!("{time_s:>8.3} s  {}", describe::text(&event)));
        }
    }
    if let Some(why) = &replay.cut {
        say(&args.play, &format!("the file ends within a message ({why}): its last moments are missing"));
    }
    if let Some(gap_ms) = replay.gap_ms {
        let at_s = gap_ms as f64 / 1000.0;
        say(&args.play, &format!("from {at_s:.3} s on the file has gaps (the disk was too slow): ends here"));
    }
    if replay.missing > 0 || !replay.absent.is_empty() {
        let absent = match replay.absent.as_slice() {
            [] => String::new(),
            topics => format!(" (nothing of {})", topics.join(", ")),
        };
        say(
            &args.play,
            &format!("{} messages{absent} are missing: another program has taken them out", replay.missing),
        );
    }
    let whole = replay.missing == 0 && replay.absent.is_empty();
    let verdict = match &replay.first_difference {
        None if replay.is_same() && !whole => "what is there is the same".to_owned(),
        None if replay.is_same() => "all the same, bit for bit".to_owned(),
        None => "nothing to compare".to_owned(),
        Some(first) => format!("{} DIFFERENT, the first: {first}", replay.different),
    };
    let (seconds, compared) = (replay.seconds, replay.compared);
    say(&args.play, &format!("{seconds:.1} s, {compared} messages compared: {verdict}"));
    if args.play.json {
        println!("{}", serde_json::to_string(&replay)?);
    }
    Ok(if replay.is_same() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Reports that this build cannot replay sessions.
#[cfg(not(feature = "mcap"))]
fn again(file: &Path, _args: &Args) -> Result<ExitCode> {
    bail!(
        "{}: this program was built without sessions on disk; build it with `--features mcap`",
        file.display()
    )
}

/// The left hand's board, and notes about its recording.
struct Left {
    board: LeftBoard,
    notes: Vec<String>,
    /// First and last time in the file.
    span_ms: [f64; 2],
}

fn read_left(file: &Path, calibration: Option<&Path>) -> Result<Left> {
    let read = AdcRecording::read(file)?;
    let length_ms = read.recording.samples.last().map_or(0, |(time_ms, _)| *time_ms);
    let span_ms = [read.start_ms, read.start_ms + length_ms as f64];
    let mut notes = read.notes;
    if calibration == Some(Path::new("start")) {
        notes.extend(refused_at_start(&read.recording));
    }
    let notes = notes.iter().map(|note| format!("{}: {note}", file.display())).collect();
    let recording = read.recording;
    let board = match calibration {
        None => LeftBoard::new(recording, None, 1),
        Some(start) if start == Path::new("start") => {
            LeftBoard::new(recording, None, 1).calibrated_at_start()
        }
        Some(file) => {
            let about = || format!("{}: the calibration cannot be used", file.display());
            let text = std::fs::read_to_string(file).with_context(about)?;
            let table = CalibrationTable::parse(&text).with_context(about)?;
            LeftBoard::new(recording, Some(table.into()), 1)
        }
    };
    Ok(Left { board, notes, span_ms })
}

/// Returns the delay of each hand relative to the session, and notes.
/// The delays are calculated from the first and last times of the recordings.
/// If their times overlap, both recordings are assumed to use a common clock.
fn aligned([left, right]: [[f64; 2]; 2]) -> ([u64; 2], Option<String>) {
    let late_ms = left[0] - right[0];
    if late_ms.abs() < 1.0 {
        return ([0, 0], None);
    }
    if left[0] > right[1] || right[0] > left[1] {
        let line = "the recordings' times do not overlap: they are of two clocks, and both start at once";
        return ([0, 0], Some(line.to_owned()));
    }
    let (hand, other) = if late_ms > 0.0 { ("left", "right") } else { ("right", "left") };
    let line = format!(
        "the {hand} hand's recording begins {:.3} s after the {other} one's, by their times, and is played so; \
         --own-clocks starts both at once",
        late_ms.abs() / 1000.0
    );
    let late = late_ms.abs().round() as u64;
    (if late_ms > 0.0 { [late, 0] } else { [0, late] }, Some(line))
}
