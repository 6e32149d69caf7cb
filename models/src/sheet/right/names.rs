//! Recognises columns by their names, which contain the axes of three sensors, the time, and declared units.

use crate::sheet::Sensor;

/// Gravity in m/s², by definition.
pub(crate) const G: f64 = 9.806_65;

/// Units of each sensor: the spelling in lower case, and the size of the unit in our units (m/s², deg/s, µT).
const ACCELERATION: &[(&str, f64)] = &[
    ("m/s2", 1.0),
    ("m/s²", 1.0),
    ("m/s^2", 1.0),
    ("m/(s^2)", 1.0),
    ("m/s/s", 1.0),
    ("ms2", 1.0),
    ("ms-2", 1.0),
    ("mps2", 1.0),
    ("meters/second^2", 1.0),
    ("g", G),
    ("gs", G),
    ("gees", G),
    ("mg", G / 1000.0),
    ("milli-g", G / 1000.0),
];
const TURN_RATE: &[(&str, f64)] = &[
    ("deg/s", 1.0),
    ("°/s", 1.0),
    ("º/s", 1.0),
    ("dps", 1.0),
    ("degps", 1.0),
    ("deg/sec", 1.0),
    ("mdps", 0.001),
    ("rad/s", 180.0 / std::f64::consts::PI),
    ("rads", 180.0 / std::f64::consts::PI),
    ("radps", 180.0 / std::f64::consts::PI),
    ("rad/sec", 180.0 / std::f64::consts::PI),
];
const FIELD: &[(&str, f64)] = &[
    ("ut", 1.0),
    ("µt", 1.0),
    ("μt", 1.0),
    ("utesla", 1.0),
    ("microtesla", 1.0),
    ("gauss", 100.0),
    ("gs", 100.0),
    ("mgauss", 0.1),
    ("nt", 0.001),
];

/// Spellings of a sensor's units, and their factors.
pub(crate) fn units(sensor: Sensor) -> &'static [(&'static str, f64)] {
    match sensor {
        Sensor::Acceleration => ACCELERATION,
        Sensor::TurnRate => TURN_RATE,
        Sensor::Field => FIELD,
    }
}

/// Returns the size of this unit in our units, if it belongs to this sensor.
pub(crate) fn factor(sensor: Sensor, unit: &str) -> Option<f64> {
    let unit = unit.trim().to_lowercase();
    units(sensor).iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
}

/// The content of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Acceleration in g, including gravity.
    GForce,
    /// Acceleration including gravity.
    Acceleration,
    /// Acceleration in a column whose name says that gravity was removed.
    Linear,
    /// Gravity alone.
    Gravity,
    TurnRate,
    Field,
    /// An axis whose name does not contain the sensor.
    Bare,
}

/// The information that a column's name contains.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Named {
    pub kind: Kind,
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Factor to our unit, if the name declares a unit.
    pub factor: Option<f64>,
    /// Factor that names like this one usually imply, if it differs from ours.
    pub usual: Option<f64>,
    /// The squashed name without axis and unit, which all columns of one sensor share.
    pub stem: String,
}

/// Returns only the lower-case letters and digits of the name.
pub(super) fn squash(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Splits a name into the part outside brackets and the part inside.
fn apart(name: &str) -> (String, Option<&str>) {
    let Some((before, rest)) = name.split_once(['(', '[']) else { return (name.to_owned(), None) };
    match rest.rsplit_once([')', ']']) {
        // `m/(s^2)` contains another bracket.
        Some((unit, after)) => (format!("{before}{after}"), Some(unit.trim())),
        None => (name.to_owned(), None),
    }
}

/// Splits a name into words, at capitals and at characters other than letters and digits.
fn words(name: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut before = ' ';
    for c in name.chars() {
        let parts = !c.is_alphanumeric() || (c.is_uppercase() && before.is_lowercase());
        if parts && !word.is_empty() {
            words.push(std::mem::take(&mut word));
        }
        if c.is_alphanumeric() {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    if !word.is_empty() {
        words.push(word);
    }
    words
}

/// Returns the factor of a name that ends in a unit without brackets, such as `acc_x_g`.
fn suffix(sensor: Sensor, words: &[String]) -> Option<f64> {
    let last = words.last()?;
    let taken: &[&str] = match sensor {
        Sensor::Acceleration => &["g", "mg", "ms2", "mps2"],
        Sensor::TurnRate => &["dps", "degps", "mdps", "rads", "radps"],
        Sensor::Field => &["ut", "gauss", "mgauss"],
    };
    if words.len() > 1 && taken.contains(&last.as_str()) { factor(sensor, last) } else { None }
}

/// Recognises the name of a column with samples.
pub(super) fn sample(name: &str) -> Option<Named> {
    let (plain, unit) = apart(name);
    let words = words(&plain);
    let squashed = squash(&plain);
    let letter = |word: &str| ["x", "y", "z"].iter().position(|axis| *axis == word);
    // The axis is a separate word, or the last letter of a word.
    let found = words.iter().rev().find_map(|word| letter(word));
    let (axis, rest) = match found {
        Some(axis) => {
            let rest: Vec<&str> = words.iter().map(String::as_str).filter(|w| letter(w).is_none()).collect();
            (axis, rest.concat())
        }
        None => {
            let last = squashed.char_indices().last()?.0;
            (letter(&squashed[last..])?, squashed[..last].to_owned())
        }
    };
    let has = |parts: &[&str]| parts.iter().any(|part| rest.contains(part));
    let whole_word = found.is_some();
    let kind = match rest.as_str() {
        "gf" | "gforce" => Kind::GForce,
        "a" | "ac" | "acc" | "accel" => Kind::Acceleration,
        "g" | "gy" | "gyr" | "gyro" | "w" | "omega" | "rot" => Kind::TurnRate,
        "m" | "mag" | "magn" | "b" | "mx" => Kind::Field,
        "la" | "lin" => Kind::Linear,
        "" if whole_word => Kind::Bare,
        "axis" => Kind::Bare,
        _ if has(&["quat", "attitude", "euler", "orient", "angle", "roll", "pitch", "yaw", "accura"]) => {
            return None;
        }
        _ if has(&[
            "gyr",
            "rotationrate",
            "rotrate",
            "gyrorotation",
            "angularvel",
            "angularrate",
            "angvel",
        ]) =>
        {
            Kind::TurnRate
        }
        _ if has(&["magnet", "compass", "magfield"]) || rest.starts_with("mag") => Kind::Field,
        _ if has(&["linear", "userac", "linacc"]) => Kind::Linear,
        _ if has(&["acc"]) => Kind::Acceleration,
        _ if has(&["gravity"]) => Kind::Gravity,
        _ if has(&["gforce"]) => Kind::GForce,
        _ => return None,
    };
    // A unit in brackets identifies the sensor to which an axis belongs.
    let of_unit = |unit: &str| {
        let kinds = [
            (Sensor::Acceleration, Kind::Acceleration),
            (Sensor::TurnRate, Kind::TurnRate),
            (Sensor::Field, Kind::Field),
        ];
        kinds.into_iter().find_map(|(sensor, kind)| Some((kind, factor(sensor, unit)?)))
    };
    if kind == Kind::Bare {
        let known = unit.and_then(of_unit);
        return Some(Named {
            kind: known.map_or(Kind::Bare, |(kind, _)| kind),
            axis,
            factor: known.map(|(_, factor)| factor),
            usual: None,
            stem: rest,
        });
    }
    let sensor = kind.sensor()?;
    let declared = unit.and_then(|unit| factor(sensor, unit)).or_else(|| suffix(sensor, &words));
    // Apple and Physics Toolbox write turn rates in rad/s without a declaration.
    let usual = match kind {
        Kind::GForce => Some(G),
        Kind::TurnRate if rest == "w" || rest.contains("rotationrate") => factor(Sensor::TurnRate, "rad/s"),
        _ => None,
    };
    Some(Named { kind, axis, factor: declared, usual, stem: rest })
}

impl Kind {
    /// Whose axis it is.
    pub(super) fn sensor(self) -> Option<Sensor> {
        match self {
            Kind::GForce | Kind::Acceleration | Kind::Linear | Kind::Gravity => Some(Sensor::Acceleration),
            Kind::TurnRate => Some(Sensor::TurnRate),
            Kind::Field => Some(Sensor::Field),
            Kind::Bare => None,
        }
    }
}

/// Recognises a time column. Returns its rank (0 is best), and the ms per unit if the name declares the unit.
pub(super) fn time(name: &str) -> Option<(u8, Option<f64>)> {
    let (plain, bracket) = apart(name);
    let words = words(&plain);
    let squashed = squash(&plain);
    let has = |word: &str| words.iter().any(|w| w == word);
    let unit = |text: &str| match text.trim().to_lowercase().as_str() {
        "s" | "sec" | "secs" | "second" | "seconds" => Some(1000.0),
        "ms" | "msec" | "millis" | "milliseconds" => Some(1.0),
        "us" | "µs" | "μs" | "usec" | "micros" | "microseconds" => Some(1e-3),
        "ns" | "nanos" | "nanoseconds" => Some(1e-6),
        _ => None,
    };
    let declared = bracket.and_then(unit).or_else(|| words.iter().find_map(|word| unit(word)));
    let rank = match squashed.as_str() {
        "timestampms" | "timestamp" | "secondselapsed" | "elapsed" => 0,
        "time" | "t" | "ts" | "millis" | "micros" | "ms" | "timems" | "tms" | "timeus" | "epoch"
        | "seconds" => 1,
        _ if has("timestamp") || squashed.contains("timestamp") => 2,
        _ if has("elapsed") || has("time") || squashed.starts_with("time") => 2,
        _ if squashed.ends_with("time") || has("epoch") => 3,
        _ if has("date") || has("datetime") => 4,
        _ => return None,
    };
    Some((rank, declared))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str) -> Option<(Kind, usize)> {
        sample(name).map(|named| (named.kind, named.axis))
    }

    #[test]
    fn names_that_programs_give_their_columns_are_known() {
        for (name, wanted) in [
            ("accX", (Kind::Acceleration, 0)),
            ("aY", (Kind::Acceleration, 1)),
            ("gZ", (Kind::TurnRate, 2)),
            ("ax", (Kind::Acceleration, 0)),
            ("AcX", (Kind::Acceleration, 0)),
            ("GyZ", (Kind::TurnRate, 2)),
            ("mz", (Kind::Field, 2)),
            ("gFx", (Kind::GForce, 0)),
            ("wx", (Kind::TurnRate, 0)),
            ("Bz", (Kind::Field, 2)),
            ("Acceleration x (m/s^2)", (Kind::Acceleration, 0)),
            ("Linear Acceleration z (m/s^2)", (Kind::Linear, 2)),
            ("Gyroscope y (rad/s)", (Kind::TurnRate, 1)),
            ("ACCELEROMETER X (m/s²)", (Kind::Acceleration, 0)),
            ("GYROSCOPE Z (rad/s)", (Kind::TurnRate, 2)),
            ("MAGNETIC FIELD Y (μT)", (Kind::Field, 1)),
            ("accelerometerAccelerationX(G)", (Kind::Acceleration, 0)),
            ("gyroRotationZ(rad/s)", (Kind::TurnRate, 2)),
            ("motionUserAccelerationY(G)", (Kind::Linear, 1)),
            ("userAcceleration.x", (Kind::Linear, 0)),
            ("gravity.y", (Kind::Gravity, 1)),
            ("rotationRate.z", (Kind::TurnRate, 2)),
            ("Shimmer_5E3A_Accel_LN_X_CAL", (Kind::Acceleration, 0)),
            ("linear_acceleration.x", (Kind::Linear, 0)),
            ("angular_velocity.z", (Kind::TurnRate, 2)),
            ("x-axis (g)", (Kind::Acceleration, 0)),
            ("z-axis (deg/s)", (Kind::TurnRate, 2)),
            ("y", (Kind::Bare, 1)),
        ] {
            assert_eq!(kind(name), Some(wanted), "{name}");
        }
        for name in [
            "timestamp",
            "label",
            "accuracy",
            "motionYaw(rad)",
            "attitude.roll",
            "quaternion_x",
            "index",
            "Absolute acceleration (m/s^2)",
            "orientation.z",
            "temperature",
            "TgF",
        ] {
            assert_eq!(kind(name), None, "{name}");
        }
    }

    #[test]
    fn units_are_read_from_names_and_some_names_have_usual_ones() {
        let factor = |name: &str| sample(name).and_then(|named| named.factor);
        assert_eq!(factor("accX"), None);
        assert_eq!(factor("accelerometerAccelerationX(G)"), Some(G));
        assert_eq!(factor("Acceleration x (m/s^2)"), Some(1.0));
        assert_eq!(factor("Accel_X [m/(s^2)]"), Some(1.0));
        assert_eq!(factor("acc_x_g"), Some(G));
        assert_eq!(factor("gyro_x_dps"), Some(1.0));
        assert_eq!(sample("wx").unwrap().usual, Some(180.0 / std::f64::consts::PI));
        assert_eq!(sample("gFx").unwrap().usual, Some(G));
    }

    #[test]
    fn times_are_known_with_their_units() {
        assert_eq!(time("timestamp_ms"), Some((0, Some(1.0))));
        assert_eq!(time("timestamp"), Some((0, None)));
        assert_eq!(time("Time (s)"), Some((1, Some(1000.0))));
        assert_eq!(time("seconds_elapsed"), Some((0, Some(1000.0))));
        assert_eq!(time("Time since start in ms"), Some((2, Some(1.0))));
        assert_eq!(time("accelerometerTimestamp_sinceReboot(s)"), Some((2, Some(1000.0))));
        assert_eq!(time("loggingTime(txt)"), Some((2, None)));
        assert_eq!((time("accX"), time("label")), (None, None));
    }
}
