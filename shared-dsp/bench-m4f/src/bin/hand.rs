//! Runs features, network and decision of recipe `aligned` with nine axes.
//! Its size minus the size of `empty` is the flash that these need, with the smallest network.
#![no_std]
#![no_main]

use core::hint::black_box;
use shared_dsp::right::aligned::AlignedWindow;
use shared_dsp::right::movement::{MovementConfig, MovementDecision};
use shared_dsp::right::network::Model;

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    if let Ok(model) = Model::parse(bench_m4f::bytes!("20-10.blob")) {
        let mut window = AlignedWindow::<9>::new();
        let mut decision = MovementDecision::new(model.info().labels(), MovementConfig::for_axes(9));
        let mut scores = [0i8; 8];
        // Without `black_box`, the compiler would see that one sample does not fill the window.
        if black_box(&mut window).push(black_box(&[1.0; 9])) {
            let _ = model.classify_features(window.features(), &mut scores);
            black_box(decision.step(&scores, None, window.movement()));
        }
    }
    bench_m4f::exit();
}
