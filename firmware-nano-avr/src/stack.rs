//! Measures the unused stack.
//! The memory is painted at start, and the untouched part is counted once per second.

use core::arch::asm;
use core::ptr::{addr_of, addr_of_mut};

const PAINT: u8 = 0xC5;
/// The stack frame of the painting function itself is not painted.
const IN_USE: usize = 32;

unsafe extern "C" {
    /// The end of static memory, defined by the linker.
    static mut __heap_start: u8;
}

fn stack_pointer() -> usize {
    let (low, high): (u8, u8);
    // Safety: this only reads SPL and SPH.
    unsafe {
        asm!("in {low}, 0x3D", "in {high}, 0x3E", low = out(reg) low, high = out(reg) high);
    }
    usize::from(high) << 8 | usize::from(low)
}

/// Paints the memory between the statics and the current stack pointer.
#[inline(never)]
pub fn paint() {
    let end = stack_pointer() - IN_USE;
    let mut at = addr_of_mut!(__heap_start);
    while (at as usize) < end {
        // Safety: no variable occupies the memory between the statics and the stack.
        unsafe {
            at.write_volatile(PAINT);
            at = at.add(1);
        }
    }
}

/// Number of bytes that the stack has never used.
pub fn least_free() -> u16 {
    let mut at = addr_of!(__heap_start);
    let mut free = 0;
    // Safety: the loop ends at the used part of the stack, which contains other values.
    while (at as usize) < stack_pointer() && unsafe { at.read_volatile() } == PAINT {
        free += 1;
        at = unsafe { at.add(1) };
    }
    free
}
