//! A network of dense layers during training by any method.

use candle_core::{Result, Tensor, Var};

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
