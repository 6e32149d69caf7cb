//! Reads the reference figures in `tests/data`.
#![allow(dead_code)]

use serde_json::Value;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec};
use std::path::PathBuf;

/// Reads a file in `tests/data`. The crates in `bench-m4f` use this too.
pub fn data(name: &str) -> PathBuf {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let mut places = root.ancestors().map(|folder| folder.join("tests/data").join(name));
    places.find(|path| path.exists()).unwrap_or_else(|| panic!("{name} is missing in tests/data"))
}

pub fn rows<T: std::str::FromStr>(name: &str) -> Vec<Vec<T>> {
    let text = std::fs::read_to_string(data(name)).unwrap();
    let cell = |cell: &str| cell.trim().parse().unwrap_or_else(|_| panic!("{name}: {cell}"));
    text.lines().map(|line| line.split(',').map(cell).collect()).collect()
}

/// The network in `mlp_int8_params.json`, with arbitrary scalings.
pub fn reference_spec() -> BlobSpec {
    let text = std::fs::read_to_string(data("mlp_int8_params.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let integer = |value: &Value| value.as_i64().unwrap();
    let scale = |value: &Value| value.as_f64().unwrap() as f32;
    let layers = json["layers"].as_array().unwrap();
    let dense = |(index, layer): (usize, &Value)| DenseSpec {
        weights: layer["W"]
            .as_array()
            .unwrap()
            .iter()
            .map(|row| row.as_array().unwrap().iter().map(|w| integer(w) as i8).collect())
            .collect(),
        biases: layer["b"].as_array().unwrap().iter().map(|b| integer(b) as i32).collect(),
        input_scale: scale(&layer["in_scale"]),
        input_zero_point: integer(&layer["in_zp"]) as i8,
        weight_scales: vec![scale(&layer["w_scale"])],
        output_scale: scale(&layer["out_scale"]),
        output_zero_point: integer(&layer["out_zp"]) as i8,
        relu: index + 1 < layers.len(),
        largest: i8::MAX,
    };
    BlobSpec {
        recipe: FeatureKind::Raw,
        axes: 9,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: ["idle", "up-down", "to-fro", "left-right", "rectangle", "rectangle-flat", "circle"]
            .map(String::from)
            .to_vec(),
        scaling: (0..117).map(|i| (0.5 + i as f32 / 100.0, i as f32 - 60.0)).collect(),
        layers: layers.iter().enumerate().map(dense).collect(),
    }
}

/// The same network with a scale for each row, and with an upper limit as in a ReLU6.
pub fn per_row_spec() -> BlobSpec {
    let mut spec = reference_spec();
    for layer in &mut spec.layers {
        let scale = layer.weight_scales[0];
        layer.weight_scales = (0..layer.weights.len()).map(|row| scale * (0.4 + 0.11 * row as f32)).collect();
    }
    spec.layers[0].largest = 90;
    spec
}
