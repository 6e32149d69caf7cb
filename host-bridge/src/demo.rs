//! The bundled sessions: recorded hands together with the expected result.
//! The second session consists of parts of the first.

use std::path::Path;

use models::recording::Recording;

use host_core::intent::MotionMap;
use host_core::session::Session;
use host_core::source::Source;
use host_links::hands::{LeftBoard, ModelFile, ModelFileError, RightBoard, Wired};
use host_robot::Door;
use models::adc::AdcRecording;

use crate::script::Script;

const SCRIPT: &str = include_str!("../sessions/demo/session.toml");
const PICK_AND_PLACE: &str = include_str!("../sessions/pick-and-place/session.toml");
const LEFT: &[u8] = include_bytes!("../sessions/demo/left.csv");
const RIGHT: &[u8] = include_bytes!("../sessions/demo/right.csv");

/// The demo's script, and the recordings of two simulated hands.
pub struct Demo {
    /// The left hand's converter at 100 Hz.
    pub left: AdcRecording,
    /// The right hand's sensor.
    pub right: Recording,
    /// Calibration of the left hand, and the expected result.
    pub script: Script,
}

impl Demo {
    /// Returns the script inside this program.
    ///
    /// # Panics
    /// This never fails, because the compiled-in files are tested.
    pub fn bundled() -> Self {
        let read = "the bundled session is whole";
        Demo {
            left: AdcRecording::parse(Path::new("sessions/demo/left.csv"), LEFT).expect(read),
            right: Recording::parse(Path::new("sessions/demo/right.csv"), RIGHT).expect(read),
            script: Script::parse(SCRIPT).expect(read),
        }
    }

    /// Returns the bundled session with this name; `None` selects the paper's six motions.
    ///
    /// # Errors
    /// Fails if there is no such session. The error lists all sessions.
    ///
    /// # Panics
    /// This never fails, because the compiled-in files are tested.
    pub fn named(name: Option<&str>) -> Result<Self, String> {
        let demo = Demo::bundled();
        let script = match name {
            None => return Ok(demo),
            Some("pick-and-place") => Script::parse(PICK_AND_PLACE).expect("the bundled session is whole"),
            Some(other) => {
                return Err(format!("there is no bundled session '{other}'; there is: pick-and-place"));
            }
        };
        let Some(cuts) = &script.cuts else { return Ok(Demo { script, ..demo }) };
        let samples = demo.left.samples;
        let left = cut(&cuts.left, samples.len(), |i| samples[i].0 as f64);
        let left = left.into_iter().map(|(time_ms, i)| (time_ms as u64, samples[i].1)).collect();
        let axes = demo.right.axes();
        let values: Vec<&[f32]> = demo.right.samples().collect();
        let right = cut(&cuts.right, values.len(), |i| demo.right.time_ms()[i]);
        let (time_ms, places): (Vec<f64>, Vec<usize>) = right.into_iter().unzip();
        let right = places.iter().flat_map(|&i| values[i]).copied().collect();
        Ok(Demo { left: AdcRecording { samples: left }, right: Recording::new(axes, time_ms, right), script })
    }

    /// Returns a session of both hands with this robot, at its start.
    ///
    /// # Errors
    /// Returns [`ModelFileError`] if the model needs other axes.
    pub fn session<D: Door>(
        self,
        model: &ModelFile,
        map: MotionMap,
        door: D,
    ) -> Result<Session<'_, D>, ModelFileError> {
        let left = LeftBoard::new(self.left, Some(self.script.calibration.into()), 1);
        let right = RightBoard::new(self.right.resampled(), model, 1)?;
        Ok(Session::new([Source::here(Wired::new(left)), Source::here(Wired::new(right))], map, door))
    }
}

/// Returns parts of a recording in sequence. Each entry has the sample's new time in ms and its index.
fn cut(stretches: &[[f64; 2]], samples: usize, time_ms: impl Fn(usize) -> f64) -> Vec<(f64, usize)> {
    let mut kept = Vec::new();
    let mut at_ms = 0.0;
    for &[from_s, to_s] in stretches {
        let (from_ms, to_ms) = (1000.0 * from_s, 1000.0 * to_s);
        let within = (0..samples).filter(|&i| (from_ms..to_ms).contains(&time_ms(i)));
        kept.extend(within.map(|i| (at_ms + time_ms(i) - from_ms, i)));
        at_ms += to_ms - from_ms;
    }
    kept
}
