//! Passes the memory layout of the selected variant to the linker.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let has = |feature| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    let layout = match (has("XIAO"), has("BLE"), has("TROUBLE")) {
        (true, true, _) => "src/boards/xiao.x",
        (true, false, _) => "src/boards/xiao-trouble.x",
        (false, true, _) => "src/boards/nano33-s140.x",
        (false, false, true) => "src/boards/nano33-trouble.x",
        (false, false, false) => "src/boards/nano33-bootloader.x",
    };
    fs::copy(layout, out.join("memory.x")).expect("the memory layout is readable");
    // Loads the model trained on simulated wearers (models/bundled) in the format that the board reads.
    let blob = models::bundled::blob().expect("the bundled model is intact");
    fs::write(out.join("model.blob"), blob).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed={layout}");
    println!("cargo:rerun-if-changed=build.rs");
    // Page alignment of segments helps only on hosted systems. Here it would move the image in flash.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
}
