//! An image that computes nothing, used as the baseline for sizes.
#![no_std]
#![no_main]

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    bench_m4f::exit();
}
