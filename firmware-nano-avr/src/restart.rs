//! Why the board started, the watchdog, and what happens when the program fails.
//!
//! **The trap.** After a watchdog reset the watchdog goes on running at 16 ms. The old bootloader of
//! many Nanos never stops it and waits for more than a second: it is reset again and again until
//! somebody pulls the plug. So where that bootloader is found in flash, the watchdog only interrupts,
//! and the interrupt restarts the program by a jump to 0, past the bootloader. A program that hangs
//! with interrupts off is not caught there: the board is silent, which stops the robot, until the
//! laptop opens the port again (that pulls the reset line). Elsewhere the watchdog resets.

use avr_device::atmega328p::Peripherals;
use core::arch::asm;

/// What led to this start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power, the reset button, or the serial port being opened.
    Ordinary,
    /// The watchdog.
    Watchdog,
    /// A panic.
    Panic,
}

/// Left in GPIOR0, which a restart by jump keeps and a reset clears.
const MARK_WATCHDOG: u8 = 0x57;
const MARK_PANIC: u8 = 0x50;
/// MCUSR: the watchdog reset flag.
const WDRF: u8 = 1 << 3;

/// Stops the watchdog, before anything else, and tells why the board started.
///
/// The count of restarts by jump since the last reset stays in GPIOR1 (see [`restarts`]).
pub fn begin() -> Cause {
    avr_device::interrupt::disable();
    // Safety: nothing else runs yet.
    let dp = unsafe { Peripherals::steal() };
    let reset_flags = dp.CPU.mcusr.read().bits();
    // WDRF holds the watchdog on, so it goes first. Some bootloaders have cleared it already.
    dp.CPU.mcusr.write(|w| unsafe { w.bits(0) });
    set_watchdog(0);
    let mark = dp.CPU.gpior0.read().bits();
    dp.CPU.gpior0.write(|w| w.bits(0));
    match mark {
        MARK_PANIC => Cause::Panic,
        MARK_WATCHDOG => Cause::Watchdog,
        _ if reset_flags & WDRF != 0 => Cause::Watchdog,
        _ => Cause::Ordinary,
    }
}

/// Restarts by jump since the last reset.
pub fn restarts() -> u8 {
    // Safety: a register that only this module writes.
    unsafe { Peripherals::steal() }.CPU.gpior1.read().bits()
}

/// Starts the watchdog: after 0.25 s a reset, or where the old bootloader would trap it, an interrupt.
pub fn arm() {
    const WDIE: u8 = 1 << 6;
    const WDE: u8 = 1 << 3;
    const QUARTER_SECOND: u8 = 4;
    let mode = if has_old_bootloader() { WDIE } else { WDE };
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

/// Starts the program anew without a reset. Every module's `start` sets its registers whole, so what
/// the old run left in them does not matter.
fn restart(mark: u8) -> ! {
    avr_device::interrupt::disable();
    // Safety: interrupts are off, and nothing of this run goes on.
    let dp = unsafe { Peripherals::steal() };
    dp.ADC.adcsra.write(|w| unsafe { w.bits(0) });
    dp.TC1.timsk1.write(|w| unsafe { w.bits(0) });
    dp.USART0.ucsr0b.write(|w| unsafe { w.bits(0) });
    dp.CPU.gpior0.write(|w| w.bits(mark));
    let restarts = restarts().wrapping_add(1);
    dp.CPU.gpior1.write(|w| w.bits(restarts));
    set_watchdog(0);
    unsafe { asm!("jmp 0", options(noreturn)) }
}

#[avr_device::interrupt(atmega328p)]
fn WDT() {
    restart(MARK_WATCHDOG)
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    restart(MARK_PANIC)
}
