//! Determines the factors that convert to our units, from the user's options, the file's declarations and the samples.

use super::judge::{self, Verdict};
use super::layout::Source;
use super::names;
use crate::sheet::{Reading, Sensor};

/// Factor of acceleration to m/s².
pub(super) fn acceleration_factor(
    source: &Source,
    reading: &Reading,
    judge: &dyn Fn(f64) -> Verdict,
    notes: &mut Vec<String>,
) -> Result<f64, String> {
    let told = reading.units.of(Sensor::Acceleration);
    let declared = told.or(source.factor);
    let expected = declared.or(source.usual).unwrap_or(1.0);
    let verdict = judge(expected);
    let whose = match (told, source.factor) {
        (Some(_), _) => "as --units has it, ",
        (None, Some(_)) => "in the unit that the file declares, ",
        (None, None) => "",
    };
    match verdict {
        Verdict::Unknown => return Ok(expected),
        Verdict::MetresPerS2 => {
            if source.linear {
                notes.push("columns of linear acceleration have gravity in them, and are used".to_owned());
            }
            if declared.is_none() && source.usual.is_some() {
                notes.push("the accelerometer is in g, by its columns' names and by gravity".to_owned());
            }
            return Ok(expected);
        }
        // Violent movement hides gravity, so the user must decide.
        Verdict::NoGravity(typical)
            if told.is_some()
                && (judge::LIGHTEST..judge::HEAVIEST).contains(&(typical / names::G as f32)) =>
        {
            notes.push("gravity is hard to see in the accelerometer's samples".to_owned());
            return Ok(expected);
        }
        Verdict::NoGravity(typical) => {
            return Err(format!(
                "{whose}there is no gravity in the accelerometer's samples (typically {typical:.2}, in m/s² a hand has about \
                 9.8): linear acceleration cannot be used; record the accelerometer itself"
            ));
        }
        // The sensor is not calibrated, but the user has declared its units.
        Verdict::Odd(_) if told.is_some() => return Ok(expected),
        Verdict::Odd(gravity) => {
            return Err(format!(
                "{whose}gravity at rest is {gravity:.1}, which is neither g nor m/s²: are these raw counts? Say what they are \
                 with --units, for example --units 16384/g"
            ));
        }
        Verdict::G | Verdict::MilliG => {}
    }
    let name = if verdict == Verdict::G { "g" } else { "mg" };
    let factor = verdict.factor().unwrap_or(1.0) * expected;
    if declared.is_some() {
        return Err(format!(
            "{whose}gravity at rest is {} m/s², where 9.8 is right: is this in {name}? Say so with --units {name}",
            if verdict == Verdict::G { "about 1" } else { "about 1000" }
        ));
    }
    if !reading.guess {
        return Err(format!(
            "gravity at rest is {} m/s², where 9.8 is right: is this in {name}? Say so with --units {name}, in \
             `models import` or where recordings are played",
            if verdict == Verdict::G { "about 0.98" } else { "about 980" }
        ));
    }
    notes.push(format!("the accelerometer is in {name}, by gravity"));
    Ok(factor)
}

/// Returns the factor that converts turn rates to deg/s, or the field to µT.
/// `judge` returns whether the samples (times a factor) are in the other unit, rad/s or gauss.
pub(super) fn other_factor(
    sensor: Sensor,
    source: &Source,
    reading: &Reading,
    judge: impl Fn(f64) -> Option<bool>,
    notes: &mut Vec<String>,
) -> Result<f64, String> {
    let (ours, theirs) = if sensor == Sensor::TurnRate { ("deg/s", "rad/s") } else { ("uT", "gauss") };
    if let Some(told) = reading.units.of(sensor) {
        return Ok(told);
    }
    let is_other = judge(source.factor.unwrap_or(1.0));
    let other = names::factor(sensor, theirs).unwrap_or(1.0);
    match (source.factor, is_other) {
        (Some(1.0), Some(true)) => Err(format!(
            "the file says that {sensor} is in {ours}, but its samples look like {theirs}; say which with --units {theirs} or \
             --units {ours}"
        )),
        (Some(factor), _) => Ok(factor),
        (None, None) => {
            if let Some(usual) = source.usual {
                notes.push(format!("{sensor} is taken to be in {theirs}, by its columns' names"));
                return Ok(usual);
            }
            Ok(1.0)
        }
        (None, Some(false)) => {
            if source.usual.is_some() {
                notes.push(format!("{sensor} is in {ours}, by how much it shows, although such columns usually are in {theirs}"));
            }
            Ok(1.0)
        }
        (None, Some(true)) if reading.guess || source.usual.is_some() => {
            notes.push(format!("{sensor} is in {theirs}, by how much it shows"));
            Ok(other)
        }
        (None, Some(true)) => Err(format!(
            "{sensor} shows very little for so much movement: is it in {theirs}? Say so with --units {theirs}, or with --units \
             {ours} if not, in `models import` or where recordings are played"
        )),
    }
}
