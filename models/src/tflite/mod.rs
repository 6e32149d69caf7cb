//! TFLite files of dense networks: reading and writing.
//!
//! Only what this project uses: a chain of FULLY_CONNECTED layers (ReLU or none) that ends in one
//! SOFTMAX, all float32 or all int8 with one scale per tensor (TFLite's full-integer quantisation:
//! symmetric weights, int32 biases of scale input × weight, softmax output 1/256 at −128). Anything
//! else is refused by name. The reader is our own and bounded: a damaged file is an error, never a
//! panic and never much memory.

mod flat;
mod write;

use flat::Table;
use shared_dsp::mlp::DenseSpec;

pub use write::write;

/// Bytes 4..8 of every TFLite file.
const IDENTIFIER: &[u8; 4] = b"TFL3";
/// The largest file that is read; ours have about 6 KB, in float 14 KB.
pub const MAX_BYTES: usize = 1 << 20;
/// The most layers that are read.
pub const MAX_LAYERS: usize = 8;
/// The widest layer that is read.
pub const MAX_WIDTH: usize = 1024;

/// Numbers of the TFLite schema.
mod schema {
    pub const FLOAT32: i8 = 0;
    pub const INT32: i8 = 2;
    pub const INT8: i8 = 9;
    pub const FULLY_CONNECTED: i32 = 9;
    pub const SOFTMAX: i32 = 25;
    pub const FULLY_CONNECTED_OPTIONS: u8 = 8;
    pub const SOFTMAX_OPTIONS: u8 = 9;
    pub const RELU: i8 = 1;
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

/// A network as a file holds it; a softmax follows the last layer.
#[derive(Clone, Debug, PartialEq)]
pub enum Network {
    /// float32 in and out.
    Float(Vec<FloatLayer>),
    /// int8 in and out.
    Int8(Vec<DenseSpec>),
}

/// Why a file is no network that can be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TfliteError {
    /// The file does not begin like a TFLite file.
    #[error("this is not a TFLite file; give the .tflite that `models train` wrote")]
    NotTflite,
    /// An offset or length leads out of the file.
    #[error("the TFLite file is damaged or cut off; copy it again or train it again")]
    Damaged,
    /// An operator other than dense and softmax.
    #[error(
        "operator {index} of the TFLite file is {name}; only FULLY_CONNECTED layers with one \
         SOFTMAX at the end can be used: train a dense network"
    )]
    ForeignOperator {
        /// Place in the graph, from 0.
        index: usize,
        /// The operator's name.
        name: String,
    },
    /// A dense network, but not of the kind that is understood.
    #[error("the TFLite file cannot be used: {0}")]
    Unsupported(String),
}

fn unsupported<T>(text: impl Into<String>) -> Result<T, TfliteError> {
    Err(TfliteError::Unsupported(text.into()))
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

/// Runs a float network: probabilities of one input vector.
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
    let largest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let powers: Vec<f32> = values.iter().map(|v| (v - largest).exp()).collect();
    let sum: f32 = powers.iter().sum();
    powers.iter().map(|p| p / sum).collect()
}

/// Name of a builtin operator, for errors.
fn operator_name(code: i32, custom: &str) -> String {
    const NAMES: [(i32, &str); 24] = [
        (0, "ADD"),
        (1, "AVERAGE_POOL_2D"),
        (2, "CONCATENATION"),
        (3, "CONV_2D"),
        (4, "DEPTHWISE_CONV_2D"),
        (6, "DEQUANTIZE"),
        (9, "FULLY_CONNECTED"),
        (14, "LOGISTIC"),
        (16, "LSTM"),
        (17, "MAX_POOL_2D"),
        (18, "MUL"),
        (19, "RELU"),
        (21, "RELU6"),
        (22, "RESHAPE"),
        (25, "SOFTMAX"),
        (27, "SVDF"),
        (28, "TANH"),
        (34, "PAD"),
        (39, "TRANSPOSE"),
        (40, "MEAN"),
        (41, "SUB"),
        (56, "ARG_MAX"),
        (83, "PACK"),
        (114, "QUANTIZE"),
    ];
    match NAMES.iter().find(|(number, _)| *number == code) {
        _ if code == 32 => format!("the custom operator {custom:?}"),
        Some((_, name)) => (*name).to_owned(),
        None => format!("builtin operator number {code}"),
    }
}

/// One tensor of the graph.
struct Tensor<'a> {
    shape: Vec<i32>,
    kind: i8,
    data: &'a [u8],
    scales: Vec<f32>,
    zero_points: Vec<i64>,
}

impl Tensor<'_> {
    /// The one scale and zero point of an int8 tensor.
    fn quantisation(&self, what: &str) -> Result<(f32, i8), TfliteError> {
        match (self.scales.as_slice(), self.zero_points.as_slice()) {
            (&[scale], &[zero]) if scale.is_finite() && scale > 0.0 => match i8::try_from(zero) {
                Ok(zero) => Ok((scale, zero)),
                Err(_) => unsupported(format!("{what}: zero point {zero} is no int8")),
            },
            ([], _) => unsupported(format!("{what} is not quantised")),
            (scales, _) if scales.len() > 1 => unsupported(format!(
                "{what} has {} scales; convert it with one scale per tensor \
                 (_experimental_disable_per_channel_quantization_for_dense_layers)",
                scales.len()
            )),
            _ => unsupported(format!("{what}: bad scale or zero point")),
        }
    }

    fn expect(&self, kind: i8, what: &str) -> Result<(), TfliteError> {
        if self.kind == kind {
            return Ok(());
        }
        unsupported(format!("{what} has tensor type {}, expected {kind}", self.kind))
    }

    /// Rows and columns of a constant matrix, both in 1..=[`MAX_WIDTH`], with `size` bytes each.
    fn matrix(&self, size: usize) -> Result<(usize, usize), TfliteError> {
        let &[rows, columns] = self.shape.as_slice() else {
            return unsupported(format!("weights of shape {:?}", self.shape));
        };
        let within = |n: i32| usize::try_from(n).ok().filter(|n| (1..=MAX_WIDTH).contains(n));
        match (within(rows), within(columns)) {
            (Some(rows), Some(columns)) if self.data.len() == rows * columns * size => Ok((rows, columns)),
            _ => unsupported(format!("weights of shape {:?} with {} bytes", self.shape, self.data.len())),
        }
    }
}

/// Reads a network from the bytes of a file. Never panics.
pub fn read(bytes: &[u8]) -> Result<Network, TfliteError> {
    if bytes.get(4..8) != Some(IDENTIFIER) {
        return Err(TfliteError::NotTflite);
    }
    if bytes.len() > MAX_BYTES {
        return unsupported(format!("{} bytes; at most {MAX_BYTES} are read", bytes.len()));
    }
    let model = Table::root(bytes)?;
    let codes = model.tables(1)?;
    let buffers = model.tables(4)?;
    let graphs = model.tables(2)?;
    let [graph] = graphs.as_slice() else {
        return unsupported(format!("{} graphs; one is expected", graphs.len()));
    };
    let tensors = graph.tables(0)?;
    let operators = graph.tables(3)?;
    if operators.len() > MAX_LAYERS + 1 {
        return unsupported(format!("{} operators; at most {} are read", operators.len(), MAX_LAYERS + 1));
    }
    let tensor = |index: i32| -> Result<Tensor<'_>, TfliteError> {
        let table = usize::try_from(index).ok().and_then(|n| tensors.get(n));
        let table = table.ok_or(TfliteError::Damaged)?;
        let buffer = usize::try_from(table.i32(2, 0)?).ok().and_then(|n| buffers.get(n));
        let quantisation = table.table(4)?;
        let (scales, zero_points) = match quantisation {
            Some(q) => (q.f32s(2)?, q.i64s(3)?),
            None => (Vec::new(), Vec::new()),
        };
        let data = buffer.ok_or(TfliteError::Damaged)?.bytes(0)?;
        Ok(Tensor { shape: table.i32s(0)?, kind: table.i8(1, 0)?, data, scales, zero_points })
    };

    let (&[input], &[output]) = (graph.i32s(1)?.as_slice(), graph.i32s(2)?.as_slice()) else {
        return unsupported("one input and one output are expected");
    };
    let is_int8 = match tensor(input)?.kind {
        schema::FLOAT32 => false,
        schema::INT8 => true,
        kind => return unsupported(format!("inputs of tensor type {kind}; float32 or int8 are expected")),
    };
    let mut floats = Vec::new();
    let mut ints = Vec::new();
    let mut at = input;
    let mut softmax = false;
    for (index, operator) in operators.iter().enumerate() {
        let code_index = usize::try_from(operator.i32(0, 0)?).map_err(|_| TfliteError::Damaged)?;
        let code = codes.get(code_index).ok_or(TfliteError::Damaged)?;
        // Old files have only the byte field, new ones both.
        let number = code.i32(3, 0)?.max(i32::from(code.i8(0, 0)?));
        let inputs = operator.i32s(1)?;
        let &[next] = operator.i32s(2)?.as_slice() else { return Err(TfliteError::Damaged) };
        if inputs.first() != Some(&at) || softmax {
            return unsupported("the operators do not form one chain that ends in a softmax");
        }
        match number {
            schema::FULLY_CONNECTED => {
                let &[_, weights, biases] = inputs.as_slice() else {
                    return unsupported(format!("layer {index} has no biases"));
                };
                let relu = match operator.table(4)?.map_or(Ok(0), |options| options.i8(0, 0))? {
                    0 => false,
                    schema::RELU => true,
                    other => {
                        return unsupported(format!(
                            "layer {index} has activation {other}; only ReLU is read"
                        ));
                    }
                };
                let (weights, biases) = (tensor(weights)?, tensor(biases)?);
                if is_int8 {
                    let before = tensor(at)?;
                    let after = tensor(next)?;
                    before.expect(schema::INT8, "a layer's input")?;
                    after.expect(schema::INT8, "a layer's output")?;
                    ints.push(int8_layer(&before, &weights, &biases, &after, relu)?);
                } else {
                    floats.push(float_layer(&weights, &biases, relu)?);
                }
            }
            schema::SOFTMAX => {
                let beta = operator.table(4)?.map_or(Ok(0.0), |options| options.f32(0, 0.0))?;
                if beta != 1.0 {
                    return unsupported(format!("softmax with beta {beta}; 1 is expected"));
                }
                if is_int8 && tensor(next)?.quantisation("the softmax's output")? != (1.0 / 256.0, -128) {
                    return unsupported("softmax output must have scale 1/256 and zero point -128");
                }
                softmax = true;
            }
            other => {
                let name = operator_name(other, code.text(1)?);
                return Err(TfliteError::ForeignOperator { index, name });
            }
        }
        at = next;
    }
    if !softmax || at != output || (floats.is_empty() && ints.is_empty()) {
        return unsupported("the operators do not form one chain that ends in a softmax");
    }
    let network = if is_int8 { Network::Int8(ints) } else { Network::Float(floats) };
    let widths: Vec<(usize, usize)> = match &network {
        Network::Float(layers) => layers.iter().map(|l| (l.weights[0].len(), l.weights.len())).collect(),
        Network::Int8(layers) => layers.iter().map(|l| (l.weights[0].len(), l.weights.len())).collect(),
    };
    if widths.windows(2).any(|pair| pair[0].1 != pair[1].0) {
        return unsupported("the layers' sizes do not fit together");
    }
    Ok(network)
}

fn float_layer(weights: &Tensor<'_>, biases: &Tensor<'_>, relu: bool) -> Result<FloatLayer, TfliteError> {
    weights.expect(schema::FLOAT32, "weights")?;
    biases.expect(schema::FLOAT32, "biases")?;
    let (rows, columns) = weights.matrix(4)?;
    let floats = |bytes: &[u8]| -> Vec<f32> {
        bytes.as_chunks().0.iter().map(|&word| f32::from_le_bytes(word)).collect()
    };
    let values = floats(weights.data);
    let biases = floats(biases.data);
    if biases.len() != rows {
        return unsupported(format!("{} biases for {rows} outputs", biases.len()));
    }
    if !values.iter().chain(&biases).all(|v| v.is_finite()) {
        return unsupported("a weight or bias is not finite");
    }
    Ok(FloatLayer { weights: values.chunks(columns).map(<[f32]>::to_vec).collect(), biases, relu })
}

fn int8_layer(
    before: &Tensor<'_>,
    weights: &Tensor<'_>,
    biases: &Tensor<'_>,
    after: &Tensor<'_>,
    relu: bool,
) -> Result<DenseSpec, TfliteError> {
    weights.expect(schema::INT8, "weights")?;
    biases.expect(schema::INT32, "biases")?;
    let (rows, columns) = weights.matrix(1)?;
    let words: &[[u8; 4]] = biases.data.as_chunks().0;
    if words.len() != rows {
        return unsupported(format!("{} biases for {rows} outputs", words.len()));
    }
    let (weight_scale, weight_zero) = weights.quantisation("weights")?;
    if weight_zero != 0 {
        return unsupported("weights must have zero point 0");
    }
    let (input_scale, input_zero_point) = before.quantisation("a layer's input")?;
    let (output_scale, output_zero_point) = after.quantisation("a layer's output")?;
    let rows = weights.data.chunks(columns).map(|row| row.iter().map(|&byte| byte as i8).collect());
    Ok(DenseSpec {
        weights: rows.collect(),
        biases: words.iter().map(|&word| i32::from_le_bytes(word)).collect(),
        input_scale,
        input_zero_point,
        weight_scale,
        output_scale,
        output_zero_point,
        relu,
    })
}
