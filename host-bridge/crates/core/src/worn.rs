//! How a right hand's board is worn, determined from three poses of the hand: level, tilted forward, and tilted left.
//!
//! The third pose only confirms the second one.
//! Otherwise, a hand that tilted backward instead of forward would drive the base the wrong way.

use shared_dsp::left::tilt::{Acceleration, Tilt as Angles};

use shared_proto::message::Sensor;

use crate::one_handed::{Axis, GRAVITY_MM_S2, NEUTRAL_MAX_MRAD, OneHanded};

/// A tilt below this angle is hardly intended.
const LITTLE_DEG: f64 = 15.0;
/// A tilt beyond this angle is no longer a tilt in one direction.
const FAR_DEG: f64 = 65.0;
/// Maximum angle between the direction of a tilt and an axis of the board.
const ASKEW_DEG: f64 = 30.0;

/// The reason why a pose does not show how the board is worn, with a remedy.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// The board was accelerated.
    #[error("the board felt {0:.2} g instead of gravity; hold the hand still")]
    NoGravity(f64),
    /// No axis of the board points up in the level pose.
    #[error(
        "no axis of the board points up; the nearest one is {0:.0}° off (30° at most); hold the hand level, or turn the board \
         so that it lies flat or on one edge"
    )]
    Steep(f64),
    /// The hand was hardly tilted, or too far.
    #[error("the hand is tilted by {0:.0}° from the level pose; tilt it by 20° to 45°")]
    Amount(f64),
    /// The hand was tilted in a direction between two axes of the board.
    #[error(
        "the direction of the tilt is {0:.0}° off the nearest axis of the board (30° at most); tilt straight, or turn the board \
         so that one edge points to the fingers"
    )]
    Askew(f64),
    /// The two tilts contradict each other.
    #[error(
        "this tilt is to the right, if the one before was forward; run calibrate again, and tilt the fingers down first, and \
         then the left edge of the hand"
    )]
    Mirrored,
    /// Both tilts were about the same axis.
    #[error(
        "this tilt is in the same direction as the one before, or against it; lower the left edge of the hand"
    )]
    SameAxis,
}

impl PoseError {
    /// Returns whether this pose contradicts the one before, so that either may be wrong.
    pub fn is_contradiction(&self) -> bool {
        matches!(self, Self::Mirrored | Self::SameAxis)
    }
}

/// Whether the axes that a board sends form a right-handed or a left-handed frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handedness {
    /// As usual: forward, left and up.
    Right,
    /// The mirror image.
    Left,
}

impl Handedness {
    /// Returns the handedness of the axes that a board with this sensor sends.
    /// Boards send the raw axes of an LSM9DS1, which are left-handed (DocID025715 Rev 2, figure 1).
    /// The driver of the BMI270 converts to the same axes. Those of the LSM6DS3TR-C are right-handed (DocID030071).
    pub fn of(sensor: Sensor) -> Self {
        match sensor {
            Sensor::Lsm9ds1 | Sensor::Bmi270 => Self::Left,
            _ => Self::Right,
        }
    }
}

/// The board in the level pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    mean: [f64; 3],
    up: Axis,
}

/// The angle between two directions, in degrees.
fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()).clamp(-1.0, 1.0).acos().to_degrees()
}

fn gravity(mean_mm_s2: [f64; 3]) -> Result<[f64; 3], PoseError> {
    let size = mean_mm_s2.iter().map(|a| a * a).sum::<f64>().sqrt();
    // This is also false for NaN.
    let is_gravity = GRAVITY_MM_S2.contains(&size);
    if is_gravity { Ok(mean_mm_s2.map(|a| a / size)) } else { Err(PoseError::NoGravity(size / 9806.65)) }
}

impl Level {
    /// Determines the axis that points up from the mean acceleration of the level hand, in mm/s².
    ///
    /// # Errors
    /// Returns [`PoseError`] if no axis points up within 30°.
    pub fn of(mean_mm_s2: [f64; 3]) -> Result<Self, PoseError> {
        let mean = gravity(mean_mm_s2)?;
        let up = Axis::nearest(mean);
        let off_deg = angle_deg(mean, up.direction());
        if off_deg > (0.001 * f64::from(NEUTRAL_MAX_MRAD)).to_degrees() {
            return Err(PoseError::Steep(off_deg));
        }
        Ok(Level { mean, up })
    }

    /// Returns the axis that a tilted hand lowers, from its mean acceleration in mm/s².
    fn lowered(&self, mean_mm_s2: [f64; 3]) -> Result<Axis, PoseError> {
        let mean = gravity(mean_mm_s2)?;
        let by_deg = angle_deg(self.mean, mean);
        if !(LITTLE_DEG..=FAR_DEG).contains(&by_deg) {
            return Err(PoseError::Amount(by_deg));
        }
        // An axis that is lowered reads less.
        let (up, _) = self.up.parts();
        let lower = std::array::from_fn(|i| if i == up { 0.0 } else { self.mean[i] - mean[i] });
        let axis = Axis::nearest(lower);
        let off_deg = angle_deg(lower, axis.direction());
        if off_deg > ASKEW_DEG { Err(PoseError::Askew(off_deg)) } else { Ok(axis) }
    }

    /// Determines how the board is worn from the mean acceleration of the hand whose fingers point down, in mm/s².
    /// The rules keep their choice of the mode. The axis to the left follows from the handedness of the board's axes.
    ///
    /// # Errors
    /// Returns [`PoseError`] if the tilt is too small, too large, or not along an axis.
    pub fn forward(
        &self,
        rules: OneHanded,
        axes: Handedness,
        mean_mm_s2: [f64; 3],
    ) -> Result<OneHanded, PoseError> {
        let forward = self.lowered(mean_mm_s2)?;
        let ([ux, uy, uz], [fx, fy, fz]) = (self.up.direction(), forward.direction());
        let cross = [uy * fz - uz * fy, uz * fx - ux * fz, ux * fy - uy * fx];
        let left = Axis::nearest(match axes {
            Handedness::Right => cross,
            Handedness::Left => cross.map(|part| -part),
        });
        let along = |axis: Axis| {
            (1000.0 * axis.direction().iter().zip(self.mean).map(|(d, m)| d * m).sum::<f64>()) as i16
        };
        // See `TiltHand`: the code of the left hand has x to the wrist and y to the right.
        let neutral = Angles::of(Acceleration { x: -along(forward), y: -along(left), z: along(self.up) });
        let (neutral_pitch_mrad, neutral_roll_mrad) = (neutral.pitch_mrad, neutral.roll_mrad);
        Ok(OneHanded { forward, left, up: self.up, neutral_pitch_mrad, neutral_roll_mrad, ..rules })
    }

    /// Checks these rules against the mean acceleration of the hand whose left edge points down, in mm/s².
    ///
    /// # Errors
    /// Returns [`PoseError`] if the tilt is unclear, or not to the left.
    pub fn check_left(&self, rules: &OneHanded, mean_mm_s2: [f64; 3]) -> Result<(), PoseError> {
        let lowered = self.lowered(mean_mm_s2)?;
        match (lowered == rules.left, lowered.parts().0 == rules.left.parts().0) {
            (true, _) => Ok(()),
            (false, true) => Err(PoseError::Mirrored),
            (false, false) => Err(PoseError::SameAxis),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The acceleration along forward, left and up at this pitch and roll.
    fn tilted(pitch_deg: f64, roll_deg: f64) -> [f64; 3] {
        let (pitch, roll) = (pitch_deg.to_radians(), roll_deg.to_radians());
        [-pitch.sin(), -pitch.cos() * roll.sin(), pitch.cos() * roll.cos()].map(|a| 9806.65 * a)
    }

    /// The reading of a board that is worn by these rules.
    fn read(worn: &OneHanded, [forward, left, up]: [f64; 3]) -> [f64; 3] {
        let parts = [(worn.forward, forward), (worn.left, left), (worn.up, up)];
        std::array::from_fn(|i| parts.iter().map(|(axis, value)| axis.direction()[i] * value).sum())
    }

    #[test]
    fn a_board_that_is_worn_any_way_round_is_recognised_from_three_poses() {
        let axes = [Axis::PlusX, Axis::MinusX, Axis::PlusY, Axis::MinusY, Axis::PlusZ, Axis::MinusZ];
        let mut ways = 0;
        for (up, handed) in axes.into_iter().flat_map(|up| [(up, Handedness::Right), (up, Handedness::Left)])
        {
            for forward in axes.into_iter().filter(|axis| axis.parts().0 != up.parts().0) {
                let ([ux, uy, uz], [fx, fy, fz]) = (up.direction(), forward.direction());
                let sign = if handed == Handedness::Right { 1.0 } else { -1.0 };
                let cross = [uy * fz - uz * fy, uz * fx - ux * fz, ux * fy - uy * fx];
                let left = Axis::nearest(cross.map(|part| sign * part));
                let worn = OneHanded { forward, left, up, ..OneHanded::OFF };
                for (pitch, roll) in [(0.0, 0.0), (12.0, -8.0), (-15.0, 10.0)] {
                    let level = Level::of(read(&worn, tilted(pitch, roll))).unwrap();
                    let lowered = read(&worn, tilted(pitch + 30.0, roll));
                    let found = level.forward(OneHanded::OFF, handed, lowered).unwrap();
                    level.check_left(&found, read(&worn, tilted(pitch, roll + 30.0))).unwrap();
                    assert_eq!((found.forward, found.left, found.up), (forward, left, up));
                    assert!(found.is_sound());
                    assert!((f64::from(found.neutral_pitch_mrad) - pitch.to_radians() * 1000.0).abs() < 3.0);
                    assert!((f64::from(found.neutral_roll_mrad) - roll.to_radians() * 1000.0).abs() < 8.0);
                    ways += 1;
                }
            }
        }
        assert_eq!(ways, 2 * 24 * 3);
    }

    #[test]
    fn unclear_poses_are_refused() {
        let steep = |pitch, roll| matches!(Level::of(tilted(pitch, roll)), Err(PoseError::Steep(_)));
        assert!(steep(40.0, 0.0) && steep(0.0, -44.0) && steep(35.0, 35.0));
        for wrong in [[0.0; 3], [0.0, 0.0, 5000.0], [0.0, 0.0, 20_000.0], [f64::NAN; 3]] {
            assert!(matches!(Level::of(wrong), Err(PoseError::NoGravity(_))));
        }
        let level = Level::of(tilted(0.0, 0.0)).unwrap();
        let forward = |pitch, roll| level.forward(OneHanded::OFF, Handedness::Right, tilted(pitch, roll));
        assert!(matches!(forward(10.0, 0.0), Err(PoseError::Amount(deg)) if (deg - 10.0).abs() < 0.1));
        assert!(matches!(forward(80.0, 0.0), Err(PoseError::Amount(_))));
        assert!(matches!(forward(25.0, 25.0), Err(PoseError::Askew(_))));
        assert!(matches!(
            level.forward(OneHanded::OFF, Handedness::Right, [0.0; 3]),
            Err(PoseError::NoGravity(_))
        ));
        let rules = forward(30.0, 0.0).unwrap();
        let left = |pitch, roll| level.check_left(&rules, tilted(pitch, roll));
        assert_eq!(left(0.0, -30.0), Err(PoseError::Mirrored));
        assert_eq!(left(30.0, 0.0), Err(PoseError::SameAxis));
        assert!(matches!(left(0.0, 5.0), Err(PoseError::Amount(_))));
    }

    #[test]
    fn a_hand_that_tilted_backward_instead_of_forward_is_found_out_by_its_tilt_to_the_left() {
        let level = Level::of(tilted(0.0, 0.0)).unwrap();
        let rules = level.forward(OneHanded::OFF, Handedness::Right, tilted(-30.0, 0.0)).unwrap();
        assert_eq!(rules.forward, Axis::MinusX);
        assert_eq!(level.check_left(&rules, tilted(0.0, 30.0)), Err(PoseError::Mirrored));
    }

    #[test]
    fn the_arduino_boards_send_left_handed_axes() {
        // The x axis of the chip points to the wrist, y to the left, and z up.
        let chip = |[forward, left, up]: [f64; 3]| [-forward, left, up];
        let level = Level::of(chip(tilted(0.0, 0.0))).unwrap();
        for sensor in [Sensor::Lsm9ds1, Sensor::Bmi270] {
            let axes = Handedness::of(sensor);
            let rules = level.forward(OneHanded::OFF, axes, chip(tilted(30.0, 0.0))).unwrap();
            assert_eq!((rules.forward, rules.left, rules.up), (Axis::MinusX, Axis::PlusY, Axis::PlusZ));
            level.check_left(&rules, chip(tilted(0.0, 30.0))).unwrap();
        }
        assert_eq!(Handedness::of(Sensor::Lsm6ds3), Handedness::Right);
    }
}
