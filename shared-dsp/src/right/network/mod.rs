//! An int8 dense network in a blob. It is parsed without copying and run without floats.
//!
//! The arithmetic is TFLite's with single rounding (`int32` accumulators, fixed-point requantisation, int8 softmax).
//! The outputs equal those of TFLite's reference kernels bit for bit.
//!
//! # The blob
//! All numbers are little-endian, and all sections start at multiples of 4 bytes.
//! The model id is the CRC-32 (ISO-HDLC) of the complete blob.
//!
//! | offset | bytes | contents |
//! |---|---|---|
//! | 0 | 4 | `BMLP` |
//! | 4 | 1 | format version: 1, or 2 if a layer's rows have individual scales |
//! | 6 | 1 | axes, 1 to 9 |
//! | 7 | 1 | layers, 1 to 8 |
//! | 8 | 2 | samples per second |
//! | 10 | 2 | samples per window |
//! | 12 | 2 | samples per hop |
//! | 14 | 2 | inputs (features): 13 per axis, or a total of 45 or 89 for recipe 3 |
//! | 16 | 1 | labels, 2 to 16 |
//! | 17 | 1 | 0 |
//! | 18 | 2 | bytes of label text |
//! | 20 | 2 | number of entries in the exponential table, 1 to 256 |
//! | 22 | 2 | 0 |
//! | 24 | 4 | length of the complete blob in bytes |
//! | 28 | 8 · inputs | `a`, `b` as `f32` for each feature: input = round(a · feature + b) |
//! | | layers | see below |
//! | | 4 · entries | exp(−d · scale) as Q0.31 for d = 0, 1, … |
//! | | text | labels in order, separated by commas; printable ASCII, padded with zeros |
//!
//! Each layer starts with a header of 12 bytes.
//! The header contains the inputs (u16), the outputs (u16) and the multiplier (i32 in 2³⁰..2³¹).
//! After these, it contains the right shift (u8 in 1..=62), the output zero point (i8),
//! the minimum output (i8), and 0.
//! For every four outputs, four biases (i32) follow, and then the weights in the order of [`kernel`](self).
//! First come the weights of rows 0, 1, 2 and 3 for the first four columns.
//! Then come the weights of these rows for the next four columns.
//! Rows and columns that do not exist are zero. The biases include the zero points of the inputs.
//!
//! In version 2, the last byte of a layer's header may be 1, which means that each row has its own scale.
//! The header's multiplier is then 0, and the maximum output (i8) replaces the shift.
//! After the weights, four multipliers (i32) and four shifts (u8) follow for every four outputs.

#[cfg(feature = "build")]
mod builder;
mod error;
mod kernel;

#[cfg(feature = "build")]
pub use builder::{BlobSpec, BuildError, DenseSpec, build_blob};

pub use error::{ModelError, WrongLength};

use crate::right::kind::FeatureKind;
use crate::right::softmax::softmax;
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use kernel::{
    BIAS_BYTES, QUAD_WEIGHT_BYTES, Quad, ROW_SCALE_BYTES, Requantise, layer, layer_per_row, pack, unpack,
};

/// Maximum number of layers in a blob.
pub const MAX_LAYERS: usize = 8;
/// Maximum number of inputs or outputs of a layer.
pub const MAX_WIDTH: usize = 256;
/// Maximum number of labels.
pub const MAX_LABELS: usize = 16;
/// Maximum number of axes.
pub const MAX_AXES: usize = 9;
/// Features per axis.
pub const FEATURES_PER_AXIS: usize = 13;
/// Version of the blob's format.
pub const BLOB_VERSION: u8 = 1;
/// Version of blobs in which a layer's rows have individual scales.
pub const BLOB_VERSION_PER_ROW: u8 = 2;

const MAGIC: &[u8; 4] = b"BMLP";
const HEADER_BYTES: usize = 28;
const LAYER_HEADER_BYTES: usize = 12;

/// The small scratch memory suffices for layers with up to this number of inputs and outputs, in quads.
/// Normal networks therefore need little stack.
const SMALL_SCRATCH_QUADS: usize = 35;
const LARGE_SCRATCH_QUADS: usize = 2 * MAX_WIDTH / 4;

/// The requirements of a model, and its labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelHeader<'a> {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// The conversion of features to inputs.
    pub recipe: FeatureKind,
    /// Number of values per sample, 1 to [`MAX_AXES`].
    pub axes: usize,
    /// Samples per second.
    pub sample_hz: u16,
    /// Samples per window.
    pub window: u16,
    /// Samples per hop.
    pub hop: u16,
    /// Number of inputs of the network: [`FeatureKind::feature_count`] of the axes.
    pub inputs: usize,
    /// Number of labels, 2 to [`MAX_LABELS`].
    pub label_count: usize,
    /// Names of the outputs in order, separated by commas.
    pub label_text: &'a str,
}

impl<'a> ModelHeader<'a> {
    /// Returns the names of the outputs in order.
    pub fn labels(&self) -> core::str::Split<'a, char> {
        self.label_text.split(',')
    }

    /// Returns the name of one output.
    pub fn label(&self, index: usize) -> Option<&'a str> {
        self.labels().nth(index)
    }
}

/// A network, with its labels and scaling, that borrows from a blob.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    info: ModelHeader<'a>,
    scaling: &'a [[u8; 8]],
    layers: &'a [u8],
    exponentials: &'a [[u8; 4]],
    small: bool,
}

/// A dense layer in the form in which the blob stores it.
struct Dense<'a> {
    inputs: usize,
    outputs: usize,
    requantise: Requantise,
    blocks: &'a [u8],
    /// Scales of the rows if each row has its own; otherwise empty.
    row_scales: &'a [u8],
    /// 1 if each row has its own scale, 0 if all rows share a scale.
    per_row: u8,
}

impl<'a> Dense<'a> {
    /// Removes the next layer from the front of `bytes`.
    fn take(bytes: &mut &'a [u8]) -> Option<Self> {
        let (header, rest) = bytes.split_first_chunk::<LAYER_HEADER_BYTES>()?;
        let inputs = usize::from(u16::from_le_bytes([header[0], header[1]]));
        let outputs = usize::from(u16::from_le_bytes([header[2], header[3]]));
        let block = BIAS_BYTES + inputs.div_ceil(4) * QUAD_WEIGHT_BYTES;
        let (blocks, rest) = rest.split_at_checked(outputs.div_ceil(4) * block)?;
        let per_row = header[11];
        let (row_scales, rest) = if per_row == 0 {
            (&[][..], rest)
        } else {
            rest.split_at_checked(outputs.div_ceil(4) * ROW_SCALE_BYTES)?
        };
        *bytes = rest;
        let requantise = Requantise {
            multiplier: i32::from_le_bytes([header[4], header[5], header[6], header[7]]),
            shift: u32::from(header[8]),
            zero_point: i32::from(header[9] as i8),
            smallest: i32::from(header[10] as i8),
        };
        Some(Self { inputs, outputs, requantise, blocks, row_scales, per_row })
    }

    /// Returns whether the layer is valid in a blob of this version.
    fn is_sound(&self, version: u8) -> bool {
        let scale = |multiplier: i32, shift: u32| multiplier >= 1 << 30 && (1..=62).contains(&shift);
        let scaled = match self.per_row {
            0 => scale(self.requantise.multiplier, self.requantise.shift),
            1 => {
                let largest = i32::from(self.requantise.shift as u8 as i8);
                let (blocks, _) = self.row_scales.as_chunks::<ROW_SCALE_BYTES>();
                let all = blocks.iter().all(|block| {
                    let (multipliers, shifts) = block.split_at(16);
                    let pairs = multipliers.as_chunks::<4>().0.iter().zip(shifts);
                    pairs.fold(true, |all, (m, s)| all & scale(i32::from_le_bytes(*m), u32::from(*s)))
                });
                version == BLOB_VERSION_PER_ROW && all && largest >= self.requantise.smallest
            }
            _ => false,
        };
        (1..=MAX_WIDTH).contains(&self.inputs) && (1..=MAX_WIDTH).contains(&self.outputs) && scaled
    }
}

impl<'a> Model<'a> {
    /// Checks a blob and borrows a model from it. Extra bytes after the blob are ignored.
    ///
    /// Any alignment works, but a blob at a multiple of 4 bytes runs about three times faster on a Cortex-M4F.
    ///
    /// # Errors
    /// Returns the problem with the blob. This never panics, whatever the bytes are.
    #[inline(never)]
    pub fn parse(blob: &'a [u8]) -> Result<Self, ModelError> {
        let header = blob.first_chunk::<HEADER_BYTES>().ok_or(ModelError::Truncated)?;
        let short = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        if !header.starts_with(MAGIC) {
            return Err(ModelError::NotAModel);
        }
        if !matches!(header[4], BLOB_VERSION | BLOB_VERSION_PER_ROW) {
            return Err(ModelError::Version(header[4]));
        }
        let recipe = FeatureKind::from_id(header[5]).ok_or(ModelError::Recipe(header[5]))?;
        let (axes, layer_count) = (usize::from(header[6]), usize::from(header[7]));
        let (inputs, label_count) = (usize::from(short(14)), usize::from(header[16]));
        let (text_bytes, entries) = (usize::from(short(18)), usize::from(short(20)));
        let size = u32::from_le_bytes([header[24], header[25], header[26], header[27]]) as usize;
        let in_range = (1..=MAX_AXES).contains(&axes)
            && (1..=MAX_LAYERS).contains(&layer_count)
            && inputs > 0
            && inputs == recipe.feature_count(axes)
            && (2..=MAX_LABELS).contains(&label_count)
            && (1..=256).contains(&entries)
            && (short(8) > 0 && short(10) > 0 && short(12) > 0)
            && (header[17] == 0 && short(22) == 0);
        if !in_range {
            return Err(ModelError::Header);
        }
        let blob = blob.get(..size).ok_or(ModelError::Truncated)?;
        let rest = blob.get(HEADER_BYTES..).ok_or(ModelError::Header)?;

        let (scaling, rest) = rest.split_at_checked(8 * inputs).ok_or(ModelError::Truncated)?;
        let (scaling, _) = scaling.as_chunks::<8>();
        for (feature, pair) in scaling.iter().enumerate() {
            let (a, b) = scale_of(pair);
            if !(a.is_finite() && b.is_finite()) {
                return Err(ModelError::Scaling { feature });
            }
        }

        let mut tail = rest;
        let mut width = inputs;
        let mut scratch = 0;
        for layer in 0..layer_count {
            let dense = Dense::take(&mut tail).ok_or(ModelError::Truncated)?;
            if !dense.is_sound(header[4]) || dense.inputs != width {
                return Err(ModelError::Layer { layer });
            }
            scratch = scratch.max(width.div_ceil(4) + dense.outputs.div_ceil(4));
            width = dense.outputs;
        }
        if width != label_count {
            return Err(ModelError::Labels);
        }
        let layers = &rest[..rest.len() - tail.len()];

        let (exponentials, rest) = tail.split_at_checked(4 * entries).ok_or(ModelError::Truncated)?;
        let (exponentials, _) = exponentials.as_chunks::<4>();
        let mut last = i32::MAX;
        for (index, word) in exponentials.iter().enumerate() {
            let value = i32::from_le_bytes(*word);
            // The first value is 1.
            // A sum of 16 values stays in range, because each value is between 0 and the first value.
            if value < 0 || value > last || (index == 0 && value != i32::MAX) {
                return Err(ModelError::ExponentialTable);
            }
            last = value;
        }

        let text = rest.get(..text_bytes).ok_or(ModelError::Truncated)?;
        if rest.len() != text_bytes.next_multiple_of(4) {
            return Err(ModelError::Header);
        }
        // One pass checks that all bytes are printable, no label is empty, and the number of labels is correct.
        let (mut commas, mut last) = (0, b',');
        for &byte in text {
            if !(b' '..=b'~').contains(&byte) || (byte == b',' && last == b',') {
                return Err(ModelError::Labels);
            }
            commas += usize::from(byte == b',');
            last = byte;
        }
        if last == b',' || commas + 1 != label_count {
            return Err(ModelError::Labels);
        }
        // SAFETY: all bytes are ASCII.
        let label_text = unsafe { core::str::from_utf8_unchecked(text) };

        Ok(Self {
            info: ModelHeader {
                model_id: crc32(blob),
                recipe,
                axes,
                sample_hz: short(8),
                window: short(10),
                hop: short(12),
                inputs,
                label_count,
                label_text,
            },
            scaling,
            layers,
            exponentials,
            small: scratch <= SMALL_SCRATCH_QUADS,
        })
    }

    /// The requirements of the model, and its labels.
    pub fn info(&self) -> &ModelHeader<'a> {
        &self.info
    }

    /// Converts features (13 per axis, in the order of [`crate::right::features`]) to the network's int8 inputs.
    ///
    /// An input is floor(a · f + b + ½), limited to −128..=127 and computed in `f32` in this order.
    /// In this formula, f is the feature after the recipe. A NaN feature becomes −128.
    ///
    /// # Errors
    /// Fails if the number of features or inputs differs from the model's.
    pub fn quantise(
        &self,
        features: &[[f32; FEATURES_PER_AXIS]],
        inputs: &mut [i8],
    ) -> Result<(), WrongLength> {
        if features.len() != self.info.axes || inputs.len() != self.scaling.len() {
            return Err(WrongLength);
        }
        for (index, input) in inputs.iter_mut().enumerate() {
            *input = self.quantise_one(features.as_flattened(), index) as i8;
        }
        Ok(())
    }

    /// Computes one input in int8 range, or 0 after the last input. Inlining would produce this code four times.
    #[inline(never)]
    fn quantise_one(&self, features: &[f32], index: usize) -> i32 {
        let (Some(&feature), Some(pair)) = (features.get(index), self.scaling.get(index)) else {
            return 0;
        };
        input_of(pair, self.info.recipe.transform(index, feature))
    }

    /// Converts int8 inputs to int8 scores, one per label, without floats.
    /// The probability is (score + 128) / 256.
    ///
    /// # Errors
    /// Fails if the number of inputs or scores differs from the model's.
    pub fn infer(&self, inputs: &[i8], scores: &mut [i8]) -> Result<(), WrongLength> {
        self.infer_with_logits(inputs, &mut [0; MAX_LABELS], scores)
    }

    /// Like [`Model::infer`], but also returns the inputs of the softmax.
    /// Only the first `label_count` values are defined.
    ///
    /// # Errors
    /// Fails if the number of inputs or scores differs from the model's.
    pub fn infer_with_logits(
        &self,
        inputs: &[i8],
        logits: &mut [i8; MAX_LABELS],
        scores: &mut [i8],
    ) -> Result<(), WrongLength> {
        if inputs.len() != self.info.inputs {
            return Err(WrongLength);
        }
        self.dispatch(&|scratch| pack_inputs(inputs, scratch), logits, scores)
    }

    /// Converts features to scores. It combines [`Model::quantise`] and [`Model::infer`], without an intermediate buffer.
    ///
    /// # Errors
    /// Fails if the number of axes or scores differs from the model's.
    pub fn classify(
        &self,
        features: &[[f32; FEATURES_PER_AXIS]],
        scores: &mut [i8],
    ) -> Result<(), WrongLength> {
        self.classify_features(features.as_flattened(), scores)
    }

    /// Like [`Model::classify`], but takes a flat slice of features of any recipe.
    ///
    /// # Errors
    /// Fails if the number of features or scores differs from the model's.
    pub fn classify_features(&self, features: &[f32], scores: &mut [i8]) -> Result<(), WrongLength> {
        if features.len() != self.info.inputs {
            return Err(WrongLength);
        }
        let fill = |scratch: &mut [Quad]| {
            // Features that stay unchanged need no index, which halves the work. The last few take the general way.
            let mut done = 0;
            if self.info.recipe != FeatureKind::LogPower {
                let ((features, _), (pairs, _)) = (features.as_chunks::<4>(), self.scaling.as_chunks::<4>());
                done = features.len();
                for ((quad, values), pairs) in scratch.iter_mut().zip(features).zip(pairs) {
                    *quad = pack(core::array::from_fn(|i| input_of(&pairs[i], values[i]) as i8));
                }
            }
            let quads = scratch.iter_mut().enumerate().take(self.info.inputs.div_ceil(4));
            for (index, quad) in quads.skip(done) {
                *quad = pack(core::array::from_fn(|i| self.quantise_one(features, 4 * index + i) as i8));
            }
        };
        self.dispatch(&fill, &mut [0; MAX_LABELS], scores)
    }

    /// Selects a scratch memory, so that the network uses no more stack than necessary.
    fn dispatch(
        &self,
        fill: &dyn Fn(&mut [Quad]),
        logits: &mut [i8; MAX_LABELS],
        scores: &mut [i8],
    ) -> Result<(), WrongLength> {
        if scores.len() != self.info.label_count {
            return Err(WrongLength);
        }
        if self.small {
            self.with_scratch::<SMALL_SCRATCH_QUADS>(fill, logits);
        } else {
            self.with_scratch::<LARGE_SCRATCH_QUADS>(fill, logits);
        }
        softmax(self.exponentials, logits.get(..scores.len()).ok_or(WrongLength)?, scores);
        Ok(())
    }

    // The code that fills the inputs is in a separate function, so that it exists only once.
    // The stack of this function is free again before the layers run.
    #[inline(never)]
    fn with_scratch<const QUADS: usize>(&self, fill: &dyn Fn(&mut [Quad]), logits: &mut [i8; MAX_LABELS]) {
        let mut scratch = [0; QUADS];
        Self::fill(&mut scratch, fill);
        self.forward(&mut scratch, logits);
    }

    #[inline(never)]
    fn fill(scratch: &mut [Quad], fill: &dyn Fn(&mut [Quad])) {
        fill(scratch);
    }

    /// Runs the layers.
    /// First, the inputs are at the start of `scratch`. Then inputs and outputs alternate between its two ends.
    #[inline(never)]
    fn forward(&self, scratch: &mut [Quad], logits: &mut [i8; MAX_LABELS]) {
        let mut layers = self.layers;
        let mut at_start = true;
        // The layer is passed by reference, because a copy of its numbers would use stack.
        while let Some(dense) = &Dense::take(&mut layers) {
            let (ins, outs) = (dense.inputs.div_ceil(4), dense.outputs.div_ceil(4));
            let middle = if at_start { ins } else { scratch.len().saturating_sub(ins) };
            let Some((start, end)) = scratch.split_at_mut_checked(middle) else { return };
            let (input, output) = if at_start {
                let free = end.len().saturating_sub(outs);
                let Some(output) = end.get_mut(free..) else { return };
                (&*start, output)
            } else {
                (&*end, start)
            };
            if dense.per_row == 0 {
                layer(dense.blocks, input, &mut output[..outs], &dense.requantise);
            } else {
                // The field of the shift contains the maximum output.
                let largest = dense.requantise.shift as u8 as i8;
                let output = &mut output[..outs];
                layer_per_row(dense.blocks, dense.row_scales, input, output, &dense.requantise, largest);
            }
            if layers.is_empty() {
                for (four, quad) in logits.chunks_exact_mut(4).zip(&*output) {
                    for (logit, value) in four.iter_mut().zip(unpack(*quad)) {
                        *logit = value;
                    }
                }
            }
            at_start = !at_start;
        }
    }
}

fn pack_inputs(inputs: &[i8], scratch: &mut [Quad]) {
    let (quads, rest) = inputs.as_chunks::<4>();
    for (packed, quad) in scratch.iter_mut().zip(quads) {
        *packed = pack(*quad);
    }
    if let (false, Some(packed)) = (rest.is_empty(), scratch.get_mut(quads.len())) {
        *packed = pack(core::array::from_fn(|i| rest.get(i).copied().unwrap_or(0)));
    }
}

/// Computes an input in int8 range from a transformed feature.
#[inline(always)]
fn input_of(pair: &[u8; 8], value: f32) -> i32 {
    let (a, b) = scale_of(pair);
    // The cast truncates, saturates, and maps NaN to 0; the offset makes truncation a floor.
    ((a * value + b + 128.5) as i32).clamp(0, 255) - 128
}

fn scale_of(pair: &[u8; 8]) -> (f32, f32) {
    let [a0, a1, a2, a3, b0, b1, b2, b3] = *pair;
    (f32::from_le_bytes([a0, a1, a2, a3]), f32::from_le_bytes([b0, b1, b2, b3]))
}

/// Returns the CRC-32 (ISO-HDLC, as in zip and PNG) of a blob, which is its model id.
pub fn crc32(blob: &[u8]) -> u32 {
    // The code uses no table: it runs only once at start, and a table would need a kilobyte of flash.
    const ISO_HDLC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);
    ISO_HDLC.checksum(blob)
}
