//! `models import` as a user runs it: exports of Edge Impulse's kind, written here, and networks.

use std::path::Path;
use std::process::{Command, Output};

use models::blob::{ModelFiles, model_id};
use models::recording::Recording;
use models::tflite::{self, Network};
use serde_json::{Value, json};

fn models(args: &[&str]) -> (bool, String) {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_models")).args(args).output().unwrap();
    (status.success(), String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr))
}

/// Two seconds of a movement along one axis, as an Edge Impulse device would send it.
fn export(axis: usize, interval_ms: f64) -> Value {
    let names = ["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ"];
    let sensors: Vec<Value> = names
        .iter()
        .map(|n| json!({"name": n, "units": if n.starts_with('a') { "m/s2" } else { "dps" }}))
        .collect();
    let rows: Vec<Value> = (0..(2000.0 / interval_ms) as usize)
        .map(|n| {
            let mut row = [0.0, 0.0, 9.81, 0.0, 0.0, 0.0];
            row[axis] += (n as f64 * interval_ms / 1000.0 * 9.0).sin() * 5.0;
            json!(row)
        })
        .collect();
    json!({
        "protected": {"ver": "v1", "alg": "HS256", "iat": 1_700_000_000},
        "signature": "ab".repeat(32),
        "payload": {"device_name": "d0:bf:9c", "device_type": "ARDUINO_NANO33BLE", "interval_ms": interval_ms,
                    "sensors": sensors, "values": rows}
    })
}

#[test]
fn an_unpacked_export_of_json_and_cbor_becomes_recordings_that_train_and_score() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("export");
    for (part, count) in [("training", 3), ("testing", 1)] {
        std::fs::create_dir_all(data.join(part)).unwrap();
        for (label, axis) in [("wave", 0), ("Up_Down", 2)] {
            for n in 0..count {
                let export = export(axis, if n == 0 { 10.0 } else { 16.0 });
                let (ending, bytes) = if n % 2 == 0 {
                    ("json", export.to_string().into_bytes())
                } else {
                    let mut cbor = Vec::new();
                    ciborium::into_writer(&export, &mut cbor).unwrap();
                    ("cbor", cbor)
                };
                std::fs::write(data.join(part).join(format!("{label}.{n}f3k.{ending}")), bytes).unwrap();
            }
        }
    }
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (ok, text) = models(&["import", &path("export"), "--out", &path("recordings"), "--person", "me"]);
    assert!(ok && text.contains("wave: 4 recordings of me") && text.contains("up-down: 4 "), "{text}");
    let first = Recording::read(&folder.path().join("recordings/wave/me__1.csv")).unwrap();
    assert_eq!((first.axes(), first.len()), (6, 200));
    // A second import goes on counting.
    let (ok, text) = models(&["import", &path("export/testing"), "--out", &path("recordings")]);
    assert!(ok && text.contains("of d0-bf-9c"), "{text}");
    let (ok, text) = models(&[
        "train",
        &path("recordings"),
        "--recipe",
        "paper",
        "--out",
        &path("models"),
        "--name",
        "mine",
    ]);
    assert!(ok, "{text}");
    let (ok, text) = models(&["eval", &path("models/mine.tflite"), &path("recordings")]);
    assert!(ok && text.contains("accuracy per recording"), "{text}");
}

#[test]
fn one_bad_file_is_named_with_its_place_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(folder.path().join("wave.1.json"), export(0, 10.0).to_string()).unwrap();
    let mut bad = export(0, 10.0);
    bad["payload"]["values"][7][2] = json!(null);
    std::fs::write(folder.path().join("wave.2.json"), bad.to_string()).unwrap();
    let (ok, text) = models(&["import", &path(""), "--out", &path("out")]);
    assert!(!ok && text.contains("wave.2.json, payload.values[7][2]: null is no finite number"), "{text}");
    assert!(!folder.path().join("out").exists());
    let (ok, text) = models(&["import", &path("none.json"), "--out", &path("out")]);
    assert!(!ok && text.contains("no such file"), "{text}");
    let (ok, text) = models(&["import", &path("wave.1.json"), "--out", &path("out"), "--label", "../x"]);
    assert!(!ok && text.contains("letters"), "{text}");
}

#[test]
fn an_int8_network_of_dense_layers_gets_a_card_and_is_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("bundled/right-9axis.tflite");
    let files = ModelFiles::read(&bundled).unwrap();
    let (bytes, labels) = (std::fs::read(&bundled).unwrap(), files.card.labels.join(","));
    let foreign = folder.path().join("foreign.tflite");
    std::fs::write(&foreign, &bytes).unwrap();
    let scaling = serde_json::to_string(&files.card.scaling).unwrap();
    std::fs::write(folder.path().join("scaling.json"), scaling).unwrap();
    let foreign = foreign.display().to_string();
    let base =
        ["import", &foreign, "--out", &path("models"), "--name", "mine", "--features", &files.card.features];
    let import = |more: &[&str]| models(&[&base, more].concat());

    let (ok, text) = import(&["--labels", &labels, "--scaling", &path("scaling.json")]);
    assert!(ok, "{text}");
    let imported = ModelFiles::read(&folder.path().join("models/mine.tflite")).unwrap();
    assert_eq!(imported.blob().unwrap(), files.blob().unwrap());
    assert!(text.contains(&model_id(&files.blob().unwrap())), "{text}");

    for (more, word) in [
        (vec![], "name the network's 8 outputs"),
        (vec!["--labels", "a,b"], "8 outputs, but --labels names 2"),
        (vec!["--labels", &labels, "--axes", "3"], "89 inputs, but 3 axes make 45 features"),
    ] {
        let (ok, text) = import(&more);
        assert!(!ok && text.contains(word), "{word} in {text}");
    }
    let float = Path::new(env!("CARGO_MANIFEST_DIR")).join("bundled/right-9axis.float.tflite");
    let float = match std::fs::read(&float) {
        Ok(bytes) => bytes,
        Err(_) => {
            let layer =
                tflite::FloatLayer { weights: vec![vec![0.5; 39]; 2], biases: vec![0.0; 2], relu: false };
            tflite::write(&Network::Float(vec![layer]))
        }
    };
    std::fs::write(folder.path().join("float.tflite"), float).unwrap();
    let (ok, text) = models(&["import", &path("float.tflite"), "--out", &path("x"), "--labels", "a,b"]);
    assert!(!ok && text.contains("export the quantized (int8) one"), "{text}");
    std::fs::write(folder.path().join("no.tflite"), b"hello").unwrap();
    let (ok, text) = models(&["import", &path("no.tflite"), "--out", &path("x"), "--labels", "a,b"]);
    assert!(!ok && text.contains("no.tflite: this is not a TFLite file"), "{text}");
}
