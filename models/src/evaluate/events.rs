//! Evaluates events. Joins one person's recordings, plays them to a board's right hand, and compares events with labels.
//!
//! The hand rests between two recordings, with the noise of a held hand.
//! The hand first holds the final posture of a recording.
//! Then it turns smoothly to the initial posture of the next recording and holds that posture.
//! A recording counts as one performed gesture, however often it repeats the shape. Its first sample counts as the onset.
//! People actually begin a little later, so delays are overestimated.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use shared_dsp::right::aligned::{AlignedWindow, Movement};
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::movement::{MovementConfig, MovementDecision};
use shared_dsp::right::network::{MAX_LABELS, Model};
use shared_dsp::right::slow::SlowWindow;
use shared_dsp::right::{ModelMismatch, RightHand};
use shared_words::is_rest;

use crate::RATE_HZ;
use crate::dataset::Item;
use crate::streams::RandomStream;
use crate::synth::{IdleKind, Motion, Segment, Wearer, session};

/// Rest between two recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pause {
    /// Range of times in s during which the hand holds the last posture.
    before_s: (f64, f64),
    /// Time in s during which the hand turns to the next posture.
    turn_s: f64,
    /// Still in that.
    after_s: (f64, f64),
}

impl Pause {
    /// 1.4 to 2.5 s.
    pub const USUAL: Self = Self { before_s: (0.3, 0.8), turn_s: 0.4, after_s: (0.7, 1.3) };

    /// Creates a rest of this length in s. The hand turns for up to 0.4 s of it.
    /// Before and after the turn, the hand is still for equal times.
    pub fn of(seconds: f64) -> Self {
        let turn_s = 0.4f64.min(0.6 * seconds);
        let still_s = 0.5 * (seconds - turn_s);
        Self { before_s: (still_s, still_s), turn_s, after_s: (still_s, still_s) }
    }
}

fn between((low, high): (f64, f64), rng: &mut ChaCha8Rng) -> f64 {
    if low < high { rng.random_range(low..high) } else { low }
}

/// A recording can cause an event for this long after its end,
/// because a decision may wait for the hand to rest.
const TAIL_S: f64 = 0.9;

/// The position of a recording in a joined recording. The sample with index `end` is not included.
#[derive(Clone, Debug, PartialEq)]
pub struct Annotation {
    /// First sample.
    pub start: usize,
    /// Index after the last sample of the recording.
    pub end: usize,
    /// Its label.
    pub label: String,
    /// Name of the recording in the data set.
    pub name: String,
}

/// Recordings of one person, joined in sequence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnnotatedRecording {
    /// Values per sample: 3, 6 or 9.
    pub axes: usize,
    /// All samples in sequence, at the models' rate.
    pub values: Vec<f32>,
    /// Positions of the recordings, in order.
    pub annotations: Vec<Annotation>,
}

impl AnnotatedRecording {
    /// Joins recordings in an order that the seed determines.
    pub fn joined(items: &[&Item], axes: usize, seed: u64) -> Self {
        Self::joined_by(items, axes, Pause::USUAL, seed)
    }

    /// Like [`Self::joined`], but with another rest between recordings.
    pub fn joined_by(items: &[&Item], axes: usize, pause: Pause, seed: u64) -> Self {
        use rand::seq::SliceRandom;
        let mut rng = RandomStream::Order.of(seed);
        let mut order: Vec<&Item> = items.to_vec();
        order.shuffle(&mut rng);
        let mut joined = Self { axes, ..Self::default() };
        for item in order {
            let recording = item.recording.with_axes(axes).resampled();
            let rows: Vec<&[f32]> = recording.samples().collect();
            joined.rest_until(&posture(&rows[..rows.len().min(POSTURE)]), pause, &mut rng);
            let start = joined.len();
            joined.values.extend(rows.iter().copied().flatten());
            let (end, label) = (joined.len(), item.label.clone());
            joined.annotations.push(Annotation { start, end, label, name: item.name.clone() });
        }
        let last = joined.end_posture();
        joined.rest_until(&last, Pause::USUAL, &mut rng);
        joined
    }

    /// Generates a simulated wearer who makes no gesture and is never used for training.
    pub fn aimless(seed: u64, index: u32, seconds: f64) -> Self {
        Self::moving(&IdleKind::EVERY, seed, index, seconds)
    }

    /// Generates a simulated wearer whose movements are of these kinds, which must not be empty.
    pub fn moving(kinds: &[IdleKind], seed: u64, index: u32, seconds: f64) -> Self {
        let wearer = Wearer::evaluation(seed, index);
        let mut rng = RandomStream::Aimless(index).of(seed);
        let mut script = Vec::new();
        let mut left_s = seconds;
        while left_s > 0.0 {
            let kind = kinds[rng.random_range(0..kinds.len())];
            let length_s = rng.random_range(5.0..20.0);
            script.push(Segment::new(Motion::Idle(kind), length_s));
            left_s -= length_s;
        }
        let recording = session(&wearer, 1, &script);
        let values: Vec<f32> = recording.samples().flatten().copied().collect();
        let end = recording.len();
        let annotation = Annotation { start: 0, end, label: "idle".to_owned(), name: wearer.name };
        Self { axes: recording.axes(), values, annotations: vec![annotation] }
    }

    /// Returns the same recording with only its first axes.
    pub fn with_axes(mut self, axes: usize) -> Self {
        if axes < self.axes {
            let rows = self.values.chunks_exact(self.axes);
            self.values = rows.flat_map(|row| row[..axes].iter().copied()).collect();
            self.axes = axes;
        }
        self
    }

    /// Samples.
    pub fn len(&self) -> usize {
        self.values.len() / self.axes.max(1)
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    fn end_posture(&self) -> Vec<f64> {
        let rows: Vec<&[f32]> = self.values.chunks_exact(self.axes).collect();
        posture(&rows[rows.len().saturating_sub(POSTURE)..])
    }

    /// Appends a rest, in which the hand turns from its current posture to the posture `next`.
    fn rest_until(&mut self, next: &[f64], pause: Pause, rng: &mut ChaCha8Rng) {
        let turn_s = pause.turn_s;
        let last = if self.is_empty() { next.to_vec() } else { self.end_posture() };
        let before = between(pause.before_s, rng);
        let seconds = before + turn_s + between(pause.after_s, rng);
        // The noise of a held hand is between the noise of a table and the noise of a tense arm.
        let quiet: f64 = rng.random_range(-1.5f64..0.7).exp();
        let turn = turn_rate_deg(&last, next);
        for n in 0..(seconds * RATE_HZ) as usize {
            let part = ((n as f64 / RATE_HZ - before) / turn_s).clamp(0.0, 1.0);
            let moved = part * part * part * (10.0 + part * (6.0 * part - 15.0));
            // Speed of the turn: the change of `moved` per second.
            let pace = 30.0 * (part * (1.0 - part)).powi(2) / turn_s;
            for axis in 0..self.axes {
                let noise: f64 = StandardNormal.sample(rng);
                let value = match axis {
                    0..3 => last[axis] + (next[axis] - last[axis]) * moved + 0.12 * quiet * noise,
                    3..6 => turn[axis - 3] * pace + 1.5 * quiet * noise,
                    _ => last[axis] + (next[axis] - last[axis]) * moved,
                };
                self.values.push(value as f32);
            }
        }
    }
}

/// Number of samples that are averaged for a posture: 0.15 s.
pub(crate) const POSTURE: usize = 15;

/// Returns the mean of some samples, which is the sensor's reading in that posture.
pub(crate) fn posture(rows: &[&[f32]]) -> Vec<f64> {
    let axes = rows.first().map_or(0, |row| row.len());
    let count = rows.len().max(1) as f64;
    (0..axes).map(|axis| rows.iter().map(|row| f64::from(row[axis])).sum::<f64>() / count).collect()
}

/// Returns the rotation between two postures, computed from their accelerometer values, in deg about each axis.
fn turn_rate_deg(from: &[f64], to: &[f64]) -> [f64; 3] {
    let length = |v: &[f64]| v[..3].iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-6);
    let (a, b) = (length(from), length(to));
    let cross = |i: usize, j: usize| (to[i] * from[j] - to[j] * from[i]) / (a * b);
    let axis = [cross(1, 2), cross(2, 0), cross(0, 1)];
    let sine = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
    let cosine = (0..3).map(|i| from[i] * to[i]).sum::<f64>() / (a * b);
    let angle = sine.atan2(cosine).to_degrees();
    axis.map(|x| if sine > 1e-9 { x / sine * angle } else { 0.0 })
}

/// The results of playing annotated recordings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    /// Gestures performed.
    pub performed: usize,
    /// Number of recordings that caused exactly one event, with the correct label.
    pub right: usize,
    /// No event came.
    pub missed: usize,
    /// Number of recordings that caused one event with another label.
    pub wrong: usize,
    /// Several events came.
    pub several: usize,
    /// Recordings of no gesture.
    pub rests: usize,
    /// Events in those.
    pub rest_events: usize,
    /// Number of events between recordings.
    pub stray_events: usize,
    /// Total duration of recordings without gestures, in s.
    pub rest_s: f64,
    /// Delays of correct events from onset to event, in s.
    pub delays_s: Vec<f64>,
    /// Names of incorrectly recognised recordings, with their results.
    pub errors: Vec<String>,
}

impl Tally {
    /// Adds another one.
    pub fn add(&mut self, other: &Self) {
        self.performed += other.performed;
        self.right += other.right;
        self.missed += other.missed;
        self.wrong += other.wrong;
        self.several += other.several;
        self.rests += other.rests;
        self.rest_events += other.rest_events;
        self.stray_events += other.stray_events;
        self.rest_s += other.rest_s;
        self.delays_s.extend(&other.delays_s);
        self.errors.extend(other.errors.iter().cloned());
    }

    /// Percentage of performed gestures that caused exactly one correct event.
    pub fn right_per_cent(&self) -> f64 {
        100.0 * self.right as f64 / self.performed.max(1) as f64
    }

    /// Median delay of correct events in s, or `None` if there are none.
    pub fn median_delay_s(&self) -> Option<f64> {
        let mut delays = self.delays_s.clone();
        delays.sort_by(f64::total_cmp);
        delays.get(delays.len() / 2).copied()
    }

    /// Returns [`Self::median_delay_s`] as text for users.
    pub fn median_delay(&self) -> String {
        self.median_delay_s().map_or_else(|| "–".to_owned(), |delay| format!("{delay:.2}"))
    }

    /// Number of events per hour in recordings without gestures.
    pub fn false_per_hour(&self) -> f64 {
        3600.0 * self.rest_events as f64 / self.rest_s.max(1e-9)
    }

    /// Adds the events (sample, label) of a recording. Gestures that the model does not know are ignored.
    pub fn count(&mut self, recording: &AnnotatedRecording, events: &[(usize, usize)], labels: &[String]) {
        let tail = (TAIL_S * RATE_HZ) as usize;
        let mut counted = 0;
        for (index, annotation) in recording.annotations.iter().enumerate() {
            // The period ends at the latest when the next recording begins.
            let next = recording.annotations.get(index + 1).map_or(usize::MAX, |next| next.start);
            let until = (annotation.end + tail).min(next);
            let mine: Vec<_> =
                events.iter().filter(|(at, _)| (annotation.start..until).contains(at)).collect();
            counted += mine.len();
            let got = || mine.iter().map(|(_, label)| labels[*label].as_str()).collect::<Vec<_>>().join(", ");
            if is_rest(&annotation.label) {
                self.rests += 1;
                self.rest_events += mine.len();
                self.rest_s += (annotation.end - annotation.start) as f64 / RATE_HZ;
                if !mine.is_empty() {
                    self.errors.push(format!("{}: {}", annotation.name, got()));
                }
                continue;
            }
            let Some(truth) = labels.iter().position(|label| *label == annotation.label) else { continue };
            self.performed += 1;
            match mine.as_slice() {
                [(at, label)] if *label == truth => {
                    self.right += 1;
                    self.delays_s.push((at - annotation.start) as f64 / RATE_HZ);
                    continue;
                }
                [] => self.missed += 1,
                [_] => self.wrong += 1,
                _ => self.several += 1,
            }
            self.errors.push(format!(
                "{}: {}",
                annotation.name,
                if mine.is_empty() { "-".into() } else { got() }
            ));
        }
        self.stray_events += events.len() - counted;
    }
}

/// Plays a recording as a board would, and returns its events as (sample, label).
///
/// # Errors
/// Fails if the model needs samples of another kind.
pub fn play(model: Model<'_>, recording: &AnnotatedRecording) -> Result<Vec<(usize, usize)>, ModelMismatch> {
    fn run<const A: usize>(model: Model<'_>, values: &[f32]) -> Result<Vec<(usize, usize)>, ModelMismatch> {
        let mut hand = RightHand::<A>::new(model, DecisionConfig::default())?;
        let mut events = Vec::new();
        for (n, sample) in values.as_chunks::<A>().0.iter().enumerate() {
            if let Some(output) = hand.push(sample, (n * 10) as u32)
                && output.is_event
            {
                events.push((n, usize::from(output.label)));
            }
        }
        Ok(events)
    }
    match recording.axes {
        3 => run::<3>(model, &recording.values),
        6 => run::<6>(model, &recording.values),
        _ => run::<9>(model, &recording.values),
    }
}

/// The outputs of a model of recipe `aligned` for one hop, before any decision.
#[derive(Clone, Debug)]
pub struct Heard {
    /// The hop's last sample.
    at: usize,
    scores: [i8; MAX_LABELS],
    slow: Option<[i8; MAX_LABELS]>,
    movement: Movement,
}

/// Returns all outputs of a model of recipe `aligned` for a recording, so that callers can compare several decisions.
///
/// # Errors
/// Fails if the model needs samples of another kind.
pub fn listen(model: Model<'_>, recording: &AnnotatedRecording) -> Result<Vec<Heard>, ModelMismatch> {
    fn run<const A: usize>(model: Model<'_>, values: &[f32]) -> Result<Vec<Heard>, ModelMismatch> {
        let info = model.info();
        if info.recipe != FeatureKind::Aligned || !info.recipe.runs_on(info.axes, A) {
            return Err(ModelMismatch::Axes { model: info.axes, hand: A });
        }
        let (mut window, mut slow) = (AlignedWindow::<A>::new(), SlowWindow::<A>::new());
        let classify = |features: &[f32]| {
            let mut scores = [i8::MIN; MAX_LABELS];
            // The number of features equals the number that the model reads.
            let _ = model.classify_features(features, &mut scores[..info.label_count]);
            scores
        };
        let mut all = Vec::new();
        for (at, sample) in values.as_chunks::<A>().0.iter().enumerate() {
            slow.push(sample);
            if window.push(sample) {
                let slow = slow.new_features().map(classify);
                all.push(Heard {
                    at,
                    scores: classify(window.features()),
                    slow,
                    movement: window.movement(),
                });
            }
        }
        Ok(all)
    }
    match recording.axes {
        3 => run::<3>(model, &recording.values),
        6 => run::<6>(model, &recording.values),
        _ => run::<9>(model, &recording.values),
    }
}

/// Returns the events (sample, label) that a decision makes from these outputs.
pub fn decide(heard: &[Heard], labels: &[String], config: MovementConfig) -> Vec<(usize, usize)> {
    let mut decision = MovementDecision::new(labels.iter().map(String::as_str), config);
    let step = |hop: &Heard| {
        let slow = hop.slow.as_ref().map(|scores| &scores[..labels.len()]);
        let event = decision.step(&hop.scores[..labels.len()], slow, hop.movement)?;
        Some((hop.at, usize::from(event.label)))
    };
    heard.iter().filter_map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Recording;
    use std::path::PathBuf;

    fn item(label: &str, number: usize, gravity: [f32; 3]) -> Item {
        let values = gravity.iter().copied().cycle().take(600).collect();
        Item {
            file: PathBuf::new(),
            name: format!("{label}/p__{number}.csv"),
            label: label.to_owned(),
            person: "p".to_owned(),
            recording: Recording::new(3, (0..200).map(|n| f64::from(n) * 10.0).collect(), values),
        }
    }

    #[test]
    fn recordings_are_joined_by_rest_without_jumps() {
        let items = [item("circle", 1, [0.0, 0.0, 9.8]), item("wave", 1, [9.8, 0.0, 0.0])];
        let recording = AnnotatedRecording::joined(&items.iter().collect::<Vec<_>>(), 3, 1);
        assert_eq!(recording.annotations.len(), 2);
        let [first, second] = [&recording.annotations[0], &recording.annotations[1]];
        let rest_s = (second.start - first.end) as f64 / RATE_HZ;
        assert!((1.4..2.5).contains(&rest_s), "{rest_s} s");
        let rows: Vec<&[f32]> = recording.values.chunks(3).collect();
        for pair in rows.windows(2) {
            assert!((0..3).all(|a| (pair[0][a] - pair[1][a]).abs() < 2.5), "{pair:?}");
        }
        assert_eq!(recording, AnnotatedRecording::joined(&items.iter().collect::<Vec<_>>(), 3, 1));
    }

    #[test]
    fn recordings_can_be_joined_by_a_rest_of_any_length() {
        let items = [item("circle", 1, [0.0, 0.0, 9.8]), item("wave", 1, [9.8, 0.0, 0.0])];
        let joined = AnnotatedRecording::joined_by(&items.iter().collect::<Vec<_>>(), 3, Pause::of(0.7), 1);
        let [first, second] = [&joined.annotations[0], &joined.annotations[1]];
        assert_eq!(second.start - first.end, 70);
    }

    #[test]
    fn a_quarter_turn_is_ninety_degrees_about_the_axis_across() {
        let turn = turn_rate_deg(&[0.0, 0.0, 9.8], &[9.8, 0.0, 0.0]);
        // In the board's frame, gravity turns in the opposite direction: nose up is a rotation about -y.
        assert!((turn[1] + 90.0).abs() < 1e-6 && turn[0].abs() < 1e-6 && turn[2].abs() < 1e-6, "{turn:?}");
    }

    #[test]
    fn events_are_counted_for_the_recording_that_they_come_in() {
        let of = |start: usize, end: usize, label: &str| Annotation {
            start,
            end,
            label: label.to_owned(),
            name: label.to_owned(),
        };
        let annotations = vec![
            of(100, 300, "circle"),
            of(500, 700, "wave"),
            of(900, 1100, "circle"),
            of(1300, 1500, "wave"),
            of(1700, 1900, "other"),
            of(2100, 2300, "unknown"),
        ];
        let recording = AnnotatedRecording { axes: 3, values: vec![0.0; 3 * 2600], annotations };
        let labels = ["circle", "other", "wave"].map(String::from);
        let events = [(280, 0), (450, 2), (600, 0), (1000, 0), (1050, 2), (1990, 0), (1980, 0)];
        let mut tally = Tally::default();
        tally.count(&recording, &events, &labels);
        assert_eq!((tally.performed, tally.right), (4, 1));
        assert_eq!((tally.missed, tally.wrong, tally.several), (1, 1, 1));
        assert_eq!((tally.rests, tally.rest_events, tally.stray_events), (1, 1, 2));
        assert_eq!(tally.delays_s, [1.8]);
        assert_eq!(tally.right_per_cent(), 25.0);
    }
}
