//! `host-bridge doctor`: measures the quality of each link and gives advice.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail, ensure};
use host_bridge::hands::ModelFile;
use host_bridge::intent::MotionMap;
use host_bridge::links::SerialSettings;
use host_bridge::one_handed::SINCE_MINOR;
use host_bridge::safety::Hand;
use host_bridge::survey::Survey;
use host_bridge::talk::{ModelNeeds, Said, Talk, Who};
use host_bridge::{describe, doubt};
use shared_dsp::right::network::crc32;
use shared_proto::message::{
    About, Board, Fault, HostMessage, Image, Mode, PROTOCOL_MAJOR, PROTOCOL_MINOR, Pairing, ResetCause,
    Sensor, Status,
};

use super::ports::{check_name, read_config, settings};

const HELLO_MS: u64 = 6000;
const PING_MS: u64 = 200;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Port of the left hand's board
    #[arg(long, value_name = "PORT")]
    left: Option<String>,
    /// Port of the right hand's board
    #[arg(long, value_name = "PORT")]
    right: Option<String>,
    /// Configuration file with the ports
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Examine the ROS 2 graph: list the subscribers of each topic, or the reasons why there are none
    #[arg(long)]
    ros2: bool,
    /// How many seconds to listen; measuring the clock's drift needs some time
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
}

/// Listens to all links at once. The exit code shows whether there are problems.
pub fn run(args: &Args) -> Result<ExitCode> {
    ensure!((1.0..=3600.0).contains(&args.seconds), "--seconds takes 1 to 3600");
    let config = read_config(args.config.as_deref())?;
    let chosen = |asked: &Option<String>, known: &str| asked.clone().unwrap_or_else(|| known.to_owned());
    let ports = [chosen(&args.left, &config.ports.left), chosen(&args.right, &config.ports.right)];
    let hands = if config.left_handed { [Hand::Right, Hand::Left] } else { [Hand::Left, Hand::Right] };
    let ports: Vec<_> =
        ports.into_iter().zip(hands).filter(|(port, _)| !port.is_empty() && port != "keyboard").collect();
    if ports.is_empty() && !args.ros2 {
        bail!("name a port with --left or --right; `host-bridge list` shows them");
    }
    for (port, _) in &ports {
        check_name(port)?;
    }
    println!("host-bridge {}, protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}", env!("CARGO_PKG_VERSION"));
    if let Ok(model) = ModelFile::bundled() {
        println!("bundled model {:08x} ({})", crc32(model.blob()), model.name());
    }
    let reports: Vec<Report> = std::thread::scope(|scope| {
        let examine = |(port, hand): &(String, Hand)| {
            let (port, hand) = (port.clone(), *hand);
            let settings = settings(&config, hand);
            let one_handed = config.one_handed.on;
            scope.spawn(move || examine(&port, hand, settings, args.seconds, one_handed))
        };
        let threads: Vec<_> = ports.iter().map(examine).collect();
        let lost = || Report { lines: Vec::new(), advice: vec!["the examination broke off".to_owned()] };
        threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| lost())).collect()
    });
    let mut well = !args.ros2 || super::ros2::doctor(&config.ros2, args.seconds)?;
    for ((port, _), report) in ports.iter().zip(&reports) {
        println!("\n{port}");
        for line in &report.lines {
            println!("  {line}");
        }
        for advice in &report.advice {
            println!("  → {advice}");
        }
        if report.advice.is_empty() {
            println!("  all is well");
        }
        well &= report.advice.is_empty();
    }
    Ok(if well { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

struct Report {
    lines: Vec<String>,
    advice: Vec<String>,
}

/// The data received from one board.
struct Heard {
    who: Who,
    model: Option<ModelNeeds>,
    about: Option<About>,
    pairing: Option<Pairing>,
    survey: Survey,
    status: Option<Status>,
    faults: Vec<Fault>,
    health: u8,
    frames: (u32, u32),
    closed: Option<String>,
    restarts: u32,
    /// Strength of the radio signal when the board was found.
    signal_dbm: Option<i16>,
    /// When the newest state arrived, and when the examination ended.
    newest_ms: Option<u64>,
    end_ms: u64,
}

fn examine(port: &str, hand: Hand, settings: SerialSettings, seconds: f64, one_handed: bool) -> Report {
    let mut talk = Talk::open(port, settings);
    let who = match talk.hello(HELLO_MS) {
        Ok(who) => who,
        Err(error) => return Report { lines: Vec::new(), advice: vec![error.to_string()] },
    };
    let heard = listen(&mut talk, who, (seconds * 1000.0) as u64);
    let mut advice = advice(&heard);
    if is_left(heard.who.board) != (hand == Hand::Left) {
        // This text is also used by `run`, which refuses such a board.
        advice.insert(
            0,
            format!("{} answers where the {hand} hand is expected: swap the ports", heard.who.board),
        );
    }
    if one_handed && hand == Hand::Right && heard.who.version.1 < SINCE_MINOR {
        advice.push(format!(
            "one-handed mode does not work: the firmware sends no tilt (wire 1.{}, needed 1.{SINCE_MINOR}): flash it anew",
            heard.who.version.1
        ));
    }
    Report { lines: lines(&heard), advice }
}

fn is_left(board: Board) -> bool {
    board.hand() == Some(Hand::Left)
}

fn listen(talk: &mut Talk, who: Who, listen_ms: u64) -> Heard {
    let (mut pinged, mut pings) = ((0, u64::MAX), 0u32);
    let mut next_ping_ms = talk.now_ms();
    if !is_left(who.board) {
        // The board may still be in record mode.
        let request = talk.next_request();
        talk.send(&HostMessage::SetMode { request, mode: Mode::Classify });
    }
    let until_ms = talk.now_ms() + listen_ms;
    let mut heard = Heard {
        who,
        model: None,
        about: None,
        pairing: None,
        survey: Survey::default(),
        status: None,
        faults: Vec::new(),
        health: 0,
        frames: (0, 0),
        closed: None,
        restarts: 0,
        signal_dbm: None,
        newest_ms: None,
        end_ms: 0,
    };
    // A left hand says how the link was paired before its first hello, and is therefore asked again.
    let mut meet = is_left(heard.who.board);
    while talk.now_ms() < until_ms {
        let now_ms = talk.now_ms();
        if meet && talk.is_ready() {
            meet = !talk.send(&HostMessage::HelloRequest);
        }
        if now_ms >= next_ping_ms && talk.is_ready() {
            next_ping_ms = now_ms + PING_MS;
            pings += 1;
            pinged = (pings, now_ms);
            talk.send(&HostMessage::Ping { id: pings });
        }
        match talk.next(20) {
            Some((at_ms, Said::Left(s))) => {
                heard.survey.state(s.sequence, s.board_time_ms, at_ms);
                heard.newest_ms = Some(at_ms);
                heard.health |= s.health;
            }
            Some((at_ms, Said::Right { sequence, board_time_ms, health, .. })) => {
                heard.survey.state(sequence, board_time_ms, at_ms);
                heard.newest_ms = Some(at_ms);
                // The first window after a start always has a gap.
                heard.health = health;
            }
            Some((at_ms, Said::Pong(pong))) if pong.id == pinged.0 => {
                heard.survey.round_trip(at_ms.saturating_sub(pinged.1));
            }
            Some((_, Said::Model(model))) => heard.model = Some(model),
            Some((_, Said::About(about))) => heard.about = Some(about),
            Some((_, Said::Pairing(pairing))) => heard.pairing = Some(pairing),
            Some((_, Said::Status(status))) => heard.status = Some(status),
            Some((_, Said::Fault(fault))) => {
                heard.faults.retain(|known| known.kind != fault.kind);
                heard.faults.push(fault);
            }
            Some((_, Said::Hello(who))) if who.boot_id != heard.who.boot_id => {
                heard.who = who;
                heard.restarts += 1;
                heard.survey.restarted();
            }
            Some((_, Said::Closed(why))) => heard.closed = Some(why),
            // The board may have restarted with a new clock, which its hello message will show.
            Some((_, Said::Opened)) => {
                heard.survey.restarted();
                meet = true;
            }
            _ => {}
        }
    }
    heard.frames = talk.frames();
    heard.signal_dbm = talk.signal_dbm();
    heard.end_ms = talk.now_ms();
    heard
}

fn lines(heard: &Heard) -> Vec<String> {
    let Heard { who, survey, .. } = heard;
    let mut lines = vec![format!(
        "{}, firmware {}, protocol {}.{}, boot {:08x}",
        who.board, who.firmware, who.version.0, who.version.1, who.boot_id
    )];
    if let Some(about) = &heard.about {
        lines.push(made_of(who.board, about));
    }
    if who.model_id != 0 {
        let labels = heard.model.as_ref().map(|m| m.labels.join(", ")).unwrap_or_default();
        let needs = heard.model.as_ref().map_or(String::new(), |m| {
            format!(", {} axes, window {} samples at {} Hz", m.axes, m.window, m.sample_hz)
        });
        lines.push(format!("model {:08x}{needs}: {labels}", who.model_id));
    }
    let rate = survey.rate_hz().map_or("none".to_owned(), |hz| format!("{hz:.1} per second"));
    lines.push(format!("samples {} Hz; states {rate}", who.sample_hz));
    if let Some((drift, error)) = survey.drift_ppm() {
        lines.push(format!("clock {drift:+.0} ppm (± {error:.0}) against this computer's"));
    }
    lines.push(format!(
        "frames {}, {} damaged; {:.2} % of the states lost",
        heard.frames.0,
        heard.frames.1,
        survey.loss() * 100.0
    ));
    if let Some((median_ms, worst_ms)) = survey.round_trip_ms() {
        lines.push(format!("latency: ping and back {median_ms} ms, at worst {worst_ms} ms"));
    }
    if let Some(dbm) = heard.signal_dbm {
        let age = heard.newest_ms.map_or("no state".to_owned(), |at_ms| {
            format!("newest state {} ms old", heard.end_ms.saturating_sub(at_ms))
        });
        lines.push(format!("Bluetooth: {dbm} dBm when found; {age}"));
    }
    if let Some(pairing) = heard.pairing {
        lines.push(describe::pairing(pairing));
    }
    if let Some(status) = heard.status {
        lines.push(format!(
            "up {:.0} s, load {:.1} %, free stack {} B, {} samples dropped, {} sensor errors, {} bad frames",
            f64::from(status.uptime_ms) / 1000.0,
            f64::from(status.load_permille) / 10.0,
            status.free_stack_bytes,
            status.dropped_samples,
            status.sensor_errors,
            status.bad_frames
        ));
    }
    lines
}

/// Maximum drift of a board with a crystal in parts per million; a larger one is reported.
const CRYSTAL_DRIFT_PPM: u32 = 500;
/// Below this signal, packets are often lost.
const WEAK_DBM: i16 = -85;
/// Tolerance for an Arduino Nano, whose 16 MHz come from a ceramic resonator (0.5 % and ageing).
const RESONATOR_DRIFT_PPM: u32 = 10_000;

/// Describes the hardware: revision, sensor, image, reset cause and battery.
fn made_of(board: Board, about: &About) -> String {
    // One image supports both revisions of a Nano 33, which differ in their sensor.
    let revision = match (board, about.sensor) {
        (Board::RightNano33 | Board::RightNano33Rev2, Sensor::Lsm9ds1) => "Rev1, ",
        (Board::RightNano33 | Board::RightNano33Rev2, Sensor::Bmi270) => "Rev2, ",
        (Board::RightNano33 | Board::RightNano33Rev2, _) => "revision not known, ",
        _ => "",
    };
    let sensor = match about.sensor {
        Sensor::None => "no sensor found".to_owned(),
        Sensor::Unknown(number) => format!("a sensor that is not known here ({number}), {} axes", about.axes),
        Sensor::Lsm9ds1 => format!("sensor LSM9DS1, {} axes", about.axes),
        Sensor::Bmi270 => format!("sensor BMI270, {} axes", about.axes),
        Sensor::Lsm6ds3 => format!("sensor LSM6DS3TR-C, {} axes", about.axes),
    };
    let image = match about.image {
        Image::Bootloader => "behind the Arduino bootloader, without Bluetooth".to_owned(),
        Image::S140 => "behind S140".to_owned(),
        Image::Uf2 => "behind S140 and the UF2 bootloader".to_owned(),
        Image::Linked => "behind the board's own bootloader, with Bluetooth in it".to_owned(),
        Image::Unknown(number) => format!("of a kind that is not known here ({number})"),
    };
    let reset = match about.reset {
        ResetCause::PowerUp => "power-up",
        ResetCause::Pin => "the reset button",
        ResetCause::Watchdog => "its watchdog",
        ResetCause::Software => "itself or its bootloader",
        _ => "something else",
    };
    let battery = match about.battery_mv {
        0 => "unknown".to_owned(),
        mv => format!("{:.2} V", f64::from(mv) / 1000.0),
    };
    format!("{revision}{sensor}; image {image}; started by {reset}; battery {battery}")
}

fn advice(heard: &Heard) -> Vec<String> {
    let left = is_left(heard.who.board);
    let state_hz = if left { 50.0 } else { 12.5 };
    let drift_ppm = if heard.who.board == Board::LeftNano { RESONATOR_DRIFT_PPM } else { CRYSTAL_DRIFT_PPM };
    let mut advice = match &heard.closed {
        // Measurements across an interruption are not meaningful.
        Some(why) => vec![format!("the link broke meanwhile: {why}; then ask again")],
        None => heard.survey.advice(state_hz, f64::from(drift_ppm)),
    };
    if heard.restarts > 0 {
        advice.push(format!("the board restarted {} times: check its power and cable", heard.restarts));
    }
    // This type is wider than u8, because clippy would complain that no minor version is below 0.
    if u16::from(heard.who.version.1) < u16::from(PROTOCOL_MINOR) {
        advice.push("the firmware is older than this program: flash it anew for all functions".to_owned());
    }
    if heard.frames.1 > 1 {
        advice.push(format!("{} damaged frames: check the cable, use 115200 baud", heard.frames.1));
    }
    if let Some(dbm) = heard.signal_dbm
        && dbm < WEAK_DBM
    {
        advice.push(format!("a weak signal ({dbm} dBm): bring the board nearer, and nothing metal between"));
    }
    advice.extend(doubt::reasons(heard.health).into_iter().map(str::to_owned));
    for fault in &heard.faults {
        advice.push(format!("the board reported {:?} (detail {:#x})", fault.kind, fault.detail));
    }
    if let Some(model) = &heard.model {
        let without = MotionMap::default();
        let without = without.without_motion(&model.labels);
        if !without.is_empty() {
            advice.push(format!(
                "no motion for {}: give them one under [motions] in the configuration",
                without.join(", ")
            ));
        }
    }
    advice
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_named_by_revision_sensor_image_reset_cause_and_battery() {
        let about = |sensor, axes, image, reset, battery_mv| About { sensor, axes, image, reset, battery_mv };
        for (board, about, line) in [
            (
                Board::RightNano33,
                about(Sensor::Lsm9ds1, 9, Image::Bootloader, ResetCause::PowerUp, 0),
                "Rev1, sensor LSM9DS1, 9 axes; image behind the Arduino bootloader, without Bluetooth; started by \
                 power-up; battery unknown",
            ),
            (
                Board::RightNano33Rev2,
                about(Sensor::Bmi270, 6, Image::S140, ResetCause::Watchdog, 0),
                "Rev2, sensor BMI270, 6 axes; image behind S140; started by its watchdog; battery unknown",
            ),
            (
                Board::RightXiao,
                about(Sensor::Lsm6ds3, 6, Image::Uf2, ResetCause::Pin, 3712),
                "sensor LSM6DS3TR-C, 6 axes; image behind S140 and the UF2 bootloader; started by the reset button; \
                 battery 3.71 V",
            ),
            (
                Board::RightNano33Rev2,
                about(Sensor::Bmi270, 6, Image::Linked, ResetCause::PowerUp, 0),
                "Rev2, sensor BMI270, 6 axes; image behind the board's own bootloader, with Bluetooth in it; started by \
                 power-up; battery unknown",
            ),
            (
                Board::RightNano33,
                about(Sensor::None, 0, Image::S140, ResetCause::Software, 0),
                "revision not known, no sensor found; image behind S140; started by itself or its bootloader; \
                 battery unknown",
            ),
            (
                Board::Unknown(77),
                about(Sensor::Unknown(9), 6, Image::Unknown(8), ResetCause::Unknown(7), 4000),
                "a sensor that is not known here (9), 6 axes; image of a kind that is not known here (8); started by \
                 something else; battery 4.00 V",
            ),
        ] {
            assert_eq!(made_of(board, &about), line);
        }
    }
}
