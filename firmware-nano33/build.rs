//! Hands the linker the memory layout of the variant that is built.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let layout = if env::var_os("CARGO_FEATURE_BLE").is_some() { "../memory.x" } else { "memory-bootloader.x" };
    fs::copy(layout, out.join("memory.x")).expect("the memory layout is readable");
    fs::write(out.join("model.blob"), placeholder()).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed={layout}");
    println!("cargo:rerun-if-changed=build.rs");
    // Page alignment of segments is for hosted systems (it would move the image in flash).
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
}

// TEMPORARY until models/bundled exists.
fn placeholder() -> Vec<u8> {
    use shared_dsp::mlp::{BlobSpec, DenseSpec, build_blob};
    let sizes = [117, 20, 10, 5, 7];
    let mut r = 1u32;
    let mut random = move || {
        r = r.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((r >> 24) as i8).max(-127)
    };
    let layers = (0..4)
        .map(|l| DenseSpec {
            weights: (0..sizes[l + 1]).map(|_| (0..sizes[l]).map(|_| random()).collect()).collect(),
            biases: (0..sizes[l + 1]).map(|_| i32::from(random()) * 16).collect(),
            input_scale: 0.05,
            input_zero_point: 0,
            weight_scale: 0.01,
            output_scale: 0.05,
            output_zero_point: if l < 3 { -128 } else { 0 },
            relu: l < 3,
        })
        .collect();
    build_blob(&BlobSpec {
        recipe: shared_dsp::recipe::Recipe::Raw,
        axes: 9,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: ["idle", "up-down", "to-fro", "left-right", "rectangle", "rectangle-flat", "circle"]
            .map(String::from)
            .to_vec(),
        scaling: vec![(1.0, 0.0); 117],
        layers,
    })
    .expect("a valid model")
}
