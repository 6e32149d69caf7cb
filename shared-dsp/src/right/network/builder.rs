//! Builds a blob from the numbers in a quantised TFLite model. Only laptops use this code.

use super::kernel::{ROW_SCALE_BYTES, encode, surplus};
use super::{
    BLOB_VERSION, BLOB_VERSION_PER_ROW, MAGIC, MAX_AXES, MAX_LABELS, MAX_LAYERS, MAX_WIDTH, Model, ModelError,
};
use crate::right::kind::FeatureKind;
use crate::right::softmax::table::exponentials;
use core::fmt;
use std::string::String;
use std::vec::Vec;

/// One fully connected layer in the form in which TFLite stores it.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseSpec {
    /// `weights[output][input]`, each in −127..=127, with zero point 0.
    pub weights: Vec<Vec<i8>>,
    /// One bias per output, in units of the input scale times the weights' scale.
    pub biases: Vec<i32>,
    /// Real value of one step of the layer's inputs.
    pub input_scale: f32,
    /// The input value that represents 0.
    pub input_zero_point: i8,
    /// Real value of one step of the weights.
    /// There is one value for all outputs, or one per output (TFLite's quantisation per channel).
    pub weight_scales: Vec<f32>,
    /// Real value of one step of the layer's outputs.
    pub output_scale: f32,
    /// The output value that represents 0.
    pub output_zero_point: i8,
    /// Whether a ReLU is fused into the layer.
    pub relu: bool,
    /// Maximum output: 127, or less if the layer has a ReLU6.
    pub largest: i8,
}

impl DenseSpec {
    /// Returns whether rows have different scales or limits, which version 1 of the blob does not support.
    fn is_per_row(&self) -> bool {
        self.weight_scales.len() != 1 || self.largest != i8::MAX
    }
}

/// The complete contents of a blob.
#[derive(Clone, Debug, PartialEq)]
pub struct BlobSpec {
    /// The conversion of features to the network's inputs.
    pub recipe: FeatureKind,
    /// Values per sample.
    pub axes: usize,
    /// Samples per second.
    pub sample_hz: u16,
    /// Samples per window.
    pub window: u16,
    /// Samples per hop.
    pub hop: u16,
    /// Names of the outputs in order. A name must not be empty or contain commas.
    pub labels: Vec<String>,
    /// (a, b) for each feature: input = round(a · feature + b). This is applied after the recipe.
    /// To standardise and quantise, set a = 1 / (deviation · input scale) and b = zero point − mean · a.
    pub scaling: Vec<(f32, f32)>,
    /// The layers in order. After them, a softmax uses the output scale of the last layer.
    pub layers: Vec<DenseSpec>,
}

/// The reason why a blob cannot be built.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum BuildError {
    /// Sizes contradict each other or exceed a maximum. The text describes these sizes.
    Shape(String),
    /// A number cannot be represented. The text describes this number.
    Value(String),
    /// The finished blob cannot be parsed.
    Parse(ModelError),
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape(text) | Self::Value(text) => f.write_str(text),
            Self::Parse(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for BuildError {}

fn shape<T>(text: String) -> Result<T, BuildError> {
    Err(BuildError::Shape(text))
}

/// Computes TFLite's `QuantizeMultiplier`: `real` = multiplier · 2^(exponent − 31), with the multiplier in 2³⁰..2³¹.
fn quantise_multiplier(real: f64) -> Option<(i32, i32)> {
    if !(real.is_finite() && real >= f64::MIN_POSITIVE) {
        return None;
    }
    // As in `frexp`, real = fraction · 2^exponent with the fraction in ½..1.
    let bits = real.to_bits();
    let mut exponent = ((bits >> 52) & 0x7FF) as i32 - 1022;
    let fraction = f64::from_bits((bits & !(0x7FF << 52)) | (1022 << 52));
    let mut fixed = (fraction * (1i64 << 31) as f64).round() as i64;
    if fixed == 1 << 31 {
        fixed /= 2;
        exponent += 1;
    }
    Some((i32::try_from(fixed).ok()?, exponent))
}

/// Builds a blob. The same input always gives the same bytes.
///
/// # Errors
/// Fails if sizes contradict each other or exceed the format's maxima, or if numbers cannot be represented.
pub fn build_blob(spec: &BlobSpec) -> Result<Vec<u8>, BuildError> {
    let inputs = spec.recipe.feature_count(spec.axes);
    if !(1..=MAX_AXES).contains(&spec.axes) {
        return shape(std::format!("{} axes: 1 to {MAX_AXES} are possible", spec.axes));
    }
    if inputs == 0 {
        return shape(std::format!("recipe {} cannot use {} axes", spec.recipe.id(), spec.axes));
    }
    if spec.scaling.len() != inputs {
        return shape(std::format!("{} scalings for {inputs} features", spec.scaling.len()));
    }
    if !(2..=MAX_LABELS).contains(&spec.labels.len()) {
        return shape(std::format!("{} labels: 2 to {MAX_LABELS} are possible", spec.labels.len()));
    }
    let is_bad = |label: &str| {
        label.is_empty() || !label.bytes().all(|byte| matches!(byte, b' '..=b'~') && byte != b',')
    };
    if let Some(label) = spec.labels.iter().find(|label| is_bad(label)) {
        return Err(BuildError::Value(std::format!(
            "label \"{label}\" is not of printable ASCII without commas"
        )));
    }
    if !(1..=MAX_LAYERS).contains(&spec.layers.len()) {
        return shape(std::format!("{} layers: 1 to {MAX_LAYERS} are possible", spec.layers.len()));
    }
    let text = spec.labels.join(",");
    let table = softmax_table(spec)?;

    let mut blob = Vec::new();
    blob.extend(MAGIC);
    // Uses version 1 whenever possible, so that older images can read the blob and model ids do not change.
    let per_row = spec.layers.iter().any(DenseSpec::is_per_row);
    let version = if per_row { BLOB_VERSION_PER_ROW } else { BLOB_VERSION };
    blob.extend([version, spec.recipe.id(), spec.axes as u8, spec.layers.len() as u8]);
    for short in [spec.sample_hz, spec.window, spec.hop, inputs as u16] {
        blob.extend(short.to_le_bytes());
    }
    blob.extend([spec.labels.len() as u8, 0]);
    let text_bytes = u16::try_from(text.len())
        .map_err(|_| BuildError::Shape(String::from("the labels are longer than 65535 bytes")))?;
    for short in [text_bytes, table.len() as u16, 0] {
        blob.extend(short.to_le_bytes());
    }
    blob.extend([0; 4]); // size, below
    for (a, b) in &spec.scaling {
        blob.extend(a.to_le_bytes());
        blob.extend(b.to_le_bytes());
    }
    let mut width = inputs;
    for (index, layer) in spec.layers.iter().enumerate() {
        push_layer(&mut blob, index, layer, width)?;
        width = layer.weights.len();
    }
    for value in &table {
        blob.extend(value.to_le_bytes());
    }
    blob.extend(text.as_bytes());
    blob.resize(blob.len().next_multiple_of(4), 0);
    let size = blob.len() as u32;
    blob[24..28].copy_from_slice(&size.to_le_bytes());
    Model::parse(&blob).map_err(BuildError::Parse)?;
    Ok(blob)
}

fn softmax_table(spec: &BlobSpec) -> Result<Vec<i32>, BuildError> {
    let scale = spec.layers.last().map_or(0.0, |layer| layer.output_scale);
    let bad = || BuildError::Value(std::format!("softmax: an input scale of {scale} cannot be represented"));
    // TFLite's PreprocessSoftmaxScaling, with beta 1 and 5 integer bits.
    let real = (f64::from(scale) * f64::from(1u32 << 26)).min(f64::from(i32::MAX));
    let (multiplier, exponent) = quantise_multiplier(real).ok_or_else(bad)?;
    let left_shift = u32::try_from(exponent).ok().filter(|&shift| shift <= 31).ok_or_else(bad)?;
    Ok(exponentials(multiplier, left_shift))
}

fn push_layer(blob: &mut Vec<u8>, index: usize, layer: &DenseSpec, inputs: usize) -> Result<(), BuildError> {
    let outputs = layer.weights.len();
    if !(1..=MAX_WIDTH).contains(&outputs) || inputs > MAX_WIDTH {
        return shape(std::format!(
            "layer {index} is {inputs} to {outputs}: at most {MAX_WIDTH} are possible"
        ));
    }
    if layer.weights.iter().any(|row| row.len() != inputs) || layer.biases.len() != outputs {
        return shape(std::format!("layer {index}: weights and biases are not {outputs} × {inputs}"));
    }
    if layer.weights.iter().flatten().any(|&weight| weight == -128) {
        return Err(BuildError::Value(std::format!("layer {index}: weight −128 (TFLite uses −127 to 127)")));
    }
    if layer.weight_scales.len() != 1 && layer.weight_scales.len() != outputs {
        return shape(std::format!(
            "layer {index}: {} scales for {outputs} outputs",
            layer.weight_scales.len()
        ));
    }
    let scales = row_scales(index, layer)?;
    let smallest = if layer.relu { layer.output_zero_point } else { i8::MIN };
    if layer.largest < smallest {
        return Err(BuildError::Value(std::format!(
            "layer {index}: its largest output is below its smallest"
        )));
    }
    let per_row = layer.is_per_row();
    blob.extend((inputs as u16).to_le_bytes());
    blob.extend((outputs as u16).to_le_bytes());
    let (multiplier, right_shift) = if per_row { (0, layer.largest as u8) } else { scales[0] };
    blob.extend(multiplier.to_le_bytes());
    blob.extend([right_shift, layer.output_zero_point as u8, smallest as u8, u8::from(per_row)]);

    for block in 0..outputs.div_ceil(4) {
        let rows: Vec<usize> = (4 * block..4 * block + 4).collect();
        for &row in &rows {
            let bias = match layer.weights.get(row) {
                Some(weights) => {
                    let sum: i64 = weights.iter().map(|&weight| i64::from(weight)).sum();
                    i64::from(layer.biases[row]) - i64::from(layer.input_zero_point) * sum - surplus(weights)
                }
                None => 0,
            };
            let bias = i32::try_from(bias).map_err(|_| {
                BuildError::Value(std::format!(
                    "layer {index}: the bias of output {row} does not fit 32 bits"
                ))
            })?;
            blob.extend(bias.to_le_bytes());
        }
        for quad in 0..inputs.div_ceil(4) {
            for &row in &rows {
                let weight = |column: usize| -> i8 {
                    layer.weights.get(row).and_then(|r| r.get(column)).copied().unwrap_or(0)
                };
                blob.extend(encode(core::array::from_fn(|i| weight(4 * quad + i))));
            }
        }
    }
    if per_row {
        for block in 0..outputs.div_ceil(4) {
            let row = |n: usize| {
                let row = (4 * block + n).min(outputs - 1);
                scales[row.min(scales.len() - 1)]
            };
            let before = blob.len();
            blob.extend((0..4).flat_map(|n| row(n).0.to_le_bytes()));
            blob.extend((0..4).map(|n| row(n).1));
            debug_assert_eq!(blob.len() - before, ROW_SCALE_BYTES);
        }
    }
    Ok(())
}

/// Multiplier and right shift that correspond to each scale of the weights.
fn row_scales(index: usize, layer: &DenseSpec) -> Result<Vec<(i32, u8)>, BuildError> {
    let one = |&weight_scale: &f32| {
        // TFLite multiplies and divides the scales as doubles.
        // Older releases used floats for the scale of a whole tensor. One output in 400,000 then differs.
        let real = f64::from(layer.input_scale) * f64::from(weight_scale) / f64::from(layer.output_scale);
        let scale = quantise_multiplier(real);
        // If all weights of a row are zero, it has no scale. TFLite then multiplies by 0, and our result is also 0 for every 32-bit sum.
        if layer.weight_scales.len() > 1 && scale.is_some_and(|(_, exponent)| exponent < -31) {
            return Ok((1 << 30, 62));
        }
        scale
            .and_then(|(multiplier, exponent)| Some((multiplier, u8::try_from(31 - exponent).ok()?)))
            .filter(|(_, shift)| (1..=62).contains(shift))
            .ok_or_else(|| {
                BuildError::Value(std::format!(
                    "layer {index}: its scales give the factor {real:e}, out of range"
                ))
            })
    };
    layer.weight_scales.iter().map(one).collect()
}
