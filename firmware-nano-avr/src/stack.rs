//! How much stack was never used: painted at start, counted once per second.

use core::arch::asm;
use core::ptr::{addr_of, addr_of_mut};

const PAINT: u8 = 0xC5;
/// Not painted: the frame of the painter.
const IN_USE: usize = 32;

unsafe extern "C" {
    /// Where static memory ends, from the linker.
    static mut __heap_start: u8;
}

fn stack_pointer() -> usize {
    let (low, high): (u8, u8);
    // Safety: reads SPL and SPH.
    unsafe {
        asm!("in {low}, 0x3D", "in {high}, 0x3E", low = out(reg) low, high = out(reg) high);
    }
    usize::from(high) << 8 | usize::from(low)
}

/// Paints what lies between static memory and the present stack.
#[inline(never)]
pub fn paint() {
    let end = stack_pointer() - IN_USE;
    let mut at = addr_of_mut!(__heap_start);
    while (at as usize) < end {
        // Safety: nobody owns the memory between the statics and the stack.
        unsafe {
            at.write_volatile(PAINT);
            at = at.add(1);
        }
    }
}

/// Bytes that no stack has ever reached.
pub fn least_free() -> u16 {
    let mut at = addr_of!(__heap_start);
    let mut free = 0;
    // Safety: the stack in use ends the walk, since it holds other bytes.
    while (at as usize) < stack_pointer() && unsafe { at.read_volatile() } == PAINT {
        free += 1;
        at = unsafe { at.add(1) };
    }
    free
}
