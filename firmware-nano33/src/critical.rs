//! Critical sections of the image without a radio: one core, so masking interrupts suffices.
//!
//! The images with Bluetooth get theirs from the radio's library. The crate `cortex-m` could provide this one, but then it
//! and all crates above it would be built a second time for this image.

use cortex_m::interrupt;
use cortex_m::register::primask;

struct SingleCore;
critical_section::set_impl!(SingleCore);

// SAFETY: there is one core, and interrupts are enabled again only by the outermost section.
unsafe impl critical_section::Impl for SingleCore {
    unsafe fn acquire() -> bool {
        let was_enabled = primask::read().is_active();
        interrupt::disable();
        was_enabled
    }

    unsafe fn release(was_enabled: bool) {
        if was_enabled {
            // SAFETY: interrupts were enabled when the section began.
            unsafe { interrupt::enable() };
        }
    }
}
