//! Converts the reference figures to bytes, which the images include.

#[path = "../tests/common/mod.rs"]
mod common;

use std::path::{Path, PathBuf};

fn main() {
    let out = PathBuf::from(std::env::var("OUT_DIR").unwrap());
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(out.join(name), bytes).unwrap();
    let mut spec = common::reference_spec();
    write("raw.blob", shared_dsp::right::network::build_blob(&spec).unwrap());
    write("rows.blob", shared_dsp::right::network::build_blob(&common::per_row_spec()).unwrap());
    spec.recipe = shared_dsp::right::kind::FeatureKind::LogPower;
    write("log.blob", shared_dsp::right::network::build_blob(&spec).unwrap());
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
