//! Detects the DSP and FPU instructions of a Cortex-M4F, because stable `cfg(target_feature)` cannot.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(cortex_m4f)");
    if std::env::var("TARGET").is_ok_and(|target| target == "thumbv7em-none-eabihf") {
        println!("cargo::rustc-cfg=cortex_m4f");
    }
}
