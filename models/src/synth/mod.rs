//! Simulates wearers, who generate recordings of the paper's seven classes.
//!
//! The paper's recordings are not public, so the bundled model learns from simulated hands.
//! A [`Wearer`] has a size, tempo, posture, tremor and habits.
//! A script of motions is converted to a smooth hand path.
//! A sensor model then computes the readings of an LSM9DS1 on that hand.
//! All values depend only on the key of the wearer.
//! On one machine, the same wearer therefore gives the same bytes for any number of threads.
//!
//! The simulation does *not* include the decisions of real people.
//! Results of the simulation are therefore not valid for real hands.
//! Every place that shows such a result must state this.

mod everyday;
mod path;
mod pose;
mod sensor;
mod wearer;

pub use path::{IdleKind, Motion, Segment};
use wearer::Draws;
pub use wearer::{Group, Wearer};

use crate::recording::Recording;

/// Plays a script of motions in sequence, and records the hand at 100 Hz with 9 axes.
///
/// Within its segment, a gesture begins and ends at rest.
/// `take` distinguishes recordings of the same wearer, which differ in phases, noise and attention.
///
/// ```
/// use models::synth::{Motion, Segment, Wearer, session};
/// let script = [Segment::new(Motion::IDLE, 3.0), Segment::new(Motion::Circle, 5.0)];
/// let recording = session(&Wearer::demo(1), 0, &script);
/// assert_eq!((recording.axes(), recording.len()), (9, 800));
/// ```
pub fn session(wearer: &Wearer, take: u64, script: &[Segment]) -> Recording {
    let mut rng = wearer.rng(Draws::Take(take));
    let track = path::track(wearer, &mut rng, script);
    sensor::record(wearer, &mut rng, &track)
}

/// A recording of a simulated wearer that is part of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Take {
    /// The label, canonical.
    pub label: &'static str,
    /// Number of the recording in the file name, and `take` of [`session`].
    pub number: u64,
    /// What is played.
    pub script: Vec<Segment>,
}

impl Take {
    /// Takes from this number on contain only the beginning or the end of a gesture.
    pub const FIRST_PART: u64 = 101;
}

/// Returns the takes of one wearer, which contain `seconds` of each gesture.
/// The takes contain half as much of each kind of idle movement, which has the label `idle`.
/// Beginnings and ends of gestures (at most 0.8 s in the window) are labelled `idle` too, because they are not a gesture yet.
/// In the recordings of a gesture, the gesture fills at least three quarters of the window.
pub fn takes(seconds: f64) -> Vec<Take> {
    const EDGE_S: f64 = 0.4;
    const PART_S: f64 = 0.8;
    const REST_S: f64 = 1.6;
    const CUT_FROM_S: f64 = 4.0;
    const REACH_S: f64 = 6.0;
    let mut takes = Vec::new();
    for motion in Motion::GESTURES {
        takes.push(Take {
            label: motion.label(),
            number: 1,
            script: vec![
                Segment::new(Motion::IDLE, EDGE_S),
                Segment::new(motion, seconds),
                Segment::new(Motion::IDLE, EDGE_S),
            ],
        });
    }
    for (kind, number) in IdleKind::ALL.into_iter().zip(1..) {
        let script = vec![Segment::new(Motion::Idle(kind), seconds / 2.0)];
        takes.push(Take { label: "idle", number, script });
    }
    for (motion, number) in Motion::GESTURES.into_iter().zip(0..) {
        // This part of a longer gesture is cut so that its first or last second equals that in a session.
        let first = Segment::cut(motion, CUT_FROM_S, 0.0, PART_S);
        let last = Segment::cut(motion, CUT_FROM_S, CUT_FROM_S - PART_S, PART_S);
        for (kind, more) in [(IdleKind::Still, 0), (IdleKind::Reach, 50)] {
            let idle = Motion::Idle(kind);
            let before = Segment::cut(idle, REACH_S, REACH_S - REST_S, REST_S);
            let after = Segment::cut(idle, REACH_S, 0.0, REST_S);
            let number = number + more;
            takes.push(Take {
                label: "idle",
                number: Take::FIRST_PART + number,
                script: vec![before, first],
            });
            takes.push(Take {
                label: "idle",
                number: Take::FIRST_PART + 100 + number,
                script: vec![last, after],
            });
        }
    }
    takes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(recording: &Recording, axis: usize) -> Vec<f64> {
        recording.samples().map(|sample| f64::from(sample[axis])).collect()
    }

    fn deviation(values: &[f64]) -> f64 {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    }

    fn of(motion: Motion, wearer: &Wearer) -> Recording {
        session(wearer, 1, &[Segment::new(motion, 8.0)])
    }

    #[test]
    fn the_same_wearer_and_take_give_the_same_recording_and_others_do_not() {
        let wearer = Wearer::training(7, 3);
        assert_eq!(of(Motion::Circle, &wearer), of(Motion::Circle, &Wearer::training(7, 3)));
        assert_ne!(of(Motion::Circle, &wearer), of(Motion::Circle, &Wearer::training(7, 4)));
        assert_ne!(of(Motion::Circle, &wearer), of(Motion::Circle, &Wearer::training(8, 3)));
        assert_ne!(
            session(&wearer, 1, &[Segment::new(Motion::Circle, 2.0)]),
            session(&wearer, 2, &[Segment::new(Motion::Circle, 2.0)])
        );
    }

    #[test]
    fn a_still_hand_feels_gravity_and_the_earth_field_only() {
        for index in 0..20 {
            let recording = of(Motion::Idle(IdleKind::Still), &Wearer::training(1, index));
            let norm = |sample: &[f32]| sample.iter().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
            for sample in recording.samples() {
                assert!((norm(&sample[..3]) - 9.81).abs() < 2.5, "gravity {sample:?}");
                assert!(norm(&sample[3..6]) < 40.0, "turning {sample:?}");
                assert!((5.0..120.0).contains(&norm(&sample[6..])), "field {sample:?}");
            }
        }
    }

    #[test]
    fn each_stroke_is_felt_most_along_its_own_direction() {
        for (motion, axis) in [(Motion::ToFro, 0), (Motion::LeftRight, 1), (Motion::UpDown, 2)] {
            let right = (0..40)
                .filter(|&index| {
                    let recording = of(motion, &Wearer::training(1, index));
                    let felt: Vec<f64> = (0..3).map(|a| deviation(&column(&recording, a))).collect();
                    felt.iter().all(|d| *d <= felt[axis])
                })
                .count();
            assert!(right >= 36, "{motion:?}: {right} of 40");
        }
    }

    #[test]
    fn the_flat_rectangle_stays_flat_and_the_upright_one_upright() {
        for (motion, quiet) in [(Motion::Rectangle, 0), (Motion::RectangleFlat, 2)] {
            let right = (0..40)
                .filter(|&index| {
                    let recording = of(motion, &Wearer::training(1, index));
                    let felt: Vec<f64> = (0..3).map(|a| deviation(&column(&recording, a))).collect();
                    felt.iter().all(|d| *d >= felt[quiet])
                })
                .count();
            assert!(right >= 32, "{motion:?}: {right} of 40");
        }
    }

    #[test]
    fn untaught_wearers_draw_circles_in_any_plane_and_others_upright_ones() {
        let quietest = |untaught: bool| {
            let mut count = [0; 3];
            for index in 0..60 {
                let wearer = Wearer::training(1, index);
                let recording = of(Motion::Circle, &if untaught { wearer.untaught() } else { wearer });
                let felt: Vec<f64> = (0..3).map(|a| deviation(&column(&recording, a))).collect();
                count[(0..3).min_by(|&a, &b| felt[a].total_cmp(&felt[b])).unwrap()] += 1;
            }
            count
        };
        // This axis (forward, left or up) is perpendicular to the circle.
        assert!(quietest(false)[0] >= 50, "{:?}", quietest(false));
        assert!(quietest(true).iter().all(|&count| count >= 8), "{:?}", quietest(true));
    }

    #[test]
    fn untaught_wearers_are_the_same_persons_each_time_and_differ_more_in_tempo() {
        assert_eq!(Wearer::training(7, 3).untaught(), Wearer::training(7, 3).untaught());
        let spread = |untaught: bool| {
            let logs: Vec<f64> = (0..200)
                .map(|index| Wearer::training(1, index))
                .map(|wearer| if untaught { wearer.untaught() } else { wearer })
                .map(|wearer| wearer.stroke_hz.ln())
                .collect();
            deviation(&logs)
        };
        assert!(spread(true) > 1.5 * spread(false), "{} and {}", spread(true), spread(false));
    }

    #[test]
    fn the_sensor_clips_quantises_and_repeats_the_magnetometer() {
        let recording = of(Motion::UpDown, &Wearer::training(1, 5));
        let limit = 4.0 * 9.806_65 + 0.01;
        assert!(recording.samples().all(|s| s[..3].iter().all(|v| f64::from(v.abs()) <= limit)));
        let rows: Vec<&[f32]> = recording.samples().collect();
        let repeats = rows.windows(2).filter(|pair| pair[0][6..] == pair[1][6..]).count();
        assert!(repeats * 10 >= rows.len() * 7, "{repeats} of {}", rows.len());
    }

    #[test]
    fn what_is_recorded_equals_what_its_csv_says() {
        let recording = of(Motion::Rectangle, &Wearer::demo(1));
        let text = recording.to_csv();
        let read = Recording::parse(std::path::Path::new("x"), text.as_bytes()).unwrap();
        assert_eq!(read, recording);
    }

    #[test]
    fn every_class_has_takes_and_part_gestures_are_idle() {
        let takes = takes(10.0);
        for label in crate::labels::PAPER {
            assert!(takes.iter().any(|take| take.label == label), "{label}");
        }
        let files: std::collections::HashSet<_> =
            takes.iter().map(|take| (take.label, take.number)).collect();
        assert_eq!(files.len(), takes.len(), "no two takes share a file");
    }
}
