//! Support for a Cortex-M4F without an operating system: start-up, an instruction counter, and text output to the host.
#![no_std]

use core::fmt::{self, Write};

/// Bytes aligned to a multiple of 4, as on a board.
#[repr(C, align(4))]
pub struct Aligned<T: ?Sized>(pub T);

/// Includes a file that the build script has created.
#[macro_export]
macro_rules! bytes {
    ($name:literal) => {{
        static BYTES: &$crate::Aligned<[u8]> =
            &$crate::Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/", $name)));
        &BYTES.0
    }};
}

core::arch::global_asm!(
    ".section .text.reset,\"ax\",%progbits",
    ".global reset",
    ".thumb_func",
    "reset:",
    "movw r0, #0xED88", // CPACR: switch the FPU on
    "movt r0, #0xE000",
    "ldr r1, [r0]",
    "orr r1, r1, #0xF00000",
    "str r1, [r0]",
    "dsb",
    "isb",
    "ldr r0, =bss_start",
    "ldr r1, =bss_end",
    "movs r2, #0",
    "2: cmp r0, r1",
    "bhs 3f",
    "str r2, [r0], #4",
    "b 2b",
    "3: bl main",
    "b .",
    ".ltorg",
    ".text",
);

const TIMER: *mut u32 = 0x4000_0000 as *mut u32;
/// The timer runs at 25 MHz, and an instruction takes 1024 ns (`-icount shift=10`).
const TICKS_PER_INSTRUCTION: f64 = 25.6;

/// Starts the timer.
pub fn start_timer() {
    // SAFETY: these are the value, reload and control registers of the CMSDK timer.
    unsafe {
        TIMER.add(1).write_volatile(u32::MAX);
        TIMER.add(2).write_volatile(u32::MAX);
        TIMER.write_volatile(1);
    }
}

#[inline(always)]
fn ticks() -> u32 {
    // SAFETY: this is the value register of the CMSDK timer, which counts down.
    unsafe { TIMER.add(1).read_volatile() }
}

fn raw_count(work: impl FnOnce()) -> u32 {
    let before = ticks();
    work();
    let after = ticks();
    (f64::from(before.wrapping_sub(after)) / TICKS_PER_INSTRUCTION + 0.5) as u32
}

/// Returns the number of instructions that `work` executes.
#[inline(always)]
pub fn count(work: impl FnOnce()) -> u32 {
    let before = ticks();
    work();
    let after = ticks();
    (f64::from(before.wrapping_sub(after)) / TICKS_PER_INSTRUCTION + 0.5) as u32 - 1
}

/// Counts the instructions of a loop (1000 × 2 + 1), to check the counter itself.
pub fn calibration() -> u32 {
    raw_count(|| {
        // SAFETY: the loop uses only a register.
        unsafe {
            core::arch::asm!("mov {0}, #1000", "4: subs {0}, #1", "bne 4b", out(reg) _, options(nomem, nostack));
        }
    })
}

fn semihosting(operation: u32, argument: u32) {
    // SAFETY: this calls a semihosting service, which QEMU provides.
    unsafe {
        core::arch::asm!("bkpt #0xAB", inout("r0") operation => _, in("r1") argument, options(nostack));
    }
}

/// Writes text to the host's output.
pub struct Host;

impl Write for Host {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for chunk in text.as_bytes().chunks(127) {
            let mut buffer = [0u8; 128];
            buffer[..chunk.len()].copy_from_slice(chunk);
            semihosting(4, buffer.as_ptr().addr() as u32);
        }
        Ok(())
    }
}

/// Ends the emulation.
pub fn exit() -> ! {
    semihosting(0x18, 0x20026);
    loop {}
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    let _ = info;
    semihosting(0x18, 0x20023);
    loop {}
}

const PAINT: u32 = 0x5AA5_C33C;

/// Returns the stack use of `work` in bytes, by painting 4 KB below the stack pointer.
#[inline(never)]
pub fn stack_of(work: impl FnOnce()) -> usize {
    const WORDS: usize = 4096;
    let mut here = 0u32;
    let top = core::ptr::addr_of_mut!(here).addr() & !3;
    let bottom = (top - 64 - 4 * WORDS) as *mut u32;
    // SAFETY: the stack below this frame is unused. Volatile accesses keep their order.
    unsafe {
        for index in 0..WORDS {
            bottom.add(index).write_volatile(PAINT);
        }
    }
    work();
    // SAFETY: as above.
    let untouched = unsafe { (0..WORDS).take_while(|&i| bottom.add(i).read_volatile() == PAINT).count() };
    let stack: usize;
    // SAFETY: this only reads the stack pointer.
    unsafe { core::arch::asm!("mov {}, sp", out(reg) stack, options(nomem, nostack)) };
    stack - (bottom.addr() + 4 * untouched)
}
