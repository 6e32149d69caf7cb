//! Writes a TFLite file. The same network always gives the same bytes.

use flatbuffers::{FlatBufferBuilder, Push, PushAlignment, TableFinishedWIPOffset, WIPOffset};

use super::{Network, schema};

/// A finished table.
type Finished = WIPOffset<TableFinishedWIPOffset>;

/// A byte in a buffer of constants, which the schema aligns to 16 bytes.
/// The type only provides the alignment at which such a vector starts.
struct Aligned16(u8);

impl Push for Aligned16 {
    type Output = u8;

    unsafe fn push(&self, dst: &mut [u8], _written_len: usize) {
        dst[0] = self.0;
    }

    fn alignment() -> PushAlignment {
        PushAlignment::new(16)
    }
}

/// Returns the slot in a vtable that belongs to a field.
fn slot(id: u16) -> u16 {
    4 + 2 * id
}

struct Writer<'a> {
    out: FlatBufferBuilder<'a>,
    buffers: Vec<Finished>,
    tensors: Vec<Finished>,
    operators: Vec<Finished>,
}

/// The properties of a tensor.
/// Only quantised tensors have a zero point and one or more scales (one per channel).
struct Tensor<'a> {
    name: &'a str,
    shape: &'a [i32],
    kind: i8,
    data: &'a [u8],
    quantisation: Option<(Vec<f32>, i64)>,
}

impl Writer<'_> {
    /// Adds a buffer of constants. TFLite requires buffer 0 to be empty.
    fn buffer(&mut self, data: &[u8]) -> u32 {
        let vector = if data.is_empty() {
            None
        } else {
            self.out.start_vector::<Aligned16>(data.len());
            for &byte in data.iter().rev() {
                self.out.push(byte);
            }
            Some(self.out.end_vector::<u8>(data.len()))
        };
        let table = self.out.start_table();
        if let Some(vector) = vector {
            self.out.push_slot_always(slot(0), vector);
        }
        self.buffers.push(self.out.end_table(table));
        self.buffers.len() as u32 - 1
    }

    fn tensor(&mut self, tensor: &Tensor<'_>) -> i32 {
        let buffer = if tensor.data.is_empty() { 0 } else { self.buffer(tensor.data) };
        let name = self.out.create_string(tensor.name);
        let shape = self.out.create_vector(tensor.shape);
        let quantisation = tensor.quantisation.as_ref().map(|(scales, zero_point)| {
            let zero_points = self.out.create_vector(&vec![*zero_point; scales.len()]);
            let scales = self.out.create_vector(scales);
            let table = self.out.start_table();
            self.out.push_slot_always(slot(2), scales);
            self.out.push_slot_always(slot(3), zero_points);
            self.out.end_table(table)
        });
        let table = self.out.start_table();
        self.out.push_slot_always(slot(0), shape);
        self.out.push_slot(slot(1), tensor.kind, 0);
        self.out.push_slot(slot(2), buffer, 0);
        self.out.push_slot_always(slot(3), name);
        if let Some(quantisation) = quantisation {
            self.out.push_slot_always(slot(4), quantisation);
        }
        self.tensors.push(self.out.end_table(table));
        self.tensors.len() as i32 - 1
    }

    fn operator(&mut self, code: u32, inputs: &[i32], output: i32, kind: u8, options: Finished) {
        let inputs = self.out.create_vector(inputs);
        let outputs = self.out.create_vector(&[output]);
        let table = self.out.start_table();
        self.out.push_slot(slot(0), code, 0);
        self.out.push_slot_always(slot(1), inputs);
        self.out.push_slot_always(slot(2), outputs);
        self.out.push_slot(slot(3), kind, 0);
        self.out.push_slot_always(slot(4), options);
        self.operators.push(self.out.end_table(table));
    }

    fn operator_code(&mut self, code: i32) -> Finished {
        let table = self.out.start_table();
        self.out.push_slot(slot(0), code as i8, 0);
        // FULLY_CONNECTED supports int8 since version 4, and SOFTMAX since version 2.
        let version = if code == schema::FULLY_CONNECTED { 4 } else { 2 };
        self.out.push_slot(slot(2), version, 1);
        self.out.push_slot(slot(3), code, 0);
        self.out.end_table(table)
    }
}

/// Creates tensors of activations, all with the same type.
struct Activation(i8);

impl Activation {
    fn of<'a>(&self, name: &'a str, shape: &'a [i32], quantisation: Option<(f32, i64)>) -> Tensor<'a> {
        let quantisation = quantisation.map(|(scale, zero_point)| (vec![scale], zero_point));
        Tensor { name, shape, kind: self.0, data: &[], quantisation }
    }
}

/// A layer's constants as bytes, with its quantisation.
struct Constants {
    outputs: i32,
    inputs: i32,
    weights: Vec<u8>,
    biases: Vec<u8>,
    activation: i8,
    quantisation: Option<Scales>,
}

/// Scales of weights and biases, and the scale and zero point of the outputs.
type Scales = (Vec<f32>, Vec<f32>, (f32, i64));

/// Returns a TFLite file with this network, which has one input `[1, inputs]` and one output `[1, labels]`.
pub fn write(network: &Network) -> Vec<u8> {
    let int32 = |values: &[i32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let float = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let (input_quantisation, layers): (Option<(f32, i64)>, Vec<Constants>) = match network {
        Network::Float(layers) => {
            let constants = layers.iter().map(|layer| Constants {
                outputs: layer.weights.len() as i32,
                inputs: layer.weights[0].len() as i32,
                weights: float(&layer.weights.concat()),
                biases: float(&layer.biases),
                activation: if layer.relu { schema::RELU } else { 0 },
                quantisation: None,
            });
            (None, constants.collect())
        }
        Network::Int8(layers) => {
            let constants = layers.iter().map(|layer| Constants {
                outputs: layer.weights.len() as i32,
                inputs: layer.weights[0].len() as i32,
                weights: layer.weights.iter().flatten().map(|&w| w as u8).collect(),
                biases: int32(&layer.biases),
                activation: match (layer.relu, layer.largest) {
                    (false, _) => 0,
                    (true, i8::MAX) => schema::RELU,
                    (true, _) => schema::RELU6,
                },
                quantisation: Some((
                    layer.weight_scales.clone(),
                    layer.weight_scales.iter().map(|scale| layer.input_scale * scale).collect(),
                    (layer.output_scale, i64::from(layer.output_zero_point)),
                )),
            });
            let first = &layers[0];
            (Some((first.input_scale, i64::from(first.input_zero_point))), constants.collect())
        }
    };
    let (kind, bias_kind) = match network {
        Network::Float(_) => (schema::FLOAT32, schema::FLOAT32),
        Network::Int8(_) => (schema::INT8, schema::INT32),
    };

    let mut w = Writer {
        out: FlatBufferBuilder::new(),
        buffers: Vec::new(),
        tensors: Vec::new(),
        operators: Vec::new(),
    };
    w.buffer(&[]);
    let activation = Activation(kind);
    let input = w.tensor(&activation.of("features", &[1, layers[0].inputs], input_quantisation));
    let mut at = input;
    for (index, layer) in layers.iter().enumerate() {
        let scales = layer.quantisation.as_ref();
        let weights = w.tensor(&Tensor {
            name: &format!("dense{index}/weights"),
            shape: &[layer.outputs, layer.inputs],
            kind,
            data: &layer.weights,
            quantisation: scales.map(|(weights, _, _)| (weights.clone(), 0)),
        });
        let biases = w.tensor(&Tensor {
            name: &format!("dense{index}/biases"),
            shape: &[layer.outputs],
            kind: bias_kind,
            data: &layer.biases,
            quantisation: scales.map(|(_, biases, _)| (biases.clone(), 0)),
        });
        let name = format!("dense{index}");
        let after = w.tensor(&activation.of(&name, &[1, layer.outputs], scales.map(|(_, _, out)| *out)));
        let table = w.out.start_table();
        w.out.push_slot(slot(0), layer.activation, 0);
        let options = w.out.end_table(table);
        w.operator(0, &[at, weights, biases], after, schema::FULLY_CONNECTED_OPTIONS, options);
        at = after;
    }
    let labels = layers[layers.len() - 1].outputs;
    let scores_quantisation = input_quantisation.map(|_| (1.0 / 256.0, -128));
    let output = w.tensor(&activation.of("scores", &[1, labels], scores_quantisation));
    let table = w.out.start_table();
    w.out.push_slot(slot(0), 1.0f32, 0.0);
    let options = w.out.end_table(table);
    w.operator(1, &[at], output, schema::SOFTMAX_OPTIONS, options);

    let codes = [w.operator_code(schema::FULLY_CONNECTED), w.operator_code(schema::SOFTMAX)];
    let codes = w.out.create_vector(&codes);
    let tensors = w.out.create_vector(&w.tensors);
    let operators = w.out.create_vector(&w.operators);
    let inputs = w.out.create_vector(&[input]);
    let outputs = w.out.create_vector(&[output]);
    let name = w.out.create_string("main");
    let table = w.out.start_table();
    w.out.push_slot_always(slot(0), tensors);
    w.out.push_slot_always(slot(1), inputs);
    w.out.push_slot_always(slot(2), outputs);
    w.out.push_slot_always(slot(3), operators);
    w.out.push_slot_always(slot(4), name);
    let graph = w.out.end_table(table);
    let graphs = w.out.create_vector(&[graph]);
    let buffers = w.out.create_vector(&w.buffers);
    let description = w.out.create_string("bimanual");
    let table = w.out.start_table();
    w.out.push_slot(slot(0), 3u32, 0);
    w.out.push_slot_always(slot(1), codes);
    w.out.push_slot_always(slot(2), graphs);
    w.out.push_slot_always(slot(3), description);
    w.out.push_slot_always(slot(4), buffers);
    let model = w.out.end_table(table);
    w.out.finish(model, Some("TFL3"));
    w.out.finished_data().to_vec()
}
