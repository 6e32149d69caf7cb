//! What an image takes that computes nothing.
#![no_std]
#![no_main]

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    bench_m4f::exit();
}
