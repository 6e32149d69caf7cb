//! Why the board started, the watchdog, and what happens when the program fails.
//!
//! **The trap.** After a watchdog reset the watchdog goes on running at 16 ms. The old bootloader of
//! many Nanos never stops it and waits for more than a second: it is reset again and again until
//! somebody pulls the plug. So where that bootloader is found in flash, the watchdog only interrupts,
//! and the interrupt restarts the program by a jump to 0, past the bootloader. A program that hangs
//! with interrupts off is not caught there: the board is silent, which stops the robot, until the
//! laptop opens the port again (that pulls the reset line). Elsewhere the watchdog interrupts first, which leaves
//! word, and resets at its next time-out.
//!
//! **What stays unsaid.** Under Optiboot, which hides the reason of a reset, a program that hangs with interrupts off is reset
//! like any other, but that start looks like one by the reset button and is not reported. Its boot id is new.

use avr_device::atmega328p::Peripherals;
use core::arch::asm;
use core::mem::MaybeUninit;
use core::ptr::{addr_of, addr_of_mut};

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power, the reset button, or the serial port being opened.
    Ordinary,
    /// The watchdog.
    Watchdog,
    /// A panic.
    Panic,
}

/// What a restart leaves in RAM for the next start. (Registers would not do: a reset clears them, and Optiboot clears
/// MCUSR, which says why there was one, before it starts the program.)
#[repr(C)]
#[derive(Clone, Copy)]
struct Kept {
    magic: [u8; 2],
    /// One of the marks below; 0 for a start that was not announced.
    cause: u8,
    /// Starts since the last power-up, wrapping.
    starts: u8,
    check: u8,
}

const MAGIC: [u8; 2] = [0x3A, 0xC5];
const MARK_WATCHDOG: u8 = 0x57;
const MARK_PANIC: u8 = 0x50;
/// MCUSR: the watchdog reset flag.
const WDRF: u8 = 1 << 3;

impl Kept {
    fn new(cause: u8, starts: u8) -> Self {
        Self { magic: MAGIC, cause, starts, check: !(cause ^ starts) }
    }

    /// `None` after a power-up, when RAM has arbitrary content.
    fn load() -> Option<Self> {
        // Safety: bytes, of which any value is one, and nobody else touches them.
        let kept = unsafe { addr_of!(KEPT).cast::<Self>().read_volatile() };
        (kept.magic == MAGIC && kept.check == !(kept.cause ^ kept.starts)).then_some(kept)
    }

    fn store(self) {
        // Safety: as above.
        unsafe { addr_of_mut!(KEPT).cast::<Self>().write_volatile(self) }
    }
}

/// The start code leaves this section alone, and so do both bootloaders.
#[unsafe(link_section = ".noinit")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Leaves a mark for the next start.
fn leave(cause: u8) {
    Kept::new(cause, starts()).store();
}

/// Stops the watchdog, before anything else, and returns why the board started.
pub fn begin() -> Cause {
    avr_device::interrupt::disable();
    // Safety: nothing else runs yet.
    let dp = unsafe { Peripherals::steal() };
    let reset_flags = dp.CPU.mcusr.read().bits();
    // WDRF holds the watchdog on, so it goes first. Some bootloaders have cleared it already.
    dp.CPU.mcusr.write(|w| unsafe { w.bits(0) });
    set_watchdog(0);
    let kept = Kept::load();
    Kept::new(0, kept.map_or(0, |kept| kept.starts.wrapping_add(1))).store();
    match kept.map(|kept| kept.cause) {
        Some(MARK_PANIC) => Cause::Panic,
        Some(MARK_WATCHDOG) => Cause::Watchdog,
        _ if reset_flags & WDRF != 0 => Cause::Watchdog,
        _ => Cause::Ordinary,
    }
}

/// Starts since the last power-up, this one not counted, wrapping.
pub fn starts() -> u8 {
    Kept::load().map_or(0, |kept| kept.starts)
}

/// Starts the watchdog: after 0.25 s an interrupt, and after as long again a reset, unless that leads into the old
/// bootloader's trap.
pub fn arm() {
    const WDIE: u8 = 1 << 6;
    const WDE: u8 = 1 << 3;
    const QUARTER_SECOND: u8 = 4;
    let mode = if has_old_bootloader() { WDIE } else { WDIE | WDE };
    set_watchdog(mode | QUARTER_SECOND);
}

/// The old bootloader starts at 0x7800; the new one at 0x7E00, with erased flash below.
fn has_old_bootloader() -> bool {
    let (low, high): (u8, u8);
    // Safety: reads two bytes of flash.
    unsafe {
        asm!("lpm {low}, Z+", "lpm {high}, Z", low = out(reg) low, high = out(reg) high,
            inout("Z") 0x7800u16 => _);
    }
    low & high != 0xFF
}

/// Tells the watchdog that all is well.
pub fn all_is_well() {
    avr_device::asm::wdr();
}

fn set_watchdog(value: u8) {
    const WDCE_WDE: u8 = 0x18;
    avr_device::asm::wdr();
    // The change must follow its permission within four cycles.
    // Safety: two stores to WDTCSR (0x60), interrupts off.
    unsafe {
        asm!("sts 0x60, {permit}", "sts 0x60, {value}",
            permit = in(reg) WDCE_WDE, value = in(reg) value);
    }
}

/// Restarts the program without a reset. Every module's `start` sets its registers whole, so what
/// the old run left in them does not matter.
fn restart(mark: u8) -> ! {
    avr_device::interrupt::disable();
    // Safety: interrupts are off, and nothing of this run goes on.
    let dp = unsafe { Peripherals::steal() };
    dp.ADC.adcsra.write(|w| unsafe { w.bits(0) });
    dp.TC1.timsk1.write(|w| unsafe { w.bits(0) });
    dp.USART0.ucsr0b.write(|w| unsafe { w.bits(0) });
    leave(mark);
    set_watchdog(0);
    unsafe { asm!("jmp 0", options(noreturn)) }
}

#[avr_device::interrupt(atmega328p)]
fn WDT() {
    if has_old_bootloader() {
        restart(MARK_WATCHDOG)
    }
    leave(MARK_WATCHDOG);
    // The next time-out resets.
    loop {
        core::hint::spin_loop();
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    restart(MARK_PANIC)
}
