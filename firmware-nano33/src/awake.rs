//! Runs the executor and measures the processor load and the least free stack.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::{DCB, DWT};
use embassy_executor::{Spawner, raw};

/// Processor cycles per second.
pub const CYCLES_HZ: u32 = 64_000_000;

/// Runs tasks for ever and sleeps while no task is ready.
///
/// The cycle counter stops while the core sleeps.
/// The counter therefore measures the time awake, including interrupts and the SoftDevice.
/// An attached debugger may prevent the counter from stopping.
pub fn run(mut dcb: DCB, mut dwt: DWT, init: impl FnOnce(Spawner)) -> ! {
    static EXECUTOR: static_cell::StaticCell<raw::Executor> = static_cell::StaticCell::new();
    dcb.enable_trace();
    dwt.enable_cycle_counter();
    // The executor in thread mode receives this context value.
    // A task that wakes therefore sends an event, which ends the sleep below.
    let executor: &'static raw::Executor = EXECUTOR.init(raw::Executor::new(usize::MAX as *mut ()));
    start(executor.spawner(), init);
    loop {
        // SAFETY: `poll` is called only here and never from within a task.
        unsafe { executor.poll() };
        sleep();
    }
}

/// Runs the initialisation in a stack frame of its own, because the frame of [`run`] remains for ever.
#[inline(never)]
fn start(spawner: Spawner, init: impl FnOnce(Spawner)) {
    init(spawner);
}

/// Sleeps until an event.
fn sleep() {
    // nRF52840 erratum 87: a pending floating-point exception prevents the core from sleeping.
    // The exception flags are sticky, and an inexact result is enough to set a flag.
    // The code therefore clears the flags and the pending interrupt.
    // SAFETY: the exception flags of FPSCR have no other use here, and interrupt 38 (FPU) has no handler.
    unsafe {
        core::arch::asm!(
            "vmrs {0}, fpscr",
            "bic {0}, {0}, #0x9f",
            "vmsr fpscr, {0}",
            out(reg) _,
            options(nomem, nostack)
        );
        (0xE000_E284 as *mut u32).write_volatile(1 << 6);
    }
    cortex_m::asm::wfe();
}

/// Cycles awake since start. The counter wraps.
pub fn cycles() -> u32 {
    DWT::cycle_count()
}

/// Measures the share of time awake since the last call, in parts per thousand.
pub struct Load {
    cycles: u32,
    at: embassy_time::Instant,
}

impl Load {
    /// Starts to count.
    pub fn new() -> Self {
        Self { cycles: cycles(), at: embassy_time::Instant::now() }
    }

    /// Returns the share of time that the processor was awake, rounded up. Calls must be at most one minute apart.
    pub fn permille(&mut self) -> u16 {
        let (now, at) = (cycles(), embassy_time::Instant::now());
        let awake = u64::from(now.wrapping_sub(self.cycles));
        let all = (at - self.at).as_ticks() * u64::from(CYCLES_HZ) / embassy_time::TICK_HZ;
        (self.cycles, self.at) = (now, at);
        (awake * 1000).div_ceil(all.max(1)).min(1000) as u16
    }
}

const PAINT: u32 = 0x57AC_57AC;
/// The used stack may contain a few words that equal the pattern.
/// Only a run of this many words therefore counts as never used.
const RUN: usize = 64;
static LEAST_FREE: AtomicU32 = AtomicU32::new(u32::MAX);

unsafe extern "C" {
    static mut __sheap: u32;
}

/// Fills the free stack with a pattern. Call this once, early in the start.
pub fn paint_stack() {
    let mut word = &raw mut __sheap;
    let end = (cortex_m::register::msp::read() - 256) as *mut u32;
    while word < end {
        // SAFETY: the memory between the statics and the stack pointer is unused, because the firmware has no heap.
        unsafe {
            word.write_volatile(PAINT);
            word = word.add(1);
        }
    }
}

/// Returns the minimum free stack since start, in bytes.
pub fn free_stack_bytes() -> u32 {
    let bottom = (&raw const __sheap) as usize;
    let top = match LEAST_FREE.load(Ordering::Relaxed) {
        u32::MAX => cortex_m::register::msp::read() as usize,
        free => bottom + free as usize,
    };
    let mut used = top;
    let mut run = 0;
    let mut at = top;
    while at > bottom && run < RUN {
        at -= 4;
        // SAFETY: as in the function above. The ends of statics and stack are aligned, so the address is too.
        if unsafe { (at as *const u32).read_volatile() } == PAINT {
            run += 1;
        } else {
            run = 0;
            used = at;
        }
    }
    let free = (used - bottom) as u32;
    LEAST_FREE.store(free, Ordering::Relaxed);
    free
}
