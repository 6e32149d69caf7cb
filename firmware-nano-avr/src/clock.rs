//! The 100 Hz sample clock (TIMER1) and the time since start.

use avr_device::atmega328p::Peripherals;
use avr_device::interrupt::{self, Mutex};
use core::cell::Cell;
use shared_dsp::left::flex::permille;

/// Samples per second.
pub const SAMPLE_HZ: u16 = 100;
/// Time between two samples.
pub const PERIOD_MS: u32 = 1000 / SAMPLE_HZ as u32;
/// TIMER1 ticks per sample period, at 2 MHz.
const TICKS: u16 = (16_000_000 / 8 / SAMPLE_HZ as u32) as u16;

static PERIODS: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));
/// Number of timer ticks that the processor spent asleep since the load was last read.
static ASLEEP: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Starts the clock at 0.
pub fn start() {
    // Safety: only this module uses TIMER1, and interrupts are disabled.
    let tc1 = unsafe { Peripherals::steal() }.TC1;
    tc1.tccr1a.write(|w| unsafe { w.bits(0) });
    tc1.tccr1b.write(|w| unsafe { w.bits(0) });
    tc1.tcnt1.write(|w| w.bits(0));
    tc1.ocr1a.write(|w| w.bits(TICKS - 1));
    tc1.tifr1.write(|w| unsafe { w.bits(0xFF) });
    tc1.timsk1.write(|w| w.ocie1a().set_bit());
    // TIMER1 is cleared on compare match (WGM12), and its clock is the CPU clock / 8 (CS11).
    tc1.tccr1b.write(|w| unsafe { w.bits(0b0000_1010) });
}

#[avr_device::interrupt(atmega328p)]
fn TIMER1_COMPA() {
    interrupt::free(|cs| {
        let periods = PERIODS.borrow(cs);
        periods.set(periods.get().wrapping_add(1));
        crate::adc::begin_sample(cs);
    });
}

/// Number of sample periods since start. The counter wraps.
pub fn periods() -> u32 {
    interrupt::free(|cs| PERIODS.borrow(cs).get())
}

/// Returns TIMER1's count within the current period.
pub fn ticks_in_period() -> u16 {
    // Safety: this only reads the register. The interrupt uses the same latch for 16-bit accesses, so interrupts are disabled.
    interrupt::free(|_| unsafe { Peripherals::steal() }.TC1.tcnt1.read().bits())
}

/// Adds the time asleep since [`ticks_in_period`] returned `then`. That call must be less than one period ago.
pub fn add_sleep_since(then: u16) {
    let now = ticks_in_period();
    let slept = if now >= then { now - then } else { now + TICKS - then };
    interrupt::free(|cs| {
        let asleep = ASLEEP.borrow(cs);
        asleep.set(asleep.get().wrapping_add(u32::from(slept)));
    });
}

/// Returns the share of `periods` that the processor was awake since the last call, in parts per thousand.
pub fn take_load_permille(periods: u32) -> u16 {
    let asleep = interrupt::free(|cs| ASLEEP.borrow(cs).replace(0));
    // After division by 64, the product with 1000 fits for intervals of up to 2 seconds.
    1000u16.saturating_sub(permille(asleep >> 6, (periods * u32::from(TICKS)) >> 6))
}
