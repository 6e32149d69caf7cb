//! Tests that stop commands still work in the real program while other parts fail.
//! Each test is one row of the campaign (`cargo xtask campaign`).
//!
//! Each test prints a line `row: NAME | COUNT | WORST | LIMIT` for the table.
//! The operating system affects only programs in wall-clock time (by signals, terminals, floods, pauses).
//! Most of these tests therefore also run in wall-clock time and wait for each expected result.
//! Time limits are judged on a quiet machine ([`Lateness`]). A busy machine gets [`GRACE_MS`] more.
//! Two kinds of tests use a desk with simulated time:
//! tests of recordings, and tests of commands without a reader.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _};
use std::net::TcpStream;
use std::os::fd::{AsFd as _, FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::Value;
use serialport::TTYPort;
use shared_proto::message::Heading;
use tungstenite::Message;
use tungstenite::client::IntoClientRequest as _;

use crate::desk::port::alone;
use crate::desk::program::Desk;
use crate::double::Double;
use crate::lateness::Lateness;
use crate::talker::{Flood, Talker};

const PATIENCE: Duration = Duration::from_secs(240);
const PROGRAM: &str = env!("CARGO_BIN_EXE_host-bridge");

/// Extra time for a machine with two processors that also runs other tests.
const GRACE_MS: u64 = 500;

fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

fn row(lateness: Lateness, name: &str, count: usize, worst_ms: u64, limit_ms: u64) {
    println!("row: {name} | {count} | {worst_ms} ms | {limit_ms} ms");
    assert!(!lateness.had_room() || worst_ms <= limit_ms + GRACE_MS, "{name}: {worst_ms} ms");
}

fn ms(time: Duration) -> u64 {
    time.as_millis() as u64
}

/// Starts `run --json` with a simulated left hand.
struct Bridge {
    child: Child,
    lines: Arc<Mutex<Vec<(Instant, Value)>>>,
    reads: Arc<AtomicBool>,
}

impl Bridge {
    fn start(talker: &Talker, more: &[&str]) -> Self {
        let alone = alone();
        let mut child = Command::new(PROGRAM)
            .args(["run", "--json", "--seconds", "120", "--left", &talker.port()])
            .args(more)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        drop(alone);
        let out = child.stdout.take().unwrap();
        // The pipe is small, so that a reader that stops reading soon has an effect.
        let _ = rustix::pipe::fcntl_setpipe_size(out.as_fd(), 4096);
        let (lines, reads) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(true)));
        let (to, may) = (Arc::clone(&lines), Arc::clone(&reads));
        std::thread::spawn(move || {
            for line in BufReader::with_capacity(256, out).lines().map_while(Result::ok) {
                while !may.load(Ordering::SeqCst) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                if let Ok(value) = serde_json::from_str(&line) {
                    to.lock().unwrap().push((Instant::now(), value));
                }
            }
        });
        Bridge { child, lines, reads }
    }

    /// Starts the program and drives forward. Returns the program and the index from which to search for later lines.
    fn driving(talker: &Talker, more: &[&str]) -> (Self, usize) {
        let bridge = Bridge::start(talker, more);
        let from = bridge.drive(talker, 0);
        (bridge, from)
    }

    /// Drives forward from neutral. Returns the index from which to search for later lines.
    /// If a busy machine delays the board, the bridge halts correctly. The drive then restarts from neutral.
    fn drive(&self, talker: &Talker, mut from: usize) -> usize {
        let until = Instant::now() + PATIENCE;
        loop {
            talker.point(Heading::Neutral);
            while !self.is_armed() {
                assert!(Instant::now() < until, "never armed; lines: {:#?}", self.lines.lock().unwrap());
                std::thread::sleep(Duration::from_millis(2));
            }
            talker.point(Heading::Forward);
            let soon = Instant::now() + Duration::from_secs(2);
            while Instant::now() < soon {
                let forward = |line: &Value| line["event"] == "heading" && line["heading"] == "forward";
                if let Some((at, ..)) = self.seen(from, forward) {
                    return at + 1;
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            from = self.lines.lock().unwrap().len();
        }
    }

    /// Returns whether the last state is armed.
    fn is_armed(&self) -> bool {
        let lines = self.lines.lock().unwrap();
        let last = lines.iter().rev().find(|(_, line)| line["event"] == "state");
        last.is_some_and(|(_, line)| line["state"] == "armed")
    }

    fn seen(&self, from: usize, wanted: impl Fn(&Value) -> bool) -> Option<(usize, Instant, Value)> {
        let lines = self.lines.lock().unwrap();
        let at = (from..lines.len()).find(|&at| wanted(&lines[at].1))?;
        Some((at, lines[at].0, lines[at].1.clone()))
    }

    fn wait(&self, from: usize, wanted: impl Fn(&Value) -> bool) -> (usize, Instant, Value) {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(found) = self.seen(from, &wanted) {
                return found;
            }
            assert!(Instant::now() < until, "not seen; lines: {:#?}", self.lines.lock().unwrap());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn signal(&self, name: &str) {
        signal(&self.child, name);
    }

    fn memory_mb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.split_whitespace().next().unwrap().parse::<u64>().unwrap() / 1024
    }

    fn page(&self) -> tungstenite::WebSocket<TcpStream> {
        let url = self.wait(0, |line| line["event"] == "page").2["url"].as_str().unwrap().to_owned();
        let address = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
        let mut request = format!("ws://{address}/live").into_client_request().unwrap();
        request.headers_mut().insert("Origin", format!("http://{address}").parse().unwrap());
        let stream = TcpStream::connect(&address).unwrap();
        tungstenite::client(request, stream).unwrap().0
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

/// Returns the time until the child exits, and its exit code.
fn end_of(child: &mut Child) -> (Duration, Option<i32>) {
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return (began.elapsed(), status.code());
        }
        assert!(began.elapsed() < PATIENCE, "it does not end");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn is_halt(line: &Value) -> bool {
    line["event"] == "halt"
}

#[test]
fn each_signal_ends_a_driving_session_with_a_halt_within_a_second() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let talker = Talker::start(folder.path());
    let moments = if is_full() { 20 } else { 1 };
    let (mut worst, mut count) = (0, 0);
    for name in ["-INT", "-TERM", "-HUP", "-QUIT"] {
        for moment in 0..moments {
            talker.point(Heading::Neutral);
            let (mut bridge, from) = Bridge::driving(&talker, &[]);
            std::thread::sleep(Duration::from_millis(37 * moment));
            bridge.signal(name);
            let (took, code) = end_of(&mut bridge.child);
            assert_eq!(code, Some(0), "{name}");
            // The last line is the final state. All output was therefore written, and none was truncated.
            bridge.wait(from, |line| line["event"] == "end");
            worst = worst.max(ms(took));
            count += 1;
        }
    }
    row(lateness, "signals: the program is gone", count, worst, 1000);
}

/// The program on a terminal of its own, with the live view.
struct OnTerminal {
    child: Child,
    /// The test's side of the terminal, which receives the screen output.
    screen: File,
    /// The terminal is kept open, so that its settings can be queried.
    terminal: File,
}

/// Returns a copy of the descriptor that no other program inherits. Otherwise, the terminal would stay open.
fn file(port: TTYPort) -> File {
    // Safety: the port gives up ownership of its descriptor.
    let port: OwnedFd = unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) };
    port.try_clone().unwrap().into()
}

impl OnTerminal {
    fn start(args: &[&str], hangups_ignored: bool) -> Self {
        let alone = alone();
        let (screen, terminal) = TTYPort::pair().unwrap();
        let (screen, terminal) = (file(screen), file(terminal));
        // The terminal gets the settings of a shell instead of those of a serial port.
        let mut sane = Command::new("stty");
        sane.args(["sane", "rows", "50", "cols", "160"]).stdin(terminal.try_clone().unwrap());
        assert!(sane.status().unwrap().success());
        let (program, first): (&str, &[&str]) = if hangups_ignored {
            ("sh", &["-c", "trap '' HUP; exec \"$0\" \"$@\"", PROGRAM])
        } else {
            (PROGRAM, &[])
        };
        let child = Command::new(program)
            .args(first)
            .args(args)
            .env("TERM", "xterm")
            .stdin(terminal.try_clone().unwrap())
            .stdout(terminal.try_clone().unwrap())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        drop(alone);
        OnTerminal { child, screen, terminal }
    }

    fn settings(&self) -> String {
        let mut ask = Command::new("stty");
        ask.arg("-g").stdin(self.terminal.try_clone().unwrap());
        String::from_utf8(ask.output().unwrap().stdout).unwrap()
    }

    /// Reads until the view displays this text.
    fn wait_for(&mut self, text: &str) -> String {
        let (mut seen, mut buffer) = (String::new(), [0; 4096]);
        let until = Instant::now() + PATIENCE;
        while !seen.contains(text) {
            assert!(Instant::now() < until, "{text:?} is not shown: {seen:?}");
            let count = self.screen.read(&mut buffer).unwrap();
            seen += &String::from_utf8_lossy(&buffer[..count]);
        }
        seen
    }
}

#[test]
fn a_signal_gives_the_terminal_back_as_it_was() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let talker = Talker::start(folder.path());
    let port = talker.port();
    let verbs: [&[&str]; 2] = [&["run", "--left", &port, "--seconds", "60"], &["demo"]];
    let (mut worst, mut count) = (0, 0);
    for args in verbs {
        for name in ["-TERM", "-HUP", "-INT", "-QUIT"] {
            let mut there = OnTerminal::start(args, false);
            // `start` leaves the terminal in a shell's mode. The program switches it to raw mode.
            there.wait_for("\x1b[?1049h");
            let raw = there.settings();
            signal(&there.child, name);
            let (took, _) = end_of(&mut there.child);
            let after = there.settings();
            assert_ne!(raw, after, "{args:?} {name}: still raw");
            let rest = there.wait_for("\x1b[?1049l");
            assert!(rest.contains("\x1b[?25h"), "{args:?} {name}: the cursor is back");
            worst = worst.max(ms(took));
            count += 1;
        }
    }
    row(lateness, "signals: the terminal is as it was", count, worst, 1000);
}

#[test]
fn a_terminal_that_vanishes_ends_the_program_even_where_hangups_are_ignored() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let talker = Talker::start(folder.path());
    let (mut worst, mut count) = (0, 0);
    for ignored in [false, true] {
        let port = talker.port();
        let mut there = OnTerminal::start(&["run", "--left", &port, "--seconds", "60"], ignored);
        there.wait_for("\x1b[?1049h");
        let OnTerminal { child, screen, terminal } = &mut there;
        let nothing = || File::open("/dev/null").unwrap();
        (*screen, *terminal) = (nothing(), nothing());
        let (took, _) = end_of(child);
        worst = worst.max(ms(took));
        count += 1;
    }
    row(lateness, "a closed terminal: the program is gone", count, worst, 1000);
}

#[test]
fn a_terminal_that_takes_no_output_delays_no_end() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let talker = Talker::start(folder.path());
    let port = talker.port();
    let mut there = OnTerminal::start(&["run", "--left", &port, "--seconds", "60"], false);
    there.wait_for("\x1b[?1049h");
    // From here on, nobody reads, and the live view's output fills the terminal's buffer.
    std::thread::sleep(Duration::from_secs(3));
    signal(&there.child, "-TERM");
    let (took, _) = end_of(&mut there.child);
    row(lateness, "a stalled terminal: the program is gone", 1, ms(took), 1000);
}

#[test]
fn floods_delay_no_stop_and_fill_no_memory() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let seconds = if is_full() { 10 } else { 2 };
    let (mut stop_worst, mut end_worst, mut memory_worst, mut count) = (0, 0, 0, 0);
    for flood in [Flood::Zeros, Flood::States, Flood::Hellos] {
        let talker = Talker::start(folder.path());
        let (mut bridge, from) = Bridge::driving(&talker, &["--web=0"]);
        let mut page = bridge.page();
        talker.set(|wish| wish.flood = Some(flood));
        std::thread::sleep(Duration::from_secs(seconds));
        memory_worst = memory_worst.max(bridge.memory_mb());
        let pressed = Instant::now();
        page.send(Message::text("stop")).unwrap();
        let (_, stopped, _) = bridge.wait(from, |line| is_halt(line) && line["reason"] == "operator-stop");
        stop_worst = stop_worst.max(ms(stopped - pressed));
        bridge.signal("-TERM");
        end_worst = end_worst.max(ms(end_of(&mut bridge.child).0));
        count += 1;
    }
    row(lateness.clone(), "floods: the page's stop", count, stop_worst, 20);
    row(lateness.clone(), "floods: the program is gone", count, end_worst, 1000);
    println!("row: floods: memory | {count} | {memory_worst} MB | 100 MB");
    assert!(memory_worst < 100, "{memory_worst} MB");
}

#[test]
fn a_thousand_connections_keep_nobody_from_the_pages_stop() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let (mut worst, mut memory_mb) = (0, 0);
    // The test has two cases: the page connects before the thousand connections, or after them.
    for comes_late in [false, true] {
        let talker = Talker::start(folder.path());
        let (bridge, from) = Bridge::driving(&talker, &["--web=0"]);
        let mut page = bridge.page();
        let address = page.get_ref().peer_addr().unwrap();
        let mut held = Vec::new();
        for n in 0..1000 {
            held.push(TcpStream::connect(address).unwrap());
            if n % 20 == 0 {
                // Like a browser, the page acknowledges each message.
                while !page.read().unwrap().to_text().unwrap().contains("safety") {}
                page.send(Message::text("took")).unwrap();
            }
        }
        memory_mb = memory_mb.max(bridge.memory_mb());
        if comes_late {
            page = bridge.page();
        }
        let pressed = Instant::now();
        page.send(Message::text("stop")).unwrap();
        let (_, stopped, _) = bridge.wait(from, |line| is_halt(line) && line["reason"] == "operator-stop");
        worst = worst.max(ms(stopped - pressed));
    }
    row(lateness, "1,000 connections: the page's stop", 2, worst, 20);
    println!("row: 1,000 connections: memory | 2 | {memory_mb} MB | 100 MB");
    assert!(memory_mb < 100, "{memory_mb} MB");
}

#[test]
fn a_hand_that_falls_silent_behind_a_flood_halts() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let (mut worst, mut count) = (0, 0);
    for flood in [Flood::Zeros, Flood::Hellos] {
        let talker = Talker::start(folder.path());
        let (bridge, from) = Bridge::driving(&talker, &[]);
        talker.set(|wish| (wish.flood, wish.silent) = (Some(flood), true));
        let (_, halted, _) = bridge.wait(from, is_halt);
        worst = worst.max(ms(halted.saturating_duration_since(talker.last_state())));
        count += 1;
    }
    row(lateness, "floods: halt by silence", count, worst, 260);
}

#[test]
fn a_reader_of_json_that_stops_reading_delays_no_halt() {
    let lateness = Lateness::watch();
    let folder = tempfile::tempdir().unwrap();
    let talker = Talker::start(folder.path());
    let (bridge, from) = Bridge::driving(&talker, &[]);
    let (_, seen, line) = bridge.wait(from - 1, |line| line["heading"] == "forward");
    let program_ms = line["time_ms"].as_u64().unwrap();
    bridge.reads.store(false, Ordering::SeqCst);
    // Each of the 60 changes of heading produces a line.
    // Together, the lines need several times the pipe's capacity.
    for change in 0..60 {
        talker.point(if change % 2 == 0 { Heading::Left } else { Heading::Right });
        std::thread::sleep(Duration::from_millis(40));
    }
    talker.set(|wish| wish.silent = true);
    std::thread::sleep(Duration::from_millis(1500));
    let silent = talker.last_state();
    bridge.reads.store(true, Ordering::SeqCst);
    let (_, _, halt) = bridge.wait(from, is_halt);
    let halted_ms = halt["time_ms"].as_u64().unwrap();
    let silent_ms = program_ms + ms(silent - seen);
    row(lateness, "a reader that stops: halt by silence", 1, halted_ms.saturating_sub(silent_ms), 260);
}

#[test]
fn a_program_that_was_stopped_and_continued_moves_nothing_before_neutral() {
    let folder = tempfile::tempdir().unwrap();
    let pauses_ms: &[u64] = if is_full() { &[300, 600, 1000, 5000, 20_000, 60_000] } else { &[400, 1500] };
    for &pause_ms in pauses_ms {
        let talker = Talker::start(folder.path());
        let (bridge, from) = Bridge::driving(&talker, &[]);
        bridge.signal("-STOP");
        std::thread::sleep(Duration::from_millis(pause_ms));
        bridge.signal("-CONT");
        let (at, _, _) = bridge.wait(from, is_halt);
        std::thread::sleep(Duration::from_millis(1500));
        let moved = bridge.seen(at, |line| line["event"] == "heading");
        assert!(moved.is_none(), "after {pause_ms} ms: {moved:?}");
        bridge.drive(&talker, at);
    }
    println!("row: stopped and continued: nothing before neutral | {} | 0 moves | 0 moves", pauses_ms.len());
}

#[test]
fn a_board_whose_words_all_come_late_never_arms() {
    let folder = tempfile::tempdir().unwrap();
    let seconds = if is_full() { 60 } else { 6 };
    let delays_ms = [200, 600, 1500, 3000];
    let boards: Vec<(Talker, Bridge)> = delays_ms
        .iter()
        .map(|delay_ms| {
            let folder = folder.path().join(delay_ms.to_string());
            std::fs::create_dir(&folder).unwrap();
            let talker = Talker::start(&folder);
            talker.set(|wish| wish.delay = Duration::from_millis(*delay_ms));
            let bridge = Bridge::start(&talker, &[]);
            (talker, bridge)
        })
        .collect();
    std::thread::sleep(Duration::from_secs(seconds));
    for ((_, bridge), delay_ms) in boards.iter().zip(delays_ms) {
        bridge.wait(0, |line| line["event"] == "hand-started");
        let armed = bridge.seen(0, |line| line["state"] == "armed");
        assert!(armed.is_none(), "{delay_ms} ms: {armed:?}");
    }
    println!("row: delays of 0.2 to 3 s: never armed | {} | 0 | 0", delays_ms.len());
}

#[test]
fn output_that_nobody_takes_is_no_panic_in_any_verb() {
    let desk = Desk::new("stops-output");
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    let (left, right) = (left.port(), right.port());
    let out = desk.text("recordings");
    let verbs = [
        format!("list {left}"),
        "run --print-config".to_owned(),
        "demo --json --speed 0".to_owned(),
        "demo --headless --speed 0".to_owned(),
        format!("run --json --seconds 1 --left {left}"),
        format!("doctor --left {left} --seconds 1"),
        format!("record --port {right} --label circle --person me --seconds 1 --countdown 0 --out {out}"),
        "--help".to_owned(),
        "replay no-such-file.mcap".to_owned(),
    ];
    let mut count = 0;
    for verb in &verbs {
        for sink in ["| true", "| head -c 1", "> /dev/full", "> /dev/full 2> /dev/full", ">&- 2>&-"] {
            let mut shell = Command::new("bash");
            // With this option, the shell returns the program's exit code,
            // and not the exit code of the pipeline's last command.
            shell.args(["-c", &format!("{PROGRAM} {verb} {sink}; exit ${{PIPESTATUS[0]}}")]);
            let (status, told) = desk.start(shell).end();
            assert!(status.code() != Some(101) && !told.contains("panicked"), "{verb} {sink}: {told}");
            count += 1;
        }
    }
    println!("row: output that nobody reads: no panic | {count} | 0 | 0");
    // The recordings were nevertheless saved.
    let saved = std::fs::read_dir(desk.path("recordings/circle")).unwrap().count();
    assert_eq!(saved, 5);
}

#[test]
fn a_recording_ended_by_any_signal_leaves_a_board_that_classifies() {
    let desk = Desk::new("stops-record");
    let right = Double::right(&desk, 0.0);
    let (port, out) = (right.port(), desk.text("r"));
    for name in ["-TERM", "-HUP", "-INT", "-QUIT"] {
        let take = ["record", "--port", &port, "--label", "circle", "--person", "me", "--seconds", "30"];
        let more = ["--countdown", "0", "--out", &out];
        let mut record = desk.run(PROGRAM.as_ref(), &[&take[..], &more].concat());
        record.wait(&["go: circle"]);
        assert!(!right.classifies(), "{name}");
        desk.pass(Duration::from_millis(300));
        record.signal(name);
        let signalled_ms = desk.time().now_ms();
        record.end();
        let took_ms = desk.time().now_ms() - signalled_ms;
        assert!(took_ms <= 1000 + GRACE_MS, "{name}: {took_ms} ms");
        assert!(right.classifies(), "{name}");
    }
    println!("row: record cut short: the board classifies | 4 | 0 | 0");
}

#[test]
fn two_recordings_of_one_label_at_a_time_are_both_kept() {
    let desk = Desk::new("stops-two");
    let out = desk.text("recordings");
    let rights = ["one", "other"].map(|name| Double::right_named(&desk, name, 0.0));
    let records = rights.each_ref().map(|right| {
        let port = right.port();
        let take = ["record", "--port", &port, "--label", "circle", "--person", "me"];
        let more = ["--seconds", "1", "--countdown", "0", "--out", &out];
        desk.run(PROGRAM.as_ref(), &[&take[..], &more].concat())
    });
    for record in records {
        let (status, text) = record.end();
        assert!(status.success(), "{text}");
    }
    assert_eq!(std::fs::read_dir(desk.path("recordings/circle")).unwrap().count(), 2);
}
