//! Tests session files. They must be complete, and must remain readable after a crash or with a full disk.
#![cfg(feature = "mcap")]

use std::io::{self, BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use host_bridge::bridge::EventKind;
use host_bridge::config::{Config, HandInput};
use host_bridge::demo::Demo;
use host_bridge::describe;
use host_bridge::engine::Engine;
use host_bridge::episodes::{Mark, MarkedBy};
use host_bridge::export::{Cut, Streams, episodes};
use host_bridge::hands::ModelFile;
use host_bridge::intent::MotionMap;
use host_bridge::journal::sink::Storage;
use host_bridge::journal::{Disk, Kept, Replay, SceneText, Setup, WhenFull, replay};
use host_bridge::keyboard::HandKey;
use host_bridge::observe::SessionEvent;
use host_bridge::robot::{Door as _, Leg};
use host_bridge::safety::Hand;
use host_bridge::session::Session;
use host_bridge::topics::Origin;
use shared_proto::message::Heading;

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, live as live_engine};

type Live = Engine<'static, Robot>;

/// A disk in memory with a capacity in bytes. Writes block while the sender of `gate` exists.
#[derive(Clone)]
struct Memory {
    bytes: Arc<Mutex<Vec<u8>>>,
    size: usize,
    gate: Arc<Mutex<Option<Receiver<()>>>>,
}

impl Memory {
    fn of_size(size: usize) -> Self {
        Memory { bytes: Arc::default(), size, gate: Arc::default() }
    }

    fn file(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().clone()
    }
}

impl Storage for Memory {
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        if let Some(gate) = self.gate.lock().unwrap().as_ref() {
            // Blocks until the sender is dropped.
            while gate.recv().is_ok() {}
        }
        let mut disk = self.bytes.lock().unwrap();
        let at = at as usize;
        let fits = bytes.len().min(self.size.saturating_sub(at));
        let end = (at + fits).max(disk.len());
        disk.resize(end, 0);
        disk[at..at + fits].copy_from_slice(&bytes[..fits]);
        if fits < bytes.len() { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.bytes.lock().unwrap().resize(length as usize, 0);
        Ok(())
    }
}

const ORIGIN: Origin = Origin { nanoseconds: 1_700_000_000_123_456_789 };

fn setup() -> Setup {
    Setup { title: "a test".to_owned(), origin_ns: ORIGIN.nanoseconds, ..Setup::default() }
}

fn with_demo<T>(setup: &Setup, look: impl FnOnce(&mut Session<'_, Robot>) -> T) -> T {
    let model = ModelFile::bundled().unwrap();
    let robot = setup.robot().unwrap();
    look(&mut Demo::bundled().session(&model, MotionMap::default(), robot).unwrap())
}

fn play(session: &mut Session<'_, Robot>, until_ms: u64, stop_ms: Option<u64>) {
    while session.now_ms() < until_ms && !session.finished() {
        if Some(session.now_ms()) == stop_ms {
            session.stop_key();
        }
        session.step();
    }
}

/// Records the demo to a disk and returns the result of closing the file.
fn recorded_demo(setup: &Setup, until_ms: u64, stop_ms: Option<u64>, memory: &Memory) -> Kept {
    with_demo(setup, |session| {
        let start = Disk::with_storage(
            memory.clone(),
            Path::new("a.mcap"),
            setup.to_metadata(),
            ORIGIN,
            WhenFull::Wait,
        );
        let (disk, recorder) = start.unwrap();
        session.tap_mut().add(Box::new(recorder));
        play(session, until_ms, stop_ms);
        session.tap_mut().clear();
        disk.close()
    })
}

fn assert_same(replay: &Replay) {
    assert_eq!((replay.first_difference.as_ref(), replay.cut.as_ref(), replay.gap_ms), (None, None, None));
    assert!(replay.is_same());
}

#[test]
fn a_played_session_from_its_file_is_the_same_bit_for_bit() {
    let memory = Memory::of_size(usize::MAX);
    let kept = recorded_demo(&setup(), 30_000, Some(15_000), &memory);
    assert_eq!((kept.lost, kept.problem), (0, None));
    let file = memory.file();
    assert_eq!(kept.bytes, file.len() as u64);
    let again = replay(&file).unwrap();
    assert_same(&again);
    with_demo(&setup(), |session| {
        play(session, 30_000, Some(15_000));
        let summary = session.summary();
        assert_eq!(again.events, summary.events);
        assert_eq!(again.odometry, summary.odometry);
        assert!(summary.events.len() > 10);
        assert_eq!(summary.stops, 1);
    });
    // The counts follow from rates of 100 Hz, 50 Hz and 20 Hz from 0 until just before 30 s.
    // The samples of both hands are counted too.
    let counted = |topic: &str| again.messages.get(topic).copied().unwrap_or_default();
    let topics = ["/joint_states", "/odom", "/tf", "/cmd_vel", "/hands/state"].map(counted);
    assert_eq!(topics, [3000, 1500, 1500, 1500, 600]);
    assert_eq!([counted("/hands/left/sample"), counted("/hands/right/imu")], [3000, 3000]);
    assert_eq!(counted("/events"), again.events.len() as u64);
    assert_eq!(counted("/bridge/operated"), 1);
    assert_eq!(again.messages.values().sum::<u64>(), kept.messages);
}

#[test]
fn motions_with_limited_jerk_are_the_same_too_and_take_longer() {
    let mut smooth = setup();
    smooth.config.arm.jerk_limited = true;
    let first_pose_ms = |setup: &Setup| {
        let memory = Memory::of_size(usize::MAX);
        recorded_demo(setup, 10_000, None, &memory);
        let again = replay(&memory.file()).unwrap();
        assert_same(&again);
        let reached = again.events.iter().find(|e| matches!(e.kind, EventKind::MotionEnded { .. }));
        reached.expect("the arm was home by then").time_ms
    };
    let (even_ms, smooth_ms) = (first_pose_ms(&setup()), first_pose_ms(&smooth));
    // If the jerk is limited to 4.3 rad/s³, an acceleration of 0.43 rad/s² takes 100 ms to build up.
    assert_eq!(smooth_ms - even_ms, 100);
}

#[test]
fn planned_motions_are_the_same_too() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/shelf.toml");
    let setup = Setup { scene: Some(SceneText::read(&scene).unwrap()), ..setup() };
    let memory = Memory::of_size(usize::MAX);
    recorded_demo(&setup, 25_000, None, &memory);
    let again = replay(&memory.file()).unwrap();
    assert_same(&again);
    let text = format!("{:?}", again.events);
    assert!(text.contains("Started("), "an arm motion was among it: {text}");
}

/// Runs a live session with keys for both hands, irregular time steps and pings.
/// The session also contains a stop with its release, and a pause.
fn live_session(memory: &Memory, when_full: WhenFull, until_ms: u64) -> (Live, Disk) {
    let mut config = Config::default();
    config.speed.start = 0.3;
    config.motions.insert("rectangle".to_owned(), "home".to_owned());
    let setup = Setup { config: config.clone(), ..setup() };
    let (disk, recorder) =
        Disk::with_storage(memory.clone(), Path::new("a.mcap"), setup.to_metadata(), ORIGIN, when_full)
            .unwrap();
    let mut now_ms = 77;
    let mut live =
        moving::live_before(moving::bare(), &config, HandInput::Keyboard, HandInput::Keyboard, now_ms);
    live.tap_mut().add(Box::new(recorder));
    let mut turn = 0_u64;
    while now_ms < until_ms {
        turn += 1;
        now_ms += 1 + turn % 4;
        if turn == 2500 {
            now_ms += 700;
        }
        match turn {
            500 | 900 | 1700 => live.press(HandKey::Arrow(Heading::Forward), now_ms),
            600 => live.press(HandKey::Gesture(2), now_ms),
            1000 => live.stop_key(now_ms),
            1600 => live.press(HandKey::Gesture(1), now_ms),
            1800 => live.press(HandKey::Faster, now_ms),
            1900 => live.press(HandKey::Gesture(5), now_ms),
            // Noise arrives on a line between two time steps.
            2000 => live.receive(Hand::Left, &[7, 0, 255, 3], now_ms),
            2100 => live.end_arm_key(now_ms),
            _ => {}
        }
        live.advance(now_ms, [true; 2]);
    }
    (live, disk)
}

#[test]
fn a_live_session_from_its_file_is_the_same_bit_for_bit() {
    let memory = Memory::of_size(usize::MAX);
    let (mut live, disk) = live_session(&memory, WhenFull::Wait, 10_000);
    live.tap_mut().clear();
    assert_eq!(disk.close().problem, None);
    let again = replay(&memory.file()).unwrap();
    assert_same(&again);
    assert_eq!(again.odometry, live.door().odometry());
    assert!(again.odometry.path_m > 0.1, "{:?}", again.odometry);
    let text = serde_json::to_string(&again.events).unwrap();
    for needed in ["\"released\"", "operator-stop", "\"started\"", "\"gesture\""] {
        assert!(text.contains(needed), "{needed}: {text}");
    }
    assert!(again.messages["/bridge/right/sent"] > 8, "hellos and a ping a second");
}

#[test]
fn motions_that_were_planned_beside_a_session_begin_where_its_file_says() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/posts.toml");
    let scene = Some(SceneText::read(&scene).unwrap());
    let mut config = Config::default();
    config.motions.insert("to-fro".to_owned(), "gap 5".to_owned());
    let setup = Setup { scene, config, plans_aside: true, ..setup() };
    let memory = Memory::of_size(usize::MAX);
    let start =
        Disk::with_storage(memory.clone(), Path::new("a.mcap"), setup.to_metadata(), ORIGIN, WhenFull::Wait);
    let (disk, recorder) = start.unwrap();
    let door = setup.stage().unwrap().simulated(&setup.config).planning_aside();
    let keys = HandInput::Keyboard;
    let mut live = moving::live_before(door, &setup.config, keys, keys, 80);
    live.tap_mut().add(Box::new(recorder));
    let mut planned_ms = None;
    for now_ms in (80..9_000).step_by(2) {
        if now_ms == 2_000 {
            live.press(HandKey::Gesture(2), now_ms);
        }
        if live.door().arm().running.is_some_and(|(_, leg)| leg == Leg::Planning) {
            // This loop waits for the planner's thread. Meanwhile, the session's virtual time does not advance.
            let since_ms = *planned_ms.get_or_insert(now_ms);
            let began = Instant::now();
            while now_ms == since_ms + 500 && !live.door().plan_is_ready() {
                assert!(began.elapsed() < Duration::from_secs(240));
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        live.advance(now_ms, [true; 2]);
    }
    let end = live.door().arm().joints_rad;
    live.tap_mut().clear();
    assert_eq!(disk.close().problem, None);
    assert!(!live.door().arm().at_rest() || end != moving::pose("home"), "it moved");
    assert_same(&replay(&memory.file()).unwrap());
}

#[test]
fn a_session_in_which_a_hand_moved_the_tool_is_the_same_from_its_file() {
    let config = Config::parse("[jog]\nlabel = 'circle'\nkey = 'j'\n").unwrap();
    let setup = Setup { config: config.clone(), ..setup() };
    let memory = Memory::of_size(usize::MAX);
    let start =
        Disk::with_storage(memory.clone(), Path::new("a.mcap"), setup.to_metadata(), ORIGIN, WhenFull::Wait);
    let (disk, recorder) = start.unwrap();
    let mut live = moving::live_before(moving::bare(), &config, HandInput::Keyboard, HandInput::Keyboard, 80);
    live.tap_mut().add(Box::new(recorder));
    let mut lent_ms = 0;
    for now_ms in (80..15_000).step_by(2) {
        match now_ms {
            // A gesture switches the left hand to the arm, and a key switches it back to the base.
            2_000 => live.press(HandKey::Gesture(6), now_ms),
            6_000 | 6_500 | 6_700 | 12_500 => live.press(HandKey::Arrow(Heading::Forward), now_ms),
            8_000 => live.press(HandKey::Faster, now_ms),
            10_000 => live.clutch_key(now_ms),
            _ => {}
        }
        live.advance(now_ms, [true; 2]);
        lent_ms += if live.bridge().is_jogging() { 2 } else { 0 };
    }
    let end = live.door().arm().joints_rad;
    live.tap_mut().clear();
    assert_eq!(disk.close().problem, None);
    assert!((4_000..8_500).contains(&lent_ms), "{lent_ms}");
    assert!(
        end != moving::pose("home") && live.door().odometry().path_m > 0.05,
        "first the tool, then the base"
    );
    let again = replay(&memory.file()).unwrap();
    assert_same(&again);
    let clutched =
        |event: &&host_bridge::bridge::BridgeEvent| matches!(event.kind, EventKind::Jogging { .. });
    assert_eq!(again.events.iter().filter(clutched).count(), 2);
    assert_eq!(again.messages["/bridge/operated"], 1);
}

#[test]
fn marks_by_gesture_key_and_page_are_in_the_file_and_make_its_episodes() {
    let mut config = Config::default();
    for (label, mark) in [("circle", Mark::Begin), ("left-right", Mark::End), ("to-fro", Mark::Again)] {
        config.marks.insert(label.to_owned(), mark);
    }
    let setup = Setup { config: config.clone(), task: Some("stack two cups".to_owned()), ..setup() };
    let memory = Memory::of_size(usize::MAX);
    let start =
        Disk::with_storage(memory.clone(), Path::new("a.mcap"), setup.to_metadata(), ORIGIN, WhenFull::Wait);
    let (disk, recorder) = start.unwrap();
    let live = moving::live_before(moving::bare(), &config, HandInput::Keyboard, HandInput::Keyboard, 80);
    let mut live = live.with_marks(config.marks.clone());
    live.tap_mut().add(Box::new(recorder));
    let mut said = Vec::new();
    for now_ms in (80..12_000).step_by(2) {
        match now_ms {
            2_000 => live.press(HandKey::Gesture(6), now_ms),
            4_000 => live.press(HandKey::Gesture(3), now_ms),
            5_000 => live.mark(Mark::Begin, MarkedBy::Key, now_ms),
            // The episode is marked again, first with a gesture and then on the page.
            5_500 => live.press(HandKey::Gesture(2), now_ms),
            6_500 => live.mark(Mark::Again, MarkedBy::Page, now_ms),
            7_500 => live.mark(Mark::Good, MarkedBy::Key, now_ms),
            8_000 => live.mark(Mark::Begin, MarkedBy::Key, now_ms),
            9_000 => live.stop_key(now_ms),
            _ => {}
        }
        let events = live.advance(now_ms, [true; 2]);
        let of_episodes = |event: &&SessionEvent| !matches!(event, SessionEvent::Bridge(_));
        said.extend(events.iter().filter(of_episodes).map(describe::text));
    }
    assert_eq!(
        said,
        [
            "episode 1 begins (gesture)",
            "episode 1 ends after 2.0 s (gesture)",
            "episode 2 begins (key)",
            "episode 2 is thrown away, episode 3 begins (gesture)",
            "episode 3 is thrown away, episode 4 begins (page)",
            "episode 4 is good (key)",
            "episode 5 begins (key)",
            "episode 5 is thrown away: somebody pressed stop",
        ]
    );
    assert!(live.door().at_rest(), "a gesture that marks moves nothing");
    live.tap_mut().clear();
    assert_eq!(disk.close().problem, None);
    let file = memory.file();
    let again = replay(&file).unwrap();
    assert_same(&again);
    assert_eq!(again.messages["/episodes/marks"], 7);
    let streams = Streams::read(&file).unwrap();
    assert!(streams.is_marked());
    let spans = |only_good| {
        let found = episodes::find(&streams, &Cut::Marks { only_good }, None);
        assert!(found.episodes.iter().all(|episode| episode.task == "stack two cups"));
        let spans: Vec<_> = found.episodes.iter().map(|e| (e.start_ms / 100, e.end_ms / 100)).collect();
        (spans, found.left_out.len())
    };
    assert_eq!(spans(false), (vec![(20, 40), (65, 75)], 3));
    assert_eq!(spans(true), (vec![(65, 75)], 4));
}

#[test]
fn a_file_in_which_one_bit_of_a_command_differs_is_found_out() {
    let memory = Memory::of_size(usize::MAX);
    recorded_demo(&setup(), 10_000, None, &memory);
    let file = memory.file();
    // This reader does not verify checksums of chunks, so the content itself must reveal the damage.
    let name = b"left_wheel\0";
    let joints: Vec<usize> =
        (0..file.len() - name.len()).filter(|&at| &file[at..at + name.len()] == name).collect();
    assert!(joints.len() > 900);
    let mut changed = file;
    // In the record, the number follows both names and their count.
    let at = joints[800];
    let after = changed[at..].windows(12).position(|w| w == b"right_wheel\0").unwrap() + at + 12;
    let count = (after..).find(|&i| changed[i] == 9).unwrap();
    // Nine floating-point values follow.
    changed[count + 20] ^= 1;
    let again = replay(&changed).unwrap();
    assert_eq!(again.different, 1);
    assert!(again.first_difference.unwrap().starts_with("/joint_states"));
}

#[test]
fn a_full_disk_is_told_once_and_leaves_a_whole_file_while_the_session_goes_on() {
    let memory = Memory::of_size(3_000_000);
    let (summary, kept) = with_demo(&setup(), |session| {
        let start = Disk::with_storage(
            memory.clone(),
            Path::new("a.mcap"),
            setup().to_metadata(),
            ORIGIN,
            WhenFull::Wait,
        );
        let (disk, recorder) = start.unwrap();
        session.tap_mut().add(Box::new(recorder));
        play(session, 60_000, None);
        session.tap_mut().clear();
        (session.summary(), disk.close())
    });
    let problem = kept.problem.unwrap();
    assert!(problem.starts_with("a.mcap: ") && problem.contains("the session goes on"), "{problem}");
    let plain = with_demo(&setup(), |session| {
        play(session, 60_000, None);
        session.summary()
    });
    assert_eq!(summary, plain);
    let file = memory.file();
    assert!(file.len() <= 3_000_000);
    assert!(file.ends_with(b"\x89MCAP0\r\n"));
    let again = replay(&file).unwrap();
    assert_same_until(&again, &plain.events);
    // Chunks are 1 MiB, so the file contains at least one.
    assert!(again.seconds > 3.0, "{}", again.seconds);
    // The file contains every message that was reported as written.
    assert_eq!(kept.messages, again.messages.values().sum::<u64>());
    assert_eq!(kept.bytes, file.len() as u64);
}

fn assert_same_until(again: &Replay, events: &[host_bridge::bridge::BridgeEvent]) {
    assert_eq!(again.different, 0, "{:?}", again.first_difference);
    assert!(again.is_same());
    assert!(again.events.len() <= events.len());
    assert_eq!(again.events, events[..again.events.len()]);
}

#[test]
fn a_disk_that_stands_still_never_delays_a_live_session_and_the_gap_is_known() {
    let memory = Memory::of_size(usize::MAX);
    let (hold, gate) = channel::<()>();
    let start = Disk::with_storage(
        memory.clone(),
        Path::new("a.mcap"),
        setup().to_metadata(),
        ORIGIN,
        WhenFull::Drop,
    );
    let (disk, recorder) = start.unwrap();
    *memory.gate.lock().unwrap() = Some(gate);
    let mut live = live_engine(&Config::default(), HandInput::Keyboard, HandInput::Nobody);
    live.tap_mut().add(Box::new(recorder));
    // If the session waited for a write, this loop would never end.
    let started = Instant::now();
    let mut now_ms = 0;
    // The loop runs long enough for the writer to start its first write.
    while now_ms < 120_000 || started.elapsed() < Duration::from_secs(2) {
        now_ms += 1;
        live.advance(now_ms, [true; 2]);
    }
    drop(hold);
    live.tap_mut().clear();
    let kept = disk.close();
    assert!(kept.lost > 1000, "{kept:?}");
    assert_eq!(kept.problem, None);
    let again = replay(&memory.file()).unwrap();
    assert_eq!(again.different, 0, "{:?}", again.first_difference);
    assert!(again.gap_ms.is_some() || again.seconds < now_ms as f64 / 1000.0 - 1.0, "{again:?}");
    assert!(again.seconds > 1.0);
}

#[test]
fn a_file_cut_anywhere_gives_what_was_before_the_cut() {
    let memory = Memory::of_size(usize::MAX);
    recorded_demo(&setup(), 6_000, None, &memory);
    let file = memory.file();
    let whole = replay(&file).unwrap();
    for share in [0.4, 0.7, 0.95] {
        let again = replay(&file[..(file.len() as f64 * share) as usize]).unwrap();
        assert_eq!(again.different, 0, "{:?}", again.first_difference);
        assert_eq!(again.events, whole.events[..again.events.len()]);
    }
    assert!(replay(&file[..100]).is_err());
}

#[test]
fn a_killed_program_leaves_a_file_up_to_its_last_second() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("killed.mcap");
    let mut program = Command::new(env!("CARGO_BIN_EXE_host-bridge"));
    program.args(["demo", "--headless", "--speed", "1", "--record"]).arg(&file);
    let mut child = program.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // Events are printed immediately. The first event after 3 s therefore shows when to kill the program.
    let mut seen_s = 0.0;
    for line in lines {
        let line = line.unwrap();
        if let Some((time, _)) = line.split_once(" s  ")
            && let Ok(time_s) = time.trim().parse::<f64>()
        {
            seen_s = time_s;
        }
        if seen_s > 3.0 {
            break;
        }
    }
    // The program is killed with SIGKILL.
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(seen_s > 3.0);
    let bytes = std::fs::read(&file).unwrap();
    let again = replay(&bytes).unwrap();
    assert_eq!(again.different, 0, "{:?}", again.first_difference);
    assert!(again.seconds > seen_s - 1.0, "{} of {seen_s} s", again.seconds);

    // The program itself can read the file too.
    let mut program = Command::new(env!("CARGO_BIN_EXE_host-bridge"));
    let output = program.arg("replay").arg(&file).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["different"], 0);
    // The reader added the index, which a killed program does not write, and changed nothing else.
    let bytes = std::fs::read(&file).unwrap();
    assert_eq!(replay(&bytes).unwrap(), again);
    // The program must not overwrite an existing file.
    let mut program = Command::new(env!("CARGO_BIN_EXE_host-bridge"));
    let output =
        program.args(["demo", "--headless", "--speed", "0", "--record"]).arg(&file).output().unwrap();
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("choose another"));
    assert_eq!(std::fs::read(&file).unwrap(), bytes);
}
