//! The bundled session: recorded hands, and what they must come to, written down with them.

use std::path::Path;

use models::recording::Recording;

use host_core::intent::MotionMap;
use host_core::session::Session;
use host_core::source::Source;
use host_links::adc::AdcRecording;
use host_links::hands::{LeftBoard, ModelFile, ModelFileError, RightBoard, Wired};
use host_robot::Door;

use crate::script::Script;

const SCRIPT: &str = include_str!("../sessions/demo/session.toml");
const LEFT: &[u8] = include_bytes!("../sessions/demo/left.csv");
const RIGHT: &[u8] = include_bytes!("../sessions/demo/right.csv");

/// Both hands' recordings and their script. The hands are simulated wearers.
pub struct Demo {
    /// The left hand's converter at 100 Hz.
    pub left: AdcRecording,
    /// The right hand's sensor.
    pub right: Recording,
    /// Calibration of the left hand, and what must come out.
    pub script: Script,
}

impl Demo {
    /// The one inside this program.
    ///
    /// # Panics
    /// Never: the files are compiled in, and the tests read them.
    pub fn bundled() -> Self {
        let read = "the bundled session is whole";
        Demo {
            left: AdcRecording::parse(Path::new("sessions/demo/left.csv"), LEFT).expect(read),
            right: Recording::parse(Path::new("sessions/demo/right.csv"), RIGHT).expect(read),
            script: Script::parse(SCRIPT).expect(read),
        }
    }

    /// Both hands before this robot, at their beginning.
    ///
    /// # Errors
    /// [`ModelFileError`] if the model is for other axes.
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
