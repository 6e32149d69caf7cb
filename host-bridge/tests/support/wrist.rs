//! A simulated hand that a test tilts while its wearer rests or draws.
#![allow(dead_code)] // each test file uses its own part

use std::ops::Range;

/// The hand turns by at most this much per sample, which is 150°/s.
const TURN_DEG: f64 = 1.5;

/// Rows of a wearer's recording at 100 Hz, with nine axes.
pub type Rows = Vec<[f64; 9]>;

/// The hand of a recorded wearer: it rests, or draws what the test selects, and is tilted as the test asks.
pub struct Wrist {
    rows: Rows,
    /// Rows in which the wearer rests. They are played to their end and then backwards, so that there is no jump.
    rest: Range<usize>,
    /// The next row of a gesture, and its end.
    pub drawing: Option<Range<usize>>,
    turning: Turning,
    next: usize,
}

impl Wrist {
    pub fn new(rows: Rows, rest: Range<usize>) -> Self {
        Wrist { rows, rest, drawing: None, turning: Turning::default(), next: 0 }
    }

    /// Turns the hand to this pitch (positive = forward) and this roll (positive = left).
    pub fn tilt(&mut self, pitch_deg: f64, roll_deg: f64) {
        self.turning.to_deg = [pitch_deg, roll_deg];
    }

    /// Returns the sample of the next 10 ms.
    pub fn sample(&mut self) -> [f64; 9] {
        let back = 2 * self.rest.len() - 2;
        let place = self.next % back;
        let mut row = self.rest.start + place.min(back - place);
        self.next += 1;
        if let Some(Range { start, end }) = self.drawing.take() {
            row = start;
            self.drawing = (start + 1 < end).then_some(start + 1..end);
        }
        self.turning.step(self.rows[row])
    }
}

/// A hand that turns to a pitch and a roll.
#[derive(Default)]
pub struct Turning {
    /// The pitch and the roll to which the hand turns, in degrees.
    pub to_deg: [f64; 2],
    now_deg: [f64; 2],
}

impl Turning {
    /// Turns the sample of the next 10 ms.
    pub fn step(&mut self, values: [f64; 9]) -> [f64; 9] {
        let turned: [f64; 2] =
            std::array::from_fn(|i| (self.to_deg[i] - self.now_deg[i]).clamp(-TURN_DEG, TURN_DEG));
        self.now_deg = std::array::from_fn(|i| self.now_deg[i] + turned[i]);
        let mut values = tilted(values, self.now_deg);
        // Degrees per sample of 10 ms to degrees per second, about the axes forward and left.
        values[3] -= 100.0 * turned[1];
        values[4] += 100.0 * turned[0];
        values
    }
}

/// Turns all three sensors of a row by this pitch and roll.
pub fn tilted(mut values: [f64; 9], [pitch_deg, roll_deg]: [f64; 2]) -> [f64; 9] {
    let [(pitch_sin, pitch_cos), (roll_sin, roll_cos)] =
        [pitch_deg, roll_deg].map(|deg| deg.to_radians().sin_cos());
    for sensor in values.chunks_exact_mut(3) {
        let [x, y, z] = [sensor[0], sensor[1], sensor[2]];
        let (x, z) = (x * pitch_cos - z * pitch_sin, x * pitch_sin + z * pitch_cos);
        let (y, z) = (y * roll_cos - z * roll_sin, y * roll_sin + z * roll_cos);
        sensor.copy_from_slice(&[x, y, z]);
    }
    values
}

/// Returns the mean acceleration of these rows in mm/s².
pub fn mean_mm_s2(rows: &[[f64; 9]]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        1000.0 * rows.iter().map(|row| row[axis]).sum::<f64>() / rows.len().max(1) as f64
    })
}
