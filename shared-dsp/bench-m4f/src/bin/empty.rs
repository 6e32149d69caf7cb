//! An image that computes nothing. Sizes of other images are compared with it.
#![no_std]
#![no_main]

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    bench_m4f::exit();
}
