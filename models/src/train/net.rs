//! A network of dense layers during training by any method.

use candle_core::{Result, Tensor, Var};

use super::fit::Rounding;
use crate::tflite::FloatLayer;

/// Weights (inputs × outputs) and biases of each layer.
pub(super) type Layers = Vec<(Var, Var)>;

/// Returns all trainable variables, with weights and biases in turn.
pub(super) fn vars(layers: &Layers) -> Vec<Var> {
    layers.iter().flat_map(|(w, b)| [w.clone(), b.clone()]).collect()
}

/// Computes the logits, with ReLU after each layer except the last.
pub(super) fn forward(layers: &Layers, inputs: &Tensor) -> Result<Tensor> {
    let mut x = inputs.clone();
    for (index, (weights, biases)) in layers.iter().enumerate() {
        x = x.matmul(weights)?.broadcast_add(biases)?;
        if index + 1 < layers.len() {
            x = x.relu()?;
        }
    }
    Ok(x)
}

/// As [`forward`], with the rounding of int8. The gradient ignores the rounding.
pub(super) fn forward_rounded(layers: &Layers, inputs: &Tensor, rounding: &Rounding) -> Result<Tensor> {
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

/// Exports the layers as plain numbers, from weights (inputs × outputs) and biases.
pub(super) fn export<'a>(
    layers: impl ExactSizeIterator<Item = (&'a Tensor, &'a Tensor)>,
) -> Result<Vec<FloatLayer>> {
    let last = layers.len() - 1;
    let layer = |(index, (weights, biases)): (usize, (&Tensor, &Tensor))| {
        Ok(FloatLayer { weights: weights.t()?.to_vec2()?, biases: biases.to_vec1()?, relu: index < last })
    };
    layers.enumerate().map(layer).collect()
}

/// Runs on one thread, because sharing such small matrices between threads takes longer than it saves.
pub(super) fn on_one_thread<T: Send>(run: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(run),
        Err(_) => run(),
    }
}
