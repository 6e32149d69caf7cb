//! Reads recordings in Edge Impulse's data acquisition format, JSON or CBOR.
//!
//! Such a file is one object with `payload.interval_ms`, `payload.sensors` (names and units) and `payload.values` (rows).
//! Signatures are not checked, because they identify the sender but do not show that the data is valid.
//! Columns and units are detected as in CSV files ([`crate::sheet`]).
//! Unusable data causes an error with the file, the place in it, and a remedy.
//! [`export`] reads the labels of an export.

pub mod export;

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::recording::{MAX_RATE_HZ, MIN_RATE_HZ, Recording, RecordingError};
use crate::sheet::{self, Reading};

/// The contents of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The samples in m/s², deg/s and µT.
    pub recording: Recording,
    /// Name of the device in the file, if the file contains a name.
    pub device: Option<String>,
    /// Descriptions of everything that was inferred or omitted.
    pub notes: Vec<String>,
}

/// The reason why a file cannot be imported, with the place in the file and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be read.
    #[error("{file}: {source}; check the path and that the file may be read")]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error message.
        source: std::io::Error,
    },
    /// Neither JSON nor CBOR.
    #[error("{file}: no Edge Impulse data file ({what}); export it again as JSON or CBOR")]
    Text {
        /// The file.
        file: PathBuf,
        /// The parser's message, with line and column or byte offset.
        what: String,
    },
    /// The columns or units of the file cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A part of the object is missing or invalid.
    #[error("{file}, {place}: {what}")]
    Content {
        /// The file.
        file: PathBuf,
        /// Place of the problem in the object, such as `payload.values[3][0]`.
        place: String,
        /// The problem at this place, and a remedy.
        what: String,
    },
}

struct Reader<'a> {
    file: &'a Path,
}

impl Reader<'_> {
    fn wrong<T>(&self, place: &str, what: impl Into<String>) -> Result<T, ImportError> {
        Err(ImportError::Content { file: self.file.to_owned(), place: place.to_owned(), what: what.into() })
    }

    /// Returns a member of the object at `path`.
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
pub fn read(file: &Path, reading: &Reading) -> Result<Imported, ImportError> {
    let bytes = std::fs::read(file).map_err(|source| ImportError::Io { file: file.to_owned(), source })?;
    parse(file, &bytes, reading)
}

/// Like [`read`], but reads from memory: JSON if the data begins like an object, otherwise CBOR.
/// `file` is used only in errors.
///
/// # Errors
/// [`ImportError`].
pub fn parse(file: &Path, bytes: &[u8], reading: &Reading) -> Result<Imported, ImportError> {
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
    let names = names(&reader, sensors)?;
    let mut table = sheet::Table::new(file, names, reading)?;
    let (factors, declared) = factors(&reader, sensors, &table, reading)?;
    table.declare(declared);
    let rows = reader.list(reader.member(payload, "payload", "values")?, "payload.values")?;
    if rows.len() < 2 {
        return reader.wrong("payload.values", format!("{} samples; at least two are needed", rows.len()));
    }
    let mut numbers = Vec::with_capacity(sensors.len());
    for (index, row) in rows.iter().enumerate() {
        let place = || format!("payload.values[{index}]");
        let row = reader.list(row, &place())?;
        if row.len() != sensors.len() {
            return reader.wrong(
                &place(),
                format!(
                    "{} values for {} sensors; the file is cut off or damaged here",
                    row.len(),
                    sensors.len()
                ),
            );
        }
        numbers.clear();
        for (column, value) in row.iter().enumerate() {
            numbers.push(match factors[column] {
                None => 0.0,
                Some(factor) => match value.as_f64().filter(|number| (*number as f32).is_finite()) {
                    Some(number) => number * factor,
                    None => reader.number(value, &format!("{}[{column}]", place()))?,
                },
            });
        }
        table.push(&numbers);
    }
    let (recording, mut notes) = table.finish(file, interval_ms, reading)?;
    let left_out: Vec<&str> = (0..sensors.len())
        .filter(|column| factors[*column].is_none())
        .filter_map(|column| sensors[column].get("name")?.as_str())
        .collect();
    if !left_out.is_empty() {
        notes.push(format!("left out {}", left_out.join(", ")));
    }
    let device = payload.get("device_name").and_then(Value::as_str).map(str::to_owned);
    Ok(Imported { recording, device, notes })
}

/// The sensors' names.
fn names(reader: &Reader<'_>, sensors: &[Value]) -> Result<Vec<String>, ImportError> {
    let one = |(column, sensor): (usize, &Value)| {
        let place = format!("payload.sensors[{column}]");
        let name = reader.member(sensor, &place, "name")?;
        match name.as_str() {
            Some(name) => Ok(name.trim().to_owned()),
            None => reader.wrong(&format!("{place}.name"), format!("{} is no name", shown(name))),
        }
    };
    sensors.iter().enumerate().map(one).collect()
}

/// Returns the factor to our unit for each used column (1 if undeclared), and the sensors whose units are declared.
fn factors(
    reader: &Reader<'_>,
    sensors: &[Value],
    table: &sheet::Table,
    reading: &Reading,
) -> Result<(Vec<Option<f64>>, [bool; 3]), ImportError> {
    let mut factors = vec![None; sensors.len()];
    let used: Vec<_> = table.columns().collect();
    let mut declared = [true; 3];
    for &(column, sensor) in &used {
        let place = format!("payload.sensors[{column}].units");
        let units = sensors[column].get("units").unwrap_or(&Value::Null);
        let spelled = units.as_str().unwrap_or_default().trim().to_lowercase();
        factors[column] = match sheet::factor(sensor, &spelled) {
            _ if reading.units.of(sensor).is_some() => {
                declared[sensor as usize] = false;
                Some(1.0)
            }
            Some(factor) => Some(factor),
            // Default names that the data forwarder writes.
            None if matches!(spelled.as_str(), "" | "n/a" | "na" | "none" | "-") => {
                declared[sensor as usize] = false;
                Some(1.0)
            }
            None => {
                return reader.wrong(
                    &place,
                    format!(
                        "{} in {}, but only {} are known; say what it is with --units",
                        sensors[column].get("name").and_then(Value::as_str).unwrap_or_default(),
                        shown(units),
                        sheet::unit_names(sensor).join(", ")
                    ),
                );
            }
        };
    }
    Ok((factors, declared))
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

    const GUESS: Reading = Reading { units: sheet::Units::NONE, rate_hz: None, columns: None, guess: true };

    fn parsed(root: &Value) -> Result<Imported, ImportError> {
        parse(Path::new("wave.1.json"), root.to_string().as_bytes(), &GUESS)
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
        let from_cbor = parse(Path::new("wave.1.cbor"), &cbor, &GUESS).unwrap();
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
        assert_eq!(imported.notes, ["left out temperature"]);
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
                ["wave.1.json", "this sensor has no y and no z"],
            ),
            (error(acc_in("furlong"), rows.clone()), ["payload.sensors[0].units", "m/s2"]),
            (error(json!([{"units": "g"}]), rows.clone()), ["payload.sensors[0].name", "is missing"]),
            (parsed(&json!({"payload": {}})).unwrap_err().to_string(), ["payload.interval_ms", "is missing"]),
            (
                parsed(&json!({"payload": {"interval_ms": 500}})).unwrap_err().to_string(),
                ["payload.interval_ms", "2 to 40 ms"],
            ),
            (
                parse(Path::new("a.json"), b"{\n \"x\": ]", &GUESS).unwrap_err().to_string(),
                ["a.json", "line 2 column 7"],
            ),
            (parse(Path::new("a.cbor"), &[0xa1, 0x61], &GUESS).unwrap_err().to_string(), ["a.cbor", "CBOR"]),
        ] {
            assert!(words.iter().all(|word| text.contains(word)), "{words:?} in {text}");
        }
        let mut lone = acc();
        lone.as_array_mut().unwrap().push(json!({"name": "magX", "units": "uT"}));
        let text = error(lone, json!([[1, 2, 3, 4], [1, 2, 3, 4]]));
        assert!(text.contains("(\"magX\"): this sensor has no y and no z"), "{text}");
    }

    /// Two seconds of a waving hand, scaled by `unit`.
    fn waved(unit: f64) -> Value {
        let row = |n: u32| {
            let s = (f64::from(n) * 0.09).sin();
            json!([(3.0 * s + 1.0) * unit, 0.5 * unit, 9.7 * unit])
        };
        (0..200).map(row).collect()
    }

    fn acc_in(units: &str) -> Value {
        ["accX", "accY", "accZ"].iter().map(|name| json!({"name": name, "units": units})).collect()
    }

    #[test]
    fn a_unit_that_gravity_contradicts_is_refused_and_one_that_is_not_said_is_judged() {
        let g = 1.0 / 9.80665;
        let text = error(acc_in("m/s2"), waved(g));
        assert!(text.contains("gravity at rest is about 1 m/s²") && text.contains("--units g"), "{text}");
        let right = parsed(&file(acc_in("m/s2"), waved(1.0))).unwrap();
        let close = |a: &Recording, b: &Recording| {
            a.samples().flatten().zip(b.samples().flatten()).all(|(a, b)| (a - b).abs() < 1e-4)
        };
        for units in ["N/A", ""] {
            let judged = parsed(&file(acc_in(units), waved(g))).unwrap();
            assert!(close(&judged.recording, &right.recording));
            assert_eq!(judged.notes, ["the accelerometer is in g, by gravity"]);
        }
        // The user's options override the file.
        let told = Reading { units: "g".parse().unwrap(), ..GUESS };
        let root = file(acc_in("m/s2"), waved(g)).to_string();
        let told = parse(Path::new("x.json"), root.as_bytes(), &told).unwrap();
        assert!(close(&told.recording, &right.recording) && told.notes.is_empty(), "{:?}", told.notes);
    }

    #[test]
    fn columns_of_ones_own_can_be_named() {
        let own: Value = ["p", "q", "r"].iter().map(|name| json!({"name": name, "units": "N/A"})).collect();
        let root = file(own, waved(1.0)).to_string();
        let text = parse(Path::new("x.json"), root.as_bytes(), &GUESS).unwrap_err().to_string();
        assert!(text.contains("no columns of an accelerometer") && text.contains("--columns"), "{text}");
        let columns = Some("accX=r,accY=q,accZ=p".parse().unwrap());
        let named = parse(Path::new("x.json"), root.as_bytes(), &Reading { columns, ..GUESS }).unwrap();
        let first: Vec<f32> = named.recording.samples().next().unwrap().to_vec();
        assert_eq!(first, [9.7, 0.5, 1.0]);
    }

    proptest::proptest! {
        #[test]
        fn damaged_files_never_panic(bytes in proptest::collection::vec(0u8.., 0..400), place in 0usize..400) {
            let _ = parse(Path::new("x"), &bytes, &GUESS);
            let mut cbor = Vec::new();
            ciborium::into_writer(&file(acc(), json!([[1, 2, 3], [1, 2, 3]])), &mut cbor).unwrap();
            let place = place % cbor.len();
            cbor[place] ^= bytes.first().copied().unwrap_or(1);
            let _ = parse(Path::new("x"), &cbor, &GUESS);
            let _ = parse(Path::new("x"), &cbor[..place], &GUESS);
        }
    }
}
