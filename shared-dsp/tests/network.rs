//! Compares the int8 network with TFLite's reference kernels. Also tests the blob parser with damaged input.

mod common;

use common::{reference_spec, rows};
use proptest::prelude::*;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{
    BlobSpec, DenseSpec, MAX_LABELS, Model, ModelError, WrongLength, build_blob,
};

#[test]
fn logits_and_scores_equal_tflites_reference_kernels_on_all_vectors() {
    let blob = build_blob(&reference_spec()).unwrap();
    let model = Model::parse(&blob).unwrap();
    let inputs = rows::<i8>("inputs_int8.csv");
    let (logits, outputs) = (rows::<i8>("logits_mlp_int8_ref.csv"), rows::<i8>("outputs_mlp_int8_ref.csv"));
    assert_eq!((inputs.len(), logits.len(), outputs.len()), (64, 64, 64));
    for (index, input) in inputs.iter().enumerate() {
        let (mut logit, mut score) = ([0; MAX_LABELS], [0; 7]);
        model.infer_with_logits(input, &mut logit, &mut score).unwrap();
        assert_eq!(&logit[..7], &logits[index][..], "logits of vector {index}");
        assert_eq!(&score[..], &outputs[index][..], "outputs of vector {index}");
    }
}

#[test]
fn any_alignment_gives_the_same_scores() {
    let blob = build_blob(&reference_spec()).unwrap();
    let input = &rows::<i8>("inputs_int8.csv")[5];
    let expected = &rows::<i8>("outputs_mlp_int8_ref.csv")[5];
    for offset in 0..4 {
        let mut shifted = vec![0; offset];
        shifted.extend(&blob);
        let mut score = [0; 7];
        Model::parse(&shifted[offset..]).unwrap().infer(input, &mut score).unwrap();
        assert_eq!(&score[..], &expected[..]);
    }
}

#[test]
fn info_tells_what_went_in() {
    let spec = reference_spec();
    let blob = build_blob(&spec).unwrap();
    let model = Model::parse(&blob).unwrap();
    let info = model.info();
    assert_eq!((info.axes, info.inputs, info.label_count), (9, 117, 7));
    assert_eq!((info.sample_hz, info.window, info.hop), (100, 200, 8));
    assert_eq!(info.recipe, FeatureKind::Raw);
    assert!(info.labels().eq(spec.labels.iter().map(String::as_str)));
    assert_eq!(info.label(6), Some("circle"));
    assert_eq!(info.label(7), None);
    assert_eq!(info.model_id, shared_dsp::right::network::crc32(&blob));
    assert_eq!(shared_dsp::right::network::crc32(b"123456789"), 0xCBF4_3926);
}

#[test]
fn quantising_rounds_scales_and_limits() {
    let mut spec = reference_spec();
    spec.scaling = vec![(2.0, 1.0); 117];
    let blob = build_blob(&spec).unwrap();
    let model = Model::parse(&blob).unwrap();
    let mut features = [[0.0f32; 13]; 9];
    features[0] = [
        0.0,
        0.24,
        0.25,
        -0.76,
        -0.75,
        63.0,
        63.3,
        -64.5,
        -64.8,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::NAN,
        1e30,
    ];
    let mut inputs = [0; 117];
    model.quantise(&features, &mut inputs).unwrap();
    assert_eq!(inputs[..13], [1, 1, 2, -1, 0, 127, 127, -128, -128, 127, -128, -128, 127]);
    assert_eq!(inputs[13..], [1; 104]);
}

#[test]
fn classify_equals_quantise_and_infer() {
    for recipe in [FeatureKind::Raw, FeatureKind::LogPower] {
        let blob = build_blob(&BlobSpec { recipe, ..reference_spec() }).unwrap();
        let model = Model::parse(&blob).unwrap();
        let features: [[f32; 13]; 9] =
            std::array::from_fn(|a| std::array::from_fn(|f| ((a * 13 + f) as f32 * 0.7).sin() * 50.0 + 51.0));
        let (mut inputs, mut two_steps, mut one_step) = ([0; 117], [0; 7], [0; 7]);
        model.quantise(&features, &mut inputs).unwrap();
        model.infer(&inputs, &mut two_steps).unwrap();
        model.classify(&features, &mut one_step).unwrap();
        assert_eq!(one_step, two_steps);
    }
}

#[test]
fn wrong_lengths_are_refused() {
    let blob = build_blob(&reference_spec()).unwrap();
    let model = Model::parse(&blob).unwrap();
    assert_eq!(model.infer(&[0; 116], &mut [0; 7]), Err(WrongLength));
    assert_eq!(model.infer(&[0; 117], &mut [0; 6]), Err(WrongLength));
    assert_eq!(model.classify(&[[0.0; 13]; 8], &mut [0; 7]), Err(WrongLength));
    assert_eq!(model.quantise(&[[0.0; 13]; 9], &mut [0; 118]), Err(WrongLength));
}

#[test]
fn damaged_headers_have_typed_errors() {
    let blob = build_blob(&reference_spec()).unwrap();
    let with = |at: usize, value: u8| {
        let mut damaged = blob.clone();
        damaged[at] = value;
        Model::parse(&damaged).map(|_| ()).unwrap_err()
    };
    assert_eq!(with(0, b'X'), ModelError::NotAModel);
    assert_eq!(with(4, 9), ModelError::Version(9));
    assert_eq!(with(5, 77), ModelError::Recipe(77));
    assert_eq!(with(6, 10), ModelError::Header);
    let mut infinite = blob.clone();
    infinite[28..32].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert_eq!(Model::parse(&infinite).map(|_| ()), Err(ModelError::Scaling { feature: 0 }));
    assert_eq!(with(28 + 8 * 117 + 8, 0), ModelError::Layer { layer: 0 });
    assert_eq!(Model::parse(&blob[..blob.len() - 1]).map(|_| ()), Err(ModelError::Truncated));
    assert_eq!(Model::parse(&[]).map(|_| ()), Err(ModelError::Truncated));
}

/// A simple model of TFLite's arithmetic, with which networks of other shapes are compared.
fn naive(spec: &BlobSpec, input: &[i8]) -> Vec<i8> {
    let mut x: Vec<i8> = input.to_vec();
    for layer in &spec.layers {
        let scale_of = |row: usize| {
            let scales = &layer.weight_scales;
            let weight_scale = scales[row.min(scales.len() - 1)];
            let real = f64::from(layer.input_scale) * f64::from(weight_scale) / f64::from(layer.output_scale);
            let exponent = real.log2().floor() as i32 + 1;
            ((real / 2f64.powi(exponent) * 2f64.powi(31)).round() as i64, exponent)
        };
        x = layer
            .weights
            .iter()
            .zip(&layer.biases)
            .enumerate()
            .map(|(index, (row, &bias))| {
                let (multiplier, exponent) = scale_of(index);
                let sum: i64 = row
                    .iter()
                    .zip(&x)
                    .map(|(&w, &x)| i64::from(w) * (i64::from(x) - i64::from(layer.input_zero_point)))
                    .sum();
                let shift = 31 - exponent;
                let product = (sum + i64::from(bias)) * multiplier;
                let scaled = ((i128::from(product) + (1i128 << (shift - 1))) >> shift) as i64;
                let low = if layer.relu { i64::from(layer.output_zero_point) } else { -128 };
                (scaled + i64::from(layer.output_zero_point)).clamp(low.max(-128), i64::from(layer.largest))
                    as i8
            })
            .collect();
    }
    x
}

fn dense(rng: &mut impl FnMut() -> u64, inputs: usize, outputs: usize, relu: bool) -> DenseSpec {
    let output_zero_point = (rng() % 256) as i8;
    DenseSpec {
        weights: (0..outputs)
            .map(|_| (0..inputs).map(|_| (rng() % 255) as i8).map(|w| w.max(-127)).collect())
            .collect(),
        biases: (0..outputs).map(|_| (rng() % 20001) as i32 - 10000).collect(),
        input_scale: 0.02,
        input_zero_point: (rng() % 256) as i8,
        // Each row has its own scale. This is TFLite's default.
        weight_scales: match rng() % 2 {
            0 => vec![0.01],
            _ => (0..outputs).map(|_| 0.001 + (rng() % 1000) as f32 * 2e-5).collect(),
        },
        output_scale: 0.001 * 10f32.powi((rng() % 4) as i32),
        output_zero_point,
        relu,
        largest: if rng().is_multiple_of(3) {
            output_zero_point.saturating_add((rng() % 100) as i8)
        } else {
            i8::MAX
        },
    }
}

#[test]
fn only_what_needs_the_second_version_of_the_blob_is_of_it() {
    let mut spec = reference_spec();
    assert_eq!(build_blob(&spec).unwrap()[4], 1);
    spec.layers[0].largest = 100;
    let blob = build_blob(&spec).unwrap();
    assert_eq!(blob[4], 2);
    // An image that supports only version 1 must refuse this blob.
    let mut first = blob.clone();
    first[4] = 1;
    assert_eq!(Model::parse(&first).map(|_| ()), Err(ModelError::Layer { layer: 0 }));
    spec.layers[0].weight_scales = vec![0.1, 0.2];
    let error = build_blob(&spec).unwrap_err().to_string();
    assert!(error.contains("2 scales for 20 outputs"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn any_stack_of_layers_equals_plain_arithmetic(
        axes in 1usize..=9,
        hidden in prop::collection::vec(1usize..=256, 0..4),
        labels in 2usize..=16,
        seed in any::<u64>(),
    ) {
        let mut state = seed | 1;
        let mut rng = move || { state ^= state << 13; state ^= state >> 7; state ^= state << 17; state >> 11 };
        let mut layers = Vec::new();
        let mut width = 13 * axes;
        for &next in &hidden {
            layers.push(dense(&mut rng, width, next, true));
            width = next;
        }
        layers.push(dense(&mut rng, width, labels, false));
        let spec = BlobSpec {
            axes,
            labels: (0..labels).map(|l| format!("label{l}")).collect(),
            scaling: vec![(1.0, 0.0); 13 * axes],
            layers,
            ..reference_spec()
        };
        let blob = build_blob(&spec).unwrap();
        let model = Model::parse(&blob).unwrap();
        for _ in 0..4 {
            let input: Vec<i8> = (0..13 * axes).map(|_| rng() as i8).collect();
            let (mut logits, mut scores) = ([0; MAX_LABELS], vec![0; labels]);
            model.infer_with_logits(&input, &mut logits, &mut scores).unwrap();
            prop_assert_eq!(&logits[..labels], &naive(&spec, &input)[..]);
        }
    }

    #[test]
    fn mutated_blobs_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12),
        header_edits in prop::collection::vec((0usize..28, any::<u8>()), 0..3),
        cut in prop::option::of(any::<prop::sample::Index>()),
        per_row: bool,
    ) {
        let mut spec = reference_spec();
        if per_row {
            spec.layers[1].weight_scales = (1..=10).map(|row| 0.001 * row as f32).collect();
        }
        let mut blob = build_blob(&spec).unwrap();
        for (at, value) in &edits {
            let at = at.index(blob.len());
            blob[at] = *value;
        }
        for &(at, value) in &header_edits {
            blob[at] = value;
        }
        if let Some(cut) = cut {
            blob.truncate(cut.index(blob.len()));
        }
        if let Ok(model) = Model::parse(&blob) {
            let info = *model.info();
            let mut scores = vec![0; info.label_count];
            for fill in [-128, 0, 127] {
                model.infer(&vec![fill; info.inputs], &mut scores).unwrap();
            }
            model.classify(&vec![[1.5; 13]; info.axes], &mut scores).unwrap();
        }
    }
}

#[test]
fn the_softmax_table_carries_only_what_can_reach_an_output() {
    let blob = build_blob(&reference_spec()).unwrap();
    assert!(blob.len() < 4900, "{} bytes", blob.len());
}
