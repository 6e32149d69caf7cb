//! The person who wears the glove, with a body, habits, and the errors of the board's sensors.

use std::f64::consts::FRAC_PI_2;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// The purpose of a simulated wearer. Each group has different keys, so that no wearer is in two groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Group {
    /// Models learn from these.
    Training,
    /// Wearers for testing models.
    Evaluation,
    /// Wearers for the bundled demonstration. No model has learned their movements.
    Demo,
}

impl Group {
    /// First letter of the wearers' names, which is also the byte of the key that separates groups.
    pub fn letter(self) -> char {
        match self {
            Self::Training => 't',
            Self::Evaluation => 'e',
            Self::Demo => 'd',
        }
    }
}

/// One simulated person with one board. Lengths are in m, angles are in rad, and times are in s.
#[derive(Clone, Debug, PartialEq)]
pub struct Wearer {
    /// Name of the person in file names: `t0007`, `e0001`, `d0001`.
    pub name: String,
    key: [u8; 32],
    /// Peak speed of the hand in a gesture, in m/s.
    pub(super) speed_m_s: f64,
    /// Strokes (to and back) per second.
    pub(super) stroke_hz: f64,
    /// Circles per second.
    pub(super) circle_hz: f64,
    /// Rectangles per second.
    pub(super) rectangle_hz: f64,
    /// Distance from the joint about which the hand swings.
    pub(super) arm_m: f64,
    /// Rotation of the hand with the arm: with 0 the hand keeps its direction, and with 1 it rotates fully.
    pub(super) coupling: f64,
    /// Normal roll, pitch and yaw of the board relative to the direction in which the wearer looks.
    pub(super) posture_rad: [f64; 3],
    /// Tilt of the plane and direction of gestures.
    pub(super) tilt_rad: [f64; 3],
    /// Rotation of the plane of circles away from the vertical plane, about y and about z.
    pub(super) circle_rad: [f64; 2],
    /// Size of the movement perpendicular to the intended movement, relative to the intended movement.
    pub(super) slop: f64,
    /// Relative variation of size and tempo.
    pub(super) wander: f64,
    /// Fraction of the time for a rectangle's side in which the hand rests in the corner.
    pub(super) corner: f64,
    /// Ratio of height to width of shapes.
    pub(super) aspect: f64,
    /// Probability of drawing shapes clockwise.
    pub(super) clockwise: f64,
    /// Frequency of the tremor, and its size as a rotation of the hand.
    pub(super) tremor_hz: f64,
    pub(super) tremor_rad: f64,
    /// Time from rest to the full gesture and back.
    pub(super) onset_s: f64,
    /// Magnetic field of the earth at the wearer's position: strength in µT, and inclination.
    pub(super) field_ut: f64,
    pub(super) inclination_rad: f64,
    /// Sensor offsets: m/s², deg/s, µT.
    pub(super) offset: [[f64; 3]; 3],
    /// Sensor gains, 1 = exact.
    pub(super) gain: [[f64; 3]; 3],
    /// Number of IMU samples per sample of the magnetometer.
    pub(super) mag_every: usize,
}

impl Wearer {
    /// Creates a wearer for training; `seed` selects the crowd and `index` the person.
    pub fn training(seed: u64, index: u32) -> Self {
        Self::new(Group::Training, seed, index)
    }

    /// Creates a wearer for testing models. This person is never a training wearer.
    pub fn evaluation(seed: u64, index: u32) -> Self {
        Self::new(Group::Evaluation, seed, index)
    }

    /// Creates a wearer for the demonstration. This person is never a training wearer.
    pub fn demo(index: u32) -> Self {
        Self::new(Group::Demo, 0, index)
    }

    /// The wearer of a group.
    pub fn new(group: Group, seed: u64, index: u32) -> Self {
        let key = key(group, seed, index);
        let mut rng = ChaCha8Rng::from_seed(key);
        let r = &mut rng;
        Self {
            name: format!("{}{index:04}", group.letter()),
            key,
            speed_m_s: 0.9 * normal(r, 0.25, 0.45).exp(),
            stroke_hz: 1.25 * normal(r, 0.2, 0.36).exp(),
            circle_hz: 1.1 * normal(r, 0.2, 0.34).exp(),
            rectangle_hz: 0.75 * normal(r, 0.15, 0.28).exp(),
            arm_m: r.random_range(0.35..0.65),
            coupling: r.random_range(0.15..0.9),
            posture_rad: [normal(r, 0.12, 0.28), normal(r, 0.14, 0.3), normal(r, 0.12, 0.28)],
            tilt_rad: [normal(r, 0.08, 0.18), normal(r, 0.08, 0.18), normal(r, 0.1, 0.2)],
            circle_rad: [0.0; 2],
            slop: r.random_range(0.03..0.16),
            wander: r.random_range(0.05..0.22),
            corner: r.random_range(0.1..0.35),
            aspect: r.random_range(0.65..1.05),
            clockwise: if r.random_bool(0.5) { 0.8 } else { 0.2 },
            tremor_hz: r.random_range(8.0..11.5),
            tremor_rad: r.random_range(0.0003..0.0025),
            onset_s: r.random_range(0.25..0.5),
            field_ut: r.random_range(28.0..60.0),
            inclination_rad: r.random_range(0.7..1.25),
            // The LSM9DS1 data sheet gives ±90 mg and ±30 deg/s; iron on the hand adds to the magnetic field.
            // Boards subtract the turn rate at rest, so little of that offset remains.
            offset: [
                [0; 3].map(|_| normal(r, 0.25, 0.88)),
                [0; 3].map(|_| normal(r, 1.0, 4.0)),
                [0; 3].map(|_| normal(r, 8.0, 20.0)),
            ],
            gain: [0.01, 0.02, 0.03].map(|spread| [0; 3].map(|_| 1.0 + normal(r, spread, 3.0 * spread))),
            mag_every: if r.random_bool(0.6) { 5 } else { 4 },
        }
    }

    /// Returns the same person with other habits, as diverse as those of real people without instructions.
    /// The tempo is halved or doubled, circles are in any plane, and the hand swings with the arm as if from the elbow.
    #[must_use]
    pub fn untaught(mut self) -> Self {
        let r = &mut self.rng(Draws::Habits);
        for hz in [&mut self.stroke_hz, &mut self.circle_hz, &mut self.rectangle_hz] {
            *hz *= normal(r, 0.35, 0.8).exp();
        }
        self.speed_m_s *= normal(r, 0.2, 0.4).exp();
        self.circle_rad = [0; 2].map(|_| r.random_range(-FRAC_PI_2..FRAC_PI_2));
        self.coupling = r.random_range(0.15..1.4);
        self
    }

    /// Returns the random numbers of one use.
    pub(super) fn rng(&self, of: Draws) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::from_seed(self.key);
        rng.set_stream(match of {
            // 0 made the wearer.
            Draws::Take(take) => take + 1,
            Draws::Habits => u64::MAX,
        });
        rng
    }
}

/// The uses of a wearer's random numbers. Each has its own stream, like [`RandomStream`](crate::streams::RandomStream).
#[derive(Clone, Copy, Debug)]
pub(super) enum Draws {
    /// The take that has this number.
    Take(u64),
    /// Habits of a person without instructions.
    Habits,
}

/// Group, seed and index occupy adjacent bytes, so two groups can never share a key.
fn key(group: Group, seed: u64, index: u32) -> [u8; 32] {
    let mut key = [0; 32];
    key[..8].copy_from_slice(b"bimanual");
    key[8] = group.letter() as u8;
    key[16..24].copy_from_slice(&seed.to_le_bytes());
    key[24..28].copy_from_slice(&index.to_le_bytes());
    key
}

/// Returns a normal random number with mean 0, limited to ±`limit`.
pub(super) fn normal(rng: &mut ChaCha8Rng, deviation: f64, limit: f64) -> f64 {
    let value: f64 = StandardNormal.sample(rng);
    (value * deviation).clamp(-limit, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn demo_and_evaluation_wearers_are_never_training_wearers() {
        let groups = [Group::Training, Group::Evaluation, Group::Demo];
        let mut keys = std::collections::HashSet::new();
        let mut bodies = std::collections::HashSet::new();
        for group in groups {
            for seed in [0, 1, 2, u64::MAX] {
                for index in 0..50 {
                    assert!(keys.insert(key(group, seed, index)));
                    let wearer = Wearer::new(group, seed, index);
                    assert!(bodies.insert(wearer.speed_m_s.to_bits() ^ wearer.arm_m.to_bits()));
                }
            }
        }
        // For any seed and index, only the letter is in the byte of the group.
        assert!(groups.iter().all(|&g| key(g, u64::MAX, u32::MAX)[8] == g.letter() as u8));
    }

    #[test]
    fn a_take_has_random_numbers_of_its_own() {
        let wearer = Wearer::demo(3);
        let first = |take| wearer.rng(Draws::Take(take)).random::<u64>();
        assert_eq!(first(4), first(4));
        assert_ne!(first(4), first(5));
    }
}
