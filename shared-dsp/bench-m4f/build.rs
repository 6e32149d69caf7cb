//! Converts the reference figures to bytes, which the images include.

#[path = "../tests/common/mod.rs"]
mod common;

use std::path::{Path, PathBuf};

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec, build_blob};

/// Creates a model of recipe `aligned` with nine axes, eight labels and random weights, because only the shape matters.
fn aligned(hidden: [usize; 2]) -> Vec<u8> {
    const AXES: usize = 9;
    let inputs = FeatureKind::Aligned.feature_count(AXES);
    let widths = [inputs, hidden[0], hidden[1], 8];
    let mut state = 7u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 24) as i8).max(-127)
    };
    let layers = (0..3).map(|layer| DenseSpec {
        weights: (0..widths[layer + 1]).map(|_| (0..widths[layer]).map(|_| random()).collect()).collect(),
        biases: (0..widths[layer + 1]).map(|_| i32::from(random()) * 16).collect(),
        input_scale: 0.05,
        input_zero_point: if layer == 0 { 0 } else { -128 },
        weight_scales: vec![0.01],
        output_scale: 0.05,
        output_zero_point: if layer < 2 { -128 } else { 0 },
        relu: layer < 2,
        largest: i8::MAX,
    });
    build_blob(&BlobSpec {
        recipe: FeatureKind::Aligned,
        axes: AXES,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: ["idle", "a", "b", "c", "d", "e", "f", "other"].map(String::from).to_vec(),
        scaling: vec![(60.0, 0.0); inputs],
        layers: layers.collect(),
    })
    .expect("a valid model")
}

fn main() {
    let out = PathBuf::from(std::env::var("OUT_DIR").unwrap());
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(out.join(name), bytes).unwrap();
    let mut spec = common::reference_spec();
    write("raw.blob", shared_dsp::right::network::build_blob(&spec).unwrap());
    write("rows.blob", shared_dsp::right::network::build_blob(&common::per_row_spec()).unwrap());
    spec.recipe = FeatureKind::LogPower;
    write("log.blob", shared_dsp::right::network::build_blob(&spec).unwrap());
    if std::env::var_os("CARGO_FEATURE_SIZES").is_some() {
        for [first, second] in [[20, 10], [40, 20], [60, 30], [80, 40]] {
            write(&format!("{first}-{second}.blob"), aligned([first, second]));
        }
    }
    let inputs = common::rows::<i8>("inputs_int8.csv").concat();
    write("inputs.bin", inputs.iter().map(|&x| x as u8).collect());
    let windows = common::rows::<f32>("windows.csv").concat();
    write("windows.bin", windows.iter().flat_map(|x| x.to_le_bytes()).collect());
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let layout = root.join("link.ld");
    println!("cargo::rustc-link-arg-bins=-T{}", layout.display());
    println!("cargo::rustc-link-arg-bins=--gc-sections");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={}", root.join("../tests/data").display());
    println!("cargo::rerun-if-changed={}", layout.display());
}
