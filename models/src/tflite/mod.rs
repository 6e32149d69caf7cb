//! Reads and writes TFLite files of dense networks.
//!
//! The supported networks are chains of FULLY_CONNECTED layers (with ReLU, ReLU6 or none, with or without biases).
//! All layers must be float32, or all must be int8 in the way that exporters write it.
//! In int8, there is one scale per tensor or per channel.
//! Weights are symmetric, biases are int32, and the softmax output has scale 1/256 and zero point −128.
//! At the ends, QUANTIZE and DEQUANTIZE are supported, with inputs and outputs of int8, uint8 or float32.
//! RESHAPE is supported between layers and before them.
//! If a network outputs logits, the program applies its own softmax to them ([`End`]).
//! Int8 networks give exactly the results of TFLite's reference kernels.
//! Any other network is refused, and the error names the reason.
//! The reader is our own. A damaged file causes an error, but never a panic or high memory use.

mod flat;
mod names;
mod read;
mod write;

use shared_dsp::right::network::DenseSpec;

pub use read::{End, read, read_to_end};
pub use write::write;

/// Bytes 4..8 of every TFLite file.
const IDENTIFIER: &[u8; 4] = b"TFL3";
/// Maximum size of a file. Our files have about 6 KB, or 14 KB in float.
pub const MAX_BYTES: usize = 1 << 20;
/// Maximum number of layers in a file.
pub const MAX_LAYERS: usize = 8;
/// Maximum width of a layer in a file.
pub const MAX_WIDTH: usize = 1024;

/// Numbers of the TFLite schema.
mod schema {
    pub const FLOAT32: i8 = 0;
    pub const INT32: i8 = 2;
    pub const UINT8: i8 = 3;
    pub const INT8: i8 = 9;
    pub const DEQUANTIZE: i32 = 6;
    pub const FULLY_CONNECTED: i32 = 9;
    pub const RESHAPE: i32 = 22;
    pub const SOFTMAX: i32 = 25;
    pub const STRIDED_SLICE: i32 = 45;
    pub const SHAPE: i32 = 77;
    pub const PACK: i32 = 83;
    pub const QUANTIZE: i32 = 114;
    pub const FULLY_CONNECTED_OPTIONS: u8 = 8;
    pub const SOFTMAX_OPTIONS: u8 = 9;
    pub const RELU: i8 = 1;
    pub const RELU6: i8 = 3;
}

/// A float layer.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatLayer {
    /// `weights[output][input]`.
    pub weights: Vec<Vec<f32>>,
    /// One per output.
    pub biases: Vec<f32>,
    /// Whether a ReLU follows.
    pub relu: bool,
}

/// A network from a file. A softmax follows its last layer, even if the file ends in logits.
#[derive(Clone, Debug, PartialEq)]
pub enum Network {
    /// float32 in and out.
    Float(Vec<FloatLayer>),
    /// int8 in and out.
    Int8(Vec<DenseSpec>),
}

/// The reason why a file cannot be used as a network.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TfliteError {
    /// The file does not begin like a TFLite file.
    #[error("this is not a TFLite file; give the .tflite that `models train` wrote")]
    NotTflite,
    /// An offset or length points outside the file.
    #[error("the TFLite file is damaged or cut off; copy it again or train it again")]
    Damaged,
    /// The file contains an operator other than dense and softmax.
    #[error(
        "operator {index} of the TFLite file is {name}; only FULLY_CONNECTED layers with one \
         SOFTMAX at the end can be used (and QUANTIZE, DEQUANTIZE and RESHAPE around them): train a dense network"
    )]
    ForeignOperator {
        /// Index of the operator in the graph, from 0.
        index: usize,
        /// The operator's name.
        name: String,
    },
    /// The network is dense, but of an unsupported kind.
    #[error("the TFLite file cannot be used: {0}")]
    Unsupported(String),
}

impl Network {
    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        match self {
            Self::Float(layers) => layers[0].weights[0].len(),
            Self::Int8(layers) => layers[0].weights[0].len(),
        }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Float(layers) => layers[layers.len() - 1].biases.len(),
            Self::Int8(layers) => layers[layers.len() - 1].biases.len(),
        }
    }
}

/// Runs a float network and returns the probabilities for one input vector.
pub fn infer_float(layers: &[FloatLayer], inputs: &[f32]) -> Vec<f32> {
    let mut values = inputs.to_vec();
    for layer in layers {
        values = layer
            .weights
            .iter()
            .zip(&layer.biases)
            .map(|(row, bias)| {
                let sum: f32 = row.iter().zip(&values).map(|(w, x)| w * x).sum::<f32>() + bias;
                if layer.relu { sum.max(0.0) } else { sum }
            })
            .collect();
    }
    softmax(&values)
}

/// Returns the probabilities that follow from a network's last values.
pub(crate) fn softmax(values: &[f32]) -> Vec<f32> {
    let largest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let powers: Vec<f32> = values.iter().map(|v| (v - largest).exp()).collect();
    let sum: f32 = powers.iter().sum();
    powers.iter().map(|p| p / sum).collect()
}
