//! A program that computes one thing, or nothing.
//! The difference of two sizes is the flash that the computation takes.
//!
//! Inputs are read and results are written with volatile accesses, so that the compiler cannot omit anything.
#![no_std]
#![no_main]

use core::ptr::{read_volatile, write_volatile};

use shared_dsp::left::tilt::{Acceleration, Tilt};

static mut ACCELERATION: Acceleration = Acceleration { x: 1, y: 2, z: 3 };
static mut TILT_MRAD: Tilt = Tilt { pitch_mrad: 0, roll_mrad: 0 };
static mut NUMBER: f32 = 1.0;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

/// Repeats the computation forever.
#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    loop {
        // SAFETY: no other code uses these variables, because there are no threads and no interrupts.
        let (acceleration, number) =
            unsafe { (read_volatile(&raw const ACCELERATION), read_volatile(&raw const NUMBER)) };
        let (tilt, number) = compute(acceleration, number);
        // SAFETY: as above.
        unsafe {
            write_volatile(&raw mut TILT_MRAD, tilt);
            write_volatile(&raw mut NUMBER, number);
        }
    }
}

#[cfg(feature = "our-tilt")]
fn compute(a: Acceleration, number: f32) -> (Tilt, f32) {
    (Tilt::of(a), number)
}

#[cfg(feature = "micromath-tilt")]
fn compute(a: Acceleration, number: f32) -> (Tilt, f32) {
    use micromath::F32;
    let angle_mrad = |along: i16, [side, up]: [i16; 2]| {
        let [along, side, up] = [along, side, up].map(|axis| F32(f32::from(axis)));
        (along.atan2((side * side + up * up).sqrt()) * F32(1000.0)).0 as i16
    };
    (Tilt { pitch_mrad: angle_mrad(a.x, [a.y, a.z]), roll_mrad: angle_mrad(a.y, [a.x, a.z]) }, number)
}

#[cfg(feature = "our-logarithm")]
fn compute(a: Acceleration, number: f32) -> (Tilt, f32) {
    use shared_dsp::right::kind::FeatureKind;
    (Tilt { pitch_mrad: a.x, roll_mrad: a.y }, FeatureKind::LogPower.transform(1, number))
}

#[cfg(feature = "micromath-logarithm")]
fn compute(a: Acceleration, number: f32) -> (Tilt, f32) {
    (Tilt { pitch_mrad: a.x, roll_mrad: a.y }, micromath::F32(number).log10().0)
}

#[cfg(not(any(
    feature = "our-tilt",
    feature = "micromath-tilt",
    feature = "our-logarithm",
    feature = "micromath-logarithm"
)))]
fn compute(a: Acceleration, number: f32) -> (Tilt, f32) {
    (Tilt { pitch_mrad: a.x, roll_mrad: a.y }, number)
}
