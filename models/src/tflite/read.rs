//! Reads a network from the bytes of a file.

use shared_dsp::right::network::DenseSpec;

use super::flat::Table;
use super::{FloatLayer, IDENTIFIER, MAX_BYTES, MAX_LAYERS, MAX_WIDTH, Network, TfliteError, names, schema};

/// Maximum number of other operators.
/// The other operators are QUANTIZE, DEQUANTIZE, SOFTMAX, and RESHAPE with the computation of its shape.
const MAX_OTHERS: usize = 4 * MAX_LAYERS + 4;

/// The output of the last operator in a file. In either case, our own softmax computes the probabilities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Probabilities.
    Softmax,
    /// What a softmax would take.
    Logits,
}

fn unsupported<T>(text: impl Into<String>) -> Result<T, TfliteError> {
    Err(TfliteError::Unsupported(text.into()))
}

/// One tensor of the graph.
struct Tensor<'a> {
    shape: Vec<i32>,
    kind: i8,
    data: &'a [u8],
    scales: Vec<f32>,
    zero_points: Vec<i64>,
    /// The dimension along which channels have individual scales.
    dimension: i32,
}

impl Tensor<'_> {
    /// Returns the scale and the zero point of a tensor of activations. There must be only one of each.
    fn quantisation(&self, what: &str) -> Result<(f32, i64), TfliteError> {
        match (self.scales.as_slice(), self.zero_points.as_slice()) {
            (&[scale], &[zero]) if scale.is_finite() && scale > 0.0 => Ok((scale, zero)),
            ([], _) => unsupported(format!("{what} is not quantised")),
            (scales, _) if scales.len() > 1 => unsupported(format!("{what} has {} scales", scales.len())),
            _ => unsupported(format!("{what}: bad scale or zero point")),
        }
    }

    /// Returns the only scale and zero point of an int8 tensor of activations.
    fn int8(&self, what: &str) -> Result<(f32, i8), TfliteError> {
        self.expect(schema::INT8, what)?;
        let (scale, zero) = self.quantisation(what)?;
        match i8::try_from(zero) {
            Ok(zero) => Ok((scale, zero)),
            Err(_) => unsupported(format!("{what}: zero point {zero} is no int8")),
        }
    }

    fn expect(&self, kind: i8, what: &str) -> Result<(), TfliteError> {
        if self.kind == kind {
            return Ok(());
        }
        unsupported(format!(
            "{what} has the tensor type {}, expected {}",
            self.type_name(),
            names::tensor_type(kind)
        ))
    }

    fn type_name(&self) -> String {
        names::tensor_type(self.kind)
    }

    /// Returns the numbers of rows and columns of a constant matrix. Both are in 1..=[`MAX_WIDTH`].
    /// Each element has `size` bytes.
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

    /// Returns the number of values of one example.
    /// This number is the product of the shape's dimensions. Unknown dimensions count as 1.
    fn elements(&self) -> u64 {
        self.shape.iter().map(|&n| u64::try_from(n).unwrap_or(1).max(1)).fold(1, u64::saturating_mul)
    }
}

/// The tensors of the graph, and the positions of their data.
struct Tensors<'b> {
    tables: Vec<Table<'b>>,
    buffers: Vec<Table<'b>>,
}

impl<'b> Tensors<'b> {
    fn at(&self, index: i32) -> Result<Tensor<'b>, TfliteError> {
        let table = usize::try_from(index).ok().and_then(|n| self.tables.get(n));
        let table = table.ok_or(TfliteError::Damaged)?;
        let buffer = usize::try_from(table.i32(2, 0)?).ok().and_then(|n| self.buffers.get(n));
        let (scales, zero_points, dimension) = match table.table(4)? {
            Some(q) => (q.f32s(2)?, q.i64s(3)?, q.i32(6, 0)?),
            None => (Vec::new(), Vec::new(), 0),
        };
        let data = buffer.ok_or(TfliteError::Damaged)?.bytes(0)?;
        Ok(Tensor { shape: table.i32s(0)?, kind: table.i8(1, 0)?, data, scales, zero_points, dimension })
    }
}

/// Reads a network from the bytes of a file. Never panics.
///
/// # Errors
/// [`TfliteError`].
pub fn read(bytes: &[u8]) -> Result<Network, TfliteError> {
    Ok(read_to_end(bytes)?.0)
}

/// Like [`read`], but also returns what the network in the file ends with.
///
/// # Errors
/// [`TfliteError`].
pub fn read_to_end(bytes: &[u8]) -> Result<(Network, End), TfliteError> {
    if bytes.get(4..8) != Some(IDENTIFIER) {
        return Err(TfliteError::NotTflite);
    }
    if bytes.len() > MAX_BYTES {
        return unsupported(format!("{} bytes; at most {MAX_BYTES} are read", bytes.len()));
    }
    let model = Table::root(bytes)?;
    let codes = model.tables(1)?;
    let graphs = model.tables(2)?;
    let [graph] = graphs.as_slice() else {
        return unsupported(format!("{} graphs; one is expected", graphs.len()));
    };
    let tensors = Tensors { tables: graph.tables(0)?, buffers: model.tables(4)? };
    let operators = graph.tables(3)?;
    if operators.len() > MAX_LAYERS + MAX_OTHERS {
        return unsupported(format!(
            "{} operators; at most {} are read",
            operators.len(),
            MAX_LAYERS + MAX_OTHERS
        ));
    }
    let (&[input], &[output]) = (graph.i32s(1)?.as_slice(), graph.i32s(2)?.as_slice()) else {
        return unsupported("one input and one output are expected");
    };
    let mut chain = Chain::new(&tensors.at(input)?)?;
    let mut at = input;
    for (index, operator) in operators.iter().enumerate() {
        let code_index = usize::try_from(operator.i32(0, 0)?).map_err(|_| TfliteError::Damaged)?;
        let code = codes.get(code_index).ok_or(TfliteError::Damaged)?;
        // Old files have only the field of type byte. New files also have the field of type int32.
        let number = code.i32(3, 0)?.max(i32::from(code.i8(0, 0)?));
        let name = || -> Result<String, TfliteError> { Ok(names::operator(number, code.text(1)?)) };
        let inputs = operator.i32s(1)?;
        let &[next] = operator.i32s(2)?.as_slice() else {
            return Err(TfliteError::ForeignOperator { index, name: name()? });
        };
        // If the batch size is open, these operators compute the shape of a RESHAPE.
        // The shape is checked at the RESHAPE.
        let of_shapes = [schema::SHAPE, schema::STRIDED_SLICE, schema::PACK];
        if of_shapes.contains(&number) && tensors.at(next)?.kind == schema::INT32 {
            continue;
        }
        let known =
            [schema::FULLY_CONNECTED, schema::SOFTMAX, schema::QUANTIZE, schema::DEQUANTIZE, schema::RESHAPE];
        if !known.contains(&number) {
            return Err(TfliteError::ForeignOperator { index, name: name()? });
        }
        if inputs.first() != Some(&at) {
            if let Some(constant) =
                inputs.first().and_then(|n| tensors.at(*n).ok()).filter(|t| !t.data.is_empty())
            {
                return unsupported(format!(
                    "{} on weights of type {}; export the full-integer (int8) network",
                    name()?,
                    constant.type_name()
                ));
            }
            return unsupported(format!(
                "operator {index} ({}) does not follow the one before in one chain",
                name()?
            ));
        }
        let (before, after) = (tensors.at(at)?, tensors.at(next)?);
        chain.goes_on(index, &name()?, number)?;
        chain.operator(index, number, operator, &tensors, (&before, &after))?;
        at = next;
    }
    if at != output {
        return unsupported("the operators do not form one chain from the input to the output");
    }
    chain.finish()
}

/// The part of the chain of operators that has been read so far.
struct Chain {
    floats: Vec<FloatLayer>,
    ints: Vec<DenseSpec>,
    end: Option<End>,
    /// After the last layer, values are no longer int8, so no operator can follow.
    over: bool,
    widths: Vec<(usize, usize)>,
}

impl Chain {
    fn new(input: &Tensor<'_>) -> Result<Self, TfliteError> {
        if !matches!(input.kind, schema::FLOAT32 | schema::INT8 | schema::UINT8) {
            return unsupported(format!(
                "inputs of the tensor type {}; FLOAT32, INT8 or UINT8 are expected",
                input.type_name()
            ));
        }
        Ok(Self { floats: Vec::new(), ints: Vec::new(), end: None, over: false, widths: Vec::new() })
    }

    fn goes_on(&self, index: usize, name: &str, number: i32) -> Result<(), TfliteError> {
        let ends = matches!(number, schema::QUANTIZE | schema::DEQUANTIZE | schema::RESHAPE);
        if self.over || (self.end.is_some() && !ends) {
            return unsupported(format!("operator {index} ({name}) stands behind the network's end"));
        }
        Ok(())
    }

    /// Processes the next supported operator between two tensors.
    fn operator(
        &mut self,
        index: usize,
        number: i32,
        operator: &Table<'_>,
        tensors: &Tensors<'_>,
        (before, after): (&Tensor<'_>, &Tensor<'_>),
    ) -> Result<(), TfliteError> {
        match number {
            schema::FULLY_CONNECTED => {
                let (weights, biases) = match operator.i32s(1)?.as_slice() {
                    &[_, weights] | &[_, weights, -1] => (tensors.at(weights)?, None),
                    &[_, weights, biases] => (tensors.at(weights)?, Some(tensors.at(biases)?)),
                    _ => return Err(TfliteError::Damaged),
                };
                let options = operator.table(4)?;
                let activation = options.map_or(Ok(0), |options| options.i8(0, 0))?;
                if options.map_or(Ok(0), |options| options.i8(1, 0))? != 0 {
                    return unsupported(format!("layer {index} has shuffled weights"));
                }
                self.layer(index, before, &weights, biases.as_ref(), after, activation)?;
            }
            schema::SOFTMAX => {
                let beta = operator.table(4)?.map_or(Ok(0.0), |options| options.f32(0, 0.0))?;
                if beta != 1.0 {
                    return unsupported(format!("softmax with beta {beta}; 1 is expected"));
                }
                if after.kind != schema::FLOAT32 && after.int8("the softmax's output")? != (1.0 / 256.0, -128)
                {
                    return unsupported("softmax output must have scale 1/256 and zero point -128");
                }
                self.end = Some(End::Softmax);
            }
            schema::QUANTIZE => self.quantize(before, after)?,
            schema::DEQUANTIZE => {
                before.int8("what DEQUANTIZE takes")?;
                after.expect(schema::FLOAT32, "what DEQUANTIZE gives")?;
                self.over = true;
            }
            _ => {
                let same = before.kind == after.kind
                    && before.elements() == after.elements()
                    && before.scales == after.scales
                    && before.zero_points == after.zero_points;
                if !same {
                    return unsupported(format!(
                        "operator {index} (RESHAPE) does more than change the shape"
                    ));
                }
            }
        }
        Ok(())
    }

    fn layer(
        &mut self,
        index: usize,
        before: &Tensor<'_>,
        weights: &Tensor<'_>,
        biases: Option<&Tensor<'_>>,
        after: &Tensor<'_>,
        activation: i8,
    ) -> Result<(), TfliteError> {
        if self.floats.len() + self.ints.len() == MAX_LAYERS {
            return unsupported(format!("more than {MAX_LAYERS} layers"));
        }
        let floats = before.kind == schema::FLOAT32;
        let known = matches!((activation, floats), (0 | schema::RELU, _) | (schema::RELU6, false));
        if !known {
            return unsupported(format!(
                "layer {index} has the activation {}; only RELU is read, and RELU6 in int8",
                names::activation(activation)
            ));
        }
        if floats && weights.kind != schema::FLOAT32 {
            return unsupported(format!(
                "layer {index} has {} weights for FLOAT32 values (dynamic range); export the full-integer (int8) network, \
                 with a representative data set",
                weights.type_name()
            ));
        }
        let (rows, columns) = if floats {
            let layer = float_layer(weights, biases, activation == schema::RELU)?;
            let size = (layer.weights.len(), layer.weights[0].len());
            self.floats.push(layer);
            size
        } else {
            let layer = int8_layer(before, weights, biases, after, activation)?;
            let size = (layer.weights.len(), layer.weights[0].len());
            self.ints.push(layer);
            size
        };
        if before.elements() != columns as u64 || after.elements() != rows as u64 {
            return unsupported(format!(
                "layer {index} makes {:?} of {:?} with {rows} × {columns} weights; RESHAPE the input to one row",
                after.shape, before.shape
            ));
        }
        self.widths.push((columns, rows));
        Ok(())
    }

    /// Processes QUANTIZE at either end of the network: float or uint8 to int8, or int8 to uint8.
    /// Other changes of scale are not supported.
    fn quantize(&mut self, before: &Tensor<'_>, after: &Tensor<'_>) -> Result<(), TfliteError> {
        let begins = self.floats.is_empty() && self.ints.is_empty();
        let wrong = || {
            unsupported(format!(
                "QUANTIZE from {} to {} with another scale; only the ends of a network may be quantised",
                before.type_name(),
                after.type_name()
            ))
        };
        match (before.kind, after.kind, begins) {
            (schema::FLOAT32, schema::INT8, true) => after.int8("the quantised input").map(drop),
            (schema::UINT8, schema::INT8, true) | (schema::INT8, schema::UINT8, false) => {
                let (unsigned, signed) = if begins { (before, after) } else { (after, before) };
                let (scale, zero) = signed.int8("the quantised end")?;
                let same = unsigned.quantisation("the unsigned end")? == (scale, i64::from(zero) + 128);
                self.over = !begins;
                if same { Ok(()) } else { wrong() }
            }
            _ => wrong(),
        }
    }

    fn finish(self) -> Result<(Network, End), TfliteError> {
        let network = match (self.floats.is_empty(), self.ints.is_empty()) {
            (false, true) => Network::Float(self.floats),
            (true, false) => Network::Int8(self.ints),
            (true, true) => return unsupported("there are no layers"),
            (false, false) => return unsupported("some layers are int8, some float"),
        };
        if self.widths.windows(2).any(|pair| pair[0].1 != pair[1].0) {
            return unsupported("the layers' sizes do not fit together");
        }
        Ok((network, self.end.unwrap_or(End::Logits)))
    }
}

fn float_layer(
    weights: &Tensor<'_>,
    biases: Option<&Tensor<'_>>,
    relu: bool,
) -> Result<FloatLayer, TfliteError> {
    weights.expect(schema::FLOAT32, "weights")?;
    let (rows, columns) = weights.matrix(4)?;
    let floats = |bytes: &[u8]| -> Vec<f32> {
        bytes.as_chunks().0.iter().map(|&word| f32::from_le_bytes(word)).collect()
    };
    let values = floats(weights.data);
    let biases = match biases {
        None => vec![0.0; rows],
        Some(biases) => {
            biases.expect(schema::FLOAT32, "biases")?;
            floats(biases.data)
        }
    };
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
    biases: Option<&Tensor<'_>>,
    after: &Tensor<'_>,
    activation: i8,
) -> Result<DenseSpec, TfliteError> {
    let (input_scale, input_zero_point) = before.int8("a layer's input")?;
    let (output_scale, output_zero_point) = after.int8("a layer's output")?;
    weights.expect(schema::INT8, "weights")?;
    let (rows, columns) = weights.matrix(1)?;
    let biases = match biases {
        None => vec![0; rows],
        Some(biases) => {
            biases.expect(schema::INT32, "biases")?;
            biases.data.as_chunks().0.iter().map(|&word| i32::from_le_bytes(word)).collect()
        }
    };
    if biases.len() != rows {
        return unsupported(format!("{} biases for {rows} outputs", biases.len()));
    }
    let per_channel = weights.scales.len() == rows && weights.dimension == 0;
    if weights.scales.len() != 1 && !per_channel {
        return unsupported(format!(
            "weights of {rows} outputs have {} scales along dimension {}",
            weights.scales.len(),
            weights.dimension
        ));
    }
    if !weights.scales.iter().all(|scale| scale.is_finite() && *scale > 0.0) {
        return unsupported("weights: bad scale");
    }
    if weights.zero_points.iter().any(|zero| *zero != 0) {
        return unsupported("weights must have zero point 0");
    }
    // TFLite's CalculateActivationRangeQuantized.
    let largest = match activation {
        schema::RELU6 => (f32::from(output_zero_point) + (6.0 / output_scale).round()).min(127.0) as i8,
        _ => i8::MAX,
    };
    let values = weights.data.chunks(columns).map(|row| row.iter().map(|&byte| byte as i8).collect());
    Ok(DenseSpec {
        weights: values.collect(),
        biases,
        input_scale,
        input_zero_point,
        weight_scales: weights.scales.clone(),
        output_scale,
        output_zero_point,
        relu: activation != 0,
        largest,
    })
}
