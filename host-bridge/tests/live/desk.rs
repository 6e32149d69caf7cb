//! Runs the program with boards behind pseudo-terminals.
//! The tests check commands and their output, a disconnected cable and a restarted board.
//! The simulated boards run the boards' own logic (`support/double.rs`).
//! The crate `tests` emulates the complete firmware images.

use std::net::TcpStream;
use std::path::Path;
use std::process::ExitStatus;
use std::time::Duration;

use host_bridge::adc::AdcRecording;
use models::recording::Recording;
use shared_dsp::left::AdcCounts;
use shared_proto::message::{PROTOCOL_MAJOR, PROTOCOL_MINOR};
use tungstenite::Message;
use tungstenite::client::IntoClientRequest as _;

use crate::desk::program::{Desk, Running};
use crate::double::{BENT, Double, FORWARD, LEVEL};
use crate::host_bridge;
use crate::renamed::renamed_model;

fn start(desk: &Desk, args: &[&str]) -> Running {
    desk.run(Path::new(host_bridge()), args)
}

fn run(desk: &Desk, args: &[&str]) -> (ExitStatus, String) {
    start(desk, args).end()
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .map(|entries| entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect())
        .unwrap_or_default();
    names.sort();
    names
}

#[test]
fn list_names_who_answers_and_gives_hints_where_nobody_does() {
    let desk = Desk::new("live-1");
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    let (status, text) = run(&desk, &["list", &left.port(), &right.port()]);
    assert!(status.success(), "{text}");
    for word in ["the left hand (Arduino Nano)", "the right hand (Nano 33 BLE Sense)", "model "] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
    let (status, text) = run(&desk, &["list", "/no/such/port"]);
    assert_eq!(status.code(), Some(1));
    for word in ["/no/such/port", "cable", "dialout", "driver", "keyboard"] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
}

#[test]
fn a_pulled_cable_halts_the_robot_and_a_replugged_one_needs_neutral() {
    let desk = Desk::new("live-2");
    let left = Double::left(&desk);
    let mut run = start(&desk, &["run", "--left", &left.port(), "--json", "--seconds", "60"]);
    run.wait(&["\"state\"", "armed"]);
    left.hold(FORWARD);
    run.wait(&["\"heading\":\"forward\""]);
    desk.pass(Duration::from_millis(700));
    left.pull();
    run.wait(&["\"open\":false", "comes back by itself"]);
    run.wait(&["\"halt\"", "silence"]);
    run.wait(&["\"state\"", "stale"]);
    // The board is reconnected while it is tilted. It restarts, and the robot does not move.
    left.plug();
    run.wait(&["\"open\":true"]);
    run.wait(&["hand-started"]);
    desk.pass(Duration::from_millis(1000));
    let before = run.seen.len();
    left.hold(LEVEL);
    run.wait(&["\"state\"", "armed"]);
    assert!(!run.seen[before..].iter().any(|line| line.contains("\"forward\"")), "{:#?}", run.seen);
    // A restart without loss of the port also halts the robot.
    left.hold(FORWARD);
    run.wait(&["\"heading\":\"forward\""]);
    left.restart();
    run.wait(&["\"halt\""]);
    left.hold(LEVEL);
    run.wait(&["\"state\"", "armed"]);
}

#[test]
fn both_hands_on_their_ports_move_base_and_arm() {
    let desk = Desk::new("live-3");
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    let mut run =
        start(&desk, &["run", "--left", &left.port(), "--right", &right.port(), "--json", "--seconds", "25"]);
    run.wait(&["\"state\"", "armed"]);
    left.hold(FORWARD);
    run.wait(&["\"heading\":\"forward\""]);
    desk.pass(Duration::from_millis(500));
    left.hold(LEVEL);
    run.wait(&["\"gesture\"", "started"]);
    let (status, text) = run.end();
    assert!(status.success(), "{text}");
    let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert_eq!(last["event"], "end");
    assert!(last["odometry"]["path_m"].as_f64().unwrap() > 0.1, "{last}");
    for hand in [0, 1] {
        assert!(last["round_trip_ms"][hand].as_u64().is_some(), "both boards answer pings: {last}");
        // On a busy machine some frames may be lost, because the boards drop frames that nobody reads.
        assert!(last["frames"][hand]["lost"].as_u64().unwrap() < 50, "{last}");
    }
}

#[test]
fn left_handed_exchanges_the_ports() {
    let desk = Desk::new("live-4");
    let left = Double::left(&desk);
    let config = desk.path("desk.toml");
    std::fs::write(&config, format!("left_handed = true\n[ports]\nright = '{}'\n", left.port())).unwrap();
    let config = config.display().to_string();
    let mut run = start(&desk, &["run", "--config", &config, "--json", "--seconds", "30"]);
    run.wait(&["\"state\"", "armed"]);
    left.hold(FORWARD);
    run.wait(&["\"heading\":\"forward\""]);
}

#[test]
fn calibrate_walks_through_three_poses_and_doctor_is_content_afterwards() {
    let desk = Desk::new("live-5");
    let left = Double::left(&desk);
    let (status, text) = run(&desk, &["doctor", "--left", &left.port(), "--seconds", "2"]);
    assert_eq!(status.code(), Some(1), "{text}");
    assert!(text.contains("host-bridge calibrate"), "{text}");

    let mut calibrate = start(&desk, &["calibrate", "--port", &left.port(), "--every", "0.4"]);
    calibrate.wait(&["1.", "level"]);
    calibrate.wait(&["3.", "bend both"]);
    left.hold(BENT);
    let (status, text) = calibrate.end();
    assert!(status.success(), "{text}");
    assert!(text.contains("pitch 0°, roll 0°") || text.contains("pitch -0°"), "{text}");

    left.hold(LEVEL);
    let (status, text) = run(&desk, &["doctor", "--left", &left.port(), "--seconds", "3"]);
    assert!(text.contains("all is well") && status.success(), "{text}");
    let (status, wrong) = run(&desk, &["doctor", "--right", &left.port(), "--seconds", "1"]);
    assert!(
        !status.success() && wrong.contains("where the right hand is expected: swap the ports"),
        "{wrong}"
    );
    let protocol = format!("protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}");
    for word in [&*protocol, "samples 100 Hz", "ppm", "ping and back", "0.00 % of the states lost"] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
}

#[test]
fn a_pose_that_cannot_be_right_is_refused_and_says_why() {
    let desk = Desk::new("live-6");
    let left = Double::left(&desk);
    // The fingers are straight although the program asks for bent ones.
    let (status, text) = run(&desk, &["calibrate", "--port", &left.port(), "--every", "0"]);
    assert_eq!(status.code(), Some(1), "{text}");
    assert_eq!(
        text.matches("refused: a finger moved, or reads about the same as when it was straight").count(),
        3,
        "{text}"
    );
    assert!(text.contains("step 3 was refused 3 times"), "{text}");
    let (status, text) = run(&desk, &["calibrate", "--port", &left.port()]);
    assert_eq!(status.code(), Some(1), "{text}");
    assert!(text.contains("--every"), "{text}");
}

#[test]
fn three_poses_show_how_a_right_board_is_worn_and_run_drives_by_them() {
    let desk = Desk::new("live-12");
    let right = Double::right(&desk, 0.0);
    // The recorded hand rests for 8.5 s from here on.
    let rest = || {
        right.tilt(0.0, 0.0);
        right.jump(42.5);
    };
    let file = desk.path("hand.toml");
    std::fs::write(&file, "# my hand\n[speed]\nstart = 0.3\n").unwrap();
    let file = file.display().to_string();
    let args = ["calibrate", "--one-handed", "--right", &right.port(), "--config", &file, "--every", "0.8"];
    let (status, text) = run(&desk, &args[..4]);
    assert!(!status.success() && text.contains("--config FILE"), "{text}");

    // The board is worn the wrong way round: its x axis points to the wrist.
    rest();
    let mut calibrate = start(&desk, &args);
    calibrate.wait(&["1.", "level"]);
    calibrate.wait(&["2.", "forward"]);
    right.tilt(-35.0, 0.0);
    calibrate.wait(&["3.", "left"]);
    right.tilt(0.0, -35.0);
    let (status, text) = calibrate.end();
    assert!(status.success(), "{text}");
    let written = std::fs::read_to_string(&file).unwrap();
    assert!(written.starts_with("# my hand\n[speed]\nstart = 0.3\n"), "{written}");
    for line in ["[one_handed]", "forward = \"-x\"", "left = \"-y\"", "up = \"+z\""] {
        assert!(written.lines().any(|written| written == line), "{line}: {written}");
    }

    // By these axes, the hand that was tilted forward drives forward.
    rest();
    let run_args =
        ["run", "--one-handed", "--right", &right.port(), "--config", &file, "--json", "--seconds", "60"];
    let mut drive = start(&desk, &run_args);
    drive.wait(&["\"state\"", "armed"]);
    right.tilt(-35.0, 0.0);
    let line = drive.wait(&["\"heading\"", "forward"]);
    assert!(line.contains("\"hand\":\"right\""), "{line}");
    drop(drive);

    // The hand never tilts.
    rest();
    let (status, text) = run(&desk, &[&args[..6], &["--every", "0"]].concat());
    assert_eq!(status.code(), Some(1), "{text}");
    assert_eq!(text.matches("tilt it by 20° to 45°").count(), 3, "{text}");
    assert!(text.contains("nothing is stored"), "{text}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), written);
}

#[test]
fn record_writes_what_the_sensor_read_in_the_training_layout() {
    let desk = Desk::new("live-7");
    let right = Double::right(&desk, 0.0);
    let out = desk.path("recordings");
    let record = |more: &[&str]| {
        let (port, out) = (right.port(), out.display().to_string());
        let mut args = vec!["record", "--port", &port, "--person", "me", "--out", &out, "--countdown", "0"];
        args.extend(more);
        run(&desk, &args)
    };
    for n in 1..=2 {
        let (status, text) = record(&["--label", "circle", "--seconds", "1.5"]);
        assert!(status.success() && text.contains("no gaps") && text.contains("models train"), "{text}");
        let file = out.join(format!("circle/me__{n}.csv"));
        let header = std::fs::read_to_string(&file).unwrap();
        assert!(header.starts_with("timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\n"));
        let recording = Recording::read(&file).unwrap();
        assert_eq!((recording.axes(), recording.len()), (9, 150));
        // The recorded samples are a part of the board's recording. Their error is at most half a count.
        let played = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/demo/right.csv");
        let played = Recording::read(&played).unwrap().resampled();
        let near = |a: &[f32], b: &[f32]| (0..9).all(|i| (a[i] - b[i]).abs() <= [0.004, 0.041, 0.013][i / 3]);
        let played: Vec<_> = played.samples().collect();
        let recorded: Vec<_> = recording.samples().collect();
        assert!(
            played.windows(150).any(|stretch| stretch.iter().zip(&recorded).all(|(a, b)| near(a, b))),
            "take {n} is no stretch of what was played"
        );
    }
    let (status, text) = record(&["--guided", "--labels", "idle,wave", "--seconds", "0.5"]);
    assert!(status.success(), "{text}");
    assert_eq!(files(&out), ["circle", "idle", "wave"]);
    assert_eq!(files(&out.join("wave")), ["me__1.csv"]);

    // Names that refer to other folders are refused before the port is opened.
    let (status, text) = record(&["--label", "../x"]);
    assert!(status.code() == Some(1) && text.contains("letters"), "{text}");
}

#[test]
fn record_writes_the_left_hands_readings_and_replay_plays_them() {
    let desk = Desk::new("live-left");
    let left = Double::left(&desk);
    left.hold(FORWARD);
    let out = desk.path("takes").display().to_string();
    let port = left.port();
    let take = ["record", "--hand", "left", "--port", &port, "--label", "forward", "--person", "me"];
    let (status, text) =
        run(&desk, &[&take[..], &["--seconds", "1.5", "--countdown", "0", "--out", &out]].concat());
    assert!(
        status.success() && text.contains("150 samples, no gaps") && text.contains("replay --left"),
        "{text}"
    );
    assert!(left.classifies());
    let file = format!("{out}/forward/me__1.csv");
    let read = AdcRecording::read(Path::new(&file)).unwrap();
    assert!(read.notes.is_empty(), "{:?}", read.notes);
    assert_eq!(read.recording.samples.len(), 150);
    for (n, (time_ms, counts)) in read.recording.samples.iter().enumerate() {
        assert_eq!(*time_ms, 10 * n as u64);
        // The recording contains conversions in eighths of a count, which the board also uses for its decisions.
        // The last bit of a conversion always varies.
        let level = AdcCounts::from_ten_bit(FORWARD);
        assert!(*counts == level || *counts == AdcCounts { z: level.z + 1, ..level }, "{counts:?}");
    }
    let (status, text) = run(&desk, &["replay", "--left", &file, "--speed", "0", "--headless"]);
    assert!(status.success() && text.contains("(0 damaged, 0 lost)"), "{text}");
    // A guided session of the left hand uses its own list of movements.
    let (status, text) =
        run(&desk, &["record", "--hand", "left", "--guided", "--person", "a__b", "--port", &port]);
    assert!(!status.success() && text.contains("underscores"), "{text}");
}

#[test]
fn a_recording_that_breaks_off_leaves_nothing_behind() {
    let desk = Desk::new("live-8");
    let right = Double::right(&desk, 0.0);
    let out = desk.path("recordings");
    type Break = fn(&Double, &Running);
    let breaks: [(Break, i32, &str); 3] = [
        (|_, run| run.interrupt(), 130, "not saved"),
        (|board, _| board.restart(), 1, "restart"),
        (|board, _| board.pull(), 1, "nothing was saved"),
    ];
    for (how, code, word) in breaks {
        let (port, folder) = (right.port(), out.display().to_string());
        let mut record = start(
            &desk,
            &[
                "record",
                "--port",
                &port,
                "--label",
                "circle",
                "--person",
                "me",
                "--seconds",
                "30",
                "--countdown",
                "0",
                "--out",
                &folder,
            ],
        );
        record.wait(&["go: circle"]);
        desk.pass(Duration::from_millis(600));
        how(&right, &record);
        let (status, text) = record.end();
        assert_eq!(status.code(), Some(code), "{text}");
        assert!(text.contains(word), "{word} in\n{text}");
        assert!(files(&out.join("circle")).is_empty(), "{:?}", files(&out.join("circle")));
    }
}

#[test]
fn a_model_sent_through_cuts_and_restarts_runs_after_the_next_start() {
    let desk = Desk::new("live-9");
    let right = Double::right(&desk, 0.0);
    let (file, id) = renamed_model(&desk.path(""));
    let file = file.display().to_string();

    let mut send = start(&desk, &["send-model", &file, "--port", &right.port()]);
    send.wait(&["sending", &id]);
    desk.pass(Duration::from_millis(250));
    right.pull();
    send.wait(&["comes back by itself"]);
    right.plug_without_restart();
    desk.pass(Duration::from_millis(900));
    right.restart();
    send.wait(&["the board restarted"]);
    let (status, text) = send.end();
    assert!(status.success(), "{text}");
    assert!(text.contains(&format!("→ {id}")) && text.contains("next restart"), "{text}");

    // The new model takes effect only after a restart.
    let (_, text) = run(&desk, &["doctor", "--right", &right.port(), "--seconds", "1"]);
    assert!(!text.contains(&format!("model {id}")), "{text}");
    right.restart();
    desk.pass(Duration::from_millis(2500));
    let (_, text) = run(&desk, &["doctor", "--right", &right.port(), "--seconds", "2"]);
    assert!(text.contains(&format!("model {id}")) && text.contains("wave"), "{text}");
    assert!(text.contains("no motion for wave"), "{text}");
    let (status, text) = run(&desk, &["send-model", &file, "--port", &right.port()]);
    assert!(status.success() && text.contains("already"), "{text}");
}

#[test]
fn by_the_pages_button_a_wearer_shows_gestures_and_gives_up_and_the_board_names_gestures_again() {
    let desk = Desk::new("live-wearer");
    let right = Double::right(&desk, 0.0);
    let wearers = desk.text("wearers");
    let port = right.port();
    let mut run = start(
        &desk,
        &["run", "--right", &port, "--json", "--web=0", "--wearers", &wearers, "--seconds", "230"],
    );
    let line: serde_json::Value = serde_json::from_str(&run.wait(&["\"page\""])).unwrap();
    let url = line["url"].as_str().unwrap().trim_end_matches('/').to_owned();
    run.wait(&["\"wearer\"", "show each of", "does not move the robot"]);
    let address = url.trim_start_matches("http://");
    let mut request = format!("ws://{address}/live").into_client_request().unwrap();
    request.headers_mut().insert("Origin", url.parse().unwrap());
    let (mut page, _) = tungstenite::client(request, TcpStream::connect(address).unwrap()).unwrap();
    page.send(Message::text("show")).unwrap();
    run.wait(&["\"wearer\"", "NOW draw up-down, 1 of 3"]);
    assert!(!right.classifies());
    page.send(Message::text("show")).unwrap();
    run.wait(&["\"wearer\"", "given up: as you wished. who wears"]);
    assert!(right.classifies());
    run.wait(&["\"gesture\"", "started"]);
    assert!(files(&desk.path("wearers")).is_empty());
    for args in [
        vec!["run", "--right", &port, "--wearer", "../ada"],
        vec!["run", "--right", &port, "--wearer", "a__b"],
        vec!["run", "--left", &port, "--wearer", "ada"],
    ] {
        let (status, text) = start(&desk, &args).end();
        assert!(status.code() == Some(1) && text.contains("--wearer"), "{args:?}: {text}");
    }
}

#[test]
fn the_wrong_hand_on_a_port_is_named() {
    let desk = Desk::new("live-10");
    let (left, right) = (Double::left(&desk), Double::right(&desk, 0.0));
    let (file, _) = renamed_model(&desk.path(""));
    let file = file.display().to_string();
    for args in [
        vec!["calibrate", "--port", &right.port(), "--every", "0"],
        vec!["send-model", &file, "--port", &left.port()],
    ] {
        let (status, text) = run(&desk, &args);
        assert_eq!(status.code(), Some(1), "{args:?}: {text}");
        assert!(text.contains("answers; only the"), "{args:?}: {text}");
    }
    let record = |port: &str, hand: &str| {
        let take = ["record", "--port", port, "--hand", hand, "--label", "circle", "--person", "me"];
        let (status, text) = run(&desk, &take);
        assert_eq!(status.code(), Some(1), "{text}");
        text
    };
    assert!(record(&left.port(), "right").contains("`record --hand left` records it"));
    assert!(record(&right.port(), "left").contains("`record --hand right` records it"));
    let mut run = start(&desk, &["run", "--left", &right.port(), "--headless", "--seconds", "20"]);
    run.wait(&["swap the ports"]);
}

#[test]
fn bad_options_and_configurations_say_what_to_do() {
    let desk = Desk::new("live-11");
    let file = desk.path("desk.toml");
    std::fs::write(&file, "[safety]\n\nstale = 100\n").unwrap();
    let file = file.display().to_string();
    for (args, words) in [
        (vec!["run"], vec!["--left PORT", "keyboard", "list"]),
        (vec!["run", "--config", &file], vec!["desk.toml", "line 3", "safety.stale_ms"]),
        (vec!["run", "--config", "/no/such.toml"], vec!["/no/such.toml"]),
        (vec!["run", "--left", "keyboard", "--headless"], vec!["terminal"]),
        (vec!["run", "--left", "/dev/x", "--right", "/dev/x"], vec!["same port"]),
        // Bluetooth is requested, but is missing on this machine or in this build.
        (vec!["doctor", "--right", "ble:Hand"], vec!["Bluetooth"]),
        (vec!["calibrate"], vec!["--port", "list"]),
        (vec!["doctor"], vec!["--left", "list"]),
        (vec!["record", "--person", "me"], vec!["--label"]),
        (vec!["record", "--label", "a", "--person", "a__b", "--port", "x"], vec!["underscores"]),
        (vec!["send-model", "/no/such.tflite", "--port", "x"], vec!["/no/such.tflite"]),
        (vec!["calibrate", "--port", "/no/such/port", "--every", "0"], vec!["/no/such/port", "plug"]),
    ] {
        let (status, text) = run(&desk, &args);
        assert!(!status.success(), "{args:?}: {text}");
        for word in words {
            assert!(text.contains(word), "{args:?} must name {word}: {text}");
        }
    }
    let (status, text) = run(&desk, &["run", "--left-handed", "--left", "/dev/ttyACM0", "--print-config"]);
    assert!(status.success());
    assert!(text.contains("left_handed = true") && text.contains("left = \"/dev/ttyACM0\""), "{text}");
}
