//! Joint values and frames.

use serde::Serialize;

/// Most joints that an arm may have. An arm with fewer leaves the last values at zero.
pub const JOINTS: usize = 7;

/// One value per joint, from the foot on: rad, rad/s, rad/s² or rad/s³ as the name says.
pub type Joints = [f64; JOINTS];

/// Position and orientation of a frame in the base frame of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pose {
    /// x forward, y left, z up, in metres.
    pub position_m: [f64; 3],
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
}

impl Pose {
    /// The frame itself.
    pub const IDENTITY: Pose =
        Pose { position_m: [0.0; 3], rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// Moves along, and turns about, the frame's own axes.
    pub fn then(&self, step_m: [f64; 3], turn: [[f64; 3]; 3]) -> Pose {
        let mut next = Pose { position_m: self.position_m, rotation: [[0.0; 3]; 3] };
        for row in 0..3 {
            for col in 0..3 {
                next.position_m[row] += self.rotation[row][col] * step_m[col];
                next.rotation[row][col] = (0..3).map(|k| self.rotation[row][k] * turn[k][col]).sum();
            }
        }
        next
    }

    /// The orientation as a unit quaternion w, x, y, z with w ≥ 0.
    pub fn quaternion_wxyz(&self) -> [f64; 4] {
        let r = &self.rotation;
        // Shepperd's method: start from the largest component, so that nothing divides by almost zero.
        let trace = r[0][0] + r[1][1] + r[2][2];
        let q = if trace > 0.0 {
            let s = 2.0 * (1.0 + trace).sqrt();
            [s / 4.0, (r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s]
        } else if r[0][0] >= r[1][1] && r[0][0] >= r[2][2] {
            let s = 2.0 * (1.0 + r[0][0] - r[1][1] - r[2][2]).sqrt();
            [(r[2][1] - r[1][2]) / s, s / 4.0, (r[0][1] + r[1][0]) / s, (r[0][2] + r[2][0]) / s]
        } else if r[1][1] >= r[2][2] {
            let s = 2.0 * (1.0 + r[1][1] - r[0][0] - r[2][2]).sqrt();
            [(r[0][2] - r[2][0]) / s, (r[0][1] + r[1][0]) / s, s / 4.0, (r[1][2] + r[2][1]) / s]
        } else {
            let s = 2.0 * (1.0 + r[2][2] - r[0][0] - r[1][1]).sqrt();
            [(r[1][0] - r[0][1]) / s, (r[0][2] + r[2][0]) / s, (r[1][2] + r[2][1]) / s, s / 4.0]
        };
        if q[0] < 0.0 { q.map(|c| -c) } else { q }
    }
}
