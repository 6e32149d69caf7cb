//! Tests `models import` with networks and with generated files in the format of Edge Impulse's exports.

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

/// Returns two seconds of a movement along one axis, in the format of an Edge Impulse device.
fn export(axis: usize, interval_ms: f64) -> Value {
    export_of(axis, interval_ms, 0)
}

/// Returns the same movement, but with another number of samples before its start.
fn export_of(axis: usize, interval_ms: f64, late: usize) -> Value {
    let names = ["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ"];
    let sensors: Vec<Value> = names
        .iter()
        .map(|n| json!({"name": n, "units": if n.starts_with('a') { "m/s2" } else { "dps" }}))
        .collect();
    let rows: Vec<Value> = (0..(2000.0 / interval_ms) as usize)
        .map(|n| {
            let mut row = [0.0, 0.0, 9.81, 0.0, 0.0, 0.0];
            row[axis] += (n.saturating_sub(late) as f64 * interval_ms / 1000.0 * 9.0).sin() * 5.0;
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
                let late = n + usize::from(part == "testing");
                let export = export_of(axis, if n == 0 { 10.0 } else { 16.0 }, late);
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
    assert!(
        ok && text.contains("training: wave: 3 recordings of me") && text.contains("testing: up-down: 1 "),
        "{text}"
    );
    let first = Recording::read(&folder.path().join("recordings/training/wave/me__1.csv")).unwrap();
    assert_eq!((first.axes(), first.len()), (6, 200));
    // A second import writes no duplicates, even with another person's name.
    let (ok, text) = models(&["import", &path("export/testing"), "--out", &path("recordings")]);
    assert!(ok && text.contains("2 recordings are there already"), "{text}");
    assert!(!folder.path().join("recordings/wave").exists());
    // The numbering of recordings continues with the next part of the export.
    let (ok, text) = models(&["import", &path("export/testing"), "--out", &path("others")]);
    assert!(ok && text.contains("wave: 1 recordings of d0-bf-9c"), "{text}");
    let (ok, text) = models(&[
        "train",
        &path("recordings/training"),
        "--recipe",
        "paper",
        "--out",
        &path("models"),
        "--name",
        "mine",
    ]);
    assert!(ok, "{text}");
    let (ok, text) = models(&["eval", &path("models/mine.tflite"), &path("recordings/testing")]);
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
    let (ok, text) = models(&["import", &path(""), "--out", &path("out"), "--skip-bad"]);
    assert!(ok && text.contains("left out: ") && text.contains("wave: 1 recordings"), "{text}");
    assert!(text.contains("the labels of 1 files are taken from their names"), "{text}");
}

#[test]
fn an_export_is_cut_at_its_labels_and_what_nobody_labelled_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::create_dir_all(folder.path().join("export/training")).unwrap();
    for name in ["a", "b"] {
        let file = folder.path().join(format!("export/training/{name}.json"));
        std::fs::write(file, export_of(0, 10.0, name.len()).to_string()).unwrap();
    }
    let info = json!({"version": 1, "files": [
        {"path": "training/a.json", "category": "training", "label": {"type": "multi-label", "labels": [
            {"label": "idle", "startIndex": 0, "endIndex": 79}, {"label": "wave", "startIndex": 80, "endIndex": 199}]}},
        {"path": "training/b.json", "category": "training", "label": {"type": "unlabeled"}},
    ]});
    std::fs::write(folder.path().join("export/info.labels"), info.to_string()).unwrap();
    let (ok, text) = models(&["import", &path("export"), "--out", &path("out"), "--person", "me"]);
    assert!(ok && text.contains("b.json: nobody has labelled it"), "{text}");
    let length = |name: &str| Recording::read(&folder.path().join(name)).unwrap().len();
    assert_eq!((length("out/idle/me__1.csv"), length("out/wave/me__1.csv")), (80, 120));
}

/// Returns rows of a waving hand, each with a time in ms and values in m/s², deg/s and µT.
fn rows(count: usize, row: impl Fn(f64, [f64; 9]) -> String) -> String {
    let one = |n: usize| {
        let s = (n as f64 * 0.09).sin();
        row(n as f64 * 10.0, [3.0 * s + 1.0, 0.5, 9.7, 60.0 * s, 20.0, -40.0 * s, 20.0, -10.0 * s, 40.0])
    };
    (0..count).map(|n| one(n) + "\n").collect()
}

/// Tests the column headers of common programs and public data sets, each with its expected imported values.
#[test]
fn files_of_ten_programs_become_the_same_recording() {
    const G: f64 = 9.806_65;
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: String| {
        let file = folder.path().join("in").join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text).unwrap();
    };
    let list = |values: &[f64], separator: &str| {
        values.iter().map(f64::to_string).collect::<Vec<_>>().join(separator)
    };
    let rad = |v: &[f64; 9]| [v[3].to_radians(), v[4].to_radians(), v[5].to_radians()];
    let g = |v: &[f64; 9]| [v[0] / G, v[1] / G, v[2] / G];
    let n = 300;
    let six = |v: [f64; 9], separator: &str| list(&[g(&v), [v[3], v[4], v[5]]].concat(), separator);
    // Program, axes, options, files.
    type Case<'a> = (&'a str, usize, &'a [&'a str], Vec<(&'a str, String)>);
    let cases: [Case; 13] = [
        // Arduino's gesture tutorial.
        (
            "arduino",
            6,
            &["--rate", "100"],
            vec![("wave.csv", format!("aX,aY,aZ,gX,gY,gZ\n{}", rows(n, |_, v| six(v, ","))))],
        ),
        (
            "arduino-plotter",
            3,
            &["--rate", "100"],
            vec![("wave.csv", rows(n, |_, v| format!("aX:{}\taY:{}\taZ:{}", v[0], v[1], v[2])))],
        ),
        (
            "phyphox",
            3,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "\"Time (s)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\",\"Absolute acceleration (m/s^2)\"\n{}",
                    rows(n, |t, v| format!("{:E},{},{:E}", t / 1000.0, list(&v[..3], ","), 9.9))
                ),
            )],
        ),
        (
            "phyphox-semicolons",
            6,
            &[],
            vec![
                (
                    "wave/Accelerometer.csv",
                    format!(
                        "\"Time (s)\";\"X (m/s^2)\";\"Y (m/s^2)\";\"Z (m/s^2)\"\n{}",
                        rows(n, |t, v| format!("{};{}", t / 1000.0, list(&v[..3], ";")).replace('.', ","))
                    ),
                ),
                (
                    "wave/Gyroscope.csv",
                    format!(
                        "\"Time (s)\";\"X (rad/s)\";\"Y (rad/s)\";\"Z (rad/s)\"\n{}",
                        rows(n, |t, v| format!("{};{}", t / 1000.0, list(&rad(&v), ";")).replace('.', ","))
                    ),
                ),
            ],
        ),
        (
            "sensor-logger",
            9,
            &[],
            ["TotalAcceleration", "Gyroscope", "Magnetometer", "Accelerometer"]
                .iter()
                .zip([0, 3, 6, 0])
                .map(|(name, from)| {
                    let unit = if from == 3 { std::f64::consts::PI / 180.0 } else { 1.0 };
                    let row = |t: f64, v: [f64; 9]| {
                        format!(
                            "{},{},{},{},{}",
                            1.7e18 + t * 1e6,
                            t / 1000.0,
                            v[from + 2] * unit,
                            v[from + 1] * unit,
                            v[from] * unit
                        )
                    };
                    (
                        match *name {
                            "TotalAcceleration" => "wave/TotalAcceleration.csv",
                            "Gyroscope" => "wave/Gyroscope.csv",
                            "Magnetometer" => "wave/Magnetometer.csv",
                            _ => "wave/Accelerometer.csv",
                        },
                        format!("time,seconds_elapsed,z,y,x\n{}", rows(n, row)),
                    )
                })
                .collect(),
        ),
        (
            "physics-toolbox",
            9,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "time,gFx,gFy,gFz,TgF,ax,ay,az,wx,wy,wz,Bx,By,Bz,\n{}",
                    rows(n, |t, v| format!(
                        "{},{},1,0.1,0.2,0.3,{},{},",
                        t / 1000.0,
                        list(&g(&v), ","),
                        list(&rad(&v), ","),
                        list(&v[6..], ",")
                    ))
                ),
            )],
        ),
        (
            "edge-impulse",
            6,
            &[],
            vec![(
                "wave.1.csv",
                format!(
                    "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ\n{}",
                    rows(n, |t, v| format!("{t},{}", list(&v[..6], ",")))
                ),
            )],
        ),
        (
            "sensorlog",
            6,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "loggingTime(txt),accelerometerTimestamp_sinceReboot(s),accelerometerAccelerationX(G),accelerometerAccelerationY(G),accelerometerAccelerationZ(G),motionYaw(rad),motionRotationRateX(rad/s),motionRotationRateY(rad/s),motionRotationRateZ(rad/s)\n{}",
                    rows(n, |t, v| format!(
                        "2026-05-01 10:00:{:06.3} +0200,{},{},0.1,{}",
                        t / 1000.0,
                        5000.0 + t / 1000.0,
                        list(&g(&v), ","),
                        list(&rad(&v), ",")
                    ))
                ),
            )],
        ),
        (
            "androsensor",
            9,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "sep=;\nACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);GYROSCOPE Z (rad/s);MAGNETIC FIELD X (μT);MAGNETIC FIELD Y (μT);MAGNETIC FIELD Z (μT);Time since start in ms ;YYYY-MO-DD HH-MI-SS_SSS\n{}",
                    rows(n, |t, v| format!(
                        "{};{};{};{t};2026-05-01 10-00-00_000",
                        list(&v[..3], ";"),
                        list(&rad(&v), ";"),
                        list(&v[6..], ";")
                    ))
                ),
            )],
        ),
        (
            "motionsense",
            6,
            &["--rate", "100"],
            vec![(
                "wave.csv",
                format!(
                    ",attitude.roll,attitude.pitch,attitude.yaw,gravity.x,gravity.y,gravity.z,rotationRate.x,rotationRate.y,rotationRate.z,userAcceleration.x,userAcceleration.y,userAcceleration.z\n{}",
                    rows(n, |t, v| {
                        let user = [v[0] / G - 0.1, v[1] / G - 0.2, v[2] / G - 0.97];
                        format!("{t},0.1,0.2,0.3,0.1,0.2,0.97,{},{}", list(&rad(&v), ","), list(&user, ","))
                    })
                ),
            )],
        ),
        (
            "metamotion",
            3,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "epoc (ms),timestamp (+0200),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n{}",
                    rows(n, |t, v| format!(
                        "{},2026-05-01T10:00:{:06.3},{},{}",
                        1.7e12 + t,
                        t / 1000.0,
                        t / 1000.0,
                        list(&g(&v), ",")
                    ))
                ),
            )],
        ),
        (
            "shimmer",
            3,
            &[],
            vec![(
                "wave.csv",
                format!(
                    "\"sep=\t\"\nShimmer_5E3A_Timestamp_Unix_CAL\tShimmer_5E3A_Accel_LN_X_CAL\tShimmer_5E3A_Accel_LN_Y_CAL\tShimmer_5E3A_Accel_LN_Z_CAL\t\nms\tm/(s^2)\tm/(s^2)\tm/(s^2)\t\n{}",
                    rows(n, |t, v| format!("{}\t{}\t", 1.7e12 + t, list(&v[..3], "\t")))
                ),
            )],
        ),
        (
            "mpu6050",
            6,
            &["--units", "16384/g,131/dps"],
            vec![(
                "wave.csv",
                format!(
                    "millis AcX AcY AcZ Tmp GyX GyY GyZ\n{}",
                    rows(n, |t, v| {
                        let counts =
                            |values: [f64; 3], per: f64| list(&values.map(|x| (x * per).round()), " ");
                        format!("{t} {} 340 {}", counts(g(&v), 16384.0), counts([v[3], v[4], v[5]], 131.0))
                    })
                ),
            )],
        ),
    ];
    for (program, axes, more, files) in cases {
        for (name, text) in files {
            put(&format!("{program}/{name}"), text);
        }
        let input = folder.path().join("in").join(program).display().to_string();
        let out = folder.path().join("out").join(program).display().to_string();
        let (ok, text) = models(&[&["import", &input, "--out", &out, "--person", "me"], more].concat());
        assert!(ok, "{program}: {text}");
        let got = Recording::read(&folder.path().join("out").join(program).join("wave/me__1.csv"));
        let got = got.unwrap_or_else(|error| panic!("{program}: {error}\n{text}"));
        assert_eq!((got.axes(), got.len()), (axes, n), "{program}: {text}");
        for (at, sample) in got.samples().enumerate() {
            let s = (at as f64 * 0.09).sin();
            let wanted = [3.0 * s + 1.0, 0.5, 9.7, 60.0 * s, 20.0, -40.0 * s, 20.0, -10.0 * s, 40.0];
            // The files contain four decimals for m/s² and two for the other units; counts are integers.
            let near = |(axis, (a, b)): (usize, (&f32, &f64))| {
                (f64::from(*a) - b).abs() < if axis < 3 { 1e-3 } else { 1.1e-2 }
            };
            assert!(
                sample.iter().zip(&wanted).enumerate().all(near),
                "{program}, {at}: {sample:?}, {wanted:?}\n{text}"
            );
        }
        assert!((got.rate_hz() - 100.0).abs() < 0.1, "{program}: {}", got.rate_hz());
    }
}

#[test]
fn an_int8_network_of_dense_layers_gets_a_card_and_is_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("bundled/right-aligned.tflite");
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
        (vec!["--labels", "a,circle,round"], "are both circle"),
        (vec!["--labels", &labels, "--axes", "3"], "89 inputs, but 3 axes make 45 features"),
    ] {
        let (ok, text) = import(&more);
        assert!(!ok && text.contains(word), "{word} in {text}");
    }
    let float = Path::new(env!("CARGO_MANIFEST_DIR")).join("bundled/right-aligned.float.tflite");
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
