//! What the recipe `aligned` does its own way: windows, scaling, and the memory that lets it learn another person.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::vary::{Kind, vary};
use super::{Windows, quantise, steps};
use crate::card::Card;
use crate::dataset::Item;
use crate::recording::Recording;
use crate::synth::{IdleKind, Motion, Segment, Wearer, session};
use crate::tflite::FloatLayer;
use crate::windows::{aligned_features, prepare};
use crate::{RATE_HZ, WINDOW};

/// Samples from one training window to the next: 1 s.
const STRIDE: usize = RATE_HZ as usize;
/// Rows that a model remembers of the people it was trained on.
const MEMORY_ROWS: usize = 4096;
/// Length of what a simulated person does.
const SIMULATED_S: f64 = 8.0;
/// Varied copies of each window of a simulated person's gesture.
const COPIES_OF_SIMULATED: usize = 2;
/// Varied copies of each window of a new person.
const COPIES_OF_NEW: usize = 60;

/// The windows of a recording at the models' rate, one after the other in each: sample after sample.
pub(super) fn cut(ready: &Recording) -> Vec<Vec<f32>> {
    let starts = (0..=ready.len().saturating_sub(WINDOW)).step_by(STRIDE);
    starts.map(|start| ready.slice(start, WINDOW).samples().flatten().copied().collect()).collect()
}

/// Features of a recording's windows and of `copies` varied ones of each.
pub(super) fn windows(item: &Item, label: usize, copies: usize, rng: &ChaCha8Rng) -> Windows {
    let (ready, prepared) = prepare(&item.recording);
    let (axes, kind) = (ready.axes(), Kind::of(&item.label));
    let mut rng = rng.clone();
    let (mut own, mut varied) = (Vec::new(), Vec::new());
    for window in cut(&ready) {
        own.push(aligned_features(axes, &window));
        for _ in 0..copies {
            varied.push(aligned_features(axes, &vary(&window, axes, kind, &mut rng)));
        }
    }
    Windows { label, own, varied, padded: prepared.padded, resampled: prepared.resampled }
}

/// What simulated wearers do that is no gesture, one thing after the other.
const AIMLESS: [IdleKind; 10] = [
    IdleKind::Still,
    IdleKind::Fidget,
    IdleKind::Reach,
    IdleKind::Walk,
    IdleKind::Turn,
    IdleKind::Scatter,
    IdleKind::Scatter,
    IdleKind::Scatter,
    IdleKind::Shake,
    IdleKind::Shake,
];

/// Features of windows that several trainings use.
type Shared = Arc<Vec<Vec<f32>>>;

/// Features of windows in which `wearers` simulated people move but make no gesture, the same for every training.
///
/// Few recordings show what a hand does when it makes no gesture, and those of one person little of it.
pub(super) fn aimless(axes: usize, wearers: u32) -> Shared {
    once(axes, wearers, "idle", || {
        let of_wearer = |index: u32| {
            let wearer = Wearer::training(0, index);
            let takes = AIMLESS.into_iter().enumerate();
            takes.flat_map(move |(take, kind)| {
                let script = [Segment::new(Motion::Idle(kind), SIMULATED_S)];
                let recording = session(&wearer, take as u64, &script).with_axes(axes);
                cut(&recording).into_iter().map(move |window| aligned_features(axes, &window))
            })
        };
        (1..=wearers).flat_map(of_wearer).collect()
    })
}

/// Features of windows in which `wearers` other simulated people make a gesture, and of varied copies, the same for every
/// training; for each of the labels that the simulator knows, with its place among them.
///
/// The people of a few recordings differ less from each other than the next one may from all of them.
pub(super) fn performed(axes: usize, wearers: u32, labels: &[String]) -> Vec<(Shared, usize)> {
    let of_gesture = |motion: Motion| {
        let label = labels.iter().position(|label| label == motion.label())?;
        let make = || {
            let of_wearer = |index: u32| {
                let wearer = Wearer::training(1, index).untaught();
                let script = [Segment::new(motion, SIMULATED_S)];
                let recording = session(&wearer, 0, &script).with_axes(axes);
                let mut rng = ChaCha8Rng::seed_from_u64(u64::from(index));
                cut(&recording).into_iter().flat_map(move |window| {
                    let varied =
                        [0; COPIES_OF_SIMULATED].map(|_| vary(&window, axes, Kind::Gesture, &mut rng));
                    let all = std::iter::once(window).chain(varied);
                    all.map(|window| aligned_features(axes, &window)).collect::<Vec<_>>()
                })
            };
            (1..=wearers).flat_map(of_wearer).collect()
        };
        Some((once(axes, wearers, motion.label(), make), label))
    };
    Motion::GESTURES.into_iter().filter_map(of_gesture).collect()
}

/// What is the same for every training is made once.
fn once(axes: usize, wearers: u32, label: &'static str, make: impl FnOnce() -> Vec<Vec<f32>>) -> Shared {
    static MADE: Mutex<BTreeMap<(usize, u32, &str), Shared>> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(made.entry((axes, wearers, label)).or_insert_with(|| Arc::new(make())))
}

/// What a feature is divided by. The addition keeps one that hardly varies from becoming an amplifier of noise.
pub(super) fn divisor(_mean: f64, deviation: f64) -> f64 {
    deviation + 0.1
}

/// Inputs of the people that a model was trained on, as many of each label, so that it does not forget them.
#[derive(Clone, Debug, PartialEq)]
pub struct Memory {
    /// int8 inputs, each (round(input / limit · 127)), with their label.
    rows: Vec<(Vec<i8>, u8)>,
}

/// Why a memory file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct MemoryError(String);

const MAGIC: &[u8; 8] = b"BIMANMEM";

impl Memory {
    pub(super) fn new(rows: &[(Vec<f32>, usize)], labels: usize, limit: f32, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1 << 42);
        let chosen = balanced(rows.iter().map(|(_, label)| *label), labels, MEMORY_ROWS, &mut rng);
        let int8 = |value: &f32| (value / limit * 127.0).round().clamp(-127.0, 127.0) as i8;
        let row = |index: usize| (rows[index].0.iter().map(int8).collect(), rows[index].1 as u8);
        Self { rows: chosen.into_iter().map(row).collect() }
    }

    /// Rows of inputs with their labels.
    fn inputs(&self, limit: f32) -> Vec<(Vec<f32>, usize)> {
        let float = |value: &i8| f32::from(*value) * limit / 127.0;
        self.rows.iter().map(|(row, label)| (row.iter().map(float).collect(), usize::from(*label))).collect()
    }

    /// The bytes of `NAME.memory.bin`: `BIMANMEM`, rows and inputs per row as u32 little-endian, then each row's label
    /// and inputs.
    pub fn to_bytes(&self) -> Vec<u8> {
        let width = self.rows.first().map_or(0, |(row, _)| row.len());
        let mut bytes = MAGIC.to_vec();
        bytes.extend((self.rows.len() as u32).to_le_bytes());
        bytes.extend((width as u32).to_le_bytes());
        for (row, label) in &self.rows {
            bytes.push(*label);
            bytes.extend(row.iter().map(|value| *value as u8));
        }
        bytes
    }

    /// Reads the bytes of a memory that belongs to a model with this card.
    ///
    /// # Errors
    /// If they are something else, damaged, or of another model.
    pub fn parse(bytes: &[u8], card: &Card) -> Result<Self, MemoryError> {
        let error =
            |what: &str| MemoryError(format!("{what}; copy the .memory.bin again or train the model again"));
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| error("this is no memory of a model"))?;
        let (sizes, rest) = rest.split_first_chunk::<8>().ok_or_else(|| error("the memory is cut short"))?;
        let [a, b, c, d, e, f, g, h] = *sizes;
        let (rows, width) =
            (u32::from_le_bytes([a, b, c, d]) as usize, u32::from_le_bytes([e, f, g, h]) as usize);
        if width != card.scaling.mean.len() {
            return Err(error(&format!(
                "the memory has {width} inputs, the model {}",
                card.scaling.mean.len()
            )));
        }
        if rows == 0 || Some(rest.len()) != rows.checked_mul(width + 1) {
            return Err(error("the memory is cut short"));
        }
        let rows: Vec<(Vec<i8>, u8)> = rest
            .chunks_exact(width + 1)
            .map(|row| (row[1..].iter().map(|value| *value as i8).collect(), row[0]))
            .collect();
        if rows.iter().any(|(_, label)| usize::from(*label) >= card.labels.len()) {
            return Err(error("the memory names a label that the model does not have"));
        }
        Ok(Self { rows })
    }

    /// Share of the rows, in per cent, to which a network gives their label.
    pub fn accuracy(&self, layers: &[FloatLayer], limit: f32) -> f64 {
        let rows = self.inputs(limit);
        let right = rows.iter().filter(|(input, label)| {
            let scores = crate::tflite::infer_float(layers, input);
            (0..scores.len()).all(|n| n == *label || scores[n] < scores[*label])
        });
        100.0 * right.count() as f64 / rows.len().max(1) as f64
    }
}

/// Indices of `count` rows, as many of each label that there is, drawn with replacement.
fn balanced(
    labels: impl Iterator<Item = usize>,
    kinds: usize,
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<usize> {
    let mut of_label = vec![Vec::new(); kinds];
    for (index, label) in labels.enumerate() {
        of_label[label].push(index);
    }
    of_label.retain(|indices| !indices.is_empty());
    if of_label.is_empty() {
        return Vec::new();
    }
    (0..count)
        .map(|n| {
            let indices = &of_label[n % of_label.len()];
            indices[rng.random_range(0..indices.len())]
        })
        .collect()
}

/// An adapted network.
pub(super) struct Adapted {
    pub layers: Vec<FloatLayer>,
    /// The inputs it was fitted to.
    pub rows: Vec<(Vec<f32>, usize)>,
}

/// Fits a network to one more person: half of what it sees is new, half is what it remembers.
pub(super) fn adapt(
    card: &Card,
    layers: &[FloatLayer],
    memory: &Memory,
    examples: &[(Vec<f32>, usize)],
    daily: &[Vec<f32>],
    seed: u64,
) -> candle_core::Result<Adapted> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(1 << 43);
    let mut new = Vec::new();
    for (window, label) in examples {
        let kind = Kind::of(&card.labels[*label]);
        // As many as the recipe reads, which may be fewer than the model's board has.
        let axes = window.len() / WINDOW;
        let mut add = |window: &[f32]| {
            new.push((crate::score::standardise(card, &aligned_features(axes, window)), *label));
        };
        add(window);
        for _ in 0..COPIES_OF_NEW {
            add(&vary(window, axes, kind, &mut rng));
        }
    }
    let mut rows = memory.inputs(card.scaling.limit);
    let chosen = balanced(new.iter().map(|(_, label)| *label), card.labels.len(), rows.len(), &mut rng);
    rows.extend(chosen.into_iter().map(|index| new[index].clone()));
    if let Some(other) = card.labels.iter().position(|label| label == super::OTHER) {
        rows.extend(daily.iter().map(|row| (crate::score::standardise(card, row), other)));
    }
    let start = steps::Start::Layers(layers);
    let plan = &steps::Steps::ADAPT;
    let layers = steps::fit(&rows, card.labels.len(), &start, plan, card.scaling.limit, seed)?;
    Ok(Adapted { layers, rows })
}

/// Int8 layers of a fitted network.
pub(super) fn int8(
    layers: &[FloatLayer],
    rows: &[(Vec<f32>, usize)],
    limit: f32,
) -> Vec<shared_dsp::mlp::DenseSpec> {
    let calibration: Vec<&[f32]> = rows.iter().map(|(input, _)| input.as_slice()).collect();
    quantise::quantise(layers, &calibration, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulated_people_show_the_gestures_they_know_and_no_others() {
        let labels = ["circle", "idle", "left-right", "other", "wave"].map(String::from);
        let shown = performed(6, 3, &labels);
        let of: Vec<(usize, usize)> = shown.iter().map(|(windows, label)| (windows.len(), *label)).collect();
        // Seven windows in 8 s, and two copies of each, from each of three people.
        assert_eq!(of, [(63, 2), (63, 0)]);
        let count = shared_dsp::aligned::feature_count(6);
        assert!(shown.iter().all(|(windows, _)| windows.iter().all(|window| window.len() == count)));
        assert_eq!(shown, performed(6, 3, &labels), "every training sees the same");
    }
}
