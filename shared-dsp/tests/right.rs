//! Tests the complete right hand, from samples to events.

use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec, Model, build_blob};
use shared_dsp::right::{ModelMismatch, RightHand};

/// Builds one layer that selects `label` if the weighted sum of its inputs is above 0, and `idle` otherwise.
/// Each of the `inputs` has a weight of 1 or -1.
fn blob_of(
    recipe: FeatureKind,
    axes: usize,
    hop: u16,
    label: &str,
    scaling: Vec<(f32, f32)>,
    weighted: &[(usize, i8)],
) -> Vec<u8> {
    let weights = |sign: i8| {
        let mut weights = vec![0; scaling.len()];
        weighted.iter().for_each(|&(input, weight)| weights[input] = 100 * sign * weight);
        weights
    };
    let layers = vec![DenseSpec {
        weights: vec![weights(-1), weights(1)],
        biases: vec![0, 0],
        input_scale: 0.1,
        input_zero_point: 0,
        weight_scales: vec![0.01],
        output_scale: 0.1,
        output_zero_point: 0,
        relu: false,
        largest: i8::MAX,
    }];
    let labels = vec!["idle".into(), label.into()];
    build_blob(&BlobSpec { recipe, axes, sample_hz: 100, window: 200, hop, labels, scaling, layers }).unwrap()
}

/// Builds a model that returns `shake` if the variance of the first axis is above 4.
fn blob(axes: usize, hop: u16) -> Vec<u8> {
    let mut scaling = vec![(0.0, 0.0); 13 * axes];
    scaling[2] = (8.0, -32.0);
    blob_of(FeatureKind::Raw, axes, hop, "shake", scaling, &[(2, 1)])
}

/// Generates a sample. If `shaking` is true, the hand shakes.
fn sample(index: u32, shaking: bool) -> [f32; 3] {
    [if shaking { 5.0 * (index as f32 * 0.9).sin() } else { 0.0 }, 0.0, 9.81]
}

#[test]
fn each_shake_makes_one_event_and_results_come_every_hop() {
    let blob = blob(3, 8);
    let mut hand = RightHand::<3>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    let (mut hops, mut events) = (0, Vec::new());
    for index in 0..3000u32 {
        let shaking = matches!(index, 500..900 | 1500..1900);
        if let Some(output) = hand.push(&sample(index, shaking), 10 * index) {
            hops += 1;
            assert_eq!(output.window_end_ms, 10 * index);
            assert_eq!(output.full, index >= 199);
            assert_eq!(output.scores().len(), 2);
            if output.is_event {
                assert_eq!(output.event_window_end_ms, output.window_end_ms);
                events.push((index, output.label, output.events));
            }
        }
    }
    assert_eq!(hops, 3000 / 8);
    assert_eq!(events.len(), 2, "{events:?}");
    assert!((500..900).contains(&events[0].0) && (1500..1900).contains(&events[1].0), "{events:?}");
    assert_eq!((events[0].1, events[0].2, events[1].1, events[1].2), (1, 1, 1, 2));
}

#[test]
fn after_a_gap_the_window_fills_anew_and_events_stay_counted() {
    let blob = blob(3, 8);
    let mut hand = RightHand::<3>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    for index in 0..800 {
        hand.push(&sample(index, index >= 400), 10 * index);
    }
    assert_eq!((hand.output().events, hand.output().full), (1, true));
    hand.push(&sample(800, true), 8000);
    hand.gap();
    assert!(!hand.output().full);
    let mut full_at = None;
    for index in 0..600 {
        if let Some(output) = hand.push(&sample(index, true), 9000 + 10 * index) {
            if output.full {
                full_at.get_or_insert(index);
            }
            assert_eq!((output.events, output.label), (1, 1), "the shake before the gap has had its event");
        }
    }
    assert_eq!(full_at, Some(199));
}

#[test]
fn a_model_for_other_samples_is_refused() {
    let other_axes = blob(6, 8);
    let refused =
        RightHand::<3>::new(Model::parse(&other_axes).unwrap(), DecisionConfig::default()).map(|_| ());
    assert_eq!(refused, Err(ModelMismatch::Axes { model: 6, hand: 3 }));
    let other_hop = blob(3, 10);
    let refused =
        RightHand::<3>::new(Model::parse(&other_hop).unwrap(), DecisionConfig::default()).map(|_| ());
    assert_eq!(refused, Err(ModelMismatch::Window { window: 200, hop: 10 }));
}

#[test]
fn replaced_values_are_reported_while_they_are_in_the_window() {
    let blob = blob(3, 8);
    let mut hand = RightHand::<3>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    for index in 0..1000u32 {
        let mut sample = sample(index, false);
        if index == 300 {
            sample[1] = f32::NAN;
        }
        if let Some(output) = hand.push(&sample, 10 * index) {
            assert_eq!(output.replaced, (300..500).contains(&index), "sample {index}");
        }
    }
    assert_eq!(hand.replaced(), 1);
}

/// Builds a model that returns `sway` if the power across gravity is higher at 1.17 Hz than at 0.39 Hz.
fn sway_blob(axes: usize) -> Vec<u8> {
    // The spectrum follows four other features, and each of its lines has three axes.
    // The hand sways along the second axis.
    let (low, high) = (4 + 1, 4 + 3 * 2 + 1);
    let scaling = vec![(60.0, 0.0); FeatureKind::Aligned.feature_count(axes)];
    blob_of(FeatureKind::Aligned, axes, 8, "sway", scaling, &[(high, 1), (low, -1)])
}

/// Returns the numbers of the samples at which a hand that sways with this frequency in Hz has events.
fn sway<const A: usize>(hand: &mut RightHand<'_, A>, hz: f32, samples: usize) -> Vec<usize> {
    let mut events = Vec::new();
    for n in 0..samples {
        let mut sample = [0.0; A];
        sample[0] = 8.0 * (core::f32::consts::TAU * hz * n as f32 / 100.0).sin();
        sample[2] = 9.81;
        if hand.push(&sample, 10 * n as u32).is_some_and(|output| output.is_event) {
            events.push(n);
        }
    }
    events
}

#[test]
fn without_a_gyroscope_a_gesture_at_half_the_tempo_makes_its_event_later() {
    let blob = sway_blob(3);
    let hand = || RightHand::<3>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    let usual = sway(&mut hand(), 0.9, 1500);
    assert!(matches!(usual[..], [at] if at < 400), "{usual:?}");
    let slow = sway(&mut hand(), 0.45, 1500);
    assert!(matches!(slow[..], [at] if (400..1100).contains(&at)), "{slow:?}");

    let blob = sway_blob(6);
    let mut hand = RightHand::<6>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    assert_eq!(sway(&mut hand, 0.45, 1500), [], "with one there is no slow window");
}

#[test]
fn after_a_gap_at_any_sample_a_slow_gesture_is_seen_as_from_the_start() {
    let blob = sway_blob(3);
    let hand = || RightHand::<3>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    let expected = sway(&mut hand(), 0.45, 1500);
    for before in (1..20).chain(400..420) {
        let mut hand = hand();
        assert_eq!(sway(&mut hand, 0.45, before), []);
        hand.gap();
        assert_eq!(sway(&mut hand, 0.45, 1500), expected, "a gap after {before} samples");
    }
}
