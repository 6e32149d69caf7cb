//! The program at the desk with the emulated Nano: its flashed image in simavr, in real time, behind a
//! pseudo-terminal. What a user types, on the bytes that the firmware sends.
#![cfg(all(feature = "avr", unix))]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::fd::{FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use fastrand::Rng;
use serialport::{SerialPort as _, TTYPort};
use tests::avr::image;
use tests::avr::nano::{CYCLES_PER_MS, Nano};
use tests::avr::session::BLANK;
use tests::avr::wearer::{Sensors, Wearer};

const PATIENCE: Duration = Duration::from_secs(60);

/// What the test does to wearer and board.
enum Order {
    Bend(f64),
    TiltForward(f64),
    Reset,
    Pull,
    Plug,
    End,
}

/// The emulated board's thread with its port.
struct Desk {
    folder: PathBuf,
    orders: Sender<Order>,
    /// How far the emulated clock is behind the real one.
    behind_ms: Arc<AtomicU64>,
    thread: Option<std::thread::JoinHandle<()>>,
}

fn plug(place: &Path) -> TTYPort {
    let (board, laptop) = TTYPort::pair().expect("a pseudo-terminal");
    // Safety: the port gives its descriptor away and is gone. The copy is not inherited by programs.
    let board = unsafe { OwnedFd::from_raw_fd(board.into_raw_fd()) };
    let copy = board.try_clone().expect("a descriptor");
    let mut port = unsafe { TTYPort::from_raw_fd(copy.into_raw_fd()) };
    port.set_timeout(Duration::from_millis(1)).expect("a timeout");
    let _ = std::fs::remove_file(place);
    std::os::unix::fs::symlink(laptop.name().expect("a name"), place).expect("a link");
    port
}

impl Desk {
    fn new() -> Self {
        let folder = std::env::temp_dir().join(format!("bimanual-desk-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let (orders, received) = channel();
        let place = folder.join("nano");
        let image = image::path();
        let mut port = Some(plug(&place));
        let behind_ms = Arc::new(AtomicU64::new(0));
        let behind = Arc::clone(&behind_ms);
        let thread = std::thread::spawn(move || {
            // The emulator stays in its thread.
            let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(7));
            let mut nano = Nano::new(&image, &BLANK, Box::new(wearer));
            let started = Instant::now();
            loop {
                while let Ok(order) = received.try_recv() {
                    let now_s = nano.now_ms() / 1000.0;
                    match order {
                        Order::Bend(depth) => {
                            (0..2).for_each(|f| hand.borrow_mut().bend(f, depth, now_s, 0.1))
                        }
                        Order::TiltForward(rad) => hand.borrow_mut().tilt(rad, 0.0, now_s, 0.15),
                        Order::Reset => nano.reset(),
                        Order::Pull => {
                            port = None;
                            let _ = std::fs::remove_file(&place);
                        }
                        Order::Plug => port = Some(plug(&place)),
                        Order::End => return,
                    }
                }
                let wanted = started.elapsed().as_millis() as u64 * CYCLES_PER_MS;
                behind.store(wanted.saturating_sub(nano.cycle()) / CYCLES_PER_MS, Ordering::Relaxed);
                if nano.cycle() < wanted {
                    // A slow machine is made good in small steps, so that orders are not kept waiting.
                    nano.run_until(wanted.min(nano.cycle() + 20 * CYCLES_PER_MS));
                } else {
                    std::thread::sleep(Duration::from_millis(1));
                }
                let mut bytes = Vec::new();
                while let Some((_, byte)) = nano.sent() {
                    bytes.push(byte);
                }
                let mut buffer = [0; 256];
                if let Some(port) = &mut port {
                    let _ = port.write(&bytes);
                    let count = port.read(&mut buffer).unwrap_or(0);
                    nano.send(&buffer[..count]);
                }
            }
        });
        Desk { folder, orders, behind_ms, thread: Some(thread) }
    }

    fn port(&self) -> String {
        self.folder.join("nano").display().to_string()
    }

    /// Waits until the emulator keeps up with the clock for two seconds; false where it never does.
    fn keeps_up(&self) -> bool {
        let until = Instant::now() + Duration::from_secs(20);
        let mut since = Instant::now();
        while Instant::now() < until {
            if self.behind_ms.load(Ordering::Relaxed) > 20 {
                since = Instant::now();
            }
            if since.elapsed() > Duration::from_secs(2) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        false
    }

    fn order(&self, order: Order) {
        self.orders.send(order).expect("the board runs");
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = self.orders.send(Order::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The program, built as a user builds it, beside the tests.
fn program() -> PathBuf {
    let exe = std::env::current_exe().expect("a path");
    let debug = exe.ancestors().nth(2).expect("target/debug/deps/test");
    let target = debug.parent().expect("target");
    let status = Command::new("cargo")
        .current_dir(image::root())
        .args(["build", "-q", "-p", "host-bridge", "--target-dir"])
        .arg(target)
        .status()
        .expect("cargo starts");
    assert!(status.success(), "host-bridge does not build");
    debug.join("host-bridge")
}

struct Running {
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
}

fn start(program: &Path, args: &[&str]) -> Running {
    let mut child = Command::new(program)
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let (sender, lines) = channel();
    let out = child.stdout.take().expect("a pipe");
    std::thread::spawn(move || {
        BufReader::new(out).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
    });
    println!("$ host-bridge {}", args.join(" "));
    Running { child, lines, seen: Vec::new() }
}

impl Running {
    fn wait(&mut self, words: &[&str]) {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(left) else {
                let _ = self.child.kill();
                panic!("no line with {words:?}; there were\n{}", self.seen.join("\n"));
            };
            println!("{line}");
            self.seen.push(line.clone());
            if words.iter().all(|word| line.contains(word)) {
                return;
            }
        }
    }

    fn end(mut self) -> bool {
        while let Ok(line) = self.lines.recv_timeout(PATIENCE) {
            println!("{line}");
            self.seen.push(line);
        }
        self.child.wait().expect("it ends").success()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

#[test]
#[ignore = "runs against the wall clock: needs a quiet machine on which the emulator keeps real time"]
fn list_calibrate_and_run_work_on_the_firmware_with_a_pulled_cable_and_a_reset() {
    let program = program();
    let desk = Desk::new();
    let port = desk.port();

    let mut list = start(&program, &["list", &port]);
    list.wait(&["the left hand (Arduino Nano), firmware"]);
    assert!(list.end());

    let mut calibrate = start(&program, &["calibrate", "--port", &port, "--every", "1.5"]);
    calibrate.wait(&["3.", "bend both"]);
    desk.order(Order::Bend(1.0));
    calibrate.wait(&["calibrated and kept in the board"]);
    assert!(calibrate.end());
    desk.order(Order::Bend(0.0));

    assert!(!doctor_says_not_calibrated(&program, &port), "the calibration was kept");

    // The dead-man takes a board whose clock falls behind for one whose states come late, and is right.
    if !desk.keeps_up() {
        println!("SKIPPED: `run`: this machine is too busy to emulate the board in real time");
        return;
    }
    let mut run = start(&program, &["run", "--left", &port, "--json", "--seconds", "120"]);
    run.wait(&["\"state\"", "armed"]);
    desk.order(Order::TiltForward(0.6));
    run.wait(&["\"heading\":\"forward\""]);
    desk.order(Order::Pull);
    run.wait(&["\"halt\"", "silence"]);
    desk.order(Order::Plug);
    run.wait(&["\"open\":true"]);
    desk.order(Order::TiltForward(0.0));
    run.wait(&["\"state\"", "armed"]);
    desk.order(Order::TiltForward(0.6));
    run.wait(&["\"heading\":\"forward\""]);
    desk.order(Order::Reset);
    run.wait(&["\"halt\""]);
    desk.order(Order::TiltForward(0.0));
    run.wait(&["\"state\"", "armed"]);
}

fn doctor_says_not_calibrated(program: &Path, port: &str) -> bool {
    let mut doctor = start(program, &["doctor", "--left", port, "--seconds", "1"]);
    doctor.wait(&["latency"]);
    let mut rest = Vec::new();
    while let Ok(line) = doctor.lines.recv_timeout(PATIENCE) {
        rest.push(line);
    }
    rest.iter().any(|line| line.contains("not calibrated"))
}
