//! Parses a model and runs it once. Its size minus the size of `empty` is the flash that the network needs.
#![no_std]
#![no_main]

use core::hint::black_box;
use shared_dsp::right::network::Model;

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    let mut scores = [0; 7];
    if let Ok(model) = Model::parse(bench_m4f::bytes!("raw.blob")) {
        let _ = model.infer(black_box(&[1; 117]), &mut scores);
    }
    black_box(scores);
    bench_m4f::exit();
}
