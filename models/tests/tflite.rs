//! TFLite files: ours, TensorFlow's, and damaged ones.

use std::path::PathBuf;

use models::tflite::{End, FloatLayer, Network, TfliteError, infer_float, read, read_to_end, write};
use proptest::prelude::*;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec, Model, build_blob};

#[path = "common/shared.rs"]
mod shared;

fn reference(name: &str) -> Option<PathBuf> {
    shared::shared(&format!("reference/mlp/{name}"))
}

fn rows<T: std::str::FromStr>(file: PathBuf) -> Vec<Vec<T>> {
    let text = std::fs::read_to_string(file).unwrap();
    let row = |line: &str| line.split(',').filter_map(|v| v.trim().parse().ok()).collect::<Vec<T>>();
    text.lines().map(row).filter(|row: &Vec<T>| !row.is_empty()).collect()
}

fn blob(layers: Vec<DenseSpec>) -> Vec<u8> {
    let inputs = layers[0].weights[0].len();
    let labels = layers[layers.len() - 1].weights.len();
    build_blob(&BlobSpec {
        recipe: FeatureKind::Raw,
        axes: inputs / 13,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: (0..labels).map(|n| format!("l{n}")).collect(),
        scaling: vec![(1.0, 0.0); inputs],
        layers,
    })
    .unwrap()
}

#[test]
fn tensorflows_int8_file_gives_the_scores_of_its_reference_kernels() {
    let Some(file) = reference("mlp_int8.tflite") else { return };
    let Network::Int8(layers) = read(&std::fs::read(file).unwrap()).unwrap() else { panic!("int8") };
    let blob = blob(layers);
    let model = Model::parse(&blob).unwrap();
    let inputs: Vec<Vec<i8>> = rows(reference("inputs_int8.csv").unwrap());
    let wanted: Vec<Vec<i8>> = rows(reference("outputs_mlp_int8_ref.csv").unwrap());
    assert_eq!((inputs.len(), wanted.len()), (64, 64));
    for (input, wanted) in inputs.iter().zip(&wanted) {
        let mut scores = [0i8; 7];
        model.infer(input, &mut scores).unwrap();
        assert_eq!(scores.as_slice(), wanted);
    }
}

#[test]
fn tensorflows_float_file_gives_its_scores() {
    let Some(file) = reference("mlp_float.tflite") else { return };
    let Network::Float(layers) = read(&std::fs::read(file).unwrap()).unwrap() else { panic!("float") };
    let inputs: Vec<Vec<f32>> = rows(reference("inputs_float.csv").unwrap());
    let wanted: Vec<Vec<f32>> = rows(reference("outputs_mlp_float_ref.csv").unwrap());
    assert_eq!((inputs.len(), wanted.len()), (64, 64));
    for (input, wanted) in inputs.iter().zip(&wanted) {
        for (got, want) in infer_float(&layers, input).iter().zip(wanted) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }
}

/// A file that `make_tflite_fixtures.py` has made.
fn fixture(name: &str) -> Vec<u8> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tflite_fixtures");
    std::fs::read(folder.join(name)).unwrap()
}

/// Inputs that the script gave to TFLite's interpreter: the same formula.
fn fixture_input(row: u64, rows: u64, width: u64) -> Vec<i8> {
    let one = |column: u64| {
        let mixed = (row * 1009 + column * 9176 + 12345) * 2_654_435_761;
        let full = ((mixed >> 13) % 256) as i64 - 128;
        (if row < rows / 2 { full.div_euclid(4) } else { full }) as i8
    };
    (0..width).map(one).collect()
}

#[test]
fn tensorflows_exports_in_eight_modes_give_the_answers_of_its_interpreter() {
    const ROWS: u64 = 1000;
    let modes = ["int8", "uint8", "float-io", "per-tensor", "reshape", "logits", "no-bias", "relu6"];
    for (network, width, outputs) in [("paper", 117, 7), ("three", 39, 5)] {
        for mode in modes {
            let name = format!("{network}-{mode}");
            let (layers, end) = read_to_end(&fixture(&format!("{name}.tflite"))).unwrap();
            let Network::Int8(layers) = layers else { panic!("{name}") };
            assert_eq!(end, if mode == "logits" { End::Logits } else { End::Softmax }, "{name}");
            let per_channel = layers.iter().any(|layer| layer.weight_scales.len() > 1);
            assert_eq!(per_channel, mode != "per-tensor", "{name}");
            let blob = blob(layers);
            // What an older image can read stays as it was.
            assert_eq!(blob[4], if per_channel { 2 } else { 1 }, "{name}");
            let model = Model::parse(&blob).unwrap();
            let wanted = fixture(&format!("{name}.answers.bin"));
            assert_eq!(wanted.len() as u64, ROWS * outputs);
            let mut different = std::collections::BTreeSet::new();
            for (row, wanted) in wanted.chunks(outputs as usize).enumerate() {
                let wanted: Vec<i8> = wanted.iter().map(|&byte| byte as i8).collect();
                let input = fixture_input(row as u64, ROWS, width);
                let (mut logits, mut scores) =
                    ([0; shared_dsp::right::network::MAX_LABELS], vec![0; outputs as usize]);
                model.infer_with_logits(&input, &mut logits, &mut scores).unwrap();
                let got = if end == End::Logits { &logits[..outputs as usize] } else { &scores[..] };
                assert_eq!(got, wanted, "{name}, input {row}");
                different.insert(wanted);
            }
            assert!(different.len() > 50, "{name}: {} answers say little", different.len());
        }
    }
}

#[test]
fn what_tensorflow_exports_besides_is_refused_by_name() {
    for (mode, told) in [
        (
            "dynamic",
            "INT8 weights for FLOAT32 values (dynamic range); export the full-integer (int8) network",
        ),
        ("float16", "DEQUANTIZE on weights of type FLOAT16; export the full-integer (int8) network"),
        ("tanh", "operator 1 of the TFLite file is TANH; only FULLY_CONNECTED"),
    ] {
        let error = read(&fixture(&format!("paper-{mode}.tflite"))).unwrap_err().to_string();
        assert!(error.contains(told), "{mode}: {error}");
    }
    assert!(matches!(read(&fixture("paper-float.tflite")), Ok(Network::Float(layers)) if layers.len() == 4));
}

#[test]
fn a_reshape_whose_shape_is_computed_is_read() {
    let Some(folder) = shared::shared("cases/tflite") else { return };
    let (network, end) = read_to_end(&std::fs::read(folder.join("c10-reshape.tflite")).unwrap()).unwrap();
    assert_eq!((network.inputs(), network.outputs(), end), (117, 7, End::Softmax));
    for name in ["c01-default-int8", "c06-int8-float-io"] {
        let network = read(&std::fs::read(folder.join(format!("{name}.tflite"))).unwrap()).unwrap();
        assert!(matches!(network, Network::Int8(_)), "{name}");
    }
}

#[test]
fn networks_of_every_mode_survive_our_writing_and_reading() {
    for mode in ["int8", "per-tensor", "relu6", "no-bias"] {
        let network = read(&fixture(&format!("paper-{mode}.tflite"))).unwrap();
        assert_eq!(read(&write(&network)).unwrap(), network, "{mode}");
    }
}

#[test]
fn what_tensorflow_wrote_survives_our_writing_and_reading() {
    for name in ["mlp_int8.tflite", "mlp_float.tflite"] {
        let Some(file) = reference(name) else { return };
        let network = read(&std::fs::read(file).unwrap()).unwrap();
        assert_eq!(read(&write(&network)).unwrap(), network);
    }
}

fn float_network() -> Network {
    let layer = |outputs: usize, inputs: usize, relu| FloatLayer {
        weights: (0..outputs).map(|o| (0..inputs).map(|i| (o + i) as f32 * 0.1).collect()).collect(),
        biases: vec![0.5; outputs],
        relu,
    };
    Network::Float(vec![layer(5, 39, true), layer(3, 5, false)])
}

fn int8_network() -> Network {
    let layer = |outputs: usize, inputs: usize, (input_scale, input_zero_point), relu| DenseSpec {
        weights: vec![vec![-3; inputs]; outputs],
        biases: vec![1000; outputs],
        input_scale,
        input_zero_point,
        weight_scales: vec![0.01],
        output_scale: 0.05,
        output_zero_point: -128,
        relu,
        largest: i8::MAX,
    };
    // The outputs of one layer are the inputs of the next.
    Network::Int8(vec![layer(5, 39, (0.03, -1), true), layer(3, 5, (0.05, -128), false)])
}

#[test]
fn float_and_int8_networks_survive_writing_and_reading() {
    for network in [float_network(), int8_network()] {
        let bytes = write(&network);
        assert_eq!(bytes, write(&network), "the same network gives the same bytes");
        assert_eq!(read(&bytes).unwrap(), network);
    }
}

#[test]
fn constants_lie_at_multiples_of_16_bytes() {
    // TFLite's schema wants it; kernels read the int32 biases in place.
    let bytes = write(&int8_network());
    let biases: Vec<u8> = [1000i32; 5].iter().flat_map(|b| b.to_le_bytes()).collect();
    let at = bytes.windows(biases.len()).position(|window| window == biases).unwrap();
    assert_eq!(at % 16, 0);
}

#[test]
fn a_foreign_operator_is_named() {
    // Operator codes are the only places that hold 25 (SOFTMAX) as byte and as int32.
    let bytes = write(&float_network());
    let mut renamed = 0;
    let mut bytes = bytes;
    for at in 0..bytes.len() - 4 {
        if bytes[at..at + 4] == 25i32.to_le_bytes() {
            bytes[at..at + 4].copy_from_slice(&3i32.to_le_bytes());
            renamed += 1;
        }
    }
    for byte in &mut bytes {
        if *byte == 25 {
            *byte = 3;
            renamed += 1;
        }
    }
    assert!(renamed >= 2);
    let error = read(&bytes).unwrap_err();
    assert_eq!(error, TfliteError::ForeignOperator { index: 2, name: "CONV_2D".to_owned() });
    assert!(error.to_string().contains("operator 2 of the TFLite file is CONV_2D; only FULLY_CONNECTED"));
}

#[test]
fn other_files_are_refused() {
    assert_eq!(read(b""), Err(TfliteError::NotTflite));
    assert_eq!(read(b"timestamp,accX"), Err(TfliteError::NotTflite));
    let bytes = write(&float_network());
    assert!(read(&bytes[..bytes.len() / 2]).is_err());
}

proptest! {
    #[test]
    fn damaged_files_never_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12), int8: bool) {
        let mut bytes = write(&if int8 { int8_network() } else { float_network() });
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(network) = read(&bytes) {
            // Whatever is accepted can be used.
            if let Network::Int8(layers) = network {
                let _ = build_blob(&BlobSpec {
                    recipe: FeatureKind::Raw,
                    axes: 3,
                    sample_hz: 100,
                    window: 200,
                    hop: 8,
                    labels: vec!["a".into(), "b".into(), "c".into()],
                    scaling: vec![(1.0, 0.0); 39],
                    layers,
                });
            } else if let Network::Float(layers) = network {
                let _ = infer_float(&layers, &[1.0; 39]);
            }
        }
    }

    #[test]
    fn shortened_files_and_noise_never_panic(cut: prop::sample::Index, noise in prop::collection::vec(any::<u8>(), 0..400)) {
        let bytes = write(&int8_network());
        let _ = read(&bytes[..cut.index(bytes.len())]);
        let mut named = noise;
        if named.len() >= 8 {
            named[4..8].copy_from_slice(b"TFL3");
        }
        let _ = read(&named);
    }
}
