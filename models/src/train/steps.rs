//! Trains new networks in a fixed number of steps. Recipe `aligned` uses this method.
//! Batches are drawn at random, and the learning rate warms up and then decreases as a cosine.
//! The result is the average of the weights over the steps.
//! Training needs no held-out recordings.
//!
//! Several networks that start differently are merged into one network.
//! The merged network's logits are the mean of its members' logits.
//! For unknown people, the networks make different errors.
//! A smaller network can then learn the probabilities of the merged one (Hinton et al., 2015).
//! The last steps simulate int8 rounding (Jacob et al., 2018).

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::fit::{Labelled, Steps, Wanted, finished, run};
use crate::streams::RandomStream;
use crate::tflite::FloatLayer;

/// Trains networks of these hidden widths on labelled inputs, and merges them into one network.
/// With the hidden widths of a `student`, that network learns from the merged one and replaces it.
/// Rare labels count as much as common labels, and `limit` is the maximum input. There must be rows.
pub(super) fn fit(
    rows: &[Labelled],
    labels: usize,
    hidden: &[usize],
    plan: &Steps,
    limit: f32,
    seed: u64,
    student: Option<[usize; 2]>,
) -> Vec<FloatLayer> {
    let wanted = Wanted::labels(rows, labels, plan);
    let member = |index: usize| new(rows, &wanted, hidden, plan, RandomStream::Member(index).of(seed));
    let members: Vec<_> = (0..plan.members.max(1)).into_par_iter().map(member).collect();
    // The teacher is finished, too: its last steps train its members together.
    let merged = finished(merged(&members), rows, &wanted, plan, limit, seed);
    match student {
        Some(hidden) => distil(rows, labels, &merged, &hidden, plan, limit, seed),
        None => merged,
    }
}

/// Trains a network of these hidden widths to give the probabilities of a trained network, the teacher.
/// The teacher's probabilities say more than a label does: which other gestures a window resembles, and how much.
fn distil(
    rows: &[Labelled],
    labels: usize,
    teacher: &[FloatLayer],
    hidden: &[usize],
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Vec<FloatLayer> {
    let wanted = Wanted::probabilities(rows, labels, teacher);
    // The members of the teacher have used the streams of lower numbers.
    let student = new(rows, &wanted, hidden, plan, RandomStream::Member(plan.members.max(1)).of(seed));
    finished(student, rows, &wanted, plan, limit, seed)
}

/// Trains a network that starts with random weights.
fn new(
    rows: &[Labelled],
    wanted: &Wanted,
    hidden: &[usize],
    plan: &Steps,
    mut rng: ChaCha8Rng,
) -> Vec<FloatLayer> {
    let inputs = rows.first().map_or(0, |(input, _)| input.len());
    let widths = [&[inputs], hidden, &[wanted.labels]].concat();
    let last = widths.len() - 2;
    let mut layer = |(index, pair): (usize, &[usize])| {
        let deviation = (2.0 / pair[0] as f64).sqrt();
        let mut weight = || {
            let value: f64 = StandardNormal.sample(&mut rng);
            (value * deviation) as f32
        };
        FloatLayer {
            weights: (0..pair[1]).map(|_| (0..pair[0]).map(|_| weight()).collect()).collect(),
            biases: vec![0.0; pair[1]],
            relu: index < last,
        }
    };
    let start: Vec<FloatLayer> = widths.windows(2).enumerate().map(&mut layer).collect();
    run(rows, wanted, &start, plan, None, rng)
}

/// Returns one network whose logits are the mean of the logits of several networks.
/// All networks must have the same shape.
fn merged(members: &[Vec<FloatLayer>]) -> Vec<FloatLayer> {
    let [first, rest @ ..] = members else { return Vec::new() };
    if rest.is_empty() {
        return first.clone();
    }
    let (count, last) = (members.len(), first.len() - 1);
    let layer = |index: usize| {
        let parts: Vec<&FloatLayer> = members.iter().map(|layers| &layers[index]).collect();
        let relu = parts[0].relu;
        if index == last {
            // The networks are side by side, and their outputs are averaged.
            let share = 1.0 / count as f32;
            let row = |output: usize| {
                parts.iter().flat_map(|part| part.weights[output].iter().map(|w| w * share)).collect()
            };
            let bias = |output: usize| parts.iter().map(|part| part.biases[output] * share).sum();
            let outputs = parts[0].biases.len();
            return FloatLayer {
                weights: (0..outputs).map(row).collect(),
                biases: (0..outputs).map(bias).collect(),
                relu,
            };
        }
        let mut weights = Vec::new();
        for (place, part) in parts.iter().enumerate() {
            for row in &part.weights {
                // All members share the inputs of the first layer; in later layers, each member uses only its own values.
                weights.push(if index == 0 {
                    row.clone()
                } else {
                    let mut wide = vec![0.0; row.len() * count];
                    wide[place * row.len()..(place + 1) * row.len()].copy_from_slice(row);
                    wide
                });
            }
        }
        FloatLayer { weights, biases: parts.iter().flat_map(|part| part.biases.clone()).collect(), relu }
    };
    (0..=last).map(layer).collect()
}
