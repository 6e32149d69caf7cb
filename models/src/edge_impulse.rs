//! Recordings in Edge Impulse's data acquisition format, JSON or CBOR, into ours.
//!
//! Such a file is one object: `payload.interval_ms`, `payload.sensors` (names and units) and `payload.values`
//! (one row of numbers per sample). Signatures are not checked: they say who sent a file, not whether it is
//! sound. What cannot be used is an error that names the file, the place in it, and what to do.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::labels;
use crate::recording::{AXIS_NAMES, MAX_RATE_HZ, MIN_RATE_HZ, Recording};

/// Gravity in m/s², by definition.
const G: f64 = 9.806_65;

/// Units by kind of sensor: how they are spelled, and how many of ours one of them is.
const ACCELERATION: &[(&str, f64)] =
    &[("m/s2", 1.0), ("m/s²", 1.0), ("m/s^2", 1.0), ("ms2", 1.0), ("g", G), ("mg", G / 1000.0)];
const TURN_RATE: &[(&str, f64)] =
    &[("deg/s", 1.0), ("°/s", 1.0), ("dps", 1.0), ("degps", 1.0), ("rad/s", 180.0 / std::f64::consts::PI)];
const FIELD: &[(&str, f64)] =
    &[("ut", 1.0), ("µt", 1.0), ("utesla", 1.0), ("gauss", 100.0), ("gs", 100.0), ("mgauss", 0.1)];

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The samples in m/s², deg/s and µT.
    pub recording: Recording,
    /// What the file calls the device, if it does.
    pub device: Option<String>,
    /// Sensors in the file that have no place in ours.
    pub left_out: Vec<String>,
}

/// Why a file cannot be imported; the text says where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be read.
    #[error("{file}: {source}; check the path and that the file may be read")]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Neither JSON nor CBOR.
    #[error("{file}: no Edge Impulse data file ({what}); export it again as JSON or CBOR")]
    Text {
        /// The file.
        file: PathBuf,
        /// What the parser said, with line and column or the byte.
        what: String,
    },
    /// A part is missing, or is not what it should be.
    #[error("{file}, {place}: {what}")]
    Place {
        /// The file.
        file: PathBuf,
        /// The place in the object, such as `payload.values[3][0]`.
        place: String,
        /// What is wrong there and what to do.
        what: String,
    },
}

struct Reader<'a> {
    file: &'a Path,
}

impl Reader<'_> {
    fn wrong<T>(&self, place: &str, what: impl Into<String>) -> Result<T, ImportError> {
        Err(ImportError::Place { file: self.file.to_owned(), place: place.to_owned(), what: what.into() })
    }

    /// The member of an object; `path` names the object.
    fn member<'v>(&self, value: &'v Value, path: &str, name: &str) -> Result<&'v Value, ImportError> {
        let place = if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
        match value.get(name) {
            Some(member) => Ok(member),
            None => self.wrong(&place, "is missing; is this a file of the data acquisition format?"),
        }
    }

    fn list<'v>(&self, value: &'v Value, place: &str) -> Result<&'v [Value], ImportError> {
        match value {
            Value::Array(list) => Ok(list),
            Value::String(text) if text.starts_with("Ref-BINARY") => self.wrong(
                place,
                "the values are in a binary attachment; export the data as JSON or CBOR with values",
            ),
            other => self.wrong(place, format!("a list is expected, not {}", kind(other))),
        }
    }

    fn number(&self, value: &Value, place: &str) -> Result<f64, ImportError> {
        match value.as_f64().filter(|number| (*number as f32).is_finite()) {
            Some(number) => Ok(number),
            None => {
                self.wrong(place, format!("{} is no finite number; correct or delete the row", shown(value)))
            }
        }
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

fn shown(value: &Value) -> String {
    value.to_string().chars().take(40).collect()
}

/// Reads a data file.
///
/// # Errors
/// [`ImportError`].
pub fn read(file: &Path) -> Result<Imported, ImportError> {
    let bytes = std::fs::read(file).map_err(|source| ImportError::Io { file: file.to_owned(), source })?;
    parse(file, &bytes)
}

/// The same from memory: JSON if it begins like an object, else CBOR. `file` is only for the errors.
///
/// # Errors
/// [`ImportError`].
pub fn parse(file: &Path, bytes: &[u8]) -> Result<Imported, ImportError> {
    let refused = |what: String| ImportError::Text { file: file.to_owned(), what };
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let is_json = text.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'{');
    let root: Value = if is_json {
        serde_json::from_slice(text).map_err(|error| refused(format!("JSON: {error}")))?
    } else {
        ciborium::from_reader(bytes).map_err(|error| refused(format!("CBOR: {error}")))?
    };
    let reader = Reader { file };
    let payload = reader.member(&root, "", "payload")?;
    let interval = reader.member(payload, "payload", "interval_ms")?;
    let interval_ms = reader.number(interval, "payload.interval_ms")?;
    let rates = 1000.0 / MAX_RATE_HZ..=1000.0 / MIN_RATE_HZ;
    if !rates.contains(&interval_ms) {
        return reader.wrong(
            "payload.interval_ms",
            format!("{interval_ms} ms between samples; {} to {} ms can be used", rates.start(), rates.end()),
        );
    }
    let sensors = reader.list(reader.member(payload, "payload", "sensors")?, "payload.sensors")?;
    let columns = columns(&reader, sensors)?;
    let rows = reader.list(reader.member(payload, "payload", "values")?, "payload.values")?;
    if rows.len() < 2 {
        return reader.wrong("payload.values", format!("{} samples; at least two are needed", rows.len()));
    }
    let mut values = Vec::with_capacity(rows.len() * columns.used.len());
    for (index, row) in rows.iter().enumerate() {
        let place = format!("payload.values[{index}]");
        let row = reader.list(row, &place)?;
        if row.len() != sensors.len() {
            return reader.wrong(
                &place,
                format!(
                    "{} values for {} sensors; the file is cut off or damaged here",
                    row.len(),
                    sensors.len()
                ),
            );
        }
        for &(column, factor) in &columns.used {
            let value = reader.number(&row[column], &format!("{place}[{column}]"))?;
            values.push((value * factor) as f32);
        }
    }
    let time_ms = (0..rows.len()).map(|n| n as f64 * interval_ms).collect();
    Ok(Imported {
        recording: Recording::new(columns.used.len(), time_ms, values),
        device: payload.get("device_name").and_then(Value::as_str).map(str::to_owned),
        left_out: columns.left_out,
    })
}

struct Columns {
    /// Per axis of ours: which column, and its factor.
    used: Vec<(usize, f64)>,
    left_out: Vec<String>,
}

fn columns(reader: &Reader<'_>, sensors: &[Value]) -> Result<Columns, ImportError> {
    let mut found: [Option<(usize, f64)>; 9] = [None; 9];
    let mut left_out = Vec::new();
    for (column, sensor) in sensors.iter().enumerate() {
        let place = format!("payload.sensors[{column}]");
        let name = reader.member(sensor, &place, "name")?;
        let Some(name) = name.as_str() else {
            return reader.wrong(&format!("{place}.name"), format!("{} is no name", shown(name)));
        };
        let Some(axis) = AXIS_NAMES.iter().position(|axis| axis.eq_ignore_ascii_case(name.trim())) else {
            left_out.push(name.to_owned());
            continue;
        };
        let units = reader.member(sensor, &place, "units")?;
        let known = [ACCELERATION, TURN_RATE, FIELD][axis / 3];
        let spelled = units.as_str().unwrap_or_default().trim().to_lowercase();
        let Some((_, factor)) = known.iter().find(|(unit, _)| *unit == spelled) else {
            let names: Vec<&str> = known.iter().map(|(unit, _)| *unit).collect();
            return reader.wrong(
                &format!("{place}.units"),
                format!(
                    "{name} in {}, but only {} are known; correct the units",
                    shown(units),
                    names.join(", ")
                ),
            );
        };
        if found[axis].replace((column, *factor)).is_some() {
            return reader.wrong(&format!("{place}.name"), format!("{name} is there twice; delete one"));
        }
    }
    let axes = (1..=3).map(|kinds| 3 * kinds).rev().find(|&axes| found[..axes].iter().all(Option::is_some));
    let missing = |range: std::ops::Range<usize>| -> Vec<&str> {
        range.filter(|&axis| found[axis].is_none()).map(|axis| AXIS_NAMES[axis]).collect()
    };
    let Some(axes) = axes else {
        return reader.wrong(
            "payload.sensors",
            format!("{} is missing; a recording needs accX, accY and accZ", missing(0..3).join(", ")),
        );
    };
    // A sensor of which an axis is missing would be left out in silence.
    if let Some(kind) = (axes / 3..3).find(|kind| found[kind * 3..kind * 3 + 3].iter().any(Option::is_some)) {
        // The magnetometer alone, without the gyroscope, has no place either.
        let missing = missing(axes..kind * 3 + 3);
        return reader.wrong(
            "payload.sensors",
            format!(
                "{} is missing beside the others; delete what is not whole, or record it again",
                missing.join(", ")
            ),
        );
    }
    Ok(Columns { used: found[..axes].iter().flatten().copied().collect(), left_out })
}

/// The label of a file: from the `info.labels` of its export, else the part of its name before the first dot,
/// as the ingestion service names files. Canonical.
pub fn label_of(file: &Path) -> Option<String> {
    for folder in file.ancestors().skip(1).take(3) {
        let Ok(bytes) = std::fs::read(folder.join("info.labels")) else { continue };
        let Ok(info) = serde_json::from_slice::<Value>(&bytes) else { continue };
        let inside = file.strip_prefix(folder).ok()?.to_string_lossy().replace('\\', "/");
        let entry = info
            .get("files")?
            .as_array()?
            .iter()
            .find(|entry| entry.get("path").and_then(Value::as_str) == Some(inside.as_str()));
        let label = entry.and_then(|entry| entry.get("label"));
        let label = label.and_then(|label| label.as_str().or_else(|| label.get("label")?.as_str()));
        if let Some(label) = label {
            return Some(labels::canonical(label));
        }
    }
    let name = file.file_name()?.to_string_lossy().into_owned();
    let label = name.split('.').next().filter(|label| !label.is_empty())?;
    Some(labels::canonical(label))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn file(sensors: Value, values: Value) -> Value {
        json!({
            "protected": { "ver": "v1", "alg": "none" },
            "signature": "00",
            "payload": {
                "device_name": "ac:87:a3", "device_type": "NANO33BLE", "interval_ms": 10,
                "sensors": sensors, "values": values,
            }
        })
    }

    fn parsed(root: &Value) -> Result<Imported, ImportError> {
        parse(Path::new("wave.1.json"), root.to_string().as_bytes())
    }

    fn error(sensors: Value, values: Value) -> String {
        parsed(&file(sensors, values)).unwrap_err().to_string()
    }

    fn acc() -> Value {
        json!([{"name": "accX", "units": "m/s2"}, {"name": "accY", "units": "m/s2"}, {"name": "accZ", "units": "m/s2"}])
    }

    #[test]
    fn json_and_cbor_of_the_same_content_are_the_same_recording() {
        let root = file(acc(), json!([[1, 2.5, -9.81], [2, 0, 0]]));
        let from_json = parsed(&root).unwrap();
        let mut cbor = Vec::new();
        ciborium::into_writer(&root, &mut cbor).unwrap();
        let from_cbor = parse(Path::new("wave.1.cbor"), &cbor).unwrap();
        assert_eq!(from_json, from_cbor);
        assert_eq!(from_json.device.as_deref(), Some("ac:87:a3"));
        let rows: Vec<&[f32]> = from_json.recording.samples().collect();
        assert_eq!(rows, [&[1.0, 2.5, -9.81], &[2.0, 0.0, 0.0]]);
        assert_eq!(from_json.recording.time_ms(), [0.0, 10.0]);
    }

    #[test]
    fn units_become_ours_and_columns_find_their_places() {
        let sensors = json!([
            {"name": "gyrZ", "units": "rad/s"}, {"name": "temperature", "units": "C"},
            {"name": "accX", "units": "g"}, {"name": "accY", "units": "g"}, {"name": "accZ", "units": "mg"},
            {"name": "gyrX", "units": "dps"}, {"name": "gyrY", "units": "deg/s"},
        ]);
        let row = json!([1.0, 20.0, 1.0, -1.0, 1000.0, 5.0, 6.0]);
        let imported = parsed(&file(sensors, json!([row, row]))).unwrap();
        assert_eq!(imported.left_out, ["temperature"]);
        assert_eq!(imported.recording.axes(), 6);
        let sample: Vec<f32> = imported.recording.samples().next().unwrap().to_vec();
        let expected = [9.80665, -9.80665, 9.80665, 5.0, 6.0, 57.295_78];
        assert!(sample.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{sample:?}");
    }

    #[test]
    fn every_error_names_its_place_and_what_to_do() {
        let rows = json!([[1, 2, 3], [1, 2, 3]]);
        for (text, words) in [
            (
                error(acc(), json!([[1, 2, 3], [1, "x", 3]])),
                ["wave.1.json, payload.values[1][1]", "\"x\" is no finite"],
            ),
            (error(acc(), json!([[1, 2, 3], [1, 2]])), ["payload.values[1]", "2 values for 3 sensors"]),
            (error(acc(), json!([[1, 2, 3]])), ["payload.values", "at least two"]),
            (error(acc(), json!("Ref-BINARY-i16 (4 bytes)")), ["payload.values", "binary attachment"]),
            (
                error(json!([{"name": "accX", "units": "m/s2"}]), rows.clone()),
                ["payload.sensors", "accY, accZ is missing"],
            ),
            (
                error(json!([{"name": "accX", "units": "furlong"}]), rows.clone()),
                ["payload.sensors[0].units", "m/s2"],
            ),
            (error(json!([{"units": "g"}]), rows.clone()), ["payload.sensors[0].name", "is missing"]),
            (parsed(&json!({"payload": {}})).unwrap_err().to_string(), ["payload.interval_ms", "is missing"]),
            (
                parsed(&json!({"payload": {"interval_ms": 500}})).unwrap_err().to_string(),
                ["payload.interval_ms", "2 to 40 ms"],
            ),
            (
                parse(Path::new("a.json"), b"{\n \"x\": ]").unwrap_err().to_string(),
                ["a.json", "line 2 column 7"],
            ),
            (parse(Path::new("a.cbor"), &[0xa1, 0x61]).unwrap_err().to_string(), ["a.cbor", "CBOR"]),
        ] {
            assert!(words.iter().all(|word| text.contains(word)), "{words:?} in {text}");
        }
        let mut lone = acc();
        lone.as_array_mut().unwrap().push(json!({"name": "magX", "units": "uT"}));
        let text = error(lone, json!([[1, 2, 3, 4], [1, 2, 3, 4]]));
        assert!(text.contains("gyrX, gyrY, gyrZ, magY, magZ is missing"), "{text}");
    }

    #[test]
    fn the_label_is_in_the_export_or_in_the_name() {
        assert_eq!(label_of(Path::new("/nowhere/Left_Right.28ta5.cbor")).as_deref(), Some("left-right"));
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("training")).unwrap();
        let info = json!({"version": 1, "files": [
            {"path": "training/a.cbor", "category": "training", "label": {"type": "label", "label": "Big Wave"}},
        ]});
        std::fs::write(folder.path().join("info.labels"), info.to_string()).unwrap();
        assert_eq!(label_of(&folder.path().join("training/a.cbor")).as_deref(), Some("big-wave"));
        assert_eq!(label_of(&folder.path().join("training/b.cbor")).as_deref(), Some("b"));
    }

    proptest::proptest! {
        #[test]
        fn damaged_files_never_panic(bytes in proptest::collection::vec(0u8.., 0..400), place in 0usize..400) {
            let _ = parse(Path::new("x"), &bytes);
            let mut cbor = Vec::new();
            ciborium::into_writer(&file(acc(), json!([[1, 2, 3], [1, 2, 3]])), &mut cbor).unwrap();
            let place = place % cbor.len();
            cbor[place] ^= bytes.first().copied().unwrap_or(1);
            let _ = parse(Path::new("x"), &cbor);
            let _ = parse(Path::new("x"), &cbor[..place]);
        }
    }
}
