//! Trains a network in a fixed number of steps with plain loops.
//! The networks are so small that these loops are faster than a library.
//! [`adapt`](super::adapt) starts from an existing network. `steps` trains new networks with the same loops.
//! A test compares the results with those of a library.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::quantise;
use crate::streams::RandomStream;
use crate::tflite::FloatLayer;

/// The parameters of training in steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Minimum number of steps.
    pub count: usize,
    /// Maximum number of steps.
    /// Below this maximum, the amount of data determines the number ([`Steps::following`]).
    pub most: usize,
    /// Windows per step.
    pub batch: usize,
    /// Largest learning rate (Adam).
    pub learning_rate: f64,
    /// Number of steps until the maximum learning rate is reached.
    pub warm_up: usize,
    /// Fraction of the probability that is distributed over all labels.
    pub label_smoothing: f32,
    /// Weight of the sum of squared weights in the loss.
    pub decay: f64,
    /// Fraction of the averaged weights that remains after each step, in the long run.
    pub keep: f64,
    /// Number of networks that start from different weights and are merged into one network.
    /// Recipe `aligned` defines their widths, and the network that learns from them.
    pub members: usize,
    /// Number of final steps in which weights and activations are rounded as in int8.
    pub rounded: usize,
}

impl Steps {
    /// For a new network.
    pub const TRAIN: Self = Self {
        count: 4000,
        most: 6000,
        batch: 128,
        learning_rate: 3e-3,
        warm_up: 50,
        label_smoothing: 0.1,
        decay: 1e-4,
        keep: 0.995,
        members: crate::ALIGNED_MEMBERS,
        rounded: 300,
    };
    /// The plan for a network that only has to learn one more person.
    pub const ADAPT: Self =
        Self { count: 800, most: 800, learning_rate: 2e-3, keep: 0.98, members: 1, ..Self::TRAIN };

    /// Returns the number of steps after which each of these windows has been seen sixteen times.
    /// The windows are those of recordings and of their varied copies.
    /// If thirty people's windows are seen only four times each, the accuracy is three to four points lower.
    pub fn following(self, windows: usize) -> Self {
        const TIMES: usize = 16;
        let wanted = (TIMES * windows).div_ceil(self.batch.max(1));
        let count = wanted.clamp(self.count, self.most.max(self.count));
        Self { count, most: count, ..self }
    }

    /// The plan for the steps at the end that simulate int8 rounding.
    pub(super) fn last(self) -> Self {
        Self { count: self.rounded, most: self.rounded, learning_rate: 5e-4, warm_up: 20, keep: 0.98, ..self }
    }

    /// Returns the probability that a network of `labels` outputs should give to a label.
    pub(super) fn target(self, is_right: bool, labels: usize) -> f32 {
        let spread = self.label_smoothing / labels as f32;
        if is_right { spread + 1.0 - self.label_smoothing } else { spread }
    }

    /// Returns the learning rate of a step (counted from 0): it warms up, and then decreases as a cosine.
    pub(super) fn rate(self, step: usize) -> f64 {
        let warm = ((step + 1) as f64 / self.warm_up as f64).min(1.0);
        let fall = 0.5 * (1.0 + (std::f64::consts::PI * step as f64 / self.count as f64).cos());
        self.learning_rate * warm * fall
    }

    /// Returns the fraction of the averaged weights that remains after a step (counted from 0).
    /// At first, the average must forget quickly, so that it does not retain the start.
    pub(super) fn kept(self, step: usize) -> f64 {
        let time = (step + 1) as f64;
        self.keep.min((1.0 + time) / (10.0 + time))
    }
}

/// An input, and the index of its label.
pub(super) type Labelled = (Vec<f32>, usize);

/// The outputs that a network should learn.
pub(super) struct Wanted {
    pub labels: usize,
    /// For each row, one probability per label.
    pub values: Vec<f32>,
    /// The rows of each label that has any.
    of_label: Vec<Vec<u32>>,
}

impl Wanted {
    /// The labels of the rows, smoothed.
    pub fn labels(rows: &[Labelled], labels: usize, plan: &Steps) -> Self {
        Self::new(rows, labels, |(_, label)| (0..labels).map(|n| plan.target(n == *label, labels)).collect())
    }

    /// The probabilities that a trained network gives to the rows.
    #[cfg(feature = "train")]
    pub fn probabilities(rows: &[Labelled], labels: usize, teacher: &[FloatLayer]) -> Self {
        Self::new(rows, labels, |(input, _)| crate::tflite::infer_float(teacher, input))
    }

    fn new(rows: &[Labelled], labels: usize, of: impl Fn(&Labelled) -> Vec<f32>) -> Self {
        let mut of_label = vec![Vec::new(); labels];
        rows.iter().zip(0..).for_each(|((_, label), row)| of_label[*label].push(row));
        of_label.retain(|rows| !rows.is_empty());
        Self { labels, values: rows.iter().flat_map(of).collect(), of_label }
    }

    /// Draws the rows of a batch. All labels are equally likely, so rare labels count as much as common labels.
    ///
    /// If rows were drawn without regard to labels, rare labels would need large weights, and the gradient would be noisier.
    pub fn drawn(&self, count: usize, rng: &mut ChaCha8Rng) -> Vec<u32> {
        let mut one = || {
            let rows = &self.of_label[rng.random_range(0..self.of_label.len())];
            rows[rng.random_range(0..rows.len())]
        };
        (0..count).map(|_| one()).collect()
    }

    /// The wanted probabilities of a row.
    fn of(&self, row: u32) -> &[f32] {
        &self.values[row as usize * self.labels..][..self.labels]
    }
}

/// Adam's running means of the gradients and of their squares.
const BETAS: [f64; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-8;

/// Trains an existing network on rows of inputs and their labels.
/// Rare labels count as much as common labels, and `limit` is the largest input.
pub(super) fn refit(
    rows: &[Labelled],
    labels: usize,
    start: &[FloatLayer],
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Vec<FloatLayer> {
    if rows.is_empty() {
        return start.to_vec();
    }
    let wanted = Wanted::labels(rows, labels, plan);
    let layers = run(rows, &wanted, start, plan, None, RandomStream::Member(0).of(seed));
    finished(layers, rows, &wanted, plan, limit, seed)
}

/// Prepares a trained network for int8: equal maxima per unit, and the steps that simulate rounding.
pub(super) fn finished(
    mut layers: Vec<FloatLayer>,
    rows: &[Labelled],
    wanted: &Wanted,
    plan: &Steps,
    limit: f32,
    seed: u64,
) -> Vec<FloatLayer> {
    equalise(&mut layers);
    if plan.rounded > 0 {
        let rounding = Rounding::new(&layers, rows, limit);
        layers = run(rows, wanted, &layers, &plan.last(), Some(&rounding), RandomStream::Rounding.of(seed));
    }
    layers
}

/// The rounding that int8 will cause, for training steps that simulate it. The gradient passes as if nothing was rounded.
pub(super) struct Rounding {
    /// Largest input.
    pub limit: f32,
    /// Smallest and largest output of each layer.
    pub ranges: Vec<(f32, f32)>,
}

impl Rounding {
    /// Creates the rounding, whose ranges are those of the outputs for `rows`.
    pub fn new(layers: &[FloatLayer], rows: &[Labelled], limit: f32) -> Self {
        let inputs: Vec<&[f32]> = rows.iter().map(|(input, _)| input.as_slice()).collect();
        Self { limit, ranges: quantise::ranges(layers, &inputs) }
    }
}

/// Values that an optimiser changes, with its running means for each, and the average of the values over the steps.
struct Changing {
    values: Vec<f32>,
    gradient: Vec<f32>,
    moments: [Vec<f32>; 2],
    average: Vec<f32>,
}

impl Changing {
    fn new(values: Vec<f32>) -> Self {
        let zeros = || vec![0.0; values.len()];
        Self { gradient: zeros(), moments: [zeros(), zeros()], average: values.clone(), values }
    }

    /// Takes a step against the gradient, and then sets the gradient to zero. `time` counts the steps from 1.
    fn step(&mut self, rate: f64, time: usize, keep: f32) {
        let [first, second] = BETAS.map(|beta| 1.0 / (1.0 - beta.powi(time as i32)));
        let [keep_first, keep_second] = BETAS.map(|beta| beta as f32);
        let (first, second, rate) = (first as f32, second as f32, rate as f32);
        let [means, squares] = &mut self.moments;
        let moments = means.iter_mut().zip(squares);
        let values = self.values.iter_mut().zip(&mut self.average);
        for (((value, average), gradient), (mean, square)) in values.zip(&mut self.gradient).zip(moments) {
            *mean = *mean * keep_first + *gradient * (1.0 - keep_first);
            *square = *square * keep_second + *gradient * *gradient * (1.0 - keep_second);
            *value -= rate * (*mean * first) / ((*square * second).sqrt() + EPSILON);
            *average = *average * keep + *value * (1.0 - keep);
            *gradient = 0.0;
        }
    }
}

/// A layer during training, with the values that it computed for the batch.
struct Fitting {
    inputs: usize,
    outputs: usize,
    /// Weights from one input to all outputs, one input after the other.
    weights: Changing,
    biases: Changing,
    /// The weights as the batch used them. They are rounded if rounding is on.
    used: Vec<f32>,
    /// For each row of the batch: 1 if the gradient passes.
    passes: Vec<f32>,
    /// The outputs for each row of the batch.
    made: Vec<f32>,
    relu: bool,
}

impl Fitting {
    fn new(layer: &FloatLayer, batch: usize) -> Self {
        let (inputs, outputs) = (layer.weights.first().map_or(0, Vec::len), layer.biases.len());
        let weights: Vec<f32> =
            (0..inputs).flat_map(|input| layer.weights.iter().map(move |row| row[input])).collect();
        Self {
            inputs,
            outputs,
            used: weights.clone(),
            weights: Changing::new(weights),
            biases: Changing::new(layer.biases.clone()),
            passes: vec![1.0; batch * outputs],
            made: vec![0.0; batch * outputs],
            relu: layer.relu,
        }
    }

    /// Computes the outputs for a batch. If values are rounded, `range` is the range that int8 can represent.
    fn forward(&mut self, batch: &[f32], range: Option<(f32, f32)>) {
        self.used.copy_from_slice(&self.weights.values);
        if range.is_some() {
            let largest = self.used.iter().fold(0.0f32, |most, weight| most.max(weight.abs()));
            let step = largest.max(1e-9) / 127.0;
            self.used.iter_mut().for_each(|weight| *weight = rounded(*weight, step));
        }
        self.made.chunks_exact_mut(self.outputs).for_each(|made| made.copy_from_slice(&self.biases.values));
        add_products(batch, self.inputs, &self.used, &mut self.made, self.outputs);
        let made = self.made.chunks_exact_mut(self.outputs);
        for (made, passes) in made.zip(self.passes.chunks_exact_mut(self.outputs)) {
            let lowest = if self.relu { 0.0 } else { f32::NEG_INFINITY };
            let (low, high) = range.unwrap_or((f32::NEG_INFINITY, f32::INFINITY));
            for (value, passes) in made.iter_mut().zip(passes) {
                let inside = value.clamp(low.max(lowest), high);
                *passes = if *value == inside { 1.0 } else { 0.0 };
                *value =
                    if range.is_some() { rounded(inside, (high - low).max(1e-9) / 255.0) } else { inside };
            }
        }
    }

    /// Adds the gradients for a batch, given the gradient of the loss with respect to the outputs.
    /// If requested, the method also stores the gradient with respect to the batch in `to_inputs`.
    fn backward(&mut self, batch: &[f32], of_outputs: &mut [f32], mut to_inputs: Option<&mut Vec<f32>>) {
        of_outputs.iter_mut().zip(&self.passes).for_each(|(gradient, passes)| *gradient *= passes);
        let (columns, rows) = (turned(batch, self.inputs), batch.len() / self.inputs.max(1));
        add_products(&columns, rows, of_outputs, &mut self.weights.gradient, self.outputs);
        for gradient in of_outputs.chunks_exact(self.outputs) {
            self.biases.gradient.iter_mut().zip(gradient).for_each(|(sum, gradient)| *sum += gradient);
        }
        let Some(to_inputs) = &mut to_inputs else { return };
        let weights = turned(&self.used, self.outputs);
        to_inputs.clear();
        to_inputs.resize(batch.len(), 0.0);
        add_products(of_outputs, self.outputs, &weights, to_inputs, self.inputs);
    }

    /// Returns the average over the steps as a plain layer.
    fn layer(&self) -> FloatLayer {
        let row =
            |output: usize| self.weights.average.iter().skip(output).step_by(self.outputs).copied().collect();
        FloatLayer {
            weights: (0..self.outputs).map(row).collect(),
            biases: self.biases.average.clone(),
            relu: self.relu,
        }
    }
}

/// Adds the product of two matrices, values × `matrix`, to `sums`. A row has `inner` values and `width` sums.
/// A sum adds its products in the order of the values, whatever the blocks.
/// Blocks of four rows and several sums stay in registers meanwhile.
fn add_products(values: &[f32], inner: usize, matrix: &[f32], sums: &mut [f32], width: usize) {
    fn block<const ROWS: usize, const N: usize>(
        values: &[&[f32]; ROWS],
        matrix: &[f32],
        sums: &mut [f32],
        width: usize,
        at: &mut usize,
    ) {
        while *at + N <= width {
            let mut block = [[0.0; N]; ROWS];
            for (row, sums) in block.iter_mut().zip(sums.chunks_exact(width)) {
                row.copy_from_slice(&sums[*at..*at + N]);
            }
            for (index, weights) in matrix.chunks_exact(width).enumerate() {
                let Some(weights) = weights[*at..].first_chunk::<N>() else { return };
                for (row, values) in block.iter_mut().zip(values) {
                    let value = values[index];
                    row.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
                }
            }
            for (row, sums) in block.iter().zip(sums.chunks_exact_mut(width)) {
                sums[*at..*at + N].copy_from_slice(row);
            }
            *at += N;
        }
    }
    fn rows<const ROWS: usize>(values: &[f32], inner: usize, matrix: &[f32], sums: &mut [f32], width: usize) {
        let values: [&[f32]; ROWS] = std::array::from_fn(|row| &values[row * inner..(row + 1) * inner]);
        let mut at = 0;
        block::<ROWS, 8>(&values, matrix, sums, width, &mut at);
        block::<ROWS, 4>(&values, matrix, sums, width, &mut at);
        block::<ROWS, 1>(&values, matrix, sums, width, &mut at);
    }
    const ROWS: usize = 4;
    let (fours, rest) = (values.chunks_exact(ROWS * inner), sums.chunks_exact_mut(ROWS * width));
    let last = fours.remainder();
    let mut rest = rest;
    for (values, sums) in fours.zip(&mut rest) {
        rows::<ROWS>(values, inner, matrix, sums, width);
    }
    let singles = last.chunks_exact(inner).zip(rest.into_remainder().chunks_exact_mut(width));
    singles.for_each(|(values, sums)| rows::<1>(values, inner, matrix, sums, width));
}

/// Turns rows of this width into columns.
fn turned(rows: &[f32], width: usize) -> Vec<f32> {
    let count = rows.len() / width.max(1);
    let mut columns = vec![0.0; count * width];
    for (index, row) in rows.chunks_exact(width.max(1)).enumerate() {
        for (column, value) in columns.chunks_exact_mut(count.max(1)).zip(row) {
            column[index] = *value;
        }
    }
    columns
}

fn rounded(value: f32, step: f32) -> f32 {
    (value / step).round() * step
}

/// Trains a network, which must not be without rows, to give the wanted outputs; with `rounding`, it simulates int8.
pub(super) fn run(
    rows: &[Labelled],
    wanted: &Wanted,
    start: &[FloatLayer],
    plan: &Steps,
    rounding: Option<&Rounding>,
    mut rng: ChaCha8Rng,
) -> Vec<FloatLayer> {
    let mut layers: Vec<Fitting> = start.iter().map(|layer| Fitting::new(layer, plan.batch)).collect();
    let range = |index: usize| rounding.and_then(|rounding| rounding.ranges.get(index).copied());
    let (mut batch, mut gradient, mut before) = (Vec::new(), Vec::new(), Vec::new());
    for step in 0..plan.count {
        let drawn = wanted.drawn(plan.batch, &mut rng);
        batch.clear();
        drawn.iter().for_each(|row| batch.extend_from_slice(&rows[*row as usize].0));
        if let Some(Rounding { limit, .. }) = rounding {
            batch.iter_mut().for_each(|value| *value = rounded(value.clamp(-limit, *limit), limit / 127.5));
        }
        for index in 0..layers.len() {
            let (done, rest) = layers.split_at_mut(index);
            if let Some(layer) = rest.first_mut() {
                layer.forward(done.last().map_or(&batch, |layer| &layer.made), range(index));
            }
        }
        gradient.clear();
        if let Some(last) = layers.last() {
            for (logits, row) in last.made.chunks_exact(wanted.labels).zip(&drawn) {
                let probabilities = crate::tflite::softmax(logits);
                let pairs = probabilities.iter().zip(wanted.of(*row));
                gradient
                    .extend(pairs.map(|(probability, wanted)| (probability - wanted) / plan.batch as f32));
            }
        }
        for index in (0..layers.len()).rev() {
            let (done, rest) = layers.split_at_mut(index);
            let Some(layer) = rest.first_mut() else { continue };
            let wanted = if index > 0 { Some(&mut before) } else { None };
            layer.backward(done.last().map_or(&batch, |layer| &layer.made), &mut gradient, wanted);
            std::mem::swap(&mut gradient, &mut before);
        }
        let (rate, keep) = (plan.rate(step), plan.kept(step) as f32);
        for layer in &mut layers {
            let decay = 2.0 * plan.decay as f32;
            let Changing { values, gradient, .. } = &mut layer.weights;
            gradient.iter_mut().zip(values).for_each(|(sum, weight)| *sum += decay * *weight);
            layer.weights.step(rate, step + 1, keep);
            layer.biases.step(rate, step + 1, keep);
        }
    }
    layers.iter().map(Fitting::layer).collect()
}

/// Scales the weights into and out of each hidden unit to the same maximum (Nagel et al., 2019).
/// The scaling changes no output: a unit that is twice as large and counts half gives the same result.
/// After that, one int8 scale per layer suits all of its units.
pub(super) fn equalise(layers: &mut [FloatLayer]) {
    for index in 1..layers.len() {
        let Some([before, after]) = layers.get_mut(index - 1..=index) else { continue };
        for (unit, (row, bias)) in before.weights.iter_mut().zip(&mut before.biases).enumerate() {
            let into = row.iter().fold(0.0f32, |most, weight| most.max(weight.abs()));
            let out = after.weights.iter().fold(0.0f32, |most, row| most.max(row[unit].abs()));
            if !(before.relu && into > 1e-6 && out > 1e-6) {
                continue;
            }
            let scale = (out / into).sqrt();
            row.iter_mut().for_each(|weight| *weight *= scale);
            *bias *= scale;
            after.weights.iter_mut().for_each(|row| row[unit] /= scale);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns data with three labels that are far apart, and an untrained network.
    fn task() -> (Vec<Labelled>, Vec<FloatLayer>) {
        let mut rng = RandomStream::Order.of(1);
        let mut uniform = |low: f32, high: f32| rng.random_range(low..high);
        let centres = [[1.0, 0.0, -1.0, 0.5], [-1.0, 1.0, 0.0, -0.5], [0.0, -1.0, 1.0, 0.0f32]];
        let rows = (0..300)
            .map(|n| (centres[n % 3].iter().map(|c| c + uniform(-0.4, 0.4)).collect(), n % 3))
            .collect();
        let mut layer = |inputs: usize, outputs: usize, relu: bool| FloatLayer {
            weights: (0..outputs).map(|_| (0..inputs).map(|_| uniform(-0.7, 0.7)).collect()).collect(),
            biases: vec![0.0; outputs],
            relu,
        };
        let layers = vec![layer(4, 8, true), layer(8, 3, false)];
        (rows, layers)
    }

    #[test]
    fn steps_follow_what_there_is_to_learn_within_bounds() {
        let steps = |windows| Steps::TRAIN.following(windows).count;
        // The numbers of windows of two people, of thirty people, and of a crowd.
        assert_eq!([steps(0), steps(12_000), steps(38_400), steps(147_000)], [4000, 4000, 4800, 6000]);
        assert_eq!(Steps::ADAPT.following(1_000_000), Steps::ADAPT);
    }

    const SHORT: Steps = Steps { count: 60, rounded: 20, ..Steps::ADAPT };
    /// Enough for a network that starts with random weights.
    const LONG: Steps = Steps { count: 3000, rounded: 200, ..Steps::ADAPT };

    #[test]
    fn a_network_learns_what_it_is_shown_and_the_same_each_time() {
        let (rows, start) = task();
        let right = |layers: &[FloatLayer]| {
            let best = |row: &Vec<f32>| {
                let scores = crate::tflite::infer_float(layers, row);
                (0..3).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))
            };
            rows.iter().filter(|(row, label)| best(row) == Some(*label)).count()
        };
        let fitted = refit(&rows, 3, &start, &LONG, 2.0, 1);
        assert!(right(&start) < 200 && right(&fitted) == 300, "{} {}", right(&start), right(&fitted));
        assert_eq!(fitted, refit(&rows, 3, &start, &LONG, 2.0, 1));
        assert_eq!(refit(&[], 3, &start, &SHORT, 2.0, 1), start);
    }

    #[test]
    fn a_label_with_few_rows_is_drawn_as_often_as_one_with_many() {
        let rows: Vec<Labelled> = (0..1000).map(|n| (vec![0.0], if n < 10 { 0 } else { 2 })).collect();
        let wanted = Wanted::labels(&rows, 3, &SHORT);
        let drawn = wanted.drawn(10_000, &mut RandomStream::Order.of(1));
        let rare = drawn.iter().filter(|row| **row < 10).count();
        // The standard deviation is 50.
        assert!((4800..5200).contains(&rare), "{rare} of 10000");
        assert!(drawn.iter().all(|row| *row < 1000));
    }

    /// The library computes gradients in another way.
    #[cfg(feature = "train")]
    #[test]
    fn plain_loops_and_the_library_come_to_the_same_network() {
        use super::super::library;
        let (rows, start) = task();
        let wanted = Wanted::labels(&rows, 3, &SHORT);
        let rounding = Rounding::new(&start, &rows, 2.0);
        for rounding in [None, Some(&rounding)] {
            let plan = Steps { count: if rounding.is_none() { 60 } else { 20 }, ..SHORT };
            let rng = || RandomStream::Member(0).of(1);
            let plain = run(&rows, &wanted, &start, &plan, rounding, rng());
            let by_library = library::run(&rows, &wanted, &start, &plan, rounding, rng()).unwrap();
            for (one, two) in plain.iter().zip(&by_library) {
                let values = one.weights.concat().into_iter().chain(one.biases.clone());
                let others = two.weights.concat().into_iter().chain(two.biases.clone());
                let apart = values.zip(others).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                // When values are rounded to steps, a difference of a thousandth occasionally becomes a full step.
                assert!(apart < if rounding.is_none() { 1e-3 } else { 2e-2 }, "{apart}");
            }
        }
    }
}
