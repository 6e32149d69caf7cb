//! Tests the program with the flashed images of both emulated boards behind pseudo-terminals.
//! The tests run user commands, disconnect cables and restart boards.
//! Boards and program share a simulated time, so results do not depend on the speed of the machine.
#![cfg(all(feature = "avr", feature = "nrf", unix))]

use std::time::Duration;

use fastrand::Rng;
use models::recording::Recording;
use models::synth::{Motion, Wearer};
use tests::desk::left::{Left, LeftStation};
use tests::desk::program::{Desk, Running};
use tests::desk::programs::{bridge, run};
use tests::desk::right::{Right, RightStation};
use tests::desk::station::{Board, Station};
use tests::is_full;

use crate::renamed::renamed_model;

/// Maximum time until the base drives, or until the end of a gesture is recognised.
const SOON: Duration = Duration::from_secs(12);
/// Maximum number of attempts. The model does not recognise every simulated gesture.
const DRAWINGS: u32 = 3;

fn armed(run: &mut Running) {
    if !run.is_armed() {
        run.wait(&["\"event\":\"state\"", "armed"]);
    }
}

/// Holds the hand level and then forward, until the base drives.
fn drive_forward(run: &mut Running, left: &LeftStation) {
    left.with(|board| board.tilt(0.0));
    armed(run);
    left.with(|board| board.tilt(0.6));
    if run.wait_for(SOON, &["\"heading\":\"forward\""]).is_none() {
        panic!("the base does not drive; there were\n{}", run.seen.join("\n"));
    }
}

/// Repeats a gesture until it starts this motion of the arm.
fn draw(run: &mut Running, right: &RightStation, motion: Motion, label: &str) {
    for _ in 0..DRAWINGS {
        armed(run);
        right.with(move |board| board.perform(motion, 4.0));
        if run.wait_for(SOON, &["\"gesture\"", label, "started"]).is_some() {
            return;
        }
    }
    panic!("{label} starts nothing; there were\n{}", run.seen.join("\n"));
}

/// Returns the last line that `run --json` printed.
fn summary(text: &str) -> serde_json::Value {
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("the last line is an object")
}

#[test]
fn list_and_doctor_name_both_hands_and_calibrate_is_kept_in_the_board() {
    let desk = Desk::new("desk-doctor");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let (status, text) = run(&desk, &["list", &left.port(), &right.port()]);
    assert!(status.success(), "{text}");
    for word in
        ["the left hand (Arduino Nano), firmware", "the right hand (Nano 33 BLE Sense), firmware", "model "]
    {
        assert!(text.contains(word), "{word} in\n{text}");
    }

    let (_, text) =
        run(&desk, &["doctor", "--left", &left.port(), "--right", &right.port(), "--seconds", "2"]);
    for word in [
        "not calibrated: `host-bridge calibrate`",
        "samples 100 Hz",
        "ppm",
        "ping and back",
        "idle, up-down",
        "load",
        "Rev1, sensor LSM9DS1, 9 axes; image behind the Arduino bootloader, without Bluetooth; started by",
        "battery unknown",
    ] {
        assert!(text.contains(word), "{word} in\n{text}");
    }

    let port = left.port();
    let mut calibrate = bridge(&desk, &["calibrate", "--port", &port]);
    left.take_three_poses(&mut calibrate);
    let (status, text) = calibrate.end();
    assert!(status.success() && text.contains("calibrated and kept in the board"), "{text}");
    left.with(|board| board.bend(0.0));

    // Opening the port restarts the board, so its data now comes from its EEPROM.
    let (_, text) = run(&desk, &["doctor", "--left", &left.port(), "--seconds", "1"]);
    assert!(text.contains("the left hand") && !text.contains("not calibrated"), "{text}");

    // If the wrong board answers, the program does nothing and names the board.
    let (status, text) = run(&desk, &["calibrate", "--port", &right.port()]);
    assert!(!status.success() && text.contains("answers; only the left"), "{text}");
}

#[test]
fn both_hands_move_base_and_arm_through_pulled_cables_and_restarts() {
    let desk = Desk::new("desk-run");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let (port, other) = (left.port(), right.port());
    let mut run = bridge(&desk, &["run", "--left", &port, "--right", &other, "--json", "--seconds", "600"]);
    draw(&mut run, &right, Motion::Circle, "circle");
    drive_forward(&mut run, &left);

    // A reset of the driving board halts the robot, and a tilted hand does not restart it.
    left.restart();
    run.wait(&["\"halt\""]);
    drive_forward(&mut run, &left);

    // Cables are disconnected at random moments. The robot must halt each time and continue only after neutral.
    let mut rng = Rng::with_seed(5);
    let pulls = if is_full() { 20 } else { 2 };
    for pull in 0..pulls {
        desk.pass(Duration::from_millis(rng.u64(0..400)));
        run.catch_up();
        if pull % 2 == 0 {
            left.pull()
        } else {
            right.pull()
        }
        run.wait(&["\"open\":false", "comes back by itself"]);
        if run.is_armed() {
            run.wait(&["\"halt\""]);
        }
        desk.pass(Duration::from_millis(rng.u64(0..400)));
        let before = run.seen.len();
        if pull % 2 == 0 {
            left.plug()
        } else {
            right.plug()
        }
        run.wait(&["hand-started"]);
        desk.pass(Duration::from_millis(300));
        run.catch_up();
        let moved = run.seen[before..].iter().any(|line| line.contains("\"heading\":\"forward\""));
        assert!(!moved, "a hand that was never neutral moves the robot:\n{}", run.seen.join("\n"));
        drive_forward(&mut run, &left);
    }
    // The right board restarts while its cable is connected.
    right.restart();
    run.wait(&["\"open\":false"]);
    run.wait(&["hand-started"]);
    left.with(|board| board.tilt(0.0));
    draw(&mut run, &right, Motion::Circle, "circle");
}

#[test]
fn a_laptop_that_slept_moves_nothing_before_neutral_though_its_boards_went_on() {
    let desk = Desk::new("desk-sleep");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let (port, other) = (left.port(), right.port());
    let mut run = bridge(&desk, &["run", "--left", &port, "--right", &other, "--json", "--seconds", "600"]);
    let slept_s: &[f32] = if is_full() { &[0.3, 1.0, 5.0, 20.0, 60.0] } else { &[0.3, 5.0] };
    for &slept_s in slept_s {
        drive_forward(&mut run, &left);
        run.catch_up();
        let asleep = run.seen.len();
        // The hand stays tilted. Frames that its board sends meanwhile are queued in the port.
        desk.time().suspend(Duration::from_secs_f32(slept_s));
        run.wait(&["\"halt\""]);
        desk.pass(Duration::from_millis(1500));
        run.catch_up();
        let moved = run.seen[asleep..].iter().any(|line| line.contains("\"heading\":\"forward\""));
        assert!(!moved, "after {slept_s} s asleep a tilt moves the robot:\n{}", run.seen.join("\n"));
    }
    println!("row: the laptop asleep: nothing before neutral | {} | 0 moves | 0 moves", slept_s.len());
}

#[test]
fn the_run_ends_with_its_figures_and_loses_next_to_nothing() {
    let desk = Desk::new("desk-figures");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(2));
    let (port, other) = (left.port(), right.port());
    let (status, text) = run(&desk, &["run", "--left", &port, "--right", &other, "--json", "--seconds", "8"]);
    assert!(status.success(), "{text}");
    let last = summary(&text);
    assert_eq!(last["event"], "end");
    for (hand, least) in [(0, 10), (1, 10)] {
        let frames = &last["frames"][hand];
        assert!(frames["frames"].as_u64() > Some(least), "{last}");
        // The port may have been opened in the middle of a frame.
        assert!(frames["damaged"].as_u64() <= Some(1), "{last}");
        assert!(last["round_trip_ms"][hand].as_u64().is_some(), "both boards answer pings: {last}");
    }
}

#[test]
fn recordings_hold_what_the_sensor_felt_and_a_spoilt_take_leaves_nothing() {
    let desk = Desk::new("desk-record");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let (port, out) = (right.port(), desk.text("recordings"));
    let options = ["record", "--port", &port, "--person", "me", "--out", &out, "--countdown", "0"];
    let record = |more: &[&str]| bridge(&desk, &[&options, more].concat());

    let mut take = record(&["--label", "up-down", "--seconds", "3"]);
    take.wait(&["go: up-down"]);
    right.with(|board| board.perform(Motion::UpDown, 4.0));
    let (status, text) = take.end();
    assert!(status.success() && text.contains("300 samples, no gaps"), "{text}");
    let file = desk.path("recordings/up-down/me__1.csv");
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("timestamp,accX,accY,accZ,gyrX"));
    let recording = Recording::read(&file).unwrap();
    assert_eq!((recording.axes(), recording.len()), (9, 300));
    // The strokes are vertical, parallel to gravity.
    let swing = |axis: usize| {
        let values: Vec<f32> = recording.samples().map(|sample| sample[axis]).collect();
        values.iter().copied().fold(f32::MIN, f32::max) - values.iter().copied().fold(f32::MAX, f32::min)
    };
    assert!(swing(2) > 5.0 && swing(2) > swing(1), "{} {} {} m/s²", swing(0), swing(1), swing(2));

    let (status, text) = record(&["--guided", "--labels", "idle,wave", "--seconds", "0.5"]).end();
    assert!(status.success(), "{text}");
    assert!(desk.path("recordings/wave/me__1.csv").is_file(), "{text}");

    type Break = fn(&RightStation, &Running);
    let breaks: [(Break, &str); 3] = [
        (|board, _| board.pull(), "nothing was saved"),
        (|board, _| board.restart(), "nothing was saved"),
        (|_, run| run.interrupt(), "not saved"),
    ];
    for (how, word) in breaks {
        right.plug();
        let mut take = record(&["--label", "circle", "--seconds", "30"]);
        take.wait(&["go: circle"]);
        desk.pass(Duration::from_millis(400));
        how(&right, &take);
        let (status, text) = take.end();
        assert!(!status.success() && text.contains(word), "{word} in\n{text}");
        assert!(!desk.path("recordings/circle/me__1.csv").exists(), "{text}");
    }
}

/// Runs a command and disconnects the cable (or presses reset) after a delay.
/// The command must end without a panic, and its error must state what to do.
fn disturbed<B: Board + 'static>(
    desk: &Desk,
    board: &Station<B>,
    args: &[&str],
    after: Duration,
    how: fn(&Station<B>),
) -> String {
    board.plug();
    let verb = bridge(desk, args);
    desk.pass(after);
    how(board);
    let (status, text) = verb.end();
    assert!(!text.contains("panicked"), "{text}");
    let advises = ["plug", "host-bridge list", "restart", "run calibrate again"];
    assert!(status.success() || advises.iter().any(|word| text.contains(word)), "{args:?}: {text}");
    text
}

#[test]
fn a_cable_pulled_or_a_reset_at_any_moment_ends_every_verb_with_advice() {
    let desk = Desk::new("desk-pulls");
    let left = Left::start(&desk, "nano");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let (port, other, out) = (left.port(), right.port(), desk.text("recordings"));
    let rounds = if is_full() { 10 } else { 1 };
    let mut rng = Rng::with_seed(9);
    let moment = |rng: &mut Rng| Duration::from_millis(rng.u64(0..3000));
    let calibrate = ["calibrate", "--port", &port, "--every", "0.5"];
    let doctor = ["doctor", "--right", &other, "--seconds", "3"];
    let record = ["record", "--port", &other, "--person", "me", "--label", "circle", "--out", &out];
    for _ in 0..rounds {
        disturbed(&desk, &left, &calibrate, moment(&mut rng), Station::pull);
        disturbed(&desk, &left, &calibrate, moment(&mut rng), Station::restart);
        disturbed(&desk, &left, &["list", &port], moment(&mut rng), Station::pull);
        let doctor_left = ["doctor", "--left", &port, "--seconds", "3"];
        disturbed(&desk, &left, &doctor_left, moment(&mut rng), Station::pull);
        disturbed(&desk, &right, &doctor, moment(&mut rng), Station::pull);
        let text = disturbed(&desk, &right, &doctor, moment(&mut rng), Station::restart);
        assert!(!text.contains("replace the board"), "two clocks are taken for one: {text}");
        let record = [&record[..], &["--seconds", "60"]].concat();
        disturbed(&desk, &right, &record, moment(&mut rng), Station::pull);
        assert!(!desk.path("recordings/circle/me__1.csv").exists(), "a spoilt take is saved");
    }
    // Both boards still work.
    left.plug();
    right.plug();
    let (status, text) = run(&desk, &["list", &port, &other]);
    assert!(status.success() && text.contains("the left hand") && text.contains("the right hand"), "{text}");
}

#[test]
fn a_model_sent_through_a_cut_and_a_restart_classifies_after_the_next_one() {
    let desk = Desk::new("desk-model");
    let right = Right::start(&desk, "nano33", Wearer::demo(1));
    let port = right.port();
    let (file, id) = renamed_model(desk.path("").as_path());
    let file = file.display().to_string();

    // The cable is disconnected in the middle of the transfer of about 1270 words.
    right.pull_when(|board| board.words_written() > 500);
    let mut send = bridge(&desk, &["send-model", &file, "--port", &port]);
    send.wait(&["sending", &id]);
    send.wait(&["comes back by itself"]);
    // The cable also supplied the board, so the board and the transfer start again.
    right.plug();
    let (status, text) = send.end();
    assert!(status.success() && text.contains(&format!("→ {id}")), "{text}");

    let (_, text) = run(&desk, &["doctor", "--right", &port, "--seconds", "1"]);
    assert!(
        text.contains("model ") && !text.contains(&format!("model {id}")),
        "not before a restart: {text}"
    );
    right.restart();
    let (_, shown) = run(&desk, &["doctor", "--right", &port, "--seconds", "1"]);
    assert!(shown.contains(&format!("model {id}")) && shown.contains("wave"), "{shown}");

    let config = desk.path("desk.toml");
    std::fs::write(&config, format!("[ports]\nright = '{port}'\n[motions]\nwave = 'pick-up'\n")).unwrap();
    let config = config.display().to_string();
    let mut run = bridge(&desk, &["run", "--config", &config, "--json", "--seconds", "600"]);
    draw(&mut run, &right, Motion::Circle, "wave");
}
