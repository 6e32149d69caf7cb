//! Quantises a trained network to int8 by TFLite's full-integer rules.
//! There is one scale per tensor, and weights are symmetric in −127..=127.
//! Biases are int32 with the scale input × weight.
//! Activations in −128..=127 cover the range that calibration inputs reach, and represent 0 exactly.

use shared_dsp::right::network::DenseSpec;

use crate::tflite::FloatLayer;

/// Maximum number of inputs that determine the ranges of activations.
const CALIBRATION: usize = 4000;

/// Quantises a network to int8. The network's inputs must be between -`limit` and `limit`.
pub(super) fn quantise(layers: &[FloatLayer], inputs: &[&[f32]], limit: f32) -> Vec<DenseSpec> {
    let (mut input_scale, mut input_zero_point) = scale_of(-limit, limit);
    let mut specs = Vec::new();
    for (layer, (low, high)) in layers.iter().zip(ranges(layers, inputs)) {
        let (output_scale, output_zero_point) = scale_of(low, high);
        let largest = layer.weights.iter().flatten().fold(0.0f32, |m, w| m.max(w.abs()));
        let weight_scale = if largest > 0.0 { largest / 127.0 } else { 1.0 };
        let bias_scale = f64::from(input_scale * weight_scale);
        let int8 = |w: &f32| (w / weight_scale).round().clamp(-127.0, 127.0) as i8;
        specs.push(DenseSpec {
            weights: layer.weights.iter().map(|row| row.iter().map(int8).collect()).collect(),
            biases: layer.biases.iter().map(|b| (f64::from(*b) / bias_scale).round() as i32).collect(),
            input_scale,
            input_zero_point,
            weight_scales: vec![weight_scale],
            output_scale,
            output_zero_point,
            relu: layer.relu,
            largest: i8::MAX,
        });
        (input_scale, input_zero_point) = (output_scale, output_zero_point);
    }
    specs
}

/// Returns the minimum and maximum output of each layer for the inputs. The range always includes 0.
pub(super) fn ranges(layers: &[FloatLayer], inputs: &[&[f32]]) -> Vec<(f32, f32)> {
    let step = inputs.len().div_ceil(CALIBRATION).max(1);
    let mut values: Vec<Vec<f32>> = inputs.iter().step_by(step).map(|row| row.to_vec()).collect();
    let mut ranges = Vec::new();
    for layer in layers {
        values = values.iter().map(|row| run(layer, row)).collect();
        let flat = || values.iter().flatten().copied();
        ranges.push((flat().fold(0.0, f32::min), flat().fold(0.0, f32::max)));
    }
    ranges
}

fn run(layer: &FloatLayer, inputs: &[f32]) -> Vec<f32> {
    let row = |(weights, bias): (&Vec<f32>, &f32)| {
        let sum: f32 = weights.iter().zip(inputs).map(|(w, x)| w * x).sum::<f32>() + bias;
        if layer.relu { sum.max(0.0) } else { sum }
    };
    layer.weights.iter().zip(&layer.biases).map(row).collect()
}

/// Returns scale and zero point of a range that contains 0.
fn scale_of(low: f32, high: f32) -> (f32, i8) {
    let (low, high) = (low.min(0.0), high.max(0.0));
    if high - low < 1e-6 {
        return (1.0 / 255.0, -128);
    }
    let scale = (high - low) / 255.0;
    let zero = (-128.0 - low / scale).round().clamp(-128.0, 127.0);
    (scale, zero as i8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_is_exact_and_the_range_fits() {
        assert_eq!(scale_of(0.0, 5.1), (5.1 / 255.0, -128));
        let (scale, zero) = scale_of(-2.0, 3.0);
        assert!(f32::from(-128 - i16::from(zero)) * scale <= -2.0 + scale);
        assert!(f32::from(127 - i16::from(zero)) * scale >= 3.0 - scale);
    }

    #[test]
    fn a_dense_layer_keeps_its_values_to_within_a_step() {
        let layer = FloatLayer {
            weights: vec![vec![0.5, -1.0], vec![0.25, 0.75]],
            biases: vec![0.1, -0.2],
            relu: false,
        };
        let inputs: Vec<Vec<f32>> =
            (0..100).map(|n| vec![(n as f32 / 10.0).sin() * 3.0, (n as f32 / 7.0).cos() * 3.0]).collect();
        let rows: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
        let spec = &quantise(std::slice::from_ref(&layer), &rows, 4.0)[0];
        for row in rows {
            let want = run(&layer, row);
            for (n, weights) in spec.weights.iter().enumerate() {
                let sum: i32 = weights
                    .iter()
                    .zip(row)
                    .map(|(w, x)| i32::from(*w) * (x / spec.input_scale).round() as i32)
                    .sum();
                let got = (sum + spec.biases[n]) as f32 * spec.input_scale * spec.weight_scales[0];
                assert!((got - want[n]).abs() < 0.05, "{got} {}", want[n]);
            }
        }
    }
}
