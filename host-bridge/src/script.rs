//! `session.toml`: describes a recorded session and its expected result.

use serde::{Deserialize, Serialize};
use shared_dsp::left::calibration::Calibration;

use host_core::session::Summary;

/// A recorded session.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// A one-line title for the user.
    pub title: String,
    /// The calibration in the left hand's EEPROM.
    pub calibration: CalibrationTable,
    /// The parts of the bundled recordings that form this session; `None` means the complete recordings.
    #[serde(default)]
    pub cuts: Option<Cuts>,
    /// The expected result.
    pub expect: Expect,
}

/// Parts of the bundled recordings in sequence, each with its start and end in s.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cuts {
    /// Parts of the left hand's recording.
    pub left: Vec<[f64; 2]>,
    /// Parts of the right hand's recording.
    pub right: Vec<[f64; 2]>,
}

/// The left hand's calibration. Each value is the sum of eight 10-bit conversions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationTable {
    /// Sums for x, y and z at 0 g.
    pub zero: [i16; 3],
    /// Sums for straight index and middle fingers.
    pub rest: [u16; 2],
    /// Sums for bent index and middle fingers.
    pub bend: [u16; 2],
}

impl From<CalibrationTable> for Calibration {
    fn from(table: CalibrationTable) -> Self {
        Calibration { zero: table.zero, rest: table.rest, bend: table.bend }
    }
}

/// The result that a session must have.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// Labels of all gesture events in order, including the one that releases the stop.
    pub gestures: Vec<String>,
    /// Names of the arm motions that reach their pose, in order.
    pub poses: Vec<String>,
    /// Number of the operator's stops, each of which is released.
    pub stops: u32,
    /// Final value of both caps in m/s and rad/s, within 0.001.
    pub cap: f64,
    /// The expected final pose of the base.
    pub base: BaseGoal,
    /// Final positions of objects in the scene.
    #[serde(default, rename = "object")]
    pub objects: Vec<ObjectPlace>,
}

/// The expected place of an object, with a tolerance.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectPlace {
    /// Name of the object in the scene.
    pub name: String,
    /// Centre of the object's bottom face.
    pub at_m: [f64; 3],
    /// Tolerance.
    pub within_m: f64,
}

/// Final pose of the base, with a tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseGoal {
    /// Distance in front of the start.
    pub x_m: f64,
    /// Distance to the left of the start.
    pub y_m: f64,
    /// Rotation to the left in rad, not wrapped.
    pub heading_rad: f64,
    /// Tolerance of the position.
    pub within_m: f64,
    /// Tolerance of the heading.
    pub within_rad: f64,
}

/// One difference from an expected value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Name of the value.
    pub what: &'static str,
    /// The value that the script expects.
    pub expected: String,
    /// The actual value.
    pub got: String,
    /// Whether the result is as expected.
    pub ok: bool,
}

/// The text does not describe a valid session; the message contains the place and the reason.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ScriptError(#[from] toml::de::Error);

impl Script {
    /// Reads the text of a `session.toml`.
    ///
    /// # Errors
    /// Returns [`ScriptError`] with line and column.
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        Ok(toml::from_str(text)?)
    }
}

impl CalibrationTable {
    /// Reads a file with `zero`, `rest` and `bend`, as in a session's `[calibration]`.
    ///
    /// # Errors
    /// Returns [`ScriptError`] with line and column.
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        Ok(toml::from_str(text)?)
    }
}

impl Expect {
    /// Compares the expected result with the actual one.
    pub fn check(&self, summary: &Summary) -> Vec<Check> {
        let list = |names: &[String]| names.join(", ");
        let check = |what, expected: String, got: String| {
            let ok = expected == got;
            Check { what, expected, got, ok }
        };
        let labels: Vec<String> = summary.gestures.iter().map(|g| g.label.clone()).collect();
        let poses: Vec<String> = summary.poses_reached.iter().map(|p| p.motion.as_str().to_owned()).collect();
        let here = summary.odometry;
        let off_m = (here.x_m - self.base.x_m).hypot(here.y_m - self.base.y_m);
        let off_rad = (here.heading_rad - self.base.heading_rad).abs();
        let place = |x_m: f64, y_m: f64, heading_rad: f64| {
            format!("x {x_m:.3} m, y {y_m:.3} m, {:.1}°", heading_rad.to_degrees())
        };
        let objects = self.objects.iter().map(|object| {
            let here = summary.objects.iter().find(|other| other.name == object.name);
            let at = |[x, y, z]: [f64; 3]| format!("{} at x {x:.2} m, y {y:.2} m, z {z:.2} m", object.name);
            let off_m = here.map(|here| here.pose.position_m.distance(object.at_m.into()));
            Check {
                what: "object",
                expected: format!("{} (within {} m)", at(object.at_m), object.within_m),
                got: here.map_or("is not there".to_owned(), |here| at(here.pose.position_m.to_array())),
                ok: off_m.is_some_and(|off_m| off_m <= object.within_m),
            }
        });
        let mut checks = vec![
            check("gestures", list(&self.gestures), list(&labels)),
            check("poses reached", list(&self.poses), list(&poses)),
            check("stops", self.stops.to_string(), summary.stops.to_string()),
            check("releases", self.stops.to_string(), summary.releases.to_string()),
            Check {
                what: "cap",
                expected: format!("{:.3}", self.cap),
                got: format!("{:.3}", summary.caps.linear_m_s),
                ok: (summary.caps.linear_m_s - self.cap).abs() <= 0.001,
            },
            Check {
                what: "base",
                expected: format!(
                    "{} (within {} m and {:.0}°)",
                    place(self.base.x_m, self.base.y_m, self.base.heading_rad),
                    self.base.within_m,
                    self.base.within_rad.to_degrees()
                ),
                got: place(here.x_m, here.y_m, here.heading_rad),
                ok: off_m <= self.base.within_m && off_rad <= self.base.within_rad,
            },
            check("at rest at the end", true.to_string(), summary.at_rest.to_string()),
        ];
        checks.extend(objects);
        checks
    }
}
