//! Computes features.
//! Its size minus the size of `empty` is the flash that the features need, and .bss is their RAM.
#![no_std]
#![no_main]

use core::hint::black_box;
use shared_dsp::right::features::FeatureWindow;

static mut WINDOW: FeatureWindow<9> = FeatureWindow::new();

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    // SAFETY: this is the only reference to the static.
    let window = unsafe { &mut *core::ptr::addr_of_mut!(WINDOW) };
    while !window.push(black_box(&[1.0; 9])) {}
    black_box(window.features());
    bench_m4f::exit();
}
