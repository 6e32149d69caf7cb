//! Tests the command line: exit codes, output on stdout and stderr, and invalid input.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn host_bridge(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-bridge")).args(args).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn demo_file(name: &str) -> String {
    format!("{}/sessions/demo/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn the_demo_prints_one_json_object_and_says_that_its_model_knows_simulated_wearers_only() {
    let output = host_bridge(&["demo", "--headless", "--speed", "0", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON value");
    assert_eq!(report["ok"], true);
    assert_eq!(report["gestures"].as_array().unwrap().len(), 7);
    assert_eq!(report["poses_reached"][5]["motion"], "random-top");
    assert!(report["odometry"]["path_m"].as_f64().unwrap() > 8.0);
    assert!(report["frames"]["left"]["frames"].as_u64().unwrap() > 4000);
    assert_eq!(report["latency"]["window_end_to_arm"]["count"], 6);
    assert!(report["drops"]["late_states"].is_u64());
    assert!(report["model"].as_str().unwrap().contains("simulated"), "{}", report["model"]);
    assert!(!stderr(&output).is_empty(), "events go to stderr");
}

#[test]
fn the_default_verb_is_the_demo_and_lines_are_printed_where_there_is_no_terminal() {
    let output = host_bridge(&["--speed", "0"]);
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("right hand: circle") && text.contains("random-top reached"), "{text}");
    assert!(!text.contains('\u{1b}'), "no escape sequences");
}

#[test]
fn a_demo_that_does_not_go_as_scripted_fails() {
    let output = host_bridge(&["demo", "--headless", "--speed", "0", "--map", "circle=home"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("FAILED poses reached"));
}

#[test]
fn replay_plays_files_of_both_hands() {
    let (left, right) = (demo_file("left.csv"), demo_file("right.csv"));
    let replay = |more: &[&str]| {
        let mut args =
            vec!["replay", "--right", &right, "--left", &left, "--headless", "--speed", "0", "--json"];
        args.extend(more);
        host_bridge(&args)
    };
    let output = replay(&["--calibration", "start"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["gestures"].as_array().unwrap().len(), 7);
    assert!(report["odometry"]["path_m"].as_f64().unwrap() > 8.0, "{}", report["odometry"]);

    // With the default calibration, this wearer's sensor never reads neutral, so the program prints a suggestion.
    let output = replay(&[]);
    assert!(output.status.success());
    assert!(stderr(&output).contains("--calibration start"), "{}", stderr(&output));
}

#[test]
fn several_right_recordings_are_joined_into_one_stream() {
    let right = demo_file("right.csv");
    let output = host_bridge(&["replay", "--right", &right, &right, "--headless", "--speed", "0", "--json"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["gestures"].as_array().unwrap().len(), 14);
    assert!((report["seconds"].as_f64().unwrap() - 168.0).abs() < 2.0);
}

/// Each kind of damage must cause an error with its location, a non-zero exit code, and an empty stdout.
#[test]
fn bad_input_names_file_line_and_column_and_moves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| -> String {
        let path: PathBuf = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let nine = "timestamp_ms,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\n";
    let row = |time: u32| format!("{time},0,0,9.8,0,0,0,20,0,40\n");
    let adc = "timestamp_ms,x,y,z,index,middle\n";
    let good = file("good.csv", &format!("{nine}{}{}", row(0), row(10)));
    let cases = [
        (["--right", "/no/such.csv"], vec!["/no/such.csv"]),
        (["--right", &file("empty.csv", "")], vec!["empty.csv", "empty"]),
        (["--right", &file("header.csv", nine)], vec!["header.csv", "no samples"]),
        (
            ["--right", &file("cut.csv", &format!("{nine}{}10,0,0", row(0)))],
            vec!["cut.csv", "line 3", "column 4"],
        ),
        (
            ["--right", &file("word.csv", &format!("{nine}{}", row(0).replace("9.8", "up")))],
            vec!["word.csv", "line 2", "column 4", "accZ"],
        ),
        (
            ["--right", &file("names.csv", "timestamp_ms,a,b,c\n0,1,2,3\n")],
            vec!["names.csv", "line 1", "column 1", "accelerometer"],
        ),
        (
            ["--right", &file("back.csv", &format!("{nine}{}{}", row(10), row(0)))],
            vec!["back.csv", "line 3", "column 1"],
        ),
        (
            ["--right", &file("three.csv", "timestamp_ms,accX,accY,accZ\n0,0,0,9.8\n10,0,0,9.8\n")],
            vec!["three.csv", "line 1", "column 5", "3 axes", "6 axes", "--model"],
        ),
        (["--left", "/no/such.csv"], vec!["/no/such.csv"]),
        (["--left", &file("lempty.csv", "")], vec!["lempty.csv", "empty"]),
        (["--left", &file("lcut.csv", &format!("{adc}0,1,2"))], vec!["lcut.csv", "line 2", "column 4"]),
        (
            ["--left", &file("lword.csv", &format!("{adc}0,1,2,3,x,5"))],
            vec!["lword.csv", "line 2", "column 5", "index"],
        ),
        (["--left", &file("lnames.csv", nine)], vec!["lnames.csv", "line 1", "column 2"]),
        (
            ["--left", &file("lback.csv", &format!("{adc}10,1,2,3,4,5\n0,1,2,3,4,5"))],
            vec!["lback.csv", "line 3", "column 1"],
        ),
    ];
    for (args, words) in &cases {
        let mut all = vec!["replay", "--headless", "--speed", "0", "--json"];
        all.extend(args);
        let output = host_bridge(&all);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{args:?}: {text}");
        assert!(output.stdout.is_empty(), "{args:?} prints nothing half-done");
        for word in words {
            assert!(text.contains(word), "{args:?} must name {word}: {text}");
        }
    }
    for (args, word) in [
        (vec!["replay", "--right", &good, "--model", "/no/such.tflite"], "/no/such.tflite"),
        (vec!["replay", "--right", &good, "--map", "circle=fly"], "fly"),
        (vec!["replay", "--right", &good, "--map", "wave=home"], "no label 'wave'"),
        (vec!["demo", "--map", "circle"], "LABEL=MOTION"),
        (vec!["demo", "--speed=-1"], "--speed"),
        (vec!["replay"], "--right"),
    ] {
        let output = host_bridge(&args);
        assert!(!output.status.success(), "{args:?}");
        assert!(stderr(&output).contains(word), "{args:?}: {}", stderr(&output));
    }
    assert!(Path::new(&good).exists());
}

#[test]
fn a_page_that_cannot_be_served_is_an_error_that_says_what_to_do() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let web = format!("--web={port}");
    let refused: [(&[&str], &str); 4] = [
        (&["demo", "--headless", &web], "choose another port with --web="),
        (&["demo", "--headless", "--web-listen", "0.0.0.0"], "--web-token"),
        (&["demo", "--headless", "--web", "--web-token", "short"], "16 to 128 letters"),
        (&["run", "--left", "/dev/none", "--headless", &web], "in use"),
    ];
    for (args, says) in refused {
        let output = host_bridge(args);
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        assert!(stderr(&output).contains(says), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn run_takes_a_scene_and_names_its_page() {
    let scene = format!("{}/scenes/room.toml", env!("CARGO_MANIFEST_DIR"));
    let run = |scene: &str| {
        let more = ["--json", "--web=0", "--seconds", "0.3", "--scene", scene];
        let args: Vec<&str> = ["run", "--left", "/dev/none"].into_iter().chain(more).collect();
        host_bridge(&args)
    };
    let output = run(&scene);
    assert!(output.status.success(), "{}", stderr(&output));
    let lines: Vec<serde_json::Value> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).expect("each line is a JSON object"))
        .collect();
    let page = lines.iter().find(|line| line["event"] == "page").expect("the page's address");
    assert!(page["url"].as_str().unwrap().starts_with("http://127.0.0.1:"), "{page}");
    let output = run("nowhere.toml");
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("nowhere.toml"), "{}", stderr(&output));
}

#[test]
fn the_demo_passes_in_the_room_too_and_its_stop_is_the_only_halt_by_hand() {
    let scene = format!("{}/scenes/room.toml", env!("CARGO_MANIFEST_DIR"));
    let output = host_bridge(&["demo", "--headless", "--speed", "0", "--json", "--scene", &scene]);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[cfg(feature = "urdf")]
#[test]
fn another_arm_from_a_file_beside_its_scene_performs_the_demo() {
    let scene = format!("{}/scenes/other-arm.toml", env!("CARGO_MANIFEST_DIR"));
    let output = host_bridge(&["demo", "--headless", "--speed", "0", "--json", "--scene", &scene]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON value");
    let reached: Vec<_> = report["poses_reached"].as_array().unwrap().iter().map(|p| &p["motion"]).collect();
    assert_eq!(reached, ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "random-top"]);
}

#[test]
fn a_motion_that_does_not_exist_is_refused_with_those_that_do() {
    for verb in
        [&["demo", "--headless"][..], &["replay", "--left", "/dev/null"], &["run", "--right", "/dev/null"]]
    {
        let output = host_bridge(&[verb, &["--map", "wave=jump"]].concat());
        assert_eq!(output.status.code(), Some(1), "{verb:?}");
        let text = stderr(&output);
        assert!(text.contains("'jump'") && text.contains("pick-up") && text.contains("'wave'"), "{text}");
    }
}

#[test]
fn a_scene_whose_pose_does_not_fit_its_arm_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("few.toml");
    std::fs::write(&scene, "[[pose]]\nname = \"pick-up\"\njoints_rad = [1.5]\n").unwrap();
    let output = host_bridge(&["demo", "--headless", "--scene", scene.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let text = stderr(&output);
    assert!(text.contains("'pick-up'") && text.contains("1 angles") && text.contains("7 joints"), "{text}");
}
