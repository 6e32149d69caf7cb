//! Trains with the library candle by the same plan as the plain loops, so that a test can compare the results.

use candle_core::{D, Device, Result, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};
use rand_chacha::ChaCha8Rng;

use super::fit::{Labelled, Rounding, Steps, Wanted};
use super::net::{Layers, export, forward, vars};
use crate::tflite::FloatLayer;

/// As [`super::fit::run`].
pub(super) fn run(
    rows: &[Labelled],
    wanted: &Wanted,
    start: &[FloatLayer],
    plan: &Steps,
    rounding: Option<&Rounding>,
    mut rng: ChaCha8Rng,
) -> Result<Vec<FloatLayer>> {
    let width = rows[0].0.len();
    let layer = |layer: &FloatLayer| {
        let outputs = layer.biases.len();
        let weights =
            Tensor::from_vec(layer.weights.concat(), (outputs, layer.weights[0].len()), &Device::Cpu)?;
        let weights = weights.t()?.contiguous()?;
        Ok((Var::from_tensor(&weights)?, Var::from_vec(layer.biases.clone(), outputs, &Device::Cpu)?))
    };
    let layers: Layers = start.iter().map(layer).collect::<Result<_>>()?;
    let vars = vars(&layers);
    let mut average: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().copy()).collect::<Result<_>>()?;
    let inputs: Vec<f32> = rows.iter().flat_map(|(input, _)| input.iter().copied()).collect();
    let inputs = Tensor::from_vec(inputs, (rows.len(), width), &Device::Cpu)?;
    let targets = Tensor::from_slice(&wanted.values, (rows.len(), wanted.labels), &Device::Cpu)?;

    let params = ParamsAdamW { lr: plan.learning_rate, weight_decay: 0.0, ..Default::default() };
    let mut optimizer = AdamW::new(vars.clone(), params)?;
    for step in 0..plan.count {
        let chosen = Tensor::from_vec(wanted.drawn(plan.batch, &mut rng), plan.batch, &Device::Cpu)?;
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

/// As [`forward`], with the rounding of int8. The gradient ignores the rounding.
fn forward_rounded(layers: &Layers, inputs: &Tensor, rounding: &Rounding) -> Result<Tensor> {
    let limit = f64::from(rounding.limit);
    let mut x = steps(&inputs.clamp(-limit, limit)?, limit / 127.5)?;
    for (index, ((weights, biases), (low, high))) in layers.iter().zip(&rounding.ranges).enumerate() {
        let (low, high) = (f64::from(*low), f64::from(*high));
        let largest = weights.as_tensor().detach().abs()?.max_all()?.to_scalar::<f32>()?;
        let weights = steps(weights.as_tensor(), f64::from(largest).max(1e-9) / 127.0)?;
        x = x.matmul(&weights)?.broadcast_add(biases)?;
        if index + 1 < layers.len() {
            x = x.relu()?;
        }
        x = steps(&x.clamp(low, high)?, (high - low).max(1e-9) / 255.0)?;
    }
    Ok(x)
}

/// Rounds to whole steps; the gradient is that of the values before rounding.
fn steps(x: &Tensor, step: f64) -> Result<Tensor> {
    let rounded = x.detach().affine(1.0 / step, 0.0)?.round()?.affine(step, 0.0)?;
    x + (rounded - x.detach())?
}
