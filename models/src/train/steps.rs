//! Trains in a fixed number of steps. Recipe `aligned` uses this method.
//! Batches are drawn at random, and the learning rate warms up and then decreases as a cosine.
//! The result is the average of the weights over the steps.
//! Training needs no held-out recordings, and can start from an existing network.
//!
//! Several networks that start differently are merged into one network.
//! The merged network's logits are the mean of its members' logits.
//! For unknown people, the networks make different errors. The last steps simulate int8 rounding (Jacob et al., 2018).

use candle_core::{D, Device, Result, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::fit::{Rounding, Steps, equalise, label_weights};
use super::net::{Layers, export, forward, forward_rounded, on_one_thread, vars};
use crate::streams::RandomStream;
use crate::tflite::{FloatLayer, infer_float};

/// The start of a network.
pub(super) enum Start<'a> {
    /// Random weights for these hidden widths.
    Widths(&'a [usize]),
    /// The weights of a network.
    Layers(&'a [FloatLayer]),
}

/// Trains networks on labelled inputs, and merges them into one network.
/// Rare labels count as much as common labels, and `limit` is the maximum input.
pub(super) fn fit(
    rows: &[(Vec<f32>, usize)],
    labels: usize,
    start: &Start<'_>,
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Result<Vec<FloatLayer>> {
    let wanted = Wanted::labels(rows, labels, plan);
    let member = |index: usize| {
        on_one_thread(|| one(rows, &wanted, start, plan, None, RandomStream::Member(index).of(seed)))
    };
    let members: Vec<_> = (0..plan.members.max(1)).into_par_iter().map(member).collect::<Result<_>>()?;
    finished(merged(&members), rows, &wanted, plan, limit, seed)
}

/// Trains a network of these hidden widths to give the probabilities of a trained network, the teacher.
/// The teacher's probabilities say more than a label does: which other gestures a window resembles, and how much.
pub(super) fn distil(
    rows: &[(Vec<f32>, usize)],
    labels: usize,
    teacher: &[FloatLayer],
    hidden: &[usize],
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Result<Vec<FloatLayer>> {
    let wanted = Wanted::probabilities(rows, labels, teacher);
    // The members of the teacher have used the streams of lower numbers.
    let rng = RandomStream::Member(plan.members.max(1)).of(seed);
    let student = on_one_thread(|| one(rows, &wanted, &Start::Widths(hidden), plan, None, rng))?;
    finished(student, rows, &wanted, plan, limit, seed)
}

/// Prepares a trained network for int8: equal maxima per unit, and the steps that simulate rounding.
fn finished(
    mut layers: Vec<FloatLayer>,
    rows: &[(Vec<f32>, usize)],
    wanted: &Wanted,
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Result<Vec<FloatLayer>> {
    equalise(&mut layers);
    if plan.rounded > 0 {
        let rounding = Rounding::new(&layers, rows, limit);
        let (start, plan) = (Start::Layers(&layers), plan.last());
        layers = on_one_thread(|| {
            one(rows, wanted, &start, &plan, Some(&rounding), RandomStream::Rounding.of(seed))
        })?;
    }
    Ok(layers)
}

/// The outputs that a network should learn.
/// For each row, `values` holds one probability per label, multiplied by the weight of the row's label.
struct Wanted {
    labels: usize,
    values: Vec<f32>,
}

impl Wanted {
    /// The labels of the rows, smoothed.
    fn labels(rows: &[(Vec<f32>, usize)], labels: usize, plan: &Steps) -> Self {
        let weights = label_weights(rows, labels);
        let of = |(_, label): &(Vec<f32>, usize)| {
            let (label, weight) = (*label, weights[*label]);
            (0..labels).map(move |n| weight * plan.target(n == label, labels))
        };
        Self { labels, values: rows.iter().flat_map(of).collect() }
    }

    /// The probabilities that a trained network gives to the rows.
    fn probabilities(rows: &[(Vec<f32>, usize)], labels: usize, teacher: &[FloatLayer]) -> Self {
        let weights = label_weights(rows, labels);
        let of = |(input, label): &(Vec<f32>, usize)| {
            let weight = weights[*label];
            infer_float(teacher, input).into_iter().map(move |probability| weight * probability)
        };
        Self { labels, values: rows.iter().flat_map(of).collect() }
    }
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

/// Trains one network to give the wanted outputs; with `rounding`, it simulates int8.
fn one(
    rows: &[(Vec<f32>, usize)],
    wanted: &Wanted,
    start: &Start<'_>,
    plan: &Steps,
    rounding: Option<&Rounding>,
    mut rng: ChaCha8Rng,
) -> Result<Vec<FloatLayer>> {
    let width = rows.first().map_or(0, |(input, _)| input.len());
    let layers = first_layers(start, width, wanted.labels, &mut rng)?;
    let vars = vars(&layers);
    let mut average: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().copy()).collect::<Result<_>>()?;

    let inputs: Vec<f32> = rows.iter().flat_map(|(input, _)| input.iter().copied()).collect();
    let inputs = Tensor::from_vec(inputs, (rows.len(), width), &Device::Cpu)?;
    let targets = Tensor::from_slice(&wanted.values, (rows.len(), wanted.labels), &Device::Cpu)?;

    let params = ParamsAdamW { lr: plan.learning_rate, weight_decay: 0.0, ..Default::default() };
    let mut optimizer = AdamW::new(vars.clone(), params)?;
    for step in 0..plan.count {
        let chosen = Tensor::from_vec(plan.drawn(rows.len(), &mut rng), plan.batch, &Device::Cpu)?;
        let (x, y) = (inputs.index_select(&chosen, 0)?, targets.index_select(&chosen, 0)?);
        let logits = match rounding {
            Some(rounding) => forward_rounded(&layers, &x, rounding)?,
            None => forward(&layers, &x)?,
        };
        let logs = candle_nn::ops::log_softmax(&logits, D::Minus1)?;
        let mut loss = (logs * y)?.sum_all()?.affine(-1.0 / plan.batch as f64, 0.0)?;
        for (weights, _) in &layers {
            loss = (loss + weights.sqr()?.sum_all()?.affine(plan.decay, 0.0)?)?;
        }
        optimizer.set_learning_rate(plan.rate(step));
        optimizer.backward_step(&loss)?;
        let keep = plan.kept(step);
        for (mean, var) in average.iter_mut().zip(&vars) {
            *mean = (mean.affine(keep, 0.0)? + var.as_tensor().detach().affine(1.0 - keep, 0.0)?)?;
        }
    }
    let (pairs, _) = average.as_chunks::<2>();
    export(pairs.iter().map(|[weights, biases]| (weights, biases)))
}

fn first_layers(start: &Start<'_>, width: usize, labels: usize, rng: &mut ChaCha8Rng) -> Result<Layers> {
    let layer = |weights: Vec<f32>, biases: Vec<f32>, inputs: usize| {
        let outputs = biases.len();
        // The inputs are stored as rows.
        let weights = Tensor::from_vec(weights, (outputs, inputs), &Device::Cpu)?.t()?.contiguous()?;
        Ok((Var::from_tensor(&weights)?, Var::from_vec(biases, outputs, &Device::Cpu)?))
    };
    match start {
        Start::Layers(layers) => {
            let one = |l: &FloatLayer| {
                layer(l.weights.concat(), l.biases.clone(), l.weights.first().map_or(0, Vec::len))
            };
            layers.iter().map(one).collect()
        }
        Start::Widths(hidden) => {
            let widths: Vec<usize> =
                std::iter::once(width).chain(hidden.iter().copied()).chain(std::iter::once(labels)).collect();
            let one = |pair: &[usize]| {
                let deviation = (2.0 / pair[0] as f64).sqrt();
                let normal = |_| {
                    let value: f64 = StandardNormal.sample(rng);
                    (value * deviation) as f32
                };
                let weights = (0..pair[0] * pair[1]).map(normal).collect();
                layer(weights, vec![0.0; pair[1]], pair[0])
            };
            widths.windows(2).map(one).collect()
        }
    }
}
