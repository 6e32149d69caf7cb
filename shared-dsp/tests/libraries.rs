//! Compares the accuracy of `micromath`, a library for microcontrollers, with our own functions.
//! docs/ARCHITECTURE.md lists the results of `cargo test -p shared-dsp --test libraries -- --nocapture`.

use micromath::F32;
use shared_dsp::left::tilt::{Acceleration, Tilt};
use shared_dsp::right::kind::{FeatureKind, LOG_FLOOR};

/// Every tilt has a guaranteed error below a milliradian, and thresholds are 52 mrad apart.
#[test]
fn tilts_are_within_a_milliradian_and_those_of_micromath_are_not() {
    let (mut ours, mut theirs) = (0.0_f64, 0.0_f64);
    for pitch_deg in -85..=85 {
        for roll_deg in -85..=85 {
            let (pitch, roll) = (f64::from(pitch_deg).to_radians(), f64::from(roll_deg).to_radians());
            let [x, y, z] = [pitch.tan(), roll.sin(), roll.cos()];
            let length = 4000.0 / (x * x + y * y + z * z).sqrt();
            let [x, y, z] = [x, y, z].map(|axis| (axis * length).round());
            let truth_mrad = 1000.0 * x.atan2((y * y + z * z).sqrt());
            let tilt = Tilt::of(Acceleration { x: x as i16, y: y as i16, z: z as i16 });
            ours = ours.max((f64::from(tilt.pitch_mrad) - truth_mrad).abs());
            let across = F32((y * y + z * z) as f32).sqrt();
            let coarse_mrad = 1000.0 * f64::from(F32(x as f32).atan2(across).0);
            theirs = theirs.max((coarse_mrad - truth_mrad).abs());
        }
    }
    println!("tilt: ours {ours:.2} mrad, micromath {theirs:.2} mrad at worst");
    assert!(ours <= 1.0, "{ours} mrad");
    assert!(theirs > 1.0, "micromath is good enough now: see docs/ARCHITECTURE.md");
}

/// Features that contain logarithms and roots are compared bit for bit with a reference.
#[test]
fn logarithms_and_roots_of_micromath_are_coarse() {
    let (mut log, mut coarse_log, mut coarse_root) = (0.0_f64, 0.0_f64, 0.0_f64);
    for step in 0..40_000 {
        let value = 10.0_f32.powf(-3.0 + step as f32 * 6.0 / 40_000.0);
        let truth = f64::from(value + LOG_FLOOR).log10();
        log = log.max((f64::from(FeatureKind::LogPower.transform(1, value)) - truth).abs());
        coarse_log = coarse_log.max((f64::from(F32(value + LOG_FLOOR).log10().0) - truth).abs());
        let root = f64::from(value).sqrt();
        coarse_root = coarse_root.max((f64::from(F32(value).sqrt().0) - root).abs() / root);
    }
    println!(
        "log10: ours {log:.1e}, micromath {coarse_log:.1e}; root: exact here, micromath {coarse_root:.1e} of it"
    );
    assert!(log < 1e-5 && coarse_log > 1e-4 && coarse_root > 1e-3);
}
