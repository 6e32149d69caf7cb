//! Determines why the board started, runs the watchdog, and handles a failure of the program.
//!
//! **The bootloader trap.** After a watchdog reset the watchdog keeps running with a time-out of 16 ms.
//! The old bootloader of many Nanos never stops the watchdog and waits for more than a second.
//! The watchdog therefore resets such a board repeatedly until the power is disconnected.
//! If the firmware finds the old bootloader in flash, its watchdog only raises an interrupt.
//! The interrupt restarts the program by a jump to address 0, past the bootloader.
//! This method does not help if a program hangs with interrupts disabled.
//! Such a board is silent, which stops the robot. When the laptop reopens the port, it pulls the reset line.
//! With any other bootloader, the watchdog first raises an interrupt, which stores the reason.
//! At its next time-out after the interrupt, the watchdog resets the board.
//!
//! **A reset that is not reported.** Optiboot hides the reason of a reset.
//! Under Optiboot, a program that hangs with interrupts disabled is reset too.
//! The board cannot distinguish that start from a press of the reset button and does not report it.
//! Such a start still gets a new boot id.

use avr_device::atmega328p::Peripherals;
use core::arch::asm;
use core::mem::MaybeUninit;
use core::ptr::{addr_of, addr_of_mut};

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The board was powered up, the reset button was pressed, or the laptop opened the serial port.
    Ordinary,
    /// The watchdog.
    Watchdog,
    /// A panic.
    Panic,
}

/// Data in RAM that a restart passes to the next start.
/// Registers are unsuitable: a reset clears them, and Optiboot clears MCUSR before it starts the program.
#[repr(C)]
#[derive(Clone, Copy)]
struct Kept {
    magic: [u8; 2],
    /// One of the marks below, or 0 if the previous run left no mark.
    cause: u8,
    /// Number of starts since the last power-up. The counter wraps.
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

    /// Returns `None` after a power-up, when the content of RAM is arbitrary.
    fn load() -> Option<Self> {
        // Safety: every byte value is valid for this type, and no other code accesses the memory.
        let kept = unsafe { addr_of!(KEPT).cast::<Self>().read_volatile() };
        (kept.magic == MAGIC && kept.check == !(kept.cause ^ kept.starts)).then_some(kept)
    }

    fn store(self) {
        // Safety: as above.
        unsafe { addr_of_mut!(KEPT).cast::<Self>().write_volatile(self) }
    }
}

/// The start code does not initialise this section, and neither bootloader uses it.
#[unsafe(link_section = ".noinit")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Stores a mark that the next start reads.
fn leave(cause: u8) {
    Kept::new(cause, starts()).store();
}

/// Stops the watchdog before other code runs, and returns why the board started.
pub fn begin() -> Cause {
    avr_device::interrupt::disable();
    // Safety: no other code runs yet.
    let dp = unsafe { Peripherals::steal() };
    let reset_flags = dp.CPU.mcusr.read().bits();
    // While WDRF is set, the watchdog cannot be disabled, so WDRF must be cleared first.
    // Some bootloaders have already cleared WDRF.
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

/// Number of earlier starts since the last power-up. The counter wraps.
pub fn starts() -> u8 {
    Kept::load().map_or(0, |kept| kept.starts)
}

/// Starts the watchdog, which raises an interrupt after 0.25 s and resets the board after another 0.25 s.
/// The reset is omitted if the old bootloader would then reset the board repeatedly.
pub fn arm() {
    const WDIE: u8 = 1 << 6;
    const WDE: u8 = 1 << 3;
    const QUARTER_SECOND: u8 = 4;
    let mode = if has_old_bootloader() { WDIE } else { WDIE | WDE };
    set_watchdog(mode | QUARTER_SECOND);
}

/// The old bootloader starts at 0x7800.
/// The new bootloader starts at 0x7E00 and leaves the flash below it erased.
fn has_old_bootloader() -> bool {
    let (low, high): (u8, u8);
    // Safety: this only reads two bytes of flash.
    unsafe {
        asm!("lpm {low}, Z+", "lpm {high}, Z", low = out(reg) low, high = out(reg) high,
            inout("Z") 0x7800u16 => _);
    }
    low & high != 0xFF
}

/// Resets the watchdog timer.
pub fn all_is_well() {
    avr_device::asm::wdr();
}

fn set_watchdog(value: u8) {
    const WDCE_WDE: u8 = 0x18;
    avr_device::asm::wdr();
    // WDTCSR must be written within four cycles after its change is enabled.
    // Safety: this performs two stores to WDTCSR (0x60) with interrupts disabled.
    unsafe {
        asm!("sts 0x60, {permit}", "sts 0x60, {value}",
            permit = in(reg) WDCE_WDE, value = in(reg) value);
    }
}

/// Restarts the program without a reset.
/// Register values from the old run have no effect, because the `start` function of every module writes all its registers.
fn restart(mark: u8) -> ! {
    avr_device::interrupt::disable();
    // Safety: interrupts are disabled, and no code of the previous run continues.
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
    // The next watchdog time-out resets the board.
    loop {
        core::hint::spin_loop();
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    restart(MARK_PANIC)
}
