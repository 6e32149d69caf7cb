//! Tests the command-line program `models`: its files, exit codes and final output lines.

use std::collections::BTreeMap;
use std::path::Path;

#[path = "common/tool.rs"]
mod tool;

use tool::{good, models};

fn bad(args: &[&str]) -> String {
    let output = models(args);
    assert!(!output.status.success(), "{args:?} must fail");
    String::from_utf8(output.stderr).unwrap()
}

/// Returns all files below a folder, with their contents.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            let below = contents(&path).into_iter();
            all.extend(below.map(|(file, bytes)| (format!("{name}/{file}"), bytes)));
        } else {
            all.insert(name, std::fs::read(&path).unwrap());
        }
    }
    all
}

#[test]
fn synth_train_and_eval_work_together_and_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    for threads in ["1", "2"] {
        let data = path(&format!("data{threads}"));
        let text = good(&[
            "--threads",
            threads,
            "synth",
            "--out",
            &data,
            "--wearers",
            "3",
            "--seconds",
            "3",
            "--seed",
            "5",
        ]);
        assert!(text.contains("simulated wearers (no real people), seed 5"), "{text}");
        let out = path(&format!("out{threads}"));
        good(&[
            "--threads",
            threads,
            "train",
            &data,
            "--out",
            &out,
            "--name",
            "tiny",
            "--test",
            "0.2",
            "--seed",
            "3",
            "--steps",
            "300",
        ]);
    }
    assert_eq!(contents(&folder.path().join("data1")), contents(&folder.path().join("data2")));
    let written = contents(&folder.path().join("out1"));
    assert_eq!(written, contents(&folder.path().join("out2")));
    let names: Vec<&str> = written.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        ["tiny.card.json", "tiny.float.tflite", "tiny.memory.bin", "tiny.test.txt", "tiny.tflite"]
    );

    let card = String::from_utf8(written["tiny.card.json"].clone()).unwrap();
    assert!(card.contains("simulated wearers, not real people"), "the card says what the data is");
    let held = String::from_utf8(written["tiny.test.txt"].clone()).unwrap();
    assert_eq!(held.lines().count(), 23, "a fifth of each label: 17 of 87 idle, 1 of 3 of six gestures");

    for model in ["tiny.tflite", "tiny.float.tflite"] {
        let model = path(&format!("out1/{model}"));
        let text = good(&["eval", &model, &path("data1"), "--only", &path("out1/tiny.test.txt")]);
        let last: f64 = text.lines().last().unwrap().parse().expect("the last line is a number");
        assert!((60.0..=100.0).contains(&last), "{text}");
        assert!(text.contains(&format!("accuracy per recording: {last:.2} %")), "{text}");
        assert!(text.contains("person t0001: "), "{text}");
    }
}

#[test]
fn a_damaged_recording_stops_training_with_its_place_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let label = folder.path().join("data/circle");
    std::fs::create_dir_all(&label).unwrap();
    std::fs::write(label.join("p__1.csv"), "timestamp,accX,accY,accZ\n0,1,2,3\n10,1,2\n").unwrap();
    let data = folder.path().join("data");
    let out = folder.path().join("out");
    let text = bad(&["train", data.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(text.contains("p__1.csv, line 3, column 4: the row has 3 values"), "{text}");
    assert!(!out.exists());
}

#[test]
fn one_label_is_not_enough_and_an_unknown_person_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let label = folder.path().join("circle");
    std::fs::create_dir_all(&label).unwrap();
    std::fs::write(label.join("p__1.csv"), "timestamp,accX,accY,accZ\n0,1,2,3\n10,1,2,3\n").unwrap();
    let data = folder.path().to_str().unwrap().to_owned();
    let out = folder.path().join("out").to_str().unwrap().to_owned();
    let text = bad(&["train", &data, "--out", &out]);
    assert!(text.contains("1 label(s) with recordings; at least 2 are needed"), "{text}");
    let text = bad(&["train", &data, "--out", &out, "--exclude-person", "q"]);
    assert!(text.contains("nobody is called \"q\"; the people are p"), "{text}");
}

#[test]
fn a_model_of_other_axes_or_without_its_card_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let label = folder.path().join("data/circle");
    std::fs::create_dir_all(&label).unwrap();
    std::fs::write(label.join("p__1.csv"), "timestamp,accX,accY,accZ\n0,1,2,3\n10,1,2,3\n").unwrap();
    let data = folder.path().join("data").to_str().unwrap().to_owned();
    let bundled = concat!(env!("CARGO_MANIFEST_DIR"), "/bundled/right-aligned.tflite");
    let text = bad(&["eval", bundled, &data]);
    assert!(text.contains("p__1.csv: 3 axes, but 6 are wanted"), "{text}");

    let lonely = folder.path().join("lonely.tflite");
    std::fs::copy(bundled, &lonely).unwrap();
    let text = bad(&["eval", lonely.to_str().unwrap(), &data]);
    assert!(text.contains("lonely.card.json") && text.contains("must lie beside the model"), "{text}");

    std::fs::write(folder.path().join("lonely.card.json"), "{}").unwrap();
    let text = bad(&["eval", lonely.to_str().unwrap(), &data]);
    assert!(text.contains("lonely.card.json: missing field"), "{text}");
}

#[test]
fn a_model_that_is_trained_again_without_a_test_loses_the_old_list_of_tests() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    good(&["synth", "--out", &path("data"), "--wearers", "2", "--seconds", "3", "--seed", "5"]);
    let train = |more: &[&str]| {
        let (data, out) = (path("data"), path("out"));
        good(
            &[&["train", &data, "--out", &out, "--name", "tiny", "--recipe", "paper", "--axes", "3"], more]
                .concat(),
        )
    };
    train(&["--test", "0.5"]);
    assert!(folder.path().join("out/tiny.test.txt").exists());
    let text = train(&[]);
    assert!(text.contains("removed") && text.contains("tiny.test.txt"), "{text}");
    assert!(!folder.path().join("out/tiny.test.txt").exists());
}

#[test]
fn six_axes_are_enough_for_a_model_that_reads_no_magnetometer() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    good(&["synth", "--out", &path("data"), "--wearers", "1", "--seconds", "3", "--seed", "5"]);
    let nine = path("data");
    let six = path("six");
    for (name, bytes) in
        contents(&folder.path().join("data")).iter().filter(|(name, _)| name.ends_with(".csv"))
    {
        let text = String::from_utf8(bytes.clone()).unwrap();
        let row = |line: &str| line.split(',').take(7).collect::<Vec<_>>().join(",") + "\n";
        let file = folder.path().join("six").join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text.lines().map(row).collect::<String>()).unwrap();
    }
    let bundled = concat!(env!("CARGO_MANIFEST_DIR"), "/bundled/right-aligned.tflite");
    let last = |folder: &str| good(&["eval", bundled, folder]).lines().last().unwrap().to_owned();
    assert_eq!(last(&nine), last(&six));
}

#[test]
fn synth_does_not_write_into_a_folder_that_holds_something() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("mine.txt"), "keep").unwrap();
    let text = bad(&["synth", "--out", folder.path().to_str().unwrap(), "--wearers", "1"]);
    assert!(text.contains("not empty; give a new folder"), "{text}");
    assert_eq!(contents(folder.path()).len(), 1);
}
