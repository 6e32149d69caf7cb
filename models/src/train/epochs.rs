//! Trains in epochs, each of which uses every window once.
//! Recipes use this method if held-out recordings determine the end of training.

use candle_core::{D, DType, Device, Result, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};
use indicatif::ProgressBar;
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::net::{Layers, export, forward, on_one_thread, vars};
use super::recipe::{Fitted, Learnt};
use crate::streams::RandomStream;
use crate::tflite::FloatLayer;

/// The parameters of training in epochs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Epochs {
    /// Widths of the hidden layers.
    pub hidden: &'static [usize],
    /// Maximum number of epochs.
    pub most: usize,
    /// Number of epochs without a lower validation loss after which the learning rate is halved.
    /// Training ends after this number of `halvings`. `None` means a constant rate.
    pub patience: Option<usize>,
    /// Maximum number of halvings of the learning rate.
    pub halvings: usize,
    /// Windows per step.
    pub batch: usize,
    /// Learning rate at the start of the training.
    pub learning_rate: f64,
    /// Decay of weights (AdamW).
    pub weight_decay: f64,
    /// Fraction of the probability that is distributed over all labels.
    pub label_smoothing: f32,
}

/// He initialisation with our own random numbers, because candle's numbers have no seed on the CPU.
fn random_layers(widths: &[usize], rng: &mut ChaCha8Rng) -> Result<Layers> {
    let mut layers = Vec::new();
    for pair in widths.windows(2) {
        let (inputs, outputs) = (pair[0], pair[1]);
        let limit = (6.0 / inputs as f32).sqrt();
        let weights: Vec<f32> = (0..inputs * outputs).map(|_| rng.random_range(-limit..limit)).collect();
        // A small positive bias keeps the few units of the narrow layers active at the start.
        let biases = vec![0.05f32; outputs];
        layers.push((
            Var::from_vec(weights, (inputs, outputs), &Device::Cpu)?,
            Var::from_vec(biases, outputs, &Device::Cpu)?,
        ));
    }
    Ok(layers)
}

fn exported(net: &Layers) -> Result<Vec<FloatLayer>> {
    export(net.iter().map(|(weights, biases)| (weights.as_tensor(), biases.as_tensor())))
}

/// Rows of inputs, and their target distributions.
struct Rows {
    inputs: Tensor,
    targets: Tensor,
}

impl Rows {
    fn new(set: &[(Vec<f32>, usize)], labels: usize, smoothing: f32) -> Result<Self> {
        let mut counts = vec![0usize; labels];
        for (_, label) in set {
            counts[*label] += 1;
        }
        let present = counts.iter().filter(|count| **count > 0).count().max(1);
        // Rare labels get a larger weight.
        // The weight grows only with the square root, because rare labels are also noisier.
        let weight =
            |label: usize| (set.len() as f32 / (present as f32 * counts[label].max(1) as f32)).sqrt();
        let width = set.first().map_or(0, |(input, _)| input.len());
        let mut inputs = Vec::with_capacity(set.len() * width);
        let mut targets = Vec::with_capacity(set.len() * labels);
        for (input, label) in set {
            inputs.extend_from_slice(input);
            let spread = smoothing / labels as f32;
            targets.extend(
                (0..labels)
                    .map(|n| weight(*label) * (spread + if n == *label { 1.0 - smoothing } else { 0.0 })),
            );
        }
        Ok(Self {
            inputs: Tensor::from_vec(inputs, (set.len(), width), &Device::Cpu)?,
            targets: Tensor::from_vec(targets, (set.len(), labels), &Device::Cpu)?,
        })
    }

    fn len(&self) -> Result<usize> {
        self.inputs.dim(0)
    }

    fn shuffled(&self, order: &Tensor) -> Result<Self> {
        Ok(Self {
            inputs: self.inputs.index_select(order, 0)?,
            targets: self.targets.index_select(order, 0)?,
        })
    }

    fn loss(&self, net: &Layers, from: usize, count: usize) -> Result<Tensor> {
        let logits = forward(net, &self.inputs.narrow(0, from, count)?)?;
        let logs = candle_nn::ops::log_softmax(&logits, D::Minus1)?;
        let targets = self.targets.narrow(0, from, count)?;
        (logs * targets)?.sum_all()?.affine(-1.0 / count as f64, 0.0)
    }
}

/// Trains a network. Its `check` rows determine the end of training and the final weights.
/// If there are too few recordings for such rows, the training windows are used instead.
pub(super) fn fit(learnt: &Learnt<'_>, plan: &Epochs, seed: u64, progress: &ProgressBar) -> Result<Fitted> {
    on_one_thread(|| fit_here(learnt, plan, seed, progress))
}

fn fit_here(learnt: &Learnt<'_>, plan: &Epochs, seed: u64, progress: &ProgressBar) -> Result<Fitted> {
    let Learnt { rows, check, labels, .. } = *learnt;
    let check = if check.is_empty() { rows } else { check };
    let mut rng = RandomStream::Epochs.of(seed);
    let inputs = rows.first().map_or(0, |(input, _)| input.len());
    let widths: Vec<usize> = [&[inputs], plan.hidden, &[labels]].concat();
    let net = random_layers(&widths, &mut rng)?;
    let learn = Rows::new(rows, labels, plan.label_smoothing)?;
    let check = Rows::new(check, labels, plan.label_smoothing)?;
    let mut rate = plan.learning_rate;
    let params = ParamsAdamW { lr: rate, weight_decay: plan.weight_decay, ..Default::default() };
    let mut optimizer = AdamW::new(vars(&net), params)?;

    let count = learn.len()?;
    let mut order: Vec<u32> = (0..count as u32).collect();
    let mut best = (f32::INFINITY, 0, exported(&net)?);
    let (mut stale, mut halvings, mut epochs) = (0, 0, 0);
    for epoch in 1..=plan.most {
        order.shuffle(&mut rng);
        let rows = learn.shuffled(&Tensor::from_slice(&order, count, &Device::Cpu)?)?;
        for from in (0..count).step_by(plan.batch) {
            let loss = rows.loss(&net, from, plan.batch.min(count - from))?;
            optimizer.backward_step(&loss)?;
        }
        epochs = epoch;
        let loss: f32 = check.loss(&net, 0, check.len()?)?.to_dtype(DType::F32)?.to_scalar()?;
        if loss < best.0 {
            best = (loss, epoch, exported(&net)?);
            stale = 0;
        } else {
            stale += 1;
        }
        progress.set_position(epoch as u64);
        let Some(patience) = plan.patience else { continue };
        if stale >= patience {
            if halvings == plan.halvings {
                break;
            }
            halvings += 1;
            stale = 0;
            rate /= 2.0;
            optimizer.set_learning_rate(rate);
        }
    }
    let (_, best_epoch, layers) = best;
    Ok(Fitted { layers, epochs, best_epoch })
}
