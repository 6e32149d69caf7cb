//! Compares features with the float64 reference, over long runs and for difficult signals.

mod common;

use common::rows;
use proptest::prelude::*;
use shared_dsp::right::features::{FEATURES_PER_AXIS, FeatureWindow, HOP, WINDOW};

const NAMES: [&str; FEATURES_PER_AXIS] =
    ["mean", "rms", "variance", "skewness", "kurtosis", "P0", "P1", "P2", "P3", "P4", "P5", "P6", "P7"];

/// The definition, in float64.
fn reference(window: &[f32]) -> [f64; FEATURES_PER_AXIS] {
    let x: Vec<f64> = window.iter().map(|&v| f64::from(v)).collect();
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let moment = |power: i32| x.iter().map(|v| (v - mean).powi(power)).sum::<f64>() / n;
    let (m2, m3, m4) = (moment(2), moment(3), moment(4));
    let mut out = [0.0; FEATURES_PER_AXIS];
    out[0] = mean;
    out[1] = (x.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
    out[2] = m2;
    if x.iter().any(|v| *v != x[0]) {
        out[3] = m3 / m2.powf(1.5);
        out[4] = m4 / (m2 * m2) - 3.0;
    }
    // The mean affects only X[0]. Omitting it elsewhere avoids rounding errors in the reference.
    for k in 0..8 {
        for start in (0..=x.len() - 16).step_by(8) {
            let (mut re, mut im) = (0.0, 0.0);
            for (i, v) in x[start..start + 16].iter().enumerate() {
                let angle = std::f64::consts::TAU * ((i * k) % 16) as f64 / 16.0;
                let v = if k == 0 { *v } else { v - x[start] };
                re += v * angle.cos();
                im -= v * angle.sin();
            }
            out[5 + k] += (re * re + im * im) / 16.0 / 24.0;
        }
    }
    out
}

/// Returns the largest error relative to its tolerance, and where it occurs.
fn worst(got: &[f32; FEATURES_PER_AXIS], expected: &[f64; FEATURES_PER_AXIS]) -> (f64, usize) {
    let ratio = |f: usize| {
        let error = (f64::from(got[f]) - expected[f]).abs();
        let allowed = 1e-4 * if f == 3 || f == 4 { expected[f].abs().max(1.0) } else { expected[f].abs() };
        if error == 0.0 { 0.0 } else { error / allowed }
    };
    (0..FEATURES_PER_AXIS).map(|f| (ratio(f), f)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

fn assert_close(got: &[f32; FEATURES_PER_AXIS], expected: &[f64; FEATURES_PER_AXIS], what: &str) {
    let (ratio, f) = worst(got, expected);
    assert!(ratio <= 1.0, "{what}: {} is {:e} instead of {:e}", NAMES[f], got[f], expected[f]);
}

#[test]
fn features_equal_the_reference_vectors() {
    let (windows, expected) = (rows::<f32>("windows.csv"), rows::<f64>("features.csv"));
    assert_eq!((windows.len(), expected.len()), (8, 8));
    let mut largest = 0f64;
    let mut continued = FeatureWindow::<9>::new();
    for (window, expected) in windows.iter().zip(&expected) {
        let mut fresh = FeatureWindow::<9>::new();
        let (samples, _) = window.as_chunks::<9>();
        for (index, sample) in samples.iter().enumerate() {
            assert_eq!(fresh.push(sample), index == WINDOW - 1);
            continued.push(sample);
        }
        for axis in 0..9 {
            let expected = expected[13 * axis..13 * axis + 13].try_into().unwrap();
            assert_close(&fresh.features()[axis], &expected, "fresh");
            assert_close(&continued.features()[axis], &expected, "continued");
            largest = largest.max(worst(&fresh.features()[axis], &expected).0);
        }
    }
    println!("largest error: {largest:.5} of the bound");
}

#[test]
fn three_and_six_axes_give_what_nine_give() {
    let windows = rows::<f32>("windows.csv");
    let (mut nine, mut six, mut three) =
        (FeatureWindow::<9>::new(), FeatureWindow::<6>::new(), FeatureWindow::<3>::new());
    for sample in windows.concat().as_chunks::<9>().0 {
        let ready = nine.push(sample);
        assert_eq!(six.push(sample.first_chunk().unwrap()), ready);
        assert_eq!(three.push(sample.first_chunk().unwrap()), ready);
        if ready {
            // Each axis turns at its own hop, for any number of axes.
            assert_eq!(nine.features()[..6], six.features()[..]);
            assert_eq!(nine.features()[..3], three.features()[..]);
        }
    }
}

/// Returns deterministic noise, uniform from −1 to 1.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Feeds one axis, and compares every `stride`-th hop with the definition.
fn check_stream(name: &str, samples: usize, stride: usize, mut next: impl FnMut(usize) -> f32) -> f64 {
    let mut window = FeatureWindow::<1>::new();
    let mut history = [0f32; 2 * WINDOW];
    let mut largest = 0f64;
    let mut hops = 0;
    for index in 0..samples {
        let value = next(index);
        history[index % WINDOW] = value;
        history[index % WINDOW + WINDOW] = value;
        if window.push(&[value]) {
            hops += 1;
            if hops % stride == 1 % stride {
                let start = index % WINDOW + 1;
                let expected = reference(&history[start..start + WINDOW]);
                assert_close(&window.features()[0], &expected, &format!("{name}, sample {index}"));
                largest = largest.max(worst(&window.features()[0], &expected).0);
            }
        }
    }
    println!("{name}: largest error {largest:.5} of the bound");
    largest
}

#[test]
fn idle_under_gravity_keeps_its_shape() {
    let mut noise = Noise(1);
    check_stream("sigma 0.01 on 9.81", 40_000, 1, |_| (9.81 + 0.017 * noise.next()) as f32);
    check_stream("sigma 0.0003 on 9.81", 40_000, 1, |_| (9.81 + 0.0005 * noise.next()) as f32);
    let step = 9.80665 * 0.000_122;
    check_stream("quantised as an LSM9DS1 does", 40_000, 1, |_| {
        (((9.81 + 0.01 * noise.next()) / step).round() * step) as f32
    });
    check_stream("two neighbouring steps", 40_000, 1, |i| {
        (if i % 37 == 5 { 8201.0 * step } else { 8200.0 * step }) as f32
    });
    check_stream("rounding noise", 40_000, 1, |i| if i % 3 == 0 { 9.81 } else { 9.81f32.next_up() });
}

#[test]
fn idle_right_after_violent_motion_is_not_disturbed() {
    let mut noise = Noise(2);
    for (name, violent) in [("30 m/s2", 30.0), ("2000 deg/s", 2000.0), ("at the limit", 60_000.0)] {
        check_stream(name, 60_000, 1, |index| {
            let moving = index / 450 % 2 == 0;
            (9.81 + if moving { violent } else { 0.017 } * noise.next()) as f32
        });
    }
    check_stream("one spike", 20_000, 1, |index| {
        (-0.3 + 0.01 * noise.next() + if index % 1000 == 777 { 4000.0 } else { 0.0 }) as f32
    });
}

#[test]
fn small_means_of_large_swings_are_kept() {
    let mut noise = Noise(3);
    let mut phase = 0f64;
    check_stream("swinging gyroscope", 200_000, 1, |_| {
        phase += 0.1 + 0.02 * noise.next();
        (250.0 * phase.sin() + 3.0 * noise.next()) as f32
    });
}

#[test]
fn ten_million_samples_do_not_drift() {
    let mut noise = Noise(4);
    let mut phase = 0f64;
    // Checks every 997th hop, which covers all phases of both queues.
    check_stream("long mixture", 10_000_000, 997, |index| {
        phase += 0.13 + 0.05 * noise.next();
        let amplitude = [0.0, 0.01, 8.0, 300.0, 0.002][index / 1300 % 5];
        (9.81 + amplitude * (phase.sin() + 0.3 * noise.next()) + 0.004 * noise.next()) as f32
    });
}

#[test]
fn a_constant_signal_has_no_shape() {
    for value in [0.0f32, 9.81, -9.81, 1e-3, 65_536.0, -0.1] {
        let mut window = FeatureWindow::<1>::new();
        for index in 0..WINDOW + 30 * HOP {
            let full = window.push(&[value]);
            if full {
                let features = window.features()[0];
                let square = (f64::from(value) * f64::from(value)) as f32;
                assert!((features[0] - value).abs() <= 1e-6 * value.abs(), "{value}: mean {}", features[0]);
                assert!((features[1] - value.abs()).abs() <= 1e-6 * value.abs());
                assert_eq!(features[2..5], [0.0; 3], "{value} after {index}");
                assert!((features[5] - 16.0 * square).abs() <= 1e-5 * square);
                assert_eq!(features[6..], [0.0; 7]);
            }
        }
    }
}

#[test]
fn values_that_are_no_numbers_are_held_counted_and_forgotten() {
    let mut bad = FeatureWindow::<3>::new();
    let mut held = FeatureWindow::<3>::new();
    let mut noise = Noise(5);
    let mut last = 0.0;
    for index in 0..1000 {
        let value = noise.next() as f32;
        let broken = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][index % 3];
        let is_bad = index % 50 == 0 && index < 500;
        if !is_bad {
            last = value;
        }
        let ready = bad.push(&[1.0, if is_bad { broken } else { value }, value]);
        assert_eq!(held.push(&[1.0, last, value]), ready);
        assert_eq!(bad.features(), held.features());
        if index % HOP == HOP - 1 {
            assert_eq!(bad.replaced(), (index as u32 / 50 + 1).min(10), "sample {index}");
        }
        if index < 450 && index > HOP {
            assert!(bad.is_tainted(), "sample {index}");
        }
    }
    assert!(!bad.is_tainted());
    bad.reset();
    assert_eq!(bad.replaced(), 0);
}

proptest! {
    #[test]
    fn any_input_gives_finite_features(samples in prop::collection::vec(any::<u32>(), 400..600)) {
        let mut window = FeatureWindow::<1>::new();
        for bits in samples {
            window.push(&[f32::from_bits(bits)]);
            prop_assert!(window.features()[0].iter().all(|feature| feature.is_finite()));
        }
    }

    #[test]
    fn any_mixture_stays_within_the_bound(
        seed in 1u64..,
        constant in -100f64..100.0,
        amplitudes in prop::collection::vec(-3f64..4.0, 4),
    ) {
        let mut noise = Noise(seed);
        check_stream("mixture", 1600, 1, |index| {
            (constant + 10f64.powf(amplitudes[index / 400]) * noise.next()) as f32
        });
    }
}
