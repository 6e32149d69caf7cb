//! Feeds damaged files to the readers of other programs' formats.
//! The readers must not panic, hang for more than 2 s, or use more than 500 MB.
//!
//! `cargo test -p models --test fuzz` gives each reader a few thousand inputs.
//! The following command gives each reader a million inputs and prints statistics:
//! `BIMANUAL_FULL=1 cargo test --release -p models --test fuzz -- --nocapture --test-threads 1`.

use std::path::Path;

use models::edge_impulse;
use models::sheet::{self, Reading, Units};
use models::tflite;

#[path = "common/mutate.rs"]
mod mutate;

use mutate::{count, fuzz};

/// A swinging hand with gravity. `row` writes each sample (time in s, acceleration in m/s², turn rate in deg/s).
fn swing(rows: usize, row: impl Fn(usize, f64, [f64; 3], [f64; 3]) -> String) -> String {
    let one = |n: usize| {
        let t = n as f64 / 100.0;
        let wave = |hz: f64, size: f64| (t * hz * std::f64::consts::TAU).sin() * size;
        row(
            n,
            t,
            [wave(2.0, 3.0), wave(1.3, 2.0), 9.81 + wave(1.0, 2.0)],
            [wave(1.0, 60.0), wave(2.0, 40.0), 1.0],
        )
    };
    (0..rows).map(one).collect()
}

/// Short examples of the formats in docs/FILES.md.
fn csv() -> Vec<Vec<u8>> {
    let g = 9.80665;
    let files = [
        "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ\n".to_owned()
            + &swing(60, |n, _, a, w| {
                format!(
                    "{},{:.3},{:.3},{:.3},{:.2},{:.2},{:.2}\n",
                    n * 10,
                    a[0],
                    a[1],
                    a[2],
                    w[0],
                    w[1],
                    w[2]
                )
            }),
        "aX,aY,aZ,gX,gY,gZ\n".to_owned()
            + &swing(60, |n, _, a, w| {
                let row = [a[0] / g, a[1] / g, a[2] / g, w[0], w[1], w[2]].map(|v| format!("{v:.3}"));
                row.join(",") + if n == 30 { "\n\n" } else { "\n" }
            }),
        "\"Time (s)\";\"Acceleration x (m/s^2)\";\"Acceleration y (m/s^2)\";\"Acceleration z (m/s^2)\"\n"
            .to_owned()
            + &swing(60, |_, t, a, _| {
                format!("{t:.3};{:.3};{:.3};{:.3}\n", a[0], a[1], a[2]).replace('.', ",")
            }),
        "time,gFx,gFy,gFz,wx,wy,wz\n".to_owned()
            + &swing(60, |_, t, a, w| {
                let w = w.map(f64::to_radians);
                format!(
                    "12:30:{:06.3},{:.3},{:.3},{:.3},{:.4},{:.4},{:.4}\n",
                    t,
                    a[0] / g,
                    a[1] / g,
                    a[2] / g,
                    w[0],
                    w[1],
                    w[2]
                )
            }),
        "epoc (ms)\telapsed (s)\tx-axis (g)\ty-axis (g)\tz-axis (g)\n".to_owned()
            + &swing(60, |n, t, a, _| {
                format!(
                    "{}\t{t:.3}\t{:.3}\t{:.3}\t{:.3}\n",
                    1_700_000_000_000_u64 + 10 * n as u64,
                    a[0] / g,
                    a[1] / g,
                    a[2] / g
                )
            }),
        swing(60, |_, _, a, _| format!("accX:{:.3},accY:{:.3},accZ:{:.3}\n", a[0], a[1], a[2])),
        "sep=;\nrecorded by hand\n\nAcX AcY AcZ Tmp GyX GyY GyZ\n".to_owned()
            + &swing(60, |_, _, a, w| {
                let a = a.map(|v| (v / g * 16384.0) as i32);
                let w = w.map(|v| (v * 131.0) as i32);
                format!("{} {} {} 25 {} {} {}\n", a[0], a[1], a[2], w[0], w[1], w[2])
            }),
    ];
    let mut files: Vec<Vec<u8>> = files.into_iter().map(String::into_bytes).collect();
    // Text in the encodings and with the line ends of other systems.
    files.push(String::from_utf8_lossy(&files[0]).encode_utf16().flat_map(u16::to_le_bytes).collect());
    files.last_mut().expect("just pushed").splice(0..0, [0xff, 0xfe]);
    files
}

#[test]
fn damaged_csv_files_of_any_format_are_read_or_refused() {
    let guess = Reading { rate_hz: Some(100.0), guess: true, ..Reading::default() };
    let counts = Reading { units: "16384/g,131/dps".parse::<Units>().unwrap(), ..guess.clone() };
    fuzz("csv", &csv(), count(2000), |bytes| {
        let strict = sheet::parse(Path::new("a.csv"), bytes, &Reading::default()).is_ok();
        let read = sheet::parse(Path::new("a.csv"), bytes, &guess);
        let told = sheet::parse(Path::new("a.csv"), bytes, &counts).is_ok();
        if let Ok(sheet) = &read {
            for take in &sheet.takes {
                // An accepted recording must contain only values that can be used.
                assert!(take.samples().all(|sample| sample.iter().all(|value| value.is_finite())));
                let _ = (take.gaps(), take.holes(1000.0), take.to_csv());
                if take.seconds() < 1e4 {
                    let _ = take.resampled();
                }
            }
        }
        strict || read.is_ok() || told
    });
}

#[test]
fn damaged_folders_of_one_file_per_sensor_are_read_or_refused() {
    let file = |scale: f64, which: usize, start: f64| {
        "time,seconds_elapsed,z,y,x\n".to_owned()
            + &swing(60, |n, t, a, w| {
                let v = if which == 0 { a } else { w.map(f64::to_radians) };
                let ns = 1_700_000_000_000_000_000_u64 + (n as f64 * scale) as u64 * 10_000_000;
                format!("{ns},{:.3},{:.4},{:.4},{:.4}\n", start + t * scale, v[2], v[1], v[0])
            })
    };
    // An input contains two files, which are separated by a byte that does not occur in text.
    let pair = |a: String, b: String| [a.as_bytes(), &[0], b.as_bytes()].concat();
    let seeds = [pair(file(1.0, 0, 0.0), file(1.0, 1, 0.02)), pair(file(1.0, 0, 0.1), file(2.0, 1, 0.0))];
    let reading = Reading { guess: true, ..Reading::default() };
    fuzz("a file per sensor", &seeds, count(2000), |bytes| {
        let mut parts = bytes.split(|byte| *byte == 0);
        let (a, b) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let files =
            [(Path::new("x/TotalAcceleration.csv"), a.to_vec()), (Path::new("x/Gyroscope.csv"), b.to_vec())];
        matches!(sheet::merge(&files, &reading), Ok(Some(_)))
    });
}

/// A file in the data acquisition format that has this number of samples.
fn acquired(rows: usize, units: &str) -> serde_json::Value {
    let values: Vec<[f64; 6]> = (0..rows)
        .map(|n| {
            let wave = (n as f64 / 7.0).sin();
            [wave, 2.0 * wave, 9.81 - wave, 50.0 * wave, 3.0, -wave]
        })
        .collect();
    let sensors: Vec<_> = ["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ"]
        .iter()
        .enumerate()
        .map(|(n, name)| serde_json::json!({"name": name, "units": if n < 3 { units } else { "deg/s" }}))
        .collect();
    serde_json::json!({
        "protected": {"ver": "v1", "alg": "none", "iat": 1_700_000_000},
        "signature": "0".repeat(64),
        "payload": {
            "device_name": "ac:87:a3:0a:2d:1b", "device_type": "NANO33BLE", "interval_ms": 10,
            "sensors": sensors, "values": values
        }
    })
}

#[test]
fn damaged_files_of_edge_impulse_are_read_or_refused() {
    let cbor = |value: &serde_json::Value| {
        let mut bytes = Vec::new();
        ciborium::into_writer(value, &mut bytes).unwrap();
        bytes
    };
    let seeds = [acquired(40, "m/s2"), acquired(25, "N/A")];
    let texts = seeds.iter().map(|value| value.to_string().into_bytes());
    let reading = Reading { guess: true, ..Reading::default() };
    let read = |bytes: &[u8]| edge_impulse::parse(Path::new("a.json"), bytes, &reading).is_ok();
    fuzz("Edge Impulse, JSON", &texts.collect::<Vec<_>>(), count(2000), read);
    fuzz("Edge Impulse, CBOR", &seeds.each_ref().map(cbor), count(2000), read);
}

#[test]
fn damaged_networks_of_tensorflow_are_read_or_refused() {
    let fixture = |name: &str| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tflite_fixtures");
        std::fs::read(folder.join(name)).unwrap()
    };
    let names =
        ["three-int8", "three-uint8", "three-float-io", "three-reshape", "three-logits", "three-relu6"];
    let seeds: Vec<_> = names.iter().map(|name| fixture(&format!("{name}.tflite"))).collect();
    fuzz("tflite", &seeds, count(2000), |bytes| match tflite::read_to_end(bytes) {
        Ok((network, _)) => {
            // An accepted network must survive writing and reading.
            assert!(tflite::read(&tflite::write(&network)).is_ok());
            true
        }
        Err(_) => false,
    });
}
