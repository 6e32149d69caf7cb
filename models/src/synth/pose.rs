//! Where the hand is, and how it is turned, at one time.

/// Position (m) and posture (roll, pitch, yaw in rad) at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BodyPose {
    pub position_m: [f64; 3],
    pub posture_rad: [f64; 3],
    /// Displacement of the body (m), which carries the hand without a swing of the arm.
    pub carried_m: [f64; 3],
}

impl BodyPose {
    fn each(self, other: Self, of: impl Fn(f64, f64) -> f64) -> Self {
        let all = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| of(a[axis], b[axis]));
        Self {
            position_m: all(self.position_m, other.position_m),
            posture_rad: all(self.posture_rad, other.posture_rad),
            carried_m: all(self.carried_m, other.carried_m),
        }
    }

    /// The sum of both.
    pub fn plus(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
    }

    /// All values multiplied by the same number.
    pub fn times(self, factor: f64) -> Self {
        self.each(self, |a, _| factor * a)
    }
}

/// Returns the rotation matrix (by rows) of roll about x, then pitch about y, then yaw about z.
pub(super) fn rotation([roll, pitch, yaw]: [f64; 3]) -> [[f64; 3]; 3] {
    let (sr, cr) = roll.sin_cos();
    let (sp, cp) = pitch.sin_cos();
    let (sy, cy) = yaw.sin_cos();
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}
