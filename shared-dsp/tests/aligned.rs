//! Compares recipe 3 with its reference in numpy, and checks its behaviour without movement.

use proptest::prelude::*;
use serde_json::Value;
use shared_dsp::right::aligned::{AlignedWindow, MAX_FEATURES, feature_count};
use shared_dsp::right::features::{HOP, WINDOW};

/// Returns the features of the last window of `samples`.
fn features<const A: usize>(samples: &[Vec<f32>]) -> Vec<f32> {
    let mut window = AlignedWindow::<A>::new();
    for sample in samples {
        window.push(sample.first_chunk().unwrap());
    }
    assert!(window.is_full());
    window.features().to_vec()
}

fn any_features(samples: &[Vec<f32>]) -> Vec<f32> {
    match samples[0].len() {
        3 => features::<3>(samples),
        6 => features::<6>(samples),
        _ => features::<9>(samples),
    }
}

/// A movement with a different tempo on each of 9 axes.
fn swing(count: usize) -> Vec<Vec<f32>> {
    let value = |n: usize, axis: usize| {
        let t = n as f32 / 100.0;
        let rest = [2.0, 3.0, 9.0, 0.0, 5.0, -3.0, 20.0, -10.0, 40.0][axis];
        rest + [3.0, 60.0, 5.0][axis / 3] * ((4.0 + axis as f32) * t + axis as f32).sin()
    };
    (0..count).map(|n| (0..9).map(|axis| value(n, axis)).collect()).collect()
}

fn assert_close(got: &[f32], expected: &[f32], tolerance: f32, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (index, (a, b)) in got.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance, "{what}, feature {index}: {a} instead of {b}");
    }
}

#[test]
fn features_equal_those_of_numpy() {
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/aligned.json")).unwrap();
    let cases: Value = serde_json::from_str(&text).unwrap();
    let numbers = |list: &Value| -> Vec<f32> {
        list.as_array().unwrap().iter().map(|value| value.as_f64().unwrap() as f32).collect()
    };
    let mut seen = 0;
    for case in cases.as_array().unwrap() {
        let window: Vec<Vec<f32>> = case["window"].as_array().unwrap().iter().map(numbers).collect();
        let got = any_features(&window);
        assert_eq!(got.len(), feature_count(window[0].len()));
        assert_close(&got, &numbers(&case["features"]), 5e-5, case["name"].as_str().unwrap());
        seen += 1;
    }
    assert_eq!(seen, 12);
}

#[test]
fn a_window_depends_on_its_own_samples_only() {
    // The features depend only on the window, bit for bit. Previous samples and the phase of the ring have no effect.
    let window = swing(WINDOW);
    let expected = features::<9>(&window);
    for hops_before in [1, 7, 24, 25, 61] {
        let mut samples: Vec<Vec<f32>> =
            (0..HOP * hops_before).map(|n| vec![1e4 * (n as f32).sin(); 9]).collect();
        samples.extend(window.iter().cloned());
        assert_eq!(features::<9>(&samples), expected, "{hops_before} hops before");
    }
}

#[test]
fn features_are_new_once_per_hop_from_the_full_window_on() {
    let mut window = AlignedWindow::<3>::new();
    for n in 0..3 * WINDOW {
        let ready = window.push(&[0.0, 0.0, 9.8]);
        assert_eq!(ready, n + 1 >= WINDOW && (n + 1) % HOP == 0, "sample {n}");
    }
    window.reset();
    assert!(!window.is_full());
}

#[test]
fn the_magnetometer_does_not_matter() {
    let nine = swing(WINDOW);
    let six: Vec<Vec<f32>> = nine.iter().map(|sample| sample[..6].to_vec()).collect();
    assert_eq!(features::<9>(&nine), features::<6>(&six));
    let mut broken = nine.clone();
    broken.iter_mut().for_each(|sample| sample[6..].fill(f32::NAN));
    assert_eq!(features::<9>(&broken), features::<6>(&six));
}

#[test]
fn a_still_hand_gives_the_same_in_any_posture_and_without_gravity() {
    let still = |gravity: [f32; 3]| vec![[gravity.as_slice(), &[1.5, -0.5, 0.25]].concat(); WINDOW];
    let expected = features::<6>(&still([0.0, 0.0, 9.806_65]));
    for gravity in [[9.806_65, 0.0, 0.0], [0.0, -9.806_65, 0.0], [5.661_872; 3], [0.0; 3], [1e-6, 0.0, 1e-5]]
    {
        let got = features::<6>(&still(gravity));
        let last = MAX_FEATURES - 1;
        assert_close(&got[..last], &expected[..last], 1e-5, "posture");
        let length = gravity.iter().map(|g| g * g).sum::<f32>().sqrt();
        assert!((got[last] - 2.0 * (length / 9.806_65 - 1.0)).abs() < 1e-5);
    }
}

#[test]
fn movement_is_told_from_rest() {
    let mut still = AlignedWindow::<9>::new();
    let mut moving = AlignedWindow::<9>::new();
    for sample in swing(WINDOW) {
        still.push(&[0.0, 0.0, 9.8, 0.0, 0.0, 0.0, 20.0, 0.0, 40.0]);
        moving.push(sample.first_chunk().unwrap());
    }
    assert_eq!((still.movement().acceleration, still.movement().rotation), (0.0, 0.0));
    assert!(
        moving.movement().acceleration > 0.7 && moving.movement().rotation > 30.0,
        "{:?}",
        moving.movement()
    );
}

#[test]
fn values_that_are_no_numbers_repeat_the_last_good_one_and_are_reported() {
    let mut bad = AlignedWindow::<3>::new();
    let mut held = AlignedWindow::<3>::new();
    for n in 0..3 * WINDOW {
        let t = n as f32 / 100.0;
        let good = [3.0 * (5.0 * t).sin(), 1.0, 9.8];
        let missing = (210..220).contains(&n);
        let last = 3.0 * (5.0f32 * 2.09).sin();
        bad.push(&if missing { [f32::NAN, f32::INFINITY, 9.8] } else { good });
        held.push(&if missing { [last, 1.0, 9.8] } else { good });
        assert_eq!(bad.features(), held.features(), "sample {n}");
        if n % HOP == HOP - 1 {
            let first = 210 / HOP * HOP;
            assert_eq!(bad.is_tainted(), n >= first && n < 220 / HOP * HOP + WINDOW, "sample {n}");
        }
    }
    assert_eq!(bad.replaced(), 20);
}

proptest! {
    #[test]
    fn turning_and_mirroring_the_sensor_change_nothing(angles in [-3.0f32..3.0, -3.0..3.0, -3.0..3.0], mirrored: bool) {
        let samples = swing(WINDOW);
        let turned: Vec<Vec<f32>> = samples.iter().map(|sample| {
            let mut sample = sample.clone();
            if mirrored {
                // The mirror is a plane. Acceleration is a vector, and rotation is an axial vector.
                sample[1] = -sample[1];
                sample[3] = -sample[3];
                sample[5] = -sample[5];
            }
            for triad in sample.chunks_mut(3) {
                for (axis, angle) in angles.iter().enumerate() {
                    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                    let (x, y) = (triad[a], triad[b]);
                    triad[a] = angle.cos() * x - angle.sin() * y;
                    triad[b] = angle.sin() * x + angle.cos() * y;
                }
            }
            sample
        }).collect();
        let (expected, got) = (features::<9>(&samples), features::<9>(&turned));
        for (a, b) in expected.iter().zip(&got) {
            prop_assert!((a - b).abs() < 2e-3, "{a} became {b}");
        }
    }

    #[test]
    fn any_bits_give_finite_features(bits in proptest::collection::vec(proptest::array::uniform6(any::<u32>()), WINDOW)) {
        let samples: Vec<Vec<f32>> = bits.iter().map(|row| row.iter().map(|&b| f32::from_bits(b)).collect()).collect();
        prop_assert!(features::<6>(&samples).iter().all(|value| value.is_finite()));
    }
}
